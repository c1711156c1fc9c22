"""The simulator node in real time over DDS: nothing waits, and everything is told."""

from __future__ import annotations

import pytest
from rclpy.node import Node

from armimp_common.executor import Spinner
from armimp_common.schema import Value
from armimp_common.status import TimingFigures, values_of
from armimp_sim.node import ArmSimNode
from armimp_sim.parameters import SimulatorParameters
from armimp_sim.plant import IntegrationError
from armimp_sim.simulator import RealtimeSimulator
from support.controller import ScriptedController
from support.graph import Launch, eventually

REALTIME: dict[str, Value] = {"mode": "realtime"}


class Surroundings(ScriptedController):
    """A controller that answers as long as it is told to."""

    def figures(self) -> list[TimingFigures]:
        told = [status for status in self.diagnostics if status.name == TimingFigures.STATUS_NAME]
        return [TimingFigures.from_values(values_of(status)) for status in told]


@pytest.fixture
def around(node: Node, spinner: Spinner) -> Surroundings:
    return Surroundings(node, spinner)


@pytest.fixture
def simulator(launch: Launch) -> ArmSimNode:
    made: ArmSimNode = launch(ArmSimNode, SimulatorParameters.preset(), REALTIME)
    return made


def test_when_commands_stay_away_expect_a_fault_no_torque_and_samples_that_go_on(
    simulator: ArmSimNode, around: Surroundings
) -> None:
    around.answer = (3.0, -3.0)
    around.bring_up(simulator)
    around.await_samples(20)

    around.answer = None
    around.await_fault()
    around.await_samples(around.count + 1200)

    # Which watchdog is the first one depends on how the machine held up the commands before.
    assert simulator.limiter is not None
    assert {message for message, _ in around.faults} == {simulator.limiter.fault}
    assert around.faults[-1][1] == "0.0 0.0"


def test_what_goes_wrong_in_the_pacing_thread_ends_the_node(
    simulator: ArmSimNode, around: Surroundings, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(paced: RealtimeSimulator, tick: int) -> None:
        raise IntegrationError("the plant broke down")

    monkeypatch.setattr(RealtimeSimulator, "advance", broken)
    around.bring_up(simulator)

    with pytest.raises(IntegrationError, match="the plant broke down"):
        eventually(around.spinner, lambda: False, "the error")
