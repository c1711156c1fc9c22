"""Each defect that is planted into a driver is named by the check that is meant for it."""

import importlib.util
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import TypeAlias

import pytest

from armimp_bringup.driver_check.findings import Finding, Verdict, with_verdict

pytestmark = pytest.mark.slow

STREAMS = ("joint_states", "torque_sensors")
Host: TypeAlias = Callable[..., None]
Check = Callable[..., dict[str, Finding]]


def _defects() -> ModuleType:
    path = Path(__file__).resolve().parent / "defective_driver.py"
    spec = importlib.util.spec_from_file_location("defective_driver", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


DEFECTS = _defects()


def names(findings: dict[str, Finding]) -> list[str]:
    return with_verdict(findings.values(), Verdict.FAIL)


@pytest.mark.parametrize(
    ("defect", "expected"),
    [
        ("BestEffort", ["joint_states: quality of service"]),
        ("TwoForOne", [f"{topic}: rate" for topic in STREAMS]),
        ("Faulty", ["no fault at rest"]),
        ("NoStop", ["service arm_sim/emergency_stop"]),
        ("DeafStop", ["emergency stop: told"]),
        ("Mute", ["emergency stop: told"]),
        ("Stubborn", ["emergency stop: reset"]),
    ],
)
def test_a_defect_that_shows_without_torque_is_named_and_nothing_else(
    host: Host, check: Check, defect: str, expected: list[str]
) -> None:
    host(getattr(DEFECTS, defect), mode="lockstep")
    assert names(check()) == expected


@pytest.mark.parametrize(
    ("defect", "expected"),
    [
        ("Swapped", ["torque: joint and sign"]),
        ("Strong", ["torque: motion"]),
        ("Moody", ["torque: no stop"]),
        ("Gullible", ["second publisher: told"]),
        ("DeafStop", ["emergency stop", "emergency stop: told"]),
    ],
)
def test_a_defect_that_shows_under_torque_is_named_and_nothing_else(
    host: Host, check: Check, defect: str, expected: list[str]
) -> None:
    host(getattr(DEFECTS, defect), mode="lockstep")
    assert names(check(move=True)) == expected


def test_when_a_rig_moves_too_far_expect_its_emergency_stop_to_be_called_and_not_reset(
    host: Host, check: Check
) -> None:
    host(DEFECTS.Strong, mode="lockstep")
    moved = check(move=True)["torque: motion"]
    assert "torque taken away" in moved.figure
    assert check()["no fault at rest"].figure == "arm_sim: rig: emergency stop"


def test_transducers_that_are_too_coarse_are_named(host: Host, check: Check) -> None:
    host(DEFECTS.ArmSimNode, mode="lockstep", sensors__torque__resolution=0.05)
    assert names(check(move=True)) == ["torque_sensors: resolution"]
