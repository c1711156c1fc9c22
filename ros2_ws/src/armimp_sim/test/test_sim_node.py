"""The simulator node over real DDS: lockstep, faults, parameters, life cycle."""

import math
from collections.abc import Sequence

import pytest
from rclpy.node import Node
from rosgraph_msgs.msg import Clock

from armimp_common import qos
from armimp_common.cdr import CommandEncoder
from armimp_common.executor import Spinner
from armimp_common.pubsub import wait_until_matched
from armimp_common.status import to_ns
from armimp_common.topics import CLOCK, PERIOD_NS
from armimp_sim.node import ArmSimNode
from armimp_sim.parameters import SimulatorParameters
from support.controller import ScriptedController
from support.graph import PATIENCE, Launch, a_moment, assert_locked_while_active, eventually
from support.plants import in_lockstep, some_commands


class World(ScriptedController):
    """A simulator that is active, and a controller that is told what to command."""

    def __init__(self, node: Node, spinner: Spinner, launch: Launch) -> None:
        super().__init__(node, spinner)
        self.simulator: ArmSimNode = launch(ArmSimNode, SimulatorParameters.preset())
        self.bring_up(self.simulator)
        self.await_samples(1)

    def send(self, commands: Sequence[Sequence[float]]) -> None:
        """Send commands, and wait for the sample that follows each."""
        wanted = self.count + len(commands)
        for command in commands:
            self.commands.publish(command)
        self.await_samples(wanted)


@pytest.fixture
def world(node: Node, spinner: Spinner, launch: Launch) -> World:
    return World(node, spinner, launch)


def test_clock_and_health_are_published_now_and_then(world: World) -> None:
    times: list[int] = []

    def hear(message: Clock) -> None:
        times.append(to_ns(message.clock))

    subscription = world.node.create_subscription(Clock, CLOCK, hear, qos.CLOCK)
    assert not wait_until_matched(world.node, subscriptions=[subscription], timeout_s=PATIENCE)

    for _ in range(11):
        world.send([(0.0, 0.0)] * 100)
    last = 1_100 * PERIOD_NS
    eventually(world.spinner, lambda: bool(times) and times[-1] == last, "the last time")

    assert set(times) <= {k * 100 * PERIOD_NS for k in range(12)}
    eventually(world.spinner, lambda: len(world.diagnostics) >= 2, "two reports")
    assert len(world.diagnostics) == 2
    assert world.faults == []
    assert {status.name for status in world.diagnostics} == {"arm_sim: rig"}


MALFORMED = {
    "too short": (CommandEncoder(1).encode((1.0,)), "malformed command: Float64MultiArray"),
    "truncated": (CommandEncoder(2).encode((1.0, 2.0))[:-9], "malformed command"),
    "empty": (b"", "malformed command"),
    "NaN": (CommandEncoder(2).encode((1.0, math.nan), 11), "command of joint 2 is not finite: nan"),
    "infinite": (
        CommandEncoder(2).encode((-math.inf, 0.0), 11),
        "command of joint 1 is not finite",
    ),
}


@pytest.mark.parametrize(("message", "reason"), MALFORMED.values(), ids=MALFORMED.keys())
def test_when_a_command_is_no_good_expect_zero_torque_the_same_tick_and_an_error(
    world: World, message: bytes, reason: str
) -> None:
    commands = some_commands(10)
    world.send(commands)

    world.commands.publisher.publish(message)
    world.await_samples(12)
    world.send(commands)
    world.await_fault(reason)
    a_moment(world.spinner)

    expected = in_lockstep([*commands, *[(0.0, 0.0)] * 11])
    assert world.positions == [(stamp, angles) for stamp, angles, _ in expected]
    assert world.torques == [(stamp, torques) for stamp, _, torques in expected]
    assert len(set(world.faults)) == 1


def test_while_active_changes_are_refused_with_a_reason(world: World) -> None:
    assert_locked_while_active(world.simulator, "voluntary.rms", 0.5, "the simulation is running")
