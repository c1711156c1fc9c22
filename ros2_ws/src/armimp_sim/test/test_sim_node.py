"""The simulator node over real DDS: lockstep, faults, parameters, its surroundings, real time."""

import math
from collections.abc import Sequence

import pytest
from rclpy.node import Node
from rclpy.time import Time
from rosgraph_msgs.msg import Clock
from std_msgs.msg import UInt64

from armimp_common import topics
from armimp_common.cdr import CommandEncoder
from armimp_common.executor import Spinner
from armimp_common.heartbeat import HeartbeatMonitor
from armimp_common.pubsub import subscribe, wait_for_partners
from armimp_common.schema import Value
from armimp_common.topics import CLOCK, PERIOD_NS
from armimp_sim.node import ArmSimNode
from armimp_sim.parameters import SimulatorParameters
from armimp_sim.plant import IntegrationError
from armimp_sim.simulator import RealtimeSimulator
from support.controller import ScriptedController
from support.graph import Launch, a_moment, assert_locked_while_active, report
from support.plants import in_lockstep, some_commands

PUSH, ZERO = (5.0, -5.0), (0.0, 0.0)


class World(ScriptedController):
    """A simulator that is active, and a controller that is told what to command."""

    def __init__(self, node: Node, spinner: Spinner, launch: Launch) -> None:
        super().__init__(node, spinner)
        self.simulator: ArmSimNode = launch(ArmSimNode, SimulatorParameters.preset())
        self.bring_up(self.simulator)
        self.await_samples(1)

    @property
    def applied(self) -> tuple[float, ...]:
        return self.simulator.limiter.applied

    def pushed(self) -> tuple[float, ...]:
        """Command a torque; return what the drives apply."""
        self.command(*PUSH)
        return self.applied

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
        times.append(Time.from_msg(message.clock).nanoseconds)

    subscription = subscribe(world.node, CLOCK, hear)
    wait_for_partners(world.node, subscriptions=[subscription])

    for _ in range(11):
        world.send([ZERO] * 100)
    last = 1_100 * PERIOD_NS
    world.until(lambda: bool(times) and times[-1] == last, "the last time")

    assert set(times) <= {k * 100 * PERIOD_NS for k in range(12)}
    world.until(lambda: len(world.diagnostics) >= 2, "two reports")
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

    expected = in_lockstep([*commands, *[ZERO] * 11])
    assert world.positions == [(stamp, angles) for stamp, angles, _ in expected]
    assert world.torques == [(stamp, torques) for stamp, _, torques in expected]
    assert len(set(world.faults)) == 1


def test_while_active_changes_are_refused_with_a_reason(world: World) -> None:
    assert_locked_while_active(world.simulator, "voluntary.rms", 0.5, "the simulation is running")


# --- Stop, reset, and processes that fall silent ------------------------------------------------


def test_emergency_stop_takes_torque_away_at_once_and_until_reset(world: World) -> None:
    assert world.pushed() == PUSH

    assert world.call("/arm_sim/emergency_stop")[0]

    assert world.applied == ZERO
    assert world.await_fault() == ("emergency stop", "0.0 0.0")
    assert world.pushed() == ZERO
    world.command(*ZERO)
    assert world.call("/arm_sim/reset")[0]
    assert world.pushed() == PUSH


@pytest.mark.parametrize(("alive", "silent"), [(0, 1), (0, 0)], ids=["silent", "left"])
def test_when_the_controller_is_lost_expect_zero_torque_and_a_fault(
    world: World, alive: int, silent: int
) -> None:
    world.command(*PUSH)
    report(world.simulator.controller, alive=1, silent=0)
    assert world.applied == PUSH

    report(world.simulator.controller, alive=alive, silent=silent)

    assert world.applied == ZERO
    message, applied = world.await_fault()
    assert message.startswith("imbic_controller ")
    assert applied == "0.0 0.0"
    # The controller may come back, but the torque does not come back by itself.
    report(world.simulator.controller, alive=1, silent=0)
    assert world.pushed() == ZERO


def with_recorder(world: World) -> HeartbeatMonitor:
    world.received.publish(b"\0\1\0\0")  # no count: one of many is lost
    world.received.publish(UInt64(data=0))
    world.until(lambda: world.simulator._flow.recorded, "the recorder")
    watch = world.simulator._recorder
    report(watch, alive=1, silent=0)
    world.command(*PUSH)
    return watch


def test_when_the_recorder_is_silent_expect_time_to_stand_still_until_it_is_back(
    world: World,
) -> None:
    watch = with_recorder(world)
    before = world.count

    report(watch, alive=0, silent=1)
    world.commands.publish(PUSH)
    world.until(lambda: world.simulator._holding, "a sample that waits")
    assert world.count == before
    report(watch, alive=1, silent=0)
    world.until(lambda: world.count == before + 1, "the sample held back")

    assert world.faults == []


def test_when_the_recorder_is_dead_expect_zero_torque_and_a_fault(world: World) -> None:
    watch = with_recorder(world)

    report(watch, alive=0, silent=1)
    world.commands.publish(PUSH)
    report(watch, alive=0, silent=0)

    assert world.pushed() == ZERO
    world.await_fault("impedance_estimator is dead, and a trial without")


@pytest.mark.parametrize("recorded", [False, True])
def test_when_a_recorder_takes_leave_or_there_was_none_expect_no_fault(
    world: World, recorded: bool
) -> None:
    watch = with_recorder(world) if recorded else world.simulator._recorder
    if recorded:
        world.received.publish(UInt64(data=topics.RECORDER_GONE))
        world.until(lambda: not world.simulator._flow.recorded, "its leave")
    report(watch, alive=1, silent=0)
    report(watch, alive=0, silent=0)
    assert world.pushed() == PUSH


# --- The simulator node in real time over DDS: nothing waits, and everything is told ------------

REALTIME: dict[str, Value] = {"mode": "realtime"}


@pytest.fixture
def answering(node: Node, spinner: Spinner) -> ScriptedController:
    """A controller that answers as long as it is told to."""
    return ScriptedController(node, spinner)


@pytest.fixture
def simulator(launch: Launch) -> ArmSimNode:
    made: ArmSimNode = launch(ArmSimNode, SimulatorParameters.preset(), REALTIME)
    return made


def test_when_commands_stay_away_expect_a_fault_no_torque_and_samples_that_go_on(
    simulator: ArmSimNode, answering: ScriptedController
) -> None:
    answering.answer = (3.0, -3.0)
    answering.bring_up(simulator)
    answering.await_samples(20)

    answering.answer = None
    answering.await_fault()
    answering.await_samples(answering.count + 1200)

    # Which watchdog is the first one depends on how the machine held up the commands before.
    assert {message for message, _ in answering.faults} == {simulator.limiter.fault}
    assert answering.faults[-1][1] == "0.0 0.0"


def test_what_goes_wrong_in_the_pacing_thread_ends_the_node(
    simulator: ArmSimNode, answering: ScriptedController, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(paced: RealtimeSimulator, tick: int) -> None:
        raise IntegrationError("the plant broke down")

    monkeypatch.setattr(RealtimeSimulator, "advance", broken)
    answering.bring_up(simulator)

    with pytest.raises(IntegrationError, match="the plant broke down"):
        answering.until(lambda: False, "the error")
