"""The controller in real time: the same answers, and a watchdog of five milliseconds."""

from __future__ import annotations

import pytest
from rclpy.node import Node

from armimp_common.executor import Spinner
from armimp_common.schema import build, flatten
from armimp_common.status import Phase
from armimp_control.node import ImbicControllerNode
from armimp_control.parameters import ControllerParameters
from support.controller import NAMES, POSTURE, SUCCESS, controller_parameters
from support.graph import HandedClock, Launch, ScriptedDriver, eventually

OFF = (POSTURE[0] + 1e-4, POSTURE[1])
LOCKSTEP = controller_parameters(300, 200, 300)
PARAMETERS = build(ControllerParameters, {**flatten(LOCKSTEP), "mode": "realtime"})
SILENCE = "no sensor sample arrived any more"


@pytest.fixture
def driver(node: Node) -> ScriptedDriver:
    return ScriptedDriver(node, NAMES)


@pytest.fixture
def controller(launch: Launch, clock: HandedClock) -> ImbicControllerNode:
    made: ImbicControllerNode = launch(ImbicControllerNode, PARAMETERS)
    assert made.trigger_configure() is SUCCESS, made.transition_error
    return made


def under_torque(controller: ImbicControllerNode, driver: ScriptedDriver, spinner: Spinner) -> None:
    """Activate, and feed some samples at once, which are answered at once."""
    assert controller.trigger_activate() is SUCCESS, controller.transition_error
    driver.wait_for_controller()
    for _ in range(20):
        driver.feed(OFF, (0.0, 0.0))
    eventually(spinner, lambda: driver.answered, "an answer to every sample")
    assert any(command != (0.0, 0.0) for command in driver.commands)


def test_when_a_sample_comes_after_a_stall_before_anyone_looked_expect_an_abort_all_the_same(
    controller: ImbicControllerNode, driver: ScriptedDriver, spinner: Spinner, clock: HandedClock
) -> None:
    under_torque(controller, driver, spinner)
    # Nothing is spun: the process is held up, and finds timer and sample waiting afterwards.
    clock.now += 0.02
    controller._on_reading(0, driver.stamp_ns, OFF)
    controller._on_reading(1, driver.stamp_ns, (0.0, 0.0))

    eventually(spinner, lambda: driver.has_said(Phase.ABORTED), "an abort")

    assert driver.statuses[-1].reason == SILENCE
