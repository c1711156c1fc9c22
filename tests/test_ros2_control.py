"""`armimp check-driver` on the bridge, in front of a robot as ros2_control shows it.

Robot, bridge and checker are three processes in real time. What depends on how much of it the
machine gives them, `armimp check-driver` judges and no test: pace, and torque under watchdogs.
"""

from collections.abc import Callable
from pathlib import Path

import pytest

from armimp_bringup.driver_check import Finding, Outcome

pytestmark = pytest.mark.slow

ROBOT = str(Path(__file__).resolve().parent / "fake_ros2_control.py")
BRIDGE = ["-m", "armimp_ros2_control.node"]
NAMES = ["-p", "names:=[exo_shoulder, exo_elbow]"]
STREAMS = ("joint_states", "torque_sensors")
Start = Callable[..., None]
Check = Callable[..., dict[str, Finding]]


def test_the_bridge_in_front_of_ros2_control_keeps_the_contract_of_a_driver(
    start: Start, check: Check
) -> None:
    start([ROBOT])
    start(BRIDGE, *NAMES)
    findings = check()
    expected = {f"service arm_sim/{name}" for name in ("emergency_stop", "reset")} | {"pairs"}
    for topic in (*STREAMS, "effort_controller/commands"):
        expected |= {f"{topic}: type", f"{topic}: quality of service"}
    for name in ("joint names", "field", "finite", "range", "stamps increase", "clock"):
        expected |= {f"{topic}: {name}" for topic in STREAMS}
    passed = {name for name, one in findings.items() if one.outcome is Outcome.PASS}
    assert expected <= passed, {name: findings[name].figure for name in expected - passed}
