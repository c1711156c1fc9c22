"""The controller in real time: the same answers, and a watchdog of five milliseconds."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping

import numpy as np
import pytest
from rclpy.context import Context
from rclpy.lifecycle import TransitionCallbackReturn
from rclpy.node import Node

from armimp_common.executor import Spinner
from armimp_common.schema import Value, build, flatten
from armimp_common.status import Phase
from armimp_common.topics import PERIOD_NS
from armimp_control.node import ImbicControllerNode
from armimp_control.parameters import ControllerParameters
from armimp_control.trial_sequencer import TrialSequencer
from support.graph import ScriptedDriver, a_moment, eventually, overrides

pytestmark = pytest.mark.alone

NAMES = ("shoulder", "elbow")
POSTURE = (1.09446, 1.34844)
OFF = (POSTURE[0] + 1e-4, POSTURE[1])
SUCCESS = TransitionCallbackReturn.SUCCESS
FAILURE = TransitionCallbackReturn.FAILURE
LOCKSTEP = ControllerParameters.preset(
    joints=NAMES,
    posture=np.array(POSTURE),
    robot_inertia=np.array([[0.354, 0.191], [0.191, 0.180]]),
    arm_inertia=np.array([[0.187, 0.084], [0.079, 0.060]]),
    duration=0.2,
)
PARAMETERS = build(ControllerParameters, {**flatten(LOCKSTEP), "mode": "realtime"})
SILENCE = "no sensor sample arrived any more"
MakeController = Callable[..., ImbicControllerNode]


def answers(parameters: ControllerParameters) -> list[tuple[bytes, bytes]]:
    """Commands and perturbations of a whole experiment with an arm that shakes a little."""
    experiment = TrialSequencer(parameters, lambda _: None)
    rng = np.random.default_rng(3)
    found = []
    tick = 0
    while not experiment.finished:
        theta = np.array(POSTURE) + rng.normal(scale=1e-6, size=2)
        experiment.answer(tick * PERIOD_NS, theta.tolist(), rng.normal(scale=0.1, size=2).tolist())
        found.append((experiment.command.tobytes(), experiment.tau_delta.tobytes()))
        tick += 1
    assert experiment.fault == ""
    return found


def test_answers_are_those_of_lockstep_bit_for_bit() -> None:
    assert answers(PARAMETERS) == answers(LOCKSTEP)


@pytest.fixture
def driver(node: Node) -> ScriptedDriver:
    return ScriptedDriver(node, NAMES)


@pytest.fixture
def make(context: Context, spinner: Spinner) -> Iterator[MakeController]:
    made: list[ImbicControllerNode] = []

    def factory(changes: Mapping[str, Value] | None = None) -> ImbicControllerNode:
        controller = ImbicControllerNode(
            context=context, parameter_overrides=overrides(PARAMETERS, changes)
        )
        made.append(controller)
        spinner.add_node(controller)
        assert controller.trigger_configure() is SUCCESS, controller.transition_error
        return controller

    yield factory
    for controller in made:
        spinner.remove_node(controller)
        controller.destroy_node()


def under_torque(controller: ImbicControllerNode, driver: ScriptedDriver, spinner: Spinner) -> None:
    """Activate, and feed some samples at once, which are answered at once."""
    assert controller.trigger_activate() is SUCCESS, controller.transition_error
    driver.wait_for_controller()
    for _ in range(20):
        driver.feed(OFF, (0.0, 0.0))
    eventually(spinner, lambda: driver.answered, "an answer to every sample")
    assert any(command != (0.0, 0.0) for command in driver.commands)


def test_when_samples_stay_away_expect_the_torque_ramped_to_zero_and_an_abort(
    make: MakeController, driver: ScriptedDriver, spinner: Spinner
) -> None:
    under_torque(make(), driver, spinner)

    eventually(
        spinner,
        lambda: driver.has_said(Phase.ABORTED) and driver.commands[-1] == (0.0, 0.0),
        "zero torque",
    )
    a_moment(spinner)

    ramp = np.array(driver.commands[19:])
    assert (np.diff(np.abs(ramp), axis=0) <= 0.0).all()
    assert driver.statuses[-1].reason == SILENCE
    assert driver.commands[-1] == (0.0, 0.0)


def test_when_a_sample_comes_after_a_stall_before_anyone_looked_expect_an_abort_all_the_same(
    make: MakeController, driver: ScriptedDriver, spinner: Spinner
) -> None:
    controller = make()
    under_torque(controller, driver, spinner)
    # Nothing is spun: the process is held up, and finds timer and sample waiting afterwards.
    time.sleep(0.02)
    controller._on_position(driver.stamp_ns, OFF)
    controller._on_torque(driver.stamp_ns, (0.0, 0.0))

    eventually(spinner, lambda: driver.has_said(Phase.ABORTED), "an abort")

    assert driver.statuses[-1].reason == SILENCE
