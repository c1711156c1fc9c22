"""`armimp check-driver` on the bridge, in front of a robot as ros2_control shows it."""

from collections.abc import Callable
from pathlib import Path

import pytest

from armimp_bringup.driver_check.findings import Finding, Verdict, with_verdict
from support.stalls import StallWitness

pytestmark = [pytest.mark.alone, pytest.mark.slow]

ROBOT = str(Path(__file__).resolve().parent / "fake_ros2_control.py")
BRIDGE = ["-m", "armimp_ros2_control.node"]
NAMES = ["-p", "names:=[exo_shoulder, exo_elbow]"]
PACE = ("rate", "jitter", "sample to command")
"""How regular samples are, and how quick answers, depends on what else the machine does."""
HELD_UP = "joint_states: nothing for 10 ms"
"""A fault of the bridge when the robot's process stands still, after which it obeys nobody."""
STALL = 0.005
"""Half of what the bridge bears (s), as three processes are held up one after another."""
Start = Callable[..., None]
Check = Callable[..., dict[str, Finding]]


def but_for_pace(names: list[str]) -> list[str]:
    return [name for name in names if name.rpartition(": ")[2] not in PACE]


def test_the_bridge_in_front_of_ros2_control_passes_every_check_with_torque(
    start: Start, check: Check, witness: StallWitness
) -> None:
    start([ROBOT])
    start(BRIDGE, *NAMES)
    for _ in range(4):
        findings = check(move=True)
        wrong = but_for_pace(with_verdict(findings.values(), Verdict.FAIL))
        # What the machine has spoiled, which holds up three processes here, is looked at once more.
        if not wrong and not but_for_pace(with_verdict(findings.values(), Verdict.INCONCLUSIVE)):
            break
    told = {name: findings[name].figure for name in wrong}
    if HELD_UP in told.get("no fault at rest", "") and witness.longest > STALL:
        pytest.skip(f"the machine stood still for {1e3 * witness.longest:.0f} ms")
    assert told == {}
    for name in (
        "torque: joint and sign",
        "torque_sensors: sign",
        "torque: delay",
        "stale commands",
        "stale commands: told",
        "stale commands: latched",
        "emergency stop",
        "emergency stop: told",
        "emergency stop: reset",
        "joint_states: stamps 1 ms apart",
        "pairs",
    ):
        assert findings[name].verdict.value == "pass", findings[name]
