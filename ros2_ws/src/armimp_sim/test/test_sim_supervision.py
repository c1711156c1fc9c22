"""The simulator and its surroundings: emergency stop, reset, and processes that fall silent."""

from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.context import Context
from rclpy.lifecycle import TransitionCallbackReturn
from rclpy.node import Node
from std_msgs.msg import UInt64
from std_srvs.srv import Trigger

from armimp_common import qos, topics
from armimp_common.executor import Spinner
from armimp_common.heartbeat import HeartbeatMonitor
from armimp_common.pubsub import CommandPublisher, subscribe_joint_states, wait_until_matched
from armimp_common.status import Level, values_of
from armimp_sim.node import ArmSimNode
from armimp_sim.parameters import SimulatorParameters
from support.graph import PATIENCE, a_moment, eventually, overrides

SUCCESS = TransitionCallbackReturn.SUCCESS
PARAMETERS = SimulatorParameters.preset()


class Surroundings:
    """Stands for controller, recorder and people."""

    def __init__(self, context: Context, node: Node, spinner: Spinner) -> None:
        self.node, self.spinner = node, spinner
        self.samples = 0
        self.faults: list[tuple[str, str]] = []
        self.commands = CommandPublisher(node, topics.COMMANDS, 2)
        self.received = node.create_publisher(UInt64, topics.RECEIVED, qos.LATCHED)
        self.subscriptions = [
            subscribe_joint_states(
                node, topic, PARAMETERS.joints, topics.VALUE_FIELD[topic], self.on_sample
            )
            for topic in (topics.JOINT_STATES, topics.TORQUE_SENSORS)
        ]
        self.health = node.create_subscription(
            DiagnosticArray, topics.DIAGNOSTICS, self.on_diagnostics, qos.DIAGNOSTICS
        )
        self.simulator = ArmSimNode(context=context, parameter_overrides=overrides(PARAMETERS))
        spinner.add_node(self.simulator)

    def on_sample(self, stamp_ns: int, values: tuple[float, ...]) -> None:
        self.samples += 1

    def on_diagnostics(self, array: DiagnosticArray) -> None:
        for status in array.status:
            if status.level == bytes([Level.ERROR]):
                self.faults.append((status.message, values_of(status)["applied"]))

    def bring_up(self) -> None:
        assert self.simulator.trigger_configure() is SUCCESS
        assert not wait_until_matched(
            self.node,
            publishers=[self.commands, self.received],
            subscriptions=[*self.subscriptions, self.health],
            timeout_s=PATIENCE,
        )
        assert self.simulator.trigger_activate() is SUCCESS, self.simulator.transition_error
        self.await_samples(1)

    def await_samples(self, number: int) -> None:
        eventually(self.spinner, lambda: self.samples >= 2 * number, f"{number} samples")

    def command(self, *torques: float) -> None:
        wanted = self.samples // 2 + 1
        self.commands.publish(torques)
        self.await_samples(wanted)

    @property
    def applied(self) -> tuple[float, ...]:
        assert self.simulator.limiter is not None
        return self.simulator.limiter.applied

    def call(self, service: str) -> Any:
        client = self.node.create_client(Trigger, service)
        assert client.wait_for_service(PATIENCE)
        future = client.call_async(Trigger.Request())
        assert self.spinner.spin_until(future, PATIENCE)
        return future.result()

    def heard(self, watch: HeartbeatMonitor, *, alive: int, silent: int) -> None:
        """Have the simulator hear from another process what the middleware would report."""
        watch._on_event(SimpleNamespace(alive_count=alive, not_alive_count=silent))


@pytest.fixture
def around(context: Context, node: Node) -> Iterator[Surroundings]:
    with Spinner([node]) as spinner:
        surroundings = Surroundings(context, node, spinner)
        yield surroundings
        spinner.remove_node(surroundings.simulator)
        surroundings.simulator.destroy_node()


def test_emergency_stop_takes_torque_away_at_once_and_until_reset(around: Surroundings) -> None:
    around.bring_up()
    around.command(5.0, -5.0)
    assert around.applied == (5.0, -5.0)

    answer = around.call("/arm_sim/emergency_stop")

    assert answer.success
    assert around.applied == (0.0, 0.0)
    eventually(around.spinner, lambda: bool(around.faults), "the fault")
    assert around.faults[0] == ("emergency stop", "0.0 0.0")
    around.command(5.0, -5.0)
    assert around.applied == (0.0, 0.0)
    around.command(0.0, 0.0)
    assert around.call("/arm_sim/reset").success
    around.command(5.0, -5.0)
    assert around.applied == (5.0, -5.0)


def test_when_torque_is_still_commanded_expect_reset_to_be_refused(around: Surroundings) -> None:
    around.bring_up()
    around.call("/arm_sim/emergency_stop")
    around.command(0.0, 1e-3)

    answer = around.call("/arm_sim/reset")

    assert not answer.success
    assert answer.message == "the last command is not zero torque: stop the controller first"
    around.command(5.0, 5.0)
    assert around.applied == (0.0, 0.0)


@pytest.mark.parametrize(("alive", "silent"), [(0, 1), (0, 0)], ids=["silent", "left"])
def test_when_the_controller_is_lost_expect_zero_torque_and_a_fault(
    around: Surroundings, alive: int, silent: int
) -> None:
    around.bring_up()
    around.command(5.0, -5.0)
    around.heard(around.simulator.controller, alive=1, silent=0)
    assert around.applied == (5.0, -5.0)

    around.heard(around.simulator.controller, alive=alive, silent=silent)

    assert around.applied == (0.0, 0.0)
    eventually(around.spinner, lambda: bool(around.faults), "the fault")
    message, applied = around.faults[0]
    assert message.startswith("imbic_controller ")
    assert applied == "0.0 0.0"
    # It may come back, but not by itself under torque.
    around.heard(around.simulator.controller, alive=1, silent=0)
    around.command(5.0, -5.0)
    assert around.applied == (0.0, 0.0)


def with_recorder(around: Surroundings) -> HeartbeatMonitor:
    around.bring_up()
    around.received.publish(UInt64(data=0))
    eventually(around.spinner, lambda: around.simulator._flow.recorded, "the recorder")
    watch = around.simulator._recorder
    around.heard(watch, alive=1, silent=0)
    around.command(5.0, -5.0)
    return watch


def test_when_the_recorder_is_silent_expect_time_to_stand_still_until_it_is_back(
    around: Surroundings,
) -> None:
    watch = with_recorder(around)
    before = around.samples

    around.heard(watch, alive=0, silent=1)
    around.commands.publish((5.0, -5.0))
    a_moment(around.spinner)
    assert around.samples == before
    around.heard(watch, alive=1, silent=0)
    eventually(around.spinner, lambda: around.samples == before + 2, "the sample held back")

    assert around.faults == []


def test_when_the_recorder_is_dead_expect_zero_torque_and_a_fault(around: Surroundings) -> None:
    watch = with_recorder(around)

    around.heard(watch, alive=0, silent=1)
    around.commands.publish((5.0, -5.0))
    around.heard(watch, alive=0, silent=0)
    around.command(5.0, -5.0)

    assert around.applied == (0.0, 0.0)
    eventually(around.spinner, lambda: bool(around.faults), "the fault")
    assert around.faults[0][0].startswith("impedance_estimator is dead, and a trial without")


def test_when_a_recorder_takes_leave_or_there_was_none_expect_no_fault(
    around: Surroundings,
) -> None:
    around.bring_up()
    watch = around.simulator._recorder
    around.heard(watch, alive=1, silent=0)
    around.heard(watch, alive=0, silent=0)
    around.command(5.0, -5.0)
    assert around.applied == (5.0, -5.0)

    around.received.publish(UInt64(data=0))
    eventually(around.spinner, lambda: around.simulator._flow.recorded, "the recorder")
    around.received.publish(UInt64(data=topics.RECORDER_GONE))
    eventually(around.spinner, lambda: not around.simulator._flow.recorded, "its leave")
    around.heard(watch, alive=1, silent=0)
    around.heard(watch, alive=0, silent=0)
    around.command(5.0, -5.0)
    assert around.applied == (5.0, -5.0)
