"""The simulator node in real time over DDS: nothing waits, and everything is told."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.context import Context
from rclpy.lifecycle import TransitionCallbackReturn
from rclpy.node import Node
from rclpy.subscription import Subscription
from std_msgs.msg import UInt64

from armimp_common import qos, topics
from armimp_common.executor import Spinner
from armimp_common.pubsub import CommandPublisher, subscribe_joint_states, wait_until_matched
from armimp_common.schema import Value
from armimp_common.status import Level, TimingFigures, values_of
from armimp_common.topics import PERIOD_NS
from armimp_sim.node import ArmSimNode
from armimp_sim.parameters import WATCHDOG_TICKS, SimulatorParameters
from armimp_sim.plant import IntegrationError
from armimp_sim.realtime_simulator import RealtimeSimulator
from support.graph import PATIENCE, eventually, overrides

pytestmark = pytest.mark.alone

SUCCESS = TransitionCallbackReturn.SUCCESS
FAILURE = TransitionCallbackReturn.FAILURE
PARAMETERS = SimulatorParameters.preset()
REALTIME: dict[str, Value] = {"mode": "realtime"}
SILENCE = f"no command for {WATCHDOG_TICKS} ticks"


class Surroundings:
    """Stands for a controller that answers as long as it is told to, and for a recorder."""

    def __init__(self, node: Node, spinner: Spinner) -> None:
        self.node, self.spinner = node, spinner
        self.answers: tuple[float, float] | None = None
        self.stamps: dict[str, list[int]] = {}
        self.diagnostics: list[DiagnosticStatus] = []
        self.commands = CommandPublisher(node, topics.COMMANDS, 2)
        self.received = node.create_publisher(UInt64, topics.RECEIVED, qos.LATCHED)
        self.subscriptions = [self.listen(topic) for topic in topics.DATA_STREAMS[:2]]
        self.health = node.create_subscription(
            DiagnosticArray, topics.DIAGNOSTICS, self.on_diagnostics, qos.DIAGNOSTICS
        )

    def listen(self, topic: str) -> Subscription:
        stamps = self.stamps[topic] = []

        def on_sample(stamp_ns: int, values: tuple[float, ...]) -> None:
            stamps.append(stamp_ns)
            if topic == topics.TORQUE_SENSORS and self.answers is not None:
                self.commands.publish(self.answers)

        field = topics.VALUE_FIELD[topic]
        return subscribe_joint_states(self.node, topic, PARAMETERS.joints, field, on_sample)

    def on_diagnostics(self, array: DiagnosticArray) -> None:
        self.diagnostics += array.status

    def bring_up(self, simulator: ArmSimNode) -> None:
        assert simulator.trigger_configure() is SUCCESS, simulator.transition_error
        assert not wait_until_matched(
            self.node,
            publishers=[self.commands, self.received],
            subscriptions=[*self.subscriptions, self.health],
            timeout_s=PATIENCE,
        )
        assert simulator.trigger_activate() is SUCCESS, simulator.transition_error

    def samples(self) -> int:
        return min(len(stamps) for stamps in self.stamps.values())

    def await_samples(self, more: int) -> None:
        wanted = self.samples() + more
        eventually(self.spinner, lambda: self.samples() >= wanted, f"{more} more samples")

    def figures(self) -> list[TimingFigures]:
        told = [status for status in self.diagnostics if status.name == TimingFigures.STATUS_NAME]
        return [TimingFigures.from_values(values_of(status)) for status in told]

    def rig(self) -> list[tuple[bytes, str, str]]:
        told = [status for status in self.diagnostics if status.name == "arm_sim: rig"]
        return [(one.level, one.message, values_of(one)["applied"]) for one in told]

    def faults(self) -> list[str]:
        return [text for level, text, _ in self.rig() if level == bytes([Level.ERROR])]


MakeRig = Callable[..., ArmSimNode]


@pytest.fixture
def around(node: Node, spinner: Spinner) -> Surroundings:
    return Surroundings(node, spinner)


@pytest.fixture
def make(context: Context, spinner: Spinner) -> Iterator[MakeRig]:
    made: list[ArmSimNode] = []

    def factory(changes: Mapping[str, Value] | None = None) -> ArmSimNode:
        values = {**REALTIME, **(changes or {})}
        simulator = ArmSimNode(context=context, parameter_overrides=overrides(PARAMETERS, values))
        made.append(simulator)
        spinner.add_node(simulator)
        return simulator

    yield factory
    for simulator in made:
        spinner.remove_node(simulator)
        simulator.destroy_node()


def test_samples_come_without_commands_one_for_each_millisecond(
    make: MakeRig, around: Surroundings
) -> None:
    simulator = make()
    began = time.monotonic()
    around.bring_up(simulator)
    around.await_samples(300)
    took = time.monotonic() - began

    for stamps in around.stamps.values():
        assert stamps == [k * PERIOD_NS for k in range(len(stamps))]
        assert (len(stamps) - 1) * 1e-3 <= took
    assert around.faults() == []


def test_timing_is_told_while_commands_come_and_once_more_at_the_end(
    make: MakeRig, around: Surroundings
) -> None:
    simulator = make()
    around.answers = (0.0, 0.0)
    around.bring_up(simulator)
    eventually(around.spinner, lambda: len(around.figures()) >= 2, "two reports")
    assert simulator.trigger_deactivate() is SUCCESS
    sent = around.figures()
    eventually(around.spinner, lambda: len(around.figures()) > len(sent), "the last report")

    first, *_, last = around.figures()
    assert 100 <= first.ticks < last.ticks
    eventually(around.spinner, lambda: around.samples() >= last.ticks, "all samples")
    assert around.samples() == last.ticks
    assert 0.0 < last.latency_p50 <= last.latency_p99 <= last.latency_max
    assert last.period_p50 <= last.period_p99 <= last.period_max
    assert first.missed <= last.missed <= last.ticks


def test_when_commands_stay_away_expect_a_fault_no_torque_and_samples_that_go_on(
    make: MakeRig, around: Surroundings
) -> None:
    around.answers = (3.0, -3.0)
    around.bring_up(make())
    eventually(around.spinner, lambda: around.samples() > 20, "some samples")

    around.answers = None
    eventually(around.spinner, lambda: bool(around.faults()), "a fault")
    around.await_samples(1200)

    assert set(around.faults()) == {SILENCE}
    assert around.rig()[-1][1:] == (SILENCE, "0.0 0.0")


def test_what_goes_wrong_in_the_pacing_thread_ends_the_node(
    make: MakeRig, around: Surroundings, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(paced: RealtimeSimulator, tick: int) -> None:
        raise IntegrationError("the plant broke down")

    monkeypatch.setattr(RealtimeSimulator, "advance", broken)
    around.bring_up(make())

    with pytest.raises(IntegrationError, match="the plant broke down"):
        eventually(around.spinner, lambda: False, "the error")
