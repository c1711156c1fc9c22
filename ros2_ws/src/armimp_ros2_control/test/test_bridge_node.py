"""The bridge through a real graph: a robot on one side, a controller on the other."""

import math
import time

import pytest
from rclpy.node import Node
from rclpy.qos import qos_profile_system_default
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from armimp_common import topics
from armimp_common.executor import Spinner
from armimp_common.pubsub import wait_for_partners
from armimp_common.status import to_time
from armimp_common.topics import PERIOD_NS
from armimp_ros2_control.node import EFFORTS, STATES, Ros2ControlBridge
from armimp_ros2_control.parameters import BridgeParameters
from support.controller import SUCCESS, ScriptedController
from support.graph import CLOCK_STEPS, Launch, set_clock

ZERO, PUSH = (0.0, 0.0), (5.0, -2.0)


class World(ScriptedController):
    """Both sides of a bridge: a robot with joint states and efforts, and a controller.

    Each sample that comes out of the bridge is answered by a command and followed by the next joint
    state, so nothing depends on the speed of the machine.
    """

    def __init__(self, node: Node, spinner: Spinner) -> None:
        super().__init__(node, spinner)
        self.tick = 0
        self.answer = ZERO
        self.running = False
        self.next: dict[str, object] = {}
        self.told: list[tuple[float, ...]] = []
        self.states = node.create_publisher(JointState, STATES, qos_profile_system_default)
        self.efforts = node.create_subscription(
            Float64MultiArray, EFFORTS, self._on_efforts, qos_profile_system_default
        )

    def _on_efforts(self, message: Float64MultiArray) -> None:
        self.told.append(tuple(message.data))

    def on_sample(self, topic: str, stamp_ns: int, values: tuple[float, ...]) -> None:
        super().on_sample(topic, stamp_ns, values)
        if topic == topics.TORQUE_SENSORS and self.running:
            changes, self.next = self.next, {}
            self.feed(**changes)  # type: ignore[arg-type]

    def feed(self, ahead_ms: float = 0.0, **changes: object) -> None:
        """Publish one joint state of the robot, with a joint that the bridge does not need."""
        fields: dict[str, object] = {
            "name": ["elbow", "pan", "shoulder"],
            "position": [1.3, 9.0, 1.1],
            "velocity": [0.0, 0.0, 0.0],
            "effort": [0.5, 9.0, -0.5],
            **changes,
        }
        self.tick += 1
        state = JointState(**fields)
        stamp = self.tick + ahead_ms
        state.header.stamp = to_time(round(PERIOD_NS * stamp))
        self.states.publish(state)

    def push(self) -> None:
        """Have samples follow each other under torque."""
        self.answer, self.running = PUSH, True
        self.feed()
        self.until_told(*PUSH)

    def until_told(self, *torque: float) -> None:
        self.until(lambda: bool(self.told) and self.told[-1] == torque, f"efforts {torque}")


class PatientBridge(Ros2ControlBridge):
    """A bridge whose watchdog is off until a test turns it on, as the machine may be busy."""

    patient = True

    def _check_silence(self) -> None:
        if self.patient:
            self._heard_before = -1
        super()._check_silence()


@pytest.fixture
def bridge(launch: Launch) -> PatientBridge:
    """A bridge that is not active yet."""
    bridge: PatientBridge = launch(PatientBridge, BridgeParameters())
    assert bridge.trigger_configure() is SUCCESS
    return bridge


@pytest.fixture
def waiting(node: Node, spinner: Spinner, bridge: PatientBridge) -> World:
    """Both sides of that bridge."""
    world = World(node, spinner)
    heard = [world.efforts, *world.subscriptions]
    wait_for_partners(node, publishers=[world.commands], subscriptions=heard)
    return world


@pytest.fixture
def world(waiting: World, node: Node, bridge: PatientBridge) -> World:
    assert bridge.trigger_activate() is SUCCESS
    waiting.until(lambda: waiting.told == [ZERO], "no torque to begin with")
    wait_for_partners(node, publishers=[waiting.states])
    wait_for_partners(bridge, subscriptions=[bridge._states])
    return waiting


def test_joint_states_that_came_before_the_activation_are_not_passed_on_in_a_burst(
    waiting: World, bridge: PatientBridge, monkeypatch: pytest.MonkeyPatch
) -> None:
    def wait(*args: object, **options: object) -> None:
        wait_for_partners(waiting.node, publishers=[waiting.states])
        # Meanwhile no callback is executed.
        for _ in range(100):
            waiting.feed()
        time.sleep(0.1)

    monkeypatch.setattr("armimp_common.driver_base.wait_for_partners", wait)
    assert bridge.trigger_activate() is SUCCESS
    waiting.feed()
    waiting.until(lambda: bool(waiting.torques), "the next sample")
    assert [stamp for stamp, _ in waiting.torques] == [101 * PERIOD_NS]


def test_joint_states_are_split_in_pairs_with_the_stamps_that_came(world: World) -> None:
    for _ in range(3):
        world.feed()
    world.until(lambda: len(world.torques) == 3, "three samples")
    stamps = [PERIOD_NS * k for k in (1, 2, 3)]
    assert world.positions == [(stamp, (1.1, 1.3)) for stamp in stamps]
    assert world.torques == [(stamp, (-0.5, 0.5)) for stamp in stamps]


@pytest.mark.parametrize("clock_step", [None, *CLOCK_STEPS])
def test_when_joint_states_stop_expect_zero_torque(
    world: World, bridge: PatientBridge, clock_step: float | None
) -> None:
    world.push()
    if clock_step is not None:
        set_clock(bridge, clock_step)
    bridge.patient = world.running = False
    world.until_told(*ZERO)
    world.await_fault("nothing for 10 ms")


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"name": ["elbow", "pan", "hip"]}, "lacks joint 'shoulder'; it has 'elbow', 'pan', 'hip'"),
        ({"effort": [0.0, 0.0, math.nan]}, "the effort of 'shoulder' is not a number"),
        ({"ahead_ms": 500.0}, "samples do not come once a millisecond"),
    ],
    ids=["unknown joint", "effort NaN", "gap"],
)
def test_what_cannot_be_used_takes_the_torque_away_and_is_told(
    world: World, changes: dict[str, object], words: str
) -> None:
    world.push()
    world.next = changes
    world.until_told(*ZERO)
    world.await_fault(words)


def test_the_emergency_stop_zeroes_torque_again_and_again_until_a_reset_refused_under_torque(
    world: World,
) -> None:
    world.push()
    assert world.call(topics.SIM_STOP_SERVICE)[0]
    world.until_told(*ZERO)
    world.await_fault("emergency stop")
    # Torque is still commanded. Even without samples, fault and zero torque are published.
    world.running, before = False, len(world.told)
    world.until(lambda: len(world.faults) >= 3, "the fault, three times")
    assert set(world.told[before:]) == {ZERO}
    assert len(world.told) - before > 10
    world.running = True
    world.feed()
    granted, message = world.call(topics.SIM_RESET_SERVICE)
    assert not granted
    assert "not zero torque" in message
    world.answer = ZERO
    # Commands and services are not heard in the order in which they were sent.
    heard = len(world.torques)
    world.until(lambda: len(world.torques) > heard + 2, "that zero torque is heard")
    assert world.call(topics.SIM_RESET_SERVICE)[0]
    world.answer = PUSH
    world.until_told(*PUSH)


@pytest.mark.usefixtures("world")
def test_the_latency_of_a_command_counts_from_the_sample_that_it_answers(
    bridge: PatientBridge,
) -> None:
    for k in range(3):
        bridge.check_sample(ZERO, 1)
        bridge.publish_sample(PERIOD_NS * k, ZERO, ZERO)
        if k != 1:  # the answer to this one comes after the next one
            bridge.on_command(ZERO)
        time.sleep(0.05)
    figures = bridge.timing()
    assert figures is not None
    assert figures.latency_max >= 0.05
