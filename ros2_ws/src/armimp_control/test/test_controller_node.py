"""The controller node over real DDS: answers, faults, watchdog, surroundings, early ends."""

import math
from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node
from std_msgs.msg import UInt64

from armimp_common import heartbeat, topics
from armimp_common.cdr import JointStateEncoder
from armimp_common.executor import Spinner
from armimp_common.pubsub import (
    JointStatePublisher,
    create_publisher,
    subscribe,
    subscribe_decoded,
    wait_for_partners,
)
from armimp_common.schema import Value
from armimp_common.status import (
    NOTICE_TICKS,
    Level,
    Phase,
    StoppingDecision,
    TrialStatus,
    status_message,
    values_of,
)
from armimp_common.topics import ESTIMATOR_NODE, SIM_NODE, SUPERVISOR_NODE
from armimp_control.node import ImbicControllerNode
from armimp_control.safety_limiter import SafetyParameters
from support.controller import (
    FAILURE,
    NAMES,
    POSTURE,
    SUCCESS,
    Partner,
    controller_parameters,
    wobble,
)
from support.graph import (
    CLOCK_STEPS,
    Launch,
    a_moment,
    assert_locked_while_active,
    raised,
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


class World(Partner):
    """A rig that feeds samples to a controller and keeps its answers."""

    before = 60
    """Answers from before a test expects an abort."""

    def __init__(self, node: Node, spinner: Spinner, launch: Launch) -> None:
        super().__init__(node, spinner)
        self.launch, self.tick = launch, 0
        self.channels = {
            topic: JointStatePublisher(node, topic, NAMES)
            for topic in (topics.JOINT_STATES, topics.TORQUE_SENSORS)
        }
        self.commands: list[tuple[float, ...]] = []
        self.perturbations: list[tuple[float, ...]] = []
        self.messages: list[DiagnosticStatus] = []
        self.subscriptions = [
            subscribe_decoded(node, topic, NAMES, partial(self.keep, answers), raised)
            for topic, answers in (
                (topics.COMMANDS, self.commands),
                (topics.PERTURBATION, self.perturbations),
            )
        ]
        self.subscriptions.append(subscribe(node, topics.TRIAL, self.messages.append))

    def keep(self, answers: list[tuple[float, ...]], _: int, values: tuple[float, ...]) -> None:
        answers.append(values)

    def bring_up(self, changes: Mapping[str, Value] | None = None) -> ImbicControllerNode:
        """A controller that is active, and that the rig reaches."""
        controller: ImbicControllerNode = self.launch(ImbicControllerNode, PARAMETERS, changes)
        assert controller.trigger_configure() is SUCCESS, controller.transition_error
        assert controller.trigger_activate() is SUCCESS, controller.transition_error
        channels = self.channels.values()
        wait_for_partners(self.node, publishers=channels, subscriptions=self.subscriptions)
        return controller

    def start(self, changes: Mapping[str, Value] | None = None) -> ImbicControllerNode:
        """Bring a controller up, and have it command torque in 60 answers."""
        controller = self.bring_up(changes)
        for theta, tau_h in wobble(60):
            self.publish(theta, tau_h)
        self.await_answers()
        assert self.commands[-1] != ZERO
        return controller

    @property
    def stamp_ns(self) -> int:
        """Stamp of the next sample (ns)."""
        return START + self.tick * topics.PERIOD_NS

    @property
    def statuses(self) -> list[TrialStatus]:
        """Trial statuses received."""
        return [TrialStatus.from_values(values_of(message)) for message in self.messages]

    def has_said(self, phase: Phase) -> bool:
        """Whether the controller announced this phase."""
        return any(status.phase is phase for status in self.statuses)

    def publish(
        self, theta: Sequence[float] = POSTURE, tau_h: Sequence[float] = ZERO, ticks: int = 1
    ) -> None:
        """Publish identical samples: angles (rad) and torques on the arm (N·m)."""
        for _ in range(ticks):
            for channel, values in zip(self.channels.values(), (theta, tau_h), strict=True):
                channel.publish(self.stamp_ns, values)
            self.tick += 1

    def feed(self, ticks: int, theta: Sequence[float] = POSTURE) -> None:
        """Publish samples that are alike, and wait for the answers."""
        self.publish(theta, ticks=ticks)
        self.await_answers()

    def await_answers(self) -> None:
        answers = (self.commands, self.perturbations)
        self.until(lambda: min(map(len, answers)) >= self.tick, "an answer to every sample")

    def await_phase(self, phase: Phase) -> TrialStatus:
        """Wait until the controller announces a phase, and return its first status of it."""
        self.until(lambda: self.has_said(phase), f"the phase {phase.value}")
        return next(status for status in self.statuses if status.phase is phase)

    def await_abort(self) -> str:
        """Wait for the end of the trial with at least one more command, and return the reason."""
        self.until(
            lambda: self.has_said(Phase.ABORTED) and len(self.commands) > self.before, "an abort"
        )
        assert self.messages[-1].level == bytes([Level.ERROR])
        return self.statuses[-1].reason


class HandedClock:
    """Replaces the module ``time`` of a node, so that the load of the machine has no effect."""

    def __init__(self) -> None:
        self.now = 1000.0
        self.pace = 0.0

    def monotonic(self) -> float:
        """Return the time (s)."""
        self.now += self.pace
        return self.now


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> HandedClock:
    """The clock of controllers in this process, which stands still until a test advances it."""
    clock = HandedClock()
    monkeypatch.setattr("armimp_control.node.time", clock)
    return clock


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

    world.channels[topic].publisher.publish(message)
    reason = world.await_abort()

    assert world.commands[60:] == [ZERO]
    assert reason.startswith("malformed sensor message: JointState")
    assert "\n" not in reason
    world.feed(10)
    assert set(world.commands[60:]) == {ZERO}
    assert set(world.perturbations[60:]) == {ZERO}


@pytest.mark.parametrize(
    ("topic", "what"),
    [(topics.JOINT_STATES, "position"), (topics.TORQUE_SENSORS, "torque reading")],
)
def test_when_a_reading_without_a_partner_is_not_finite_expect_zero_torque_at_once(
    world: World, topic: str, what: str
) -> None:
    world.start()

    for _ in range(3):
        world.channels[topic].publish(world.stamp_ns + 10**15, (math.nan, 1.0))
    reason = world.await_abort()
    assert reason == f"{what} of joint 1 is not finite: nan"
    world.publish(ticks=3)
    world.until(lambda: len(world.perturbations) >= 63, "an answer to every sample")

    # One command is enough beside the answers: in lockstep each is a step.
    world.until(lambda: len(world.commands) >= 64, "the commands")
    assert world.commands[60:] == [ZERO] * 4


@pytest.mark.parametrize("clock_step", [None, *CLOCK_STEPS])
def test_when_samples_stay_away_expect_the_torque_ramped_to_zero_and_an_abort(
    world: World, clock: HandedClock, clock_step: float | None
) -> None:
    controller = world.start({**IMPATIENT, "safety.ramp_time": 0.05})
    if clock_step is not None:
        set_clock(controller, clock_step)

    last = np.abs(world.commands[59])
    a_moment(world.spinner)
    assert len(world.commands) == 60
    clock.pace = 0.005
    reason = world.await_abort()
    world.until(lambda: world.commands[-1] == ZERO, "zero torque")
    a_moment(world.spinner)

    ramp = np.array([last, *np.abs(world.commands[60:])])
    assert (np.diff(ramp, axis=0) <= 0.0).all()
    assert len(np.unique(ramp)) > 5
    assert world.commands[-1] == ZERO
    assert reason == "no sensor sample arrived any more"


def test_emergency_stop_takes_the_torque_away_at_once_and_for_good(world: World) -> None:
    controller = world.start()

    success, message = world.call(topics.CONTROLLER_STOP_SERVICE)
    assert success
    assert message == "no torque until imbic_controller/reset is called"
    assert world.await_abort() == "emergency stop"
    assert world.commands[60:] == [ZERO]
    world.feed(20)
    assert controller.trigger_deactivate() is SUCCESS
    assert controller.trigger_activate() is FAILURE
    assert controller.transition_error == (
        "a fault is latched: emergency stop; call imbic_controller/reset first"
    )
    assert controller.trigger_cleanup() is SUCCESS
    assert controller.trigger_configure() is SUCCESS
    assert controller.trigger_activate() is FAILURE
    assert set(world.commands[60:]) == {ZERO}

    told = "reset: emergency stop; the next activation begins a new experiment"
    assert world.call(topics.CONTROLLER_RESET_SERVICE) == (True, told)
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
    assert world.commands[-1] == ZERO
    success, message = world.call(topics.CONTROLLER_RESET_SERVICE)
    assert not success
    assert message.startswith(f"not reset: the cause persists: {reason}")

    world.feed(20)
    success, message = world.call(topics.CONTROLLER_RESET_SERVICE)
    assert success
    assert message.startswith(f"reset: {reason}")
    assert world.call(topics.CONTROLLER_RESET_SERVICE) == (True, "there was no fault")


def test_clips_and_fault_go_out_at_a_low_rate_and_at_once_on_a_fault(world: World) -> None:
    heard: list[DiagnosticStatus] = []

    def hear(message: DiagnosticArray) -> None:
        heard.extend(message.status)

    subscribe(world.node, topics.DIAGNOSTICS, hear)
    world.bring_up({"safety.torque_limit": 1e-3, "sequence.duration": 2.0})
    for tick, (theta, tau_h) in enumerate(wobble(1010)):
        world.publish(theta, tau_h)
        if tick % 100 == 0:
            world.await_answers()
    world.until(lambda: len(heard) == 1, "diagnostics")
    values = values_of(heard[0])
    assert (heard[0].level, heard[0].message) == (bytes([Level.WARN]), "commands were clipped")
    assert values["tick"] == "1000"
    assert int(values["clipped_torque"]) > 0

    world.publish((math.nan, 0.0))
    world.until(lambda: len(heard) == 2, "diagnostics of the fault")
    assert heard[1].level == bytes([Level.ERROR])
    assert heard[1].message == values_of(heard[1])["fault"]
    assert heard[1].message == "position of joint 1 is not finite: nan"


def test_while_active_changes_are_refused_with_a_reason(world: World) -> None:
    assert_locked_while_active(world.bring_up(), "law.gamma", 50.0, "a trial is running")


@pytest.mark.parametrize("how", ["trigger_shutdown", "destroy_node"])
def test_when_ended_during_a_trial_expect_zero_torque_and_an_abort(world: World, how: str) -> None:
    getattr(world.start(), how)()
    world.await_abort()
    assert world.commands[60:] == [ZERO]


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
        self.before = self.tick
        assert self.commands[-1] != ZERO
        assert not self.has_said(Phase.ABORTED)

    def assert_aborted(self, reason: str) -> None:
        assert self.await_abort() == reason
        self.publish(OFF)
        self.until(lambda: len(self.commands) > self.before + 1, "an answer")
        assert set(self.commands[self.before :]) == {ZERO}


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

    around.publish(OFF)

    around.assert_aborted(f"{SIM_NODE} is dead")


def test_when_the_recorder_takes_leave_expect_zero_torque(around: Surrounded) -> None:
    around.surround()
    around.received.publish(UInt64(data=0))
    around.until(lambda: around.controller._recorded, "the recorder is known")
    around.assert_going_on()

    around.received.publish(UInt64(data=topics.RECORDER_GONE))

    around.assert_aborted("nothing is recorded any more")


def test_when_a_sample_comes_after_a_stall_before_anyone_looked_expect_an_abort_all_the_same(
    around: Surrounded, clock: HandedClock
) -> None:
    around.surround("realtime")

    # Nothing is spun: the process is held up, and finds timer and sample waiting afterwards.
    clock.now += 0.02
    around.controller._on_reading(0, around.stamp_ns, OFF)
    around.controller._on_reading(1, around.stamp_ns, ZERO)

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
        self.until(lambda: self.judge.get_subscription_count() == 1, "who is judged")
        self.publish(ticks=SETTLE + 1)
        self.await_phase(Phase.PERTURB)
        self.judge.publish(status_message(ANNOUNCED))
        sequencer = self.controller._sequencer
        assert sequencer is not None
        self.until(lambda: sequencer._due is not None, "the decision to come is known")

    def feed_up_to_the_decision(self) -> None:
        """Feed all samples before the one at which the trial may end, and then that one."""
        self.feed(END - 1)
        self.publish()
        self.until(lambda: self.controller._held is not None, "a sample that waits")
        assert len(self.commands) == len(self.perturbations) == SETTLE + END


@pytest.fixture
def judged(node: Node, spinner: Spinner, launch: Launch, clock: HandedClock) -> Judged:
    return Judged(node, spinner, launch)


@pytest.mark.parametrize(("decision", "ticks"), [(ENOUGH, END), (NOT_YET, LONG)])
def test_in_lockstep_the_sample_that_a_decision_is_about_is_answered_after_it(
    judged: Judged, decision: StoppingDecision, ticks: int
) -> None:
    judged.feed_up_to_the_decision()

    judged.judge.publish(status_message(decision))
    judged.await_answers()
    judged.publish(ticks=LONG)
    rest = judged.await_phase(Phase.REST)

    assert (rest.tick, rest.ticks, rest.valid) == (SETTLE + ticks, ticks, True)


def test_when_an_announced_decision_does_not_come_expect_the_end_with_that_reason(
    judged: Judged, clock: HandedClock
) -> None:
    judged.feed_up_to_the_decision()
    clock.now += 60.0

    aborted = judged.await_phase(Phase.ABORTED)

    assert aborted.reason == "the estimator does not say whether the trial is over"
    judged.until(lambda: judged.commands[-1] == (0.0, 0.0), "zero torque")
