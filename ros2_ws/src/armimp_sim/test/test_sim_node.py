"""The simulator node over real DDS: lockstep, faults, parameters, life cycle."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.context import Context
from rclpy.lifecycle import TransitionCallbackReturn
from rclpy.node import Node
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock

from armimp_common import qos
from armimp_common.cdr import CommandEncoder
from armimp_common.errors import GraphError
from armimp_common.executor import Spinner
from armimp_common.lifecycle import LifecycleManager
from armimp_common.pubsub import CommandPublisher, subscribe_joint_states, wait_until_matched
from armimp_common.schema import Value
from armimp_common.status import Level, to_ns
from armimp_common.topics import (
    CLOCK,
    COMMANDS,
    DIAGNOSTICS,
    JOINT_STATES,
    PERIOD_NS,
    SIM_NODE,
    TORQUE_SENSORS,
    VALUE_FIELD,
)
from armimp_sim.node import ArmSimNode
from armimp_sim.parameters import SimulatorParameters
from armimp_sim.simulator import SimulatedRig
from support.graph import PATIENCE, a_moment, eventually, overrides

SUCCESS = TransitionCallbackReturn.SUCCESS
FAILURE = TransitionCallbackReturn.FAILURE
PARAMETERS = SimulatorParameters.preset()
Sample = tuple[int, tuple[float, ...]]


class Commander:
    """Stands for controller and supervisor: sends commands, and keeps what comes back."""

    def __init__(self, node: Node) -> None:
        self.node = node
        self.positions: list[Sample] = []
        self.torques: list[Sample] = []
        self.times: list[int] = []
        self.diagnostics: list[DiagnosticStatus] = []
        self.channel = CommandPublisher(node, COMMANDS, 2)
        self.subscriptions = [
            subscribe_joint_states(
                node, topic, PARAMETERS.joints, VALUE_FIELD[topic], partial(_keep, kept)
            )
            for topic, kept in (
                (JOINT_STATES, self.positions),
                (TORQUE_SENSORS, self.torques),
            )
        ]
        self.clock = node.create_subscription(Clock, CLOCK, self.on_clock, qos.CLOCK)
        self.health = node.create_subscription(
            DiagnosticArray, DIAGNOSTICS, self.on_diagnostics, qos.DIAGNOSTICS
        )

    def on_clock(self, clock: Clock) -> None:
        self.times.append(to_ns(clock.clock))

    def on_diagnostics(self, array: DiagnosticArray) -> None:
        self.diagnostics += array.status

    def wait_for_rig(self) -> None:
        assert not wait_until_matched(
            self.node,
            publishers=[self.channel],
            subscriptions=[*self.subscriptions, self.clock, self.health],
            timeout_s=PATIENCE,
        )

    @property
    def samples(self) -> int:
        return min(len(self.positions), len(self.torques))

    def errors(self) -> list[str]:
        return [
            status.message for status in self.diagnostics if status.level == bytes([Level.ERROR])
        ]


def _keep(kept: list[Sample], stamp_ns: int, values: tuple[float, ...]) -> None:
    kept.append((stamp_ns, values))


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
def make(context: Context, spinner: Spinner) -> Iterator[MakeRig]:
    made: list[ArmSimNode] = []

    def factory(changes: Mapping[str, Value] | None = None, **kwargs: Any) -> ArmSimNode:
        simulator = ArmSimNode(
            context=context, parameter_overrides=overrides(PARAMETERS, changes), **kwargs
        )
        made.append(simulator)
        spinner.add_node(simulator)
        return simulator

    yield factory
    for simulator in made:
        spinner.remove_node(simulator)
        simulator.destroy_node()


@pytest.fixture
def commander(node: Node) -> Commander:
    return Commander(node)


def bring_up(simulator: ArmSimNode, commander: Commander) -> None:
    assert simulator.trigger_configure() is SUCCESS
    commander.wait_for_rig()
    assert simulator.trigger_activate() is SUCCESS, simulator.transition_error


def send(commander: Commander, spinner: Spinner, commands: Sequence[Sequence[float]]) -> None:
    """Send commands, and wait for the sample that follows each."""
    wanted = max(commander.samples, 1) + len(commands)
    for command in commands:
        commander.channel.publish(command)
    eventually(spinner, lambda: commander.samples >= wanted, "a sample for every command")


class TestLockstep:
    def test_activation_publishes_the_first_sample_and_each_command_one_more(
        self, make: MakeRig, commander: Commander, spinner: Spinner
    ) -> None:
        bring_up(make(), commander)
        eventually(spinner, lambda: commander.samples == 1, "the first sample")
        a_moment(spinner)
        assert commander.samples == 1

        commands = some_commands(50)
        send(commander, spinner, commands)
        a_moment(spinner)

        positions, torques = expected_samples(commands)
        assert commander.positions == positions
        assert commander.torques == torques
        assert [stamp_ns for stamp_ns, _ in positions] == [k * PERIOD_NS for k in range(51)]

    def test_clock_and_health_are_published_now_and_then(
        self, make: MakeRig, commander: Commander, spinner: Spinner
    ) -> None:
        bring_up(make(), commander)

        for _ in range(11):
            send(commander, spinner, [(0.0, 0.0)] * 100)
        eventually(
            spinner,
            lambda: bool(commander.times) and commander.times[-1] == 1_100 * PERIOD_NS,
            "the last time",
        )

        assert set(commander.times) <= {k * 100 * PERIOD_NS for k in range(12)}
        eventually(spinner, lambda: len(commander.diagnostics) >= 2, "two reports")
        assert len(commander.diagnostics) == 2
        assert commander.errors() == []
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
        commander: Commander,
        spinner: Spinner,
        message: bytes,
        reason: str,
    ) -> None:
        bring_up(make(), commander)
        commands = some_commands(10)
        send(commander, spinner, commands)

        commander.channel.publisher.publish(message)
        eventually(spinner, lambda: commander.samples == 12, "a sample for the bad command")
        send(commander, spinner, commands)
        eventually(spinner, lambda: bool(commander.errors()), "an error in the diagnostics")
        a_moment(spinner)

        positions, torques = expected_samples([*commands, *[(0.0, 0.0)] * 11])
        assert commander.positions == positions
        assert commander.torques == torques
        assert len(commander.errors()) == 1
        assert commander.errors()[0].startswith(reason)


class TestParameters:
    def test_while_active_changes_are_refused_with_a_reason(
        self, make: MakeRig, commander: Commander
    ) -> None:
        simulator = make()
        bring_up(simulator, commander)
        change = Parameter("voluntary.rms", value=0.5)

        (result,) = simulator.set_parameters([change])
        assert not result.successful
        assert result.reason == "voluntary.rms cannot be changed now: the simulation is running"

        simulator.trigger_deactivate()
        (result,) = simulator.set_parameters([change])
        assert result.successful

    @pytest.mark.parametrize(
        ("changes", "reason"),
        [
            ({"arm.damping": [1.0]}, "parameter 'arm.damping'"),
            ({"friction.sigma_0": [1e11, 1e11]}, "too long for the stuck joints"),
            ({"arm.inertia": [9.0, 90.0, 90.0, 9.0]}, "positive definite symmetric part"),
        ],
        ids=lambda value: None if isinstance(value, dict) else value,
    )
    def test_when_values_describe_no_rig_expect_configure_to_fail_and_the_node_alive(
        self,
        make: MakeRig,
        node: Node,
        spinner: Spinner,
        capfd: pytest.CaptureFixture[str],
        changes: dict[str, Value],
        reason: str,
    ) -> None:
        simulator = make(changes)
        manager = LifecycleManager(
            node, [SIM_NODE], spin_until=spinner.spin_until, timeout=PATIENCE
        )

        with pytest.raises(GraphError, match="arm_sim failed to configure"):
            manager.change(SIM_NODE, "configure")

        assert reason in simulator.transition_error
        log = capfd.readouterr().err
        assert log.count("\n") == 1
        assert reason in log
        assert manager.state(SIM_NODE) == "unconfigured"
        good = {parameter.name: parameter for parameter in overrides(PARAMETERS)}
        simulator.set_parameters([good[name] for name in changes])
        manager.change(SIM_NODE, "configure")


class TestLife:
    def test_life_can_be_gone_through_again_and_starts_anew_after_configuring(
        self, make: MakeRig, commander: Commander, spinner: Spinner
    ) -> None:
        simulator = make()
        commands = some_commands(10)
        for _ in range(3):
            commander.positions.clear()
            commander.torques.clear()
            bring_up(simulator, commander)
            send(commander, spinner, commands)
            assert commander.positions == expected_samples(commands)[0]
            assert simulator.trigger_deactivate() is SUCCESS
            assert simulator.trigger_cleanup() is SUCCESS
        assert simulator.trigger_shutdown() is SUCCESS
