"""The simulator node over real DDS: lockstep, faults, parameters, life cycle."""

import math
from collections.abc import Callable, Sequence

import numpy as np
import pytest
from rclpy.node import Node
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock

from armimp_common import qos
from armimp_common.cdr import CommandEncoder
from armimp_common.executor import Spinner
from armimp_common.status import to_ns
from armimp_common.topics import CLOCK, PERIOD_NS
from armimp_sim.node import ArmSimNode
from armimp_sim.parameters import SimulatorParameters
from armimp_sim.simulator import SimulatedRig
from support.controller import Sample, ScriptedController
from support.graph import Launch, a_moment, eventually

PARAMETERS = SimulatorParameters.preset()


def some_commands(ticks: int) -> list[tuple[float, ...]]:
    return [tuple(row) for row in np.random.default_rng(5).uniform(-20, 20, (ticks, 2)).tolist()]


def expected_samples(commands: Sequence[Sequence[float]]) -> tuple[list[Sample], list[Sample]]:
    rig = SimulatedRig(PARAMETERS)
    positions: list[Sample] = [(0, tuple(rig.position.tolist()))]
    torques: list[Sample] = [(0, tuple(rig.torque.tolist()))]
    for command in commands:
        rig.step(command)
        positions.append((rig.stamp_ns, tuple(rig.position.tolist())))
        torques.append((rig.stamp_ns, tuple(rig.torque.tolist())))
    return positions, torques


MakeRig = Callable[..., ArmSimNode]


@pytest.fixture
def make(launch: Launch) -> MakeRig:
    return lambda *changes, **kwargs: launch(ArmSimNode, PARAMETERS, *changes, **kwargs)


@pytest.fixture
def commander(node: Node, spinner: Spinner) -> ScriptedController:
    return ScriptedController(node, spinner)


def send(commander: ScriptedController, commands: Sequence[Sequence[float]]) -> None:
    """Send commands, and wait for the sample that follows each."""
    wanted = max(commander.count, 1) + len(commands)
    for command in commands:
        commander.commands.publish(command)
    commander.await_samples(wanted)


class TestLockstep:
    def test_activation_publishes_the_first_sample_and_each_command_one_more(
        self, make: MakeRig, commander: ScriptedController, spinner: Spinner
    ) -> None:
        commander.bring_up(make())
        commander.await_samples(1)
        a_moment(spinner)
        assert commander.count == 1

        commands = some_commands(50)
        send(commander, commands)
        a_moment(spinner)

        positions, torques = expected_samples(commands)
        assert commander.positions == positions
        assert commander.torques == torques
        assert [stamp_ns for stamp_ns, _ in positions] == [k * PERIOD_NS for k in range(51)]

    def test_clock_and_health_are_published_now_and_then(
        self, make: MakeRig, commander: ScriptedController, spinner: Spinner, node: Node
    ) -> None:
        times: list[int] = []

        def hear(message: Clock) -> None:
            times.append(to_ns(message.clock))

        node.create_subscription(Clock, CLOCK, hear, qos.CLOCK)
        commander.bring_up(make())

        for _ in range(11):
            send(commander, [(0.0, 0.0)] * 100)
        eventually(
            spinner,
            lambda: bool(times) and times[-1] == 1_100 * PERIOD_NS,
            "the last time",
        )

        assert set(times) <= {k * 100 * PERIOD_NS for k in range(12)}
        eventually(spinner, lambda: len(commander.diagnostics) >= 2, "two reports")
        assert len(commander.diagnostics) == 2
        assert commander.faults == []
        assert {status.name for status in commander.diagnostics} == {"arm_sim: rig"}


MALFORMED = {
    "too short": (CommandEncoder(1).encode((1.0,)), "malformed command: Float64MultiArray"),
    "too long": (CommandEncoder(3).encode((1.0, 2.0, 3.0)), "malformed command"),
    "truncated": (CommandEncoder(2).encode((1.0, 2.0))[:-9], "malformed command"),
    "rubbish": (b"\0\1\0\0rubbish", "malformed command"),
    "empty": (b"", "malformed command"),
    "NaN": (CommandEncoder(2).encode((1.0, math.nan), 11), "command of joint 2 is not finite: nan"),
    "infinite": (
        CommandEncoder(2).encode((-math.inf, 0.0), 11),
        "command of joint 1 is not finite",
    ),
}


class TestFaults:
    @pytest.mark.parametrize(("message", "reason"), MALFORMED.values(), ids=MALFORMED.keys())
    def test_when_a_command_is_no_good_expect_zero_torque_the_same_tick_and_an_error(
        self,
        make: MakeRig,
        commander: ScriptedController,
        spinner: Spinner,
        message: bytes,
        reason: str,
    ) -> None:
        commander.bring_up(make())
        commands = some_commands(10)
        send(commander, commands)

        commander.commands.publisher.publish(message)
        eventually(spinner, lambda: commander.count == 12, "a sample for the bad command")
        send(commander, commands)
        commander.await_fault(reason)
        a_moment(spinner)

        positions, torques = expected_samples([*commands, *[(0.0, 0.0)] * 11])
        assert commander.positions == positions
        assert commander.torques == torques
        assert len(set(commander.faults)) == 1


class TestParameters:
    def test_while_active_changes_are_refused_with_a_reason(
        self, make: MakeRig, commander: ScriptedController
    ) -> None:
        simulator = make()
        commander.bring_up(simulator)
        change = Parameter("voluntary.rms", value=0.5)

        (result,) = simulator.set_parameters([change])
        assert not result.successful
        assert result.reason == "voluntary.rms cannot be changed now: the simulation is running"

        simulator.trigger_deactivate()
        (result,) = simulator.set_parameters([change])
        assert result.successful
