"""Values that make no sense are refused, and presets are those of paper and design."""

from typing import Any

import numpy as np
import pytest

from armimp_common.errors import ConfigurationError
from armimp_common.schema import build, flatten
from armimp_control import presets
from armimp_control.laws import INERTIA_MODEL
from armimp_control.parameters import ControllerParameters
from armimp_control.safety_limiter import SafetyParameters
from support.controller import controller_parameters
from support.laws import preset_law

PRESET = {**flatten(controller_parameters()), "perturbation.kind": "optimal"}
NAN, INF = float("nan"), float("inf")


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("joints", [()]),
        ("safety.torque_limit", [0.0, -80.0, NAN, INF]),
        ("safety.rate_limit", [0.0, NAN, 1599.0]),
        ("safety.power_limit", [0.0, INF]),
        ("safety.watchdog_ticks", [0, -5, 101, 10**9]),
        ("safety.ramp_time", [-0.01, 0.051, NAN]),
        ("safety.position_limit", [(1.0, 0.0), (1.0, NAN), (), (1.0,) * 3]),
        ("safety.velocity_limit", [(1.0, -0.5), (INF,)]),
        ("perturbation.peak", [(3.0, 0.0), (3.0,), (3.0, NAN)]),
        ("perturbation.cutoff", [0.0, 500.0]),
        ("sequence.duration", [0.0, -1.5, 4e-4, INF]),
        ("sequence.settle", [0.0, 0.049, NAN]),
        ("tare.duration", [0.2, 61.0, NAN]),
        ("target.posture", [(1.0, NAN)]),
        ("target.inertia", [(0.2, 0.0), (0.2,)]),
        ("target.lock_dither_frequency", [380.0]),
        ("law.model_inertia", [(1.0, 0.0, 1.0), (NAN, 0.0, 0.0, 1.0)]),
        ("known.robot_inertia", [(1.0, 2.0, 2.0, 1.0), (1.0,)]),
        ("known.arm_inertia", [(0.1, 0.0, 0.0, 0.0), (1.0,)]),
        ("known.actuator_lag", [1e-12, 0.2]),
        ("known.torque_cutoff", [1e-6, INF]),
    ],
)
def test_a_value_that_makes_no_sense_is_refused_and_named(name: str, values: list[Any]) -> None:
    group, _, short = name.partition(".")
    named = {"robot_inertia": "M_r|robot_inertia", "cutoff": "cutoff"}.get(short, short)
    for value in values:
        with pytest.raises(ConfigurationError, match=rf"{named}|'{group}'"):
            build(ControllerParameters, {**PRESET, name: value}).check()


def test_the_slowest_rate_limit_brings_the_torque_down_just_in_time() -> None:
    slow = SafetyParameters(torque_limit=80.0, rate_limit=1600.0, ramp_time=0.05)
    assert slow.rules(np.zeros(2)).shape[1] == 2
    with pytest.raises(ConfigurationError, match=r"rate_limit 1599\.0 .* 80\.0 .* within 0\.05 s"):
        slow.model_copy(update={"rate_limit": 1599.0}).rules(np.zeros(2))


@pytest.mark.parametrize(("law", "share"), [("tde", 0.7), ("observer", 0.35), ("paper", 0.0)])
def test_dither_is_a_share_of_a_count_unless_the_encoders_are_no_good(
    law: presets.LawName, share: float
) -> None:
    dither = [
        preset_law(np.eye(2), np.zeros(2), law, count).target.lock_dither
        for count in (1e-3, 0.01, 0.5)
    ]
    assert dither == pytest.approx([share * 1e-3, share * 0.01, share * 0.01])


# --- Presets of the controller: the paper's Table III, and what the design assumes --------------


@pytest.mark.parametrize(("level", "peak"), [(1, (3.0, 1.8)), (2, (6.0, 3.6)), (3, (9.0, 5.4))])
def test_peaks_are_those_of_table_three(level: int, peak: tuple[float, ...]) -> None:
    config = presets.perturbation(level, 2)
    assert config.peak == pytest.approx(peak, rel=1e-15)
    assert config.cutoff == 15.0


@pytest.mark.parametrize("n", [1, 3, 7])
def test_law_for_other_numbers_of_joints_follows_the_robot(n: int) -> None:
    root = np.random.default_rng(n).normal(size=(n, n))
    robot = root @ root.T + np.eye(n)
    config = preset_law(robot, np.zeros(n))
    target = config.target
    assert target.inertia == pytest.approx(0.56 * np.diag(robot))
    assert np.divide(target.damping, target.inertia) == pytest.approx(np.full(n, 10.0))
    assert np.divide(target.stiffness, target.inertia) == pytest.approx(np.full(n, 100.0))
    assert np.array_equal(config.model(0)[INERTIA_MODEL], robot)
