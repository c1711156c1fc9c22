"""The controller node over real DDS: answers, faults, watchdog, surroundings, early ends."""

import math
from collections.abc import Mapping, Sequence

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node
from std_msgs.msg import UInt64

from armimp_common import heartbeat, topics
from armimp_common.cdr import JointStateEncoder
from armimp_common.executor import Spinner
from armimp_common.pubsub import create_publisher, subscribe
from armimp_common.schema import Value
from armimp_common.status import (
    NOTICE_TICKS,
    Level,
    Phase,
    StoppingDecision,
    status_message,
    values_of,
)
from armimp_common.topics import ESTIMATOR_NODE, SIM_NODE, SUPERVISOR_NODE
from armimp_control.node import ImbicControllerNode
from armimp_control.safety_limiter import SafetyParameters
from support.controller import FAILURE, NAMES, POSTURE, SUCCESS, ask, controller_parameters, wobble
from support.graph import (
    CLOCK_STEPS,
    HandedClock,
    Launch,
    ScriptedDriver,
    a_moment,
    assert_locked_while_active,
    eventually,
    report,
    set_clock,
)

SETTLE, PERTURB, REST = 50, 100, 50
START = 5_000_000_000
# A timeout so long that no test meets the watchdog by accident.
PARAMETERS = controller_parameters(
    SETTLE, PERTURB, REST, safety=SafetyParameters(slowest_tick=10.0)
)
ZERO = (0.0, 0.0)
OFF = (POSTURE[0] + 1e-4, POSTURE[1])
SILENCE = "gave no sign of life for 6 s: it is dead or stopped"
IMPATIENT: dict[str, Value] = {"safety.slowest_tick": 0.06, "safety.watchdog_ticks": 5}


class World:
    """A scripted rig, and the controllers that are launched for it."""

    before = 60
    """Answers from before a test expects an abort."""

    def __init__(self, node: Node, spinner: Spinner, launch: Launch) -> None:
        self.node, self.spinner, self.launch = node, spinner, launch
        self.driver = ScriptedDriver(node, NAMES, start_ns=START)

    def bring_up(self, changes: Mapping[str, Value] | None = None) -> ImbicControllerNode:
        """A controller that is active, and that the driver reaches."""
        controller: ImbicControllerNode = self.launch(ImbicControllerNode, PARAMETERS, changes)
        assert controller.trigger_configure() is SUCCESS, controller.transition_error
        assert controller.trigger_activate() is SUCCESS, controller.transition_error
        self.driver.wait_for_controller()
        return controller

    def start(self, changes: Mapping[str, Value] | None = None) -> ImbicControllerNode:
        """Bring a controller up, and have it command torque in 60 answers."""
        controller = self.bring_up(changes)
        for theta, tau_h in wobble(60):
            self.driver.feed(theta, tau_h)
        self.driver.await_answers(self.spinner)
        assert self.driver.commands[-1] != ZERO
        return controller

    def feed(self, ticks: int, theta: Sequence[float] = POSTURE) -> None:
        """Feed samples that are alike, and wait for the answers."""
        self.driver.feed(theta, ticks=ticks)
        self.driver.await_answers(self.spinner)

    def await_abort(self) -> str:
        """Wait for the end of the trial with at least one more command, and return the reason."""
        driver = self.driver
        eventually(
            self.spinner,
            lambda: driver.has_said(Phase.ABORTED) and len(driver.commands) > self.before,
            "an abort",
        )
        assert driver.messages[-1].level == bytes([Level.ERROR])
        return driver.statuses[-1].reason

    def ask(self, service: str) -> tuple[bool, str]:
        return ask(self.node, self.spinner, service)


@pytest.fixture
def world(node: Node, spinner: Spinner, launch: Launch) -> World:
    return World(node, spinner, launch)


MALFORMED = {
    "truncated": JointStateEncoder(NAMES, "position").encode(START, POSTURE)[:-30],
    "empty": b"",
    "unknown joint": JointStateEncoder(("shoulder", "wrist"), "position").encode(START, POSTURE),
}
"""One of each kind; the tests of the decoder show which messages are malformed."""


@pytest.mark.parametrize("topic", [topics.JOINT_STATES, topics.TORQUE_SENSORS])
@pytest.mark.parametrize("message", MALFORMED.values(), ids=MALFORMED.keys())
def test_when_a_sample_is_malformed_expect_zero_torque_and_an_abort(
    world: World, topic: str, message: bytes
) -> None:
    world.start()
    driver = world.driver

    driver.channels[topic].publisher.publish(message)
    reason = world.await_abort()

    assert driver.commands[60:] == [ZERO]
    assert reason.startswith("malformed sensor message: JointState")
    assert "\n" not in reason
    world.feed(10)
    assert set(driver.commands[60:]) == {ZERO}
    assert {values for _, values in driver.perturbations[60:]} == {ZERO}


@pytest.mark.parametrize(
    ("topic", "what"),
    [(topics.JOINT_STATES, "position"), (topics.TORQUE_SENSORS, "torque reading")],
)
def test_when_a_reading_without_a_partner_is_not_finite_expect_zero_torque_at_once(
    world: World, topic: str, what: str
) -> None:
    world.start()
    driver = world.driver

    for _ in range(3):
        driver.channels[topic].publish(driver.stamp_ns + 10**15, (math.nan, 1.0))
    reason = world.await_abort()
    assert reason == f"{what} of joint 1 is not finite: nan"
    driver.feed(POSTURE, ticks=3)
    eventually(world.spinner, lambda: len(driver.perturbations) >= 63, "an answer to every sample")

    # One command is enough beside the answers: in lockstep each is a step.
    eventually(world.spinner, lambda: len(driver.commands) >= 64, "the commands")
    assert driver.commands[60:] == [ZERO] * 4


@pytest.mark.parametrize("clock_step", [None, *CLOCK_STEPS])
def test_when_samples_stay_away_expect_the_torque_ramped_to_zero_and_an_abort(
    world: World, clock: HandedClock, clock_step: float | None
) -> None:
    controller = world.start({**IMPATIENT, "safety.ramp_time": 0.05})
    driver = world.driver
    if clock_step is not None:
        set_clock(controller, clock_step)

    last = np.abs(driver.commands[59])
    a_moment(world.spinner)
    assert len(driver.commands) == 60
    clock.pace = 0.005
    reason = world.await_abort()
    eventually(world.spinner, lambda: driver.commands[-1] == ZERO, "zero torque")
    a_moment(world.spinner)

    ramp = np.array([last, *np.abs(driver.commands[60:])])
    assert (np.diff(ramp, axis=0) <= 0.0).all()
    assert len(np.unique(ramp)) > 5
    assert driver.commands[-1] == ZERO
    assert reason == "no sensor sample arrived any more"


def test_emergency_stop_takes_the_torque_away_at_once_and_for_good(world: World) -> None:
    controller = world.start()

    success, message = world.ask(topics.CONTROLLER_STOP_SERVICE)
    assert success
    assert message == "no torque until imbic_controller/reset is called"
    assert world.await_abort() == "emergency stop"
    assert world.driver.commands[60:] == [ZERO]
    world.feed(20)
    assert controller.trigger_deactivate() is SUCCESS
    assert controller.trigger_activate() is FAILURE
    assert controller.transition_error == (
        "a fault is latched: emergency stop; call imbic_controller/reset first"
    )
    assert controller.trigger_cleanup() is SUCCESS
    assert controller.trigger_configure() is SUCCESS
    assert controller.trigger_activate() is FAILURE
    assert set(world.driver.commands[60:]) == {ZERO}

    told = "reset: emergency stop; the next activation begins a new experiment"
    assert world.ask(topics.CONTROLLER_RESET_SERVICE) == (True, told)
    assert controller.trigger_activate() is SUCCESS, controller.transition_error


@pytest.mark.parametrize(
    ("theta", "reason"),
    [
        ((POSTURE[0] + 0.6, POSTURE[1]), "joint 1 is 0.6 rad away from the posture"),
        ((POSTURE[0], math.nan), "position of joint 2 is not finite: nan"),
    ],
)
def test_while_the_cause_persists_expect_reset_refused(
    world: World, theta: tuple[float, float], reason: str
) -> None:
    world.start()
    world.feed(20, theta)
    assert world.driver.commands[-1] == ZERO
    success, message = world.ask(topics.CONTROLLER_RESET_SERVICE)
    assert not success
    assert message.startswith(f"not reset: the cause persists: {reason}")

    world.feed(20)
    success, message = world.ask(topics.CONTROLLER_RESET_SERVICE)
    assert success
    assert message.startswith(f"reset: {reason}")
    assert world.ask(topics.CONTROLLER_RESET_SERVICE) == (True, "there was no fault")


def test_clips_and_fault_go_out_at_a_low_rate_and_at_once_on_a_fault(world: World) -> None:
    heard: list[DiagnosticStatus] = []
    driver = world.driver

    def hear(message: DiagnosticArray) -> None:
        heard.extend(message.status)

    subscribe(world.node, topics.DIAGNOSTICS, hear)
    world.bring_up({"safety.torque_limit": 1e-3, "sequence.duration": 2.0})
    for tick, (theta, tau_h) in enumerate(wobble(1010)):
        driver.feed(theta, tau_h)
        if tick % 100 == 0:
            driver.await_answers(world.spinner)
    eventually(world.spinner, lambda: len(heard) == 1, "diagnostics")
    values = values_of(heard[0])
    assert (heard[0].level, heard[0].message) == (bytes([Level.WARN]), "commands were clipped")
    assert values["tick"] == "1000"
    assert int(values["clipped_torque"]) > 0

    driver.feed((math.nan, 0.0))
    eventually(world.spinner, lambda: len(heard) == 2, "diagnostics of the fault")
    assert heard[1].level == bytes([Level.ERROR])
    assert heard[1].message == values_of(heard[1])["fault"]
    assert heard[1].message == "position of joint 1 is not finite: nan"


def test_while_active_changes_are_refused_with_a_reason(world: World) -> None:
    assert_locked_while_active(world.bring_up(), "law.gamma", 50.0, "a trial is running")


@pytest.mark.parametrize("how", ["trigger_shutdown", "destroy_node"])
def test_when_ended_during_a_trial_expect_zero_torque_and_an_abort(world: World, how: str) -> None:
    getattr(world.start(), how)()
    world.await_abort()
    assert world.driver.commands[60:] == [ZERO]


# --- The surroundings: the experiment ends when one of the others is lost -----------------------


class Surrounded(World):
    """A controller under torque among other nodes, with their heartbeats and a recorder."""

    def surround(self, mode: str = "lockstep") -> None:
        self.received = create_publisher(self.node, topics.RECEIVED)
        self.controller = self.start({"mode": mode})
        self.monitors = [*self.controller._partners, self.controller._supervisor]

    def heard(self, name: str, *, alive: int, silent: int) -> None:
        (monitor,) = (one for one in self.monitors if one.name == name)
        report(monitor, alive=alive, silent=silent)

    def assert_going_on(self) -> None:
        """The answer to one more sample is a torque."""
        self.feed(1, OFF)
        self.before = self.driver.tick
        assert self.driver.commands[-1] != ZERO
        assert not self.driver.has_said(Phase.ABORTED)

    def assert_aborted(self, reason: str) -> None:
        assert self.await_abort() == reason
        self.driver.feed(OFF)
        eventually(self.spinner, lambda: len(self.driver.commands) > self.before + 1, "an answer")
        assert set(self.driver.commands[self.before :]) == {ZERO}


@pytest.fixture
def around(node: Node, spinner: Spinner, launch: Launch, clock: HandedClock) -> Surrounded:
    return Surrounded(node, spinner, launch)


@pytest.mark.parametrize(
    ("mode", "name", "borne", "lost", "how"),
    [
        ("lockstep", SIM_NODE, 0, 1, SILENCE),
        ("lockstep", SIM_NODE, 0, 0, "has left"),
        # Orchestrator and recorder may be silent in lockstep, until they are dead.
        ("lockstep", SUPERVISOR_NODE, 1, 0, "is dead"),
        ("lockstep", ESTIMATOR_NODE, 1, 0, "is dead"),
        ("realtime", ESTIMATOR_NODE, 0, 1, SILENCE),
        ("realtime", SIM_NODE, 0, 1, SILENCE),
    ],
)
def test_when_another_node_is_lost_expect_zero_torque_but_patience_with_those_that_may_be_silent(
    around: Surrounded, mode: str, name: str, borne: int, lost: int, how: str
) -> None:
    around.surround(mode)
    around.heard(name, alive=1, silent=0)
    if borne:
        around.heard(name, alive=0, silent=borne)
    around.assert_going_on()

    around.heard(name, alive=0, silent=lost)

    around.assert_aborted(f"{name} {how}")


def test_when_this_process_was_held_up_expect_no_torque_for_a_rig_that_has_died_meanwhile(
    around: Surrounded, clock: HandedClock, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(heartbeat, "state_of", lambda _: "R")
    around.surround()
    around.heard(SIM_NODE, alive=1, silent=0)
    monkeypatch.setattr(heartbeat, "state_of", lambda _: "")
    # Only the sample can find out: it is waiting, and the timers of the monitors are off.
    for monitor in around.monitors:
        monitor._timer.cancel()
        monitor.checked = clock.now - 0.1

    around.driver.feed(OFF)

    around.assert_aborted(f"{SIM_NODE} is dead")


def test_when_the_recorder_takes_leave_expect_zero_torque(around: Surrounded) -> None:
    around.surround()
    around.received.publish(UInt64(data=0))
    eventually(around.spinner, lambda: around.controller._recorded, "the recorder is known")
    around.assert_going_on()

    around.received.publish(UInt64(data=topics.RECORDER_GONE))

    around.assert_aborted("nothing is recorded any more")


def test_when_a_sample_comes_after_a_stall_before_anyone_looked_expect_an_abort_all_the_same(
    around: Surrounded, clock: HandedClock
) -> None:
    around.surround("realtime")

    # Nothing is spun: the process is held up, and finds timer and sample waiting afterwards.
    clock.now += 0.02
    around.controller._on_reading(0, around.driver.stamp_ns, OFF)
    around.controller._on_reading(1, around.driver.stamp_ns, ZERO)

    assert around.await_abort() == "no sensor sample arrived any more"


# --- Decisions on the end of a trial: in lockstep samples wait for them -------------------------

LONG = 600
JUDGED = 20
END = JUDGED + NOTICE_TICKS
ANNOUNCED = StoppingDecision(trial=1, samples=0, enough=False, due=JUDGED, bound=0.02)
ENOUGH = StoppingDecision(trial=1, samples=JUDGED, enough=True, due=None, bound=0.02, largest=0.01)
NOT_YET = StoppingDecision(
    trial=1, samples=JUDGED, enough=False, due=None, bound=0.02, largest=0.03
)


class Judged(World):
    """A controller in its first perturbation that awaits a stopping decision, and its judge."""

    def __init__(self, node: Node, spinner: Spinner, launch: Launch) -> None:
        super().__init__(node, spinner, launch)
        self.judge = create_publisher(node, topics.STOPPING)
        trial: dict[str, Value] = {"sequence.duration": LONG / 1000, "sequence.may_end_early": True}
        self.controller = self.bring_up(trial)
        eventually(spinner, lambda: self.judge.get_subscription_count() == 1, "who is judged")
        self.driver.feed(POSTURE, ticks=SETTLE + 1)
        self.driver.await_phase(Phase.PERTURB, spinner)
        self.judge.publish(status_message(ANNOUNCED))
        sequencer = self.controller._sequencer
        assert sequencer is not None
        eventually(spinner, lambda: sequencer._due is not None, "the decision to come is known")

    def feed_up_to_the_decision(self) -> None:
        """Feed all samples before the one at which the trial may end, and then that one."""
        self.feed(END - 1)
        self.driver.feed(POSTURE)
        eventually(self.spinner, lambda: self.controller._held is not None, "a sample that waits")
        assert len(self.driver.commands) == len(self.driver.perturbations) == SETTLE + END


@pytest.fixture
def judged(node: Node, spinner: Spinner, launch: Launch, clock: HandedClock) -> Judged:
    return Judged(node, spinner, launch)


@pytest.mark.parametrize(("decision", "ticks"), [(ENOUGH, END), (NOT_YET, LONG)])
def test_in_lockstep_the_sample_that_a_decision_is_about_is_answered_after_it(
    judged: Judged, decision: StoppingDecision, ticks: int
) -> None:
    judged.feed_up_to_the_decision()

    judged.judge.publish(status_message(decision))
    judged.driver.await_answers(judged.spinner)
    judged.driver.feed(POSTURE, ticks=LONG)
    rest = judged.driver.await_phase(Phase.REST, judged.spinner)

    assert (rest.tick, rest.ticks, rest.valid) == (SETTLE + ticks, ticks, True)


def test_when_an_announced_decision_does_not_come_expect_the_end_with_that_reason(
    judged: Judged, clock: HandedClock
) -> None:
    judged.feed_up_to_the_decision()
    clock.now += 60.0

    aborted = judged.driver.await_phase(Phase.ABORTED, judged.spinner)

    assert aborted.reason == "the estimator does not say whether the trial is over"
    eventually(judged.spinner, lambda: judged.driver.commands[-1] == (0.0, 0.0), "zero torque")
