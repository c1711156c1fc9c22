"""The simulator and its surroundings: stop, reset, processes that fall silent, real time."""

from __future__ import annotations

import pytest
from rclpy.node import Node
from std_msgs.msg import UInt64

from armimp_common import topics
from armimp_common.executor import Spinner
from armimp_common.heartbeat import HeartbeatMonitor
from armimp_common.schema import Value
from armimp_common.status import TimingFigures, values_of
from armimp_sim.node import ArmSimNode
from armimp_sim.parameters import SimulatorParameters
from armimp_sim.plant import IntegrationError
from armimp_sim.simulator import RealtimeSimulator
from support.controller import ScriptedController
from support.graph import Launch, a_moment, eventually, report


class Surroundings(ScriptedController):
    """Controller, recorder and people around a simulator that is active."""

    def __init__(self, node: Node, spinner: Spinner, simulator: ArmSimNode) -> None:
        super().__init__(node, spinner)
        self.simulator = simulator
        self.bring_up(simulator)
        self.await_samples(1)

    @property
    def applied(self) -> tuple[float, ...]:
        assert self.simulator.limiter is not None
        return self.simulator.limiter.applied


@pytest.fixture
def around(node: Node, spinner: Spinner, launch: Launch) -> Surroundings:
    return Surroundings(node, spinner, launch(ArmSimNode, SimulatorParameters.preset()))


def test_emergency_stop_takes_torque_away_at_once_and_until_reset(around: Surroundings) -> None:
    around.command(5.0, -5.0)
    assert around.applied == (5.0, -5.0)

    assert around.call("/arm_sim/emergency_stop")[0]

    assert around.applied == (0.0, 0.0)
    assert around.await_fault() == ("emergency stop", "0.0 0.0")
    around.command(5.0, -5.0)
    assert around.applied == (0.0, 0.0)
    around.command(0.0, 0.0)
    assert around.call("/arm_sim/reset")[0]
    around.command(5.0, -5.0)
    assert around.applied == (5.0, -5.0)


@pytest.mark.parametrize(("alive", "silent"), [(0, 1), (0, 0)], ids=["silent", "left"])
def test_when_the_controller_is_lost_expect_zero_torque_and_a_fault(
    around: Surroundings, alive: int, silent: int
) -> None:
    around.command(5.0, -5.0)
    report(around.simulator.controller, alive=1, silent=0)
    assert around.applied == (5.0, -5.0)

    report(around.simulator.controller, alive=alive, silent=silent)

    assert around.applied == (0.0, 0.0)
    message, applied = around.await_fault()
    assert message.startswith("imbic_controller ")
    assert applied == "0.0 0.0"
    # It may come back, but not by itself under torque.
    report(around.simulator.controller, alive=1, silent=0)
    around.command(5.0, -5.0)
    assert around.applied == (0.0, 0.0)


def with_recorder(around: Surroundings) -> HeartbeatMonitor:
    around.received.publish(UInt64(data=0))
    eventually(around.spinner, lambda: around.simulator._flow.recorded, "the recorder")
    watch = around.simulator._recorder
    report(watch, alive=1, silent=0)
    around.command(5.0, -5.0)
    return watch


def test_when_the_recorder_is_silent_expect_time_to_stand_still_until_it_is_back(
    around: Surroundings,
) -> None:
    watch = with_recorder(around)
    before = around.count

    report(watch, alive=0, silent=1)
    around.commands.publish((5.0, -5.0))
    a_moment(around.spinner)
    assert around.count == before
    report(watch, alive=1, silent=0)
    eventually(around.spinner, lambda: around.count == before + 1, "the sample held back")

    assert around.faults == []


def test_when_the_recorder_is_dead_expect_zero_torque_and_a_fault(around: Surroundings) -> None:
    watch = with_recorder(around)

    report(watch, alive=0, silent=1)
    around.commands.publish((5.0, -5.0))
    report(watch, alive=0, silent=0)
    around.command(5.0, -5.0)

    assert around.applied == (0.0, 0.0)
    around.await_fault("impedance_estimator is dead, and a trial without")


def test_when_a_recorder_takes_leave_or_there_was_none_expect_no_fault(
    around: Surroundings,
) -> None:
    watch = around.simulator._recorder
    report(watch, alive=1, silent=0)
    report(watch, alive=0, silent=0)
    around.command(5.0, -5.0)
    assert around.applied == (5.0, -5.0)

    around.received.publish(UInt64(data=0))
    eventually(around.spinner, lambda: around.simulator._flow.recorded, "the recorder")
    around.received.publish(UInt64(data=topics.RECORDER_GONE))
    eventually(around.spinner, lambda: not around.simulator._flow.recorded, "its leave")
    report(watch, alive=1, silent=0)
    report(watch, alive=0, silent=0)
    around.command(5.0, -5.0)
    assert around.applied == (5.0, -5.0)


# --- The simulator node in real time over DDS: nothing waits, and everything is told ------------


REALTIME: dict[str, Value] = {"mode": "realtime"}


class Answering(ScriptedController):
    """A controller that answers as long as it is told to."""

    def figures(self) -> list[TimingFigures]:
        told = [status for status in self.diagnostics if status.name == TimingFigures.STATUS_NAME]
        return [TimingFigures.from_values(values_of(status)) for status in told]


@pytest.fixture
def answering(node: Node, spinner: Spinner) -> Answering:
    return Answering(node, spinner)


@pytest.fixture
def simulator(launch: Launch) -> ArmSimNode:
    made: ArmSimNode = launch(ArmSimNode, SimulatorParameters.preset(), REALTIME)
    return made


def test_when_commands_stay_away_expect_a_fault_no_torque_and_samples_that_go_on(
    simulator: ArmSimNode, answering: Answering
) -> None:
    answering.answer = (3.0, -3.0)
    answering.bring_up(simulator)
    answering.await_samples(20)

    answering.answer = None
    answering.await_fault()
    answering.await_samples(answering.count + 1200)

    # Which watchdog is the first one depends on how the machine held up the commands before.
    assert simulator.limiter is not None
    assert {message for message, _ in answering.faults} == {simulator.limiter.fault}
    assert answering.faults[-1][1] == "0.0 0.0"


def test_what_goes_wrong_in_the_pacing_thread_ends_the_node(
    simulator: ArmSimNode, answering: Answering, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(paced: RealtimeSimulator, tick: int) -> None:
        raise IntegrationError("the plant broke down")

    monkeypatch.setattr(RealtimeSimulator, "advance", broken)
    answering.bring_up(simulator)

    with pytest.raises(IntegrationError, match="the plant broke down"):
        eventually(answering.spinner, lambda: False, "the error")
