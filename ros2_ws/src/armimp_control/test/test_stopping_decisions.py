"""The controller node and decisions: in lockstep samples wait for them, on a rig they do not."""

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.node import Node

from armimp_common import qos, topics
from armimp_common.executor import Spinner
from armimp_common.status import NOTICE_TICKS, Phase, StoppingDecision, status_message
from support.controller import NAMES, POSTURE, active_controller, controller_parameters
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


class World:
    """A controller in its first perturbation, which knows of a decision to come, and its judge."""

    def __init__(self, node: Node, spinner: Spinner, launch: Launch) -> None:
        self.spinner = spinner
        self.driver = driver = ScriptedDriver(node, NAMES)
        self.judge = node.create_publisher(DiagnosticStatus, topics.STOPPING, qos.LATCHED)
        controller = active_controller(launch, driver, PARAMETERS, {"sequence.may_end_early": True})
        eventually(spinner, lambda: self.judge.get_subscription_count() == 1, "who is judged")
        driver.feed(POSTURE, ticks=SETTLE + 1)
        driver.await_phase(Phase.PERTURB, spinner)
        self.judge.publish(status_message(ANNOUNCED))
        sequencer = controller._sequencer
        assert sequencer is not None
        eventually(spinner, lambda: sequencer._due is not None, "the decision to come is known")

    def feed_up_to_the_decision(self) -> None:
        """Feed all samples before that on which the decision decides, and then that one."""
        self.driver.feed(POSTURE, ticks=END - 1)
        self.driver.await_answers(self.spinner)
        self.driver.feed(POSTURE)
        a_moment(self.spinner)
        assert len(self.driver.commands) == len(self.driver.perturbations) == SETTLE + END


@pytest.fixture
def world(node: Node, spinner: Spinner, launch: Launch, clock: HandedClock) -> World:
    return World(node, spinner, launch)


@pytest.mark.parametrize(("decision", "ticks"), [(ENOUGH, END), (NOT_YET, PERTURB)])
def test_in_lockstep_the_sample_on_which_a_decision_decides_is_answered_after_it(
    world: World, decision: StoppingDecision, ticks: int
) -> None:
    world.feed_up_to_the_decision()

    world.judge.publish(status_message(decision))
    world.driver.await_answers(world.spinner)
    world.driver.feed(POSTURE, ticks=PERTURB)
    rest = world.driver.await_phase(Phase.REST, world.spinner)

    assert (rest.tick, rest.ticks, rest.valid) == (SETTLE + ticks, ticks, True)


def test_when_an_announced_decision_does_not_come_expect_the_end_with_that_reason(
    world: World, clock: HandedClock
) -> None:
    world.feed_up_to_the_decision()
    clock.now += 60.0

    aborted = world.driver.await_phase(Phase.ABORTED, world.spinner)

    assert aborted.reason == "the estimator does not say whether the trial is over"
    eventually(world.spinner, lambda: world.driver.commands[-1] == (0.0, 0.0), "zero torque")
