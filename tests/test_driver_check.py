"""``armimp check-driver`` and the driver template through the real graph."""

import contextlib
import functools
import io
import itertools
import random
import signal
import sys
import threading
from collections.abc import Callable
from typing import Any, ClassVar, TypeAlias

import pytest
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy, qos_profile_system_default
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from armimp_bringup.config import CheckOptions
from armimp_bringup.driver_check import Finding, Outcome
from armimp_bringup.driver_check.command import ask
from armimp_common import topics
from armimp_common.cdr import JointStateEncoder
from armimp_common.errors import ConfigurationError
from armimp_common.executor import steady_timer
from armimp_common.pubsub import CommandPublisher, JointStatePublisher
from armimp_common.status import to_time
from armimp_common.topics import PERIOD, PERIOD_NS
from armimp_ros2_control.node import EFFORTS, STATES
from armimp_sim.node import ArmSimNode
from armimp_sim.parameters import SimulatorParameters
from armimp_sim.simulator import SimulatedRig
from support.command import interrupted, program, refused
from support.graph import PATIENCE
from support.processes import wait_until

JOINTS = ("shoulder", "elbow")
STREAMS = (topics.JOINT_STATES, topics.TORQUE_SENSORS)
SIMULATOR = ["-m", "armimp_sim.node"]
TEMPLATE = ["-m", "armimp_driver_template.node"]
Start: TypeAlias = Callable[..., None]
Check: TypeAlias = Callable[..., dict[str, Finding]]
CONTRACT = {
    *(f"service arm_sim/{name}" for name in ("emergency_stop", "reset")),
    *("pairs", f"{topics.COMMANDS}: type", f"{topics.COMMANDS}: quality of service"),
    *(
        f"{topic}: {name}"
        for topic in STREAMS
        for name in ("type", "quality of service", "joint names", "field", "finite", "range")
    ),
    *(f"{topic}: {name}" for topic in STREAMS for name in ("stamps increase", "clock")),
}
"""What a sound driver passes, whatever the speed of the machine."""


def names(findings: dict[str, Finding], outcome: Outcome = Outcome.FAIL) -> list[str]:
    return [name for name, one in findings.items() if one.outcome is outcome]


@pytest.mark.slow
@pytest.mark.alone
@pytest.mark.parametrize("driver", [SIMULATOR, TEMPLATE], ids=["simulator", "template"])
def test_simulator_and_template_pass_every_check(
    start: Start, check: Check, driver: list[str]
) -> None:
    start(driver, "-p", "mode:=realtime")

    findings = check(move=True)

    passed = set(names(findings, Outcome.PASS))
    assert passed >= CONTRACT | {"lifecycle", "no fault at rest", "joint_states: jumps"}
    # Regularity depends on the machine; where it fails, later checks may be inconclusive.
    paced = (": rate", "torque: delay", "torque: no stop")
    assert not [name for name in names(findings) if not name.endswith(paced)]
    if "torque: no stop" in passed:
        paced_too = (*paced, ": jitter")
        assert [one for one in findings.keys() - passed if not one.endswith(paced_too)] == []
    assert names(findings, Outcome.NOT_CHECKED) == []
    # It was given back as it was found, so that it can be checked again.
    assert check()["lifecycle"].figure == "was unconfigured"


@pytest.mark.slow
def test_a_driver_in_a_namespace_is_found_there(host: Start, check: Check) -> None:
    host(functools.partial(ArmSimNode, namespace="/exo"), mode="realtime")
    assert not [name for name in names(check(namespace="/exo")) if not name.endswith(": rate")]


class Plain(Node):
    """No lifecycle node, no services, torques by best effort, and a pace of its own."""

    def __init__(self, **options: Any) -> None:
        super().__init__(topics.SIM_NODE, **options)
        hasty = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
        angles = JointStatePublisher(self, topics.JOINT_STATES, JOINTS)
        torques = self.create_publisher(JointState, topics.TORQUE_SENSORS, hasty)
        encoder = JointStateEncoder(JOINTS, "effort")
        stamps = itertools.count(0, 2 * PERIOD_NS)

        def publish() -> None:
            stamp_ns = next(stamps)
            angles.publish(stamp_ns, (1.0, 1.0))
            torques.publish(encoder.encode(stamp_ns, (0.0, 0.0)))

        steady_timer(self, 2.0 * PERIOD, publish)


@pytest.mark.slow
def test_a_plain_node_is_judged_as_it_is(host: Start, check: Check) -> None:
    host(Plain)
    findings = check()
    assert findings["lifecycle"].outcome is Outcome.NOT_CHECKED
    expected = {f"service arm_sim/{name}" for name in ("emergency_stop", "reset")}
    expected |= {"torque_sensors: quality of service", "effort_controller/commands: type"}
    assert expected <= set(names(findings))
    for topic in STREAMS:
        assert findings[f"{topic}: joint names"].outcome is Outcome.PASS


class InUse(ArmSimNode):
    """A simulator that is commanded already."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self._commander = CommandPublisher(self, topics.COMMANDS, len(JOINTS))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("defect", "words"),
    [(InUse, "the driver is in use: /arm_sim commands it"), (None, "no driver: neither")],
)
def test_when_there_is_nothing_to_check_expect_one_line_and_status_one(
    host: Start, driver_domain: int, defect: type[ArmSimNode] | None, words: str
) -> None:
    if defect is not None:
        host(defect)
    told = refused("check-driver", "--domain-id", str(driver_domain))
    assert told.status == 1
    assert words in told.err


@pytest.mark.parametrize(("answer", "allowed"), [("yes\n", True), ("y\n", False), ("", False)])
def test_before_anything_moves_somebody_is_asked_and_only_yes_is_one(
    answer: str,
    allowed: bool,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    terminal = io.StringIO(answer)
    monkeypatch.setattr(terminal, "isatty", lambda: True)
    monkeypatch.setattr(sys, "stdin", terminal)
    refusal = pytest.raises(ConfigurationError, match="not without a yes")
    with contextlib.nullcontext() if allowed else refusal:
        ask(CheckOptions(joints=JOINTS, move=True, torque=2.0, most_motion=0.1), 5)
    said = capsys.readouterr()
    assert said.out == ""
    for words in ("Nobody may be in the rig", "2 N·m", "0.1 rad", "shoulder, elbow", "domain 5"):
        assert words in said.err


class Listening(ArmSimNode):
    """The simulator, which calls back when the first torque is commanded."""

    heard: ClassVar[list[tuple[float, ...]]] = []
    pushed: ClassVar[threading.Event]

    def on_command(self, command: tuple[float, ...]) -> None:
        self.heard.append(command)
        if any(command):
            self.pushed.set()
        super().on_command(command)


@pytest.mark.slow
@pytest.mark.alone
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_when_it_is_interrupted_under_torque_expect_zero_torque_to_be_commanded_last(
    host: Start, driver_domain: int, number: signal.Signals
) -> None:
    Listening.heard, Listening.pushed = [], threading.Event()
    host(Listening, mode="realtime")
    options = ("--duration", "1", "--domain-id", str(driver_domain), "--move", "--yes")
    with program("check-driver", *options) as process:
        assert Listening.pushed.wait(PATIENCE)
        assert interrupted(process, 130, number)[-2:] == ["pushing shoulder", "armimp: interrupted"]
    # The last commands may still be on their way; no more are sent.
    wait_until(lambda: Listening.heard[-5:] == [(0.0, 0.0)] * 5, "zero torque, five times")


# --- The bridge, in front of a robot as ros2_control shows it -----------------------------------

# The bridge is a process of its own, in real time. What depends on the load of the machine (pace,
# and torque under watchdogs) is judged by `armimp check-driver` and by no test.
BRIDGE = ["-m", "armimp_ros2_control.node"]


class Robot(Node):
    """A robot as ros2_control shows it: one joint state for everything, and efforts that are held.

    Topics, quality of service and habits are those of joint_state_broadcaster and
    forward_command_controller; the rig behind them is the simulated one.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__("controller_manager", **options)
        self._rig = SimulatedRig(SimulatorParameters.preset())
        self._efforts = [0.0, 0.0]
        self._states = self.create_publisher(JointState, STATES, qos_profile_system_default)
        self._listener = self.create_subscription(
            Float64MultiArray, EFFORTS, self._on_efforts, qos_profile_system_default
        )
        self._random = random.Random(1)
        self._timer = steady_timer(self, PERIOD, self._on_timer)

    def _on_efforts(self, message: Float64MultiArray) -> None:
        if len(message.data) == len(self._efforts):
            self._efforts = list(message.data)

    def _on_timer(self) -> None:
        shoulder, elbow = self._rig.position.tolist()
        torques = self._rig.torque.tolist()
        state = JointState(name=("exo_elbow", "camera_pan", "exo_shoulder"), velocity=[0.0] * 3)
        late_ns = self._random.randint(0, 50_000)
        state.header.stamp = to_time(10**18 + self._rig.tick * PERIOD_NS + late_ns)
        state.position = [elbow, float("nan"), shoulder]
        state.effort = [torques[1], float("nan"), torques[0]]
        self._states.publish(state)
        self._rig.step(self._efforts)


@pytest.mark.slow
def test_the_bridge_in_front_of_ros2_control_keeps_the_contract_of_a_driver(
    start: Start, host: Start, check: Check
) -> None:
    host(Robot)
    start(BRIDGE, "-p", "names:=[exo_shoulder, exo_elbow]")
    findings = check()
    missed = CONTRACT - set(names(findings, Outcome.PASS))
    assert not missed, {name: findings[name].figure for name in missed}
