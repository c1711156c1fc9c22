"""The controller node and decisions: in lockstep samples wait for them, on a rig they do not."""

from collections.abc import Callable, Mapping

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.node import Node
from rclpy.publisher import Publisher

from armimp_common import qos, topics
from armimp_common.executor import Spinner
from armimp_common.schema import Value
from armimp_common.status import NOTICE_TICKS, Phase, StoppingDecision, status_message
from armimp_control.node import ImbicControllerNode
from support.controller import NAMES, POSTURE, SUCCESS, controller_parameters
from support.graph import HandedClock, Launch, ScriptedDriver, a_moment, eventually

SETTLE, PERTURB, REST = 50, 600, 50
JUDGED = 20
END = JUDGED + NOTICE_TICKS
PARAMETERS = controller_parameters(SETTLE, PERTURB, REST)
ANNOUNCED = StoppingDecision(trial=1, samples=0, enough=False, due=JUDGED, bound=0.02)
ENOUGH = StoppingDecision(trial=1, samples=JUDGED, enough=True, due=None, bound=0.02, largest=0.01)
NOT_YET = StoppingDecision(
    trial=1, samples=JUDGED, enough=False, due=None, bound=0.02, largest=0.03
)

Start = Callable[..., ImbicControllerNode]


@pytest.fixture
def driver(node: Node) -> ScriptedDriver:
    return ScriptedDriver(node, NAMES)


@pytest.fixture
def judge(node: Node) -> Publisher:
    return node.create_publisher(DiagnosticStatus, topics.STOPPING, qos.LATCHED)


@pytest.fixture
def start(
    launch: Launch, spinner: Spinner, driver: ScriptedDriver, judge: Publisher, clock: HandedClock
) -> Start:
    """Makes a controller which is in its first perturbation and knows of a decision to come."""

    def factory(changes: Mapping[str, Value] | None = None) -> ImbicControllerNode:
        changes = {"sequence.may_end_early": True, **(changes or {})}
        controller: ImbicControllerNode = launch(ImbicControllerNode, PARAMETERS, changes)
        assert controller.trigger_configure() is SUCCESS
        assert controller.trigger_activate() is SUCCESS
        driver.wait_for_controller()
        eventually(spinner, lambda: judge.get_subscription_count() == 1, "somebody who is judged")
        feed(driver, SETTLE + 1)
        eventually(spinner, lambda: driver.has_said(Phase.PERTURB), "the perturbation")
        judge.publish(status_message(ANNOUNCED))
        sequencer = controller._sequencer
        assert sequencer is not None
        eventually(spinner, lambda: sequencer._due is not None, "the decision to come is known")
        return controller

    return factory


def feed(driver: ScriptedDriver, ticks: int) -> None:
    for _ in range(ticks):
        driver.feed(POSTURE, (0.0, 0.0))


def feed_up_to_the_decision(driver: ScriptedDriver, spinner: Spinner) -> None:
    feed(driver, END - 1)
    eventually(spinner, lambda: len(driver.commands) == SETTLE + END, "answers up to the decision")


@pytest.mark.parametrize(("decision", "ticks"), [(ENOUGH, END), (NOT_YET, PERTURB)])
def test_in_lockstep_the_sample_on_which_a_decision_decides_is_answered_after_it(
    start: Start,
    driver: ScriptedDriver,
    spinner: Spinner,
    judge: Publisher,
    decision: StoppingDecision,
    ticks: int,
) -> None:
    start()
    feed_up_to_the_decision(driver, spinner)
    feed(driver, 1)
    a_moment(spinner)
    assert len(driver.commands) == len(driver.perturbations) == SETTLE + END

    judge.publish(status_message(decision))
    eventually(spinner, lambda: len(driver.commands) == SETTLE + END + 1, "the answer")
    feed(driver, PERTURB)
    eventually(spinner, lambda: driver.has_said(Phase.REST), "the end of the perturbation")
    eventually(spinner, lambda: driver.answered, "an answer to every sample")

    rest = next(status for status in driver.statuses if status.phase is Phase.REST)
    assert (rest.tick, rest.ticks, rest.valid) == (SETTLE + ticks, ticks, True)


def test_when_an_announced_decision_does_not_come_expect_the_end_with_that_reason(
    start: Start, driver: ScriptedDriver, spinner: Spinner, clock: HandedClock
) -> None:
    start()
    feed_up_to_the_decision(driver, spinner)
    feed(driver, 1)
    a_moment(spinner)
    clock.now += 60.0

    eventually(spinner, lambda: driver.has_said(Phase.ABORTED), "the end")

    assert driver.statuses[-1].reason == "the estimator does not say whether the trial is over"
    eventually(spinner, lambda: driver.commands[-1] == (0.0, 0.0), "zero torque")
