"""The estimator node over real DDS, fed by a script: results, faults, parameters, life cycle."""

import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.node import Node
from rosbags.highlevel import AnyReader

from armimp_common import topics
from armimp_common.cdr import decode_trial_status, encode_trial_status
from armimp_common.executor import Spinner
from armimp_common.pubsub import create_publisher, subscribe, subscribe_raw, wait_for_partners
from armimp_common.schema import Value
from armimp_common.status import Level, Phase
from armimp_common.topics import COMMANDS, RESULT, TRIAL
from armimp_estimation.bags.reader import read_bag
from armimp_estimation.node import RESULT_NAME, ImpedanceEstimatorNode
from armimp_estimation.parameters import EstimatorParameters
from armimp_estimation.problems import ProblemCode
from armimp_estimation.summary import Summary, read_summary
from support.controller import FAILURE, SUCCESS, Partner
from support.graph import PATIENCE, Launch, assert_locked_while_active, overrides, report
from support.problems import codes
from support.processes import wait_until
from support.streams import changed
from support.synthetic_bags import Message, synthetic_recording

SETTLE, TICKS, REST = 60, 100, 60
MADE_UP = synthetic_recording(perturbed=(0, 1), ticks=TICKS, settle=SETTLE, rest=REST).messages
"""Two trials, much too short to be estimated."""
ONE_TRIAL = 4 * (SETTLE + TICKS + REST) + 3
LAST = next(decode_trial_status(raw) for topic, _, raw in reversed(MADE_UP) if topic == TRIAL)
DONE = (TRIAL, 0, encode_trial_status(changed(LAST, phase=Phase.DONE)))
CHUNK = 800
"""Messages sent at a time: less than queues hold."""


class Desk(Partner):
    """An estimator, a node that plays messages to it and hears its answers, and its results."""

    def __init__(self, node: Node, spinner: Spinner, launch: Launch, directory: Path) -> None:
        super().__init__(node, spinner)
        self.launch, self.directory = launch, directory
        self.echoes = 0
        self.results: list[DiagnosticStatus] = []
        played = (*topics.DATA_STREAMS, TRIAL)
        self.publishers = {topic: create_publisher(node, topic) for topic in played}
        self.echo = [subscribe_raw(node, topic, self.on_echo) for topic in played]
        self.people = subscribe(node, RESULT, self.results.append)

    def on_echo(self, message: bytes) -> None:
        self.echoes += 1

    def make(self, changes: Mapping[str, Value] | None = None) -> None:
        settings = EstimatorParameters(directory=str(self.directory / "out"))
        self.estimator: ImpedanceEstimatorNode = self.launch(
            ImpedanceEstimatorNode, settings, changes
        )

    def bring_up(self) -> None:
        self.make()
        assert self.estimator.trigger_configure() is SUCCESS, self.estimator.transition_error
        assert self.estimator.trigger_activate() is SUCCESS, self.estimator.transition_error
        self.wait_for_estimator()

    def wait_for_estimator(self) -> None:
        # One subscription of each topic is the echo.
        publishers = self.publishers.values()
        wait_until(
            lambda: all(one.get_subscription_count() >= 2 for one in publishers), "who listens"
        )
        wait_for_partners(self.node, subscriptions=[self.people])

    def play(self, messages: Iterable[Message]) -> None:
        """Publish messages no faster than they are received."""
        sent = list(messages)
        for start in range(0, len(sent), CHUNK):
            self.send(sent[start : start + CHUNK])

    def send(self, messages: Sequence[Message]) -> None:
        wanted = self.echoes + len(messages)
        for topic, _, raw in messages:
            self.publishers[topic].publish(raw)
        self.until(lambda: self.echoes >= wanted, "echoes")

    @property
    def conclusions(self) -> list[DiagnosticStatus]:
        return [result for result in self.results if result.name == RESULT_NAME]

    def conclude(self, messages: Iterable[Message] = ()) -> Summary:
        """Play messages, and wait for the conclusion; return the stored summary."""
        self.play(messages)
        self.until(lambda: bool(self.conclusions), "the conclusion")
        return read_summary(self.directory / "out" / "summary.json")

    def announce(self, phase: Phase) -> None:
        raw = next(raw for topic, _, raw in MADE_UP if topic == TRIAL)
        start_ns = None if phase is Phase.SETTLE else 0
        status = changed(decode_trial_status(raw), phase=phase, start_ns=start_ns)
        self.publishers[TRIAL].publish(encode_trial_status(status))

    @property
    def bags(self) -> list[Path]:
        return sorted((self.directory / "out" / "bags").iterdir())


@pytest.fixture
def desk(node: Node, spinner: Spinner, launch: Launch, tmp_path: Path) -> Desk:
    return Desk(node, spinner, launch, tmp_path)


def test_when_a_message_is_malformed_expect_it_named_and_the_node_alive(desk: Desk) -> None:
    desk.bring_up()
    messages, topic = list(MADE_UP), topics.PERTURBATION
    spoiled = next(i for i in range(500, 600) if messages[i][0] == topic)
    messages[spoiled] = (topic, 0, b"\0\1\0\0")

    summary = desk.conclude(messages)

    assert not summary.valid
    refused, missing = summary.problems[:2]
    assert (refused.code, refused.values["stream"]) == (ProblemCode.MESSAGE_REFUSED, topic)
    assert (missing.code, missing.values["stream"]) == (ProblemCode.SAMPLES_MISSING, topic)
    assert len(desk.bags) == 2


def test_samples_may_come_after_the_end_was_announced(
    desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("armimp_estimation.node._STRAGGLERS", PATIENCE)
    desk.bring_up()
    statuses = [message for message in MADE_UP if message[0] == TRIAL]

    desk.play([*statuses, DONE])
    desk.until(lambda: desk.estimator._done_at < math.inf, "the end")
    assert desk.estimator.result is None
    summary = desk.conclude(message for message in MADE_UP if message[0] != TRIAL)

    assert [(trial.ticks, trial.lost) for trial in summary.trials] == [(TICKS, 0)] * 2
    assert len(desk.bags) == 2


def test_when_samples_stay_away_after_the_end_expect_the_result_without_them(
    desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("armimp_estimation.node._STRAGGLERS", 0.1)
    desk.bring_up()
    whole = ONE_TRIAL + 4 * (SETTLE + TICKS)
    cut = [message for message in MADE_UP[whole:] if message[0] == TRIAL]

    summary = desk.conclude([*MADE_UP[: whole - 40], *cut, DONE])

    assert not summary.valid
    first, second = summary.trials
    assert first.lost == 0
    assert second.lost > 0


def test_when_the_bag_exists_expect_the_end_with_the_reason_and_nothing_overwritten(
    desk: Desk,
) -> None:
    bag = desk.directory / "out" / "bags" / "trial_1_joint_1"
    bag.mkdir(parents=True)
    desk.bring_up()

    problem = desk.conclude(MADE_UP[:ONE_TRIAL]).problems[0]

    assert problem.code is ProblemCode.RECORDING_FAILED
    assert str(bag) in problem.sentence
    assert list(bag.iterdir()) == []


def test_while_active_changes_are_refused_with_a_reason(desk: Desk) -> None:
    desk.bring_up()
    assert_locked_while_active(desk.estimator, "record", False, "a trial is being recorded")


@pytest.mark.parametrize(
    ("name", "value", "reason"),
    [
        ("estimators", ["welch_sisi"], "unknown estimator 'welch_sisi'"),
        ("metadata", '{"seed": 1}', "parameter 'metadata' is not a JSON object of strings"),
        ("metadata", '{"config": "[]"}', "parameter 'metadata': metadata: config: Input"),
    ],
)
def test_when_values_make_no_sense_expect_configure_to_fail_and_the_node_alive(
    desk: Desk, name: str, value: Value, reason: str
) -> None:
    desk.make({name: value})
    assert desk.estimator.trigger_configure() is FAILURE
    assert desk.estimator.transition_error.startswith(reason)
    good = next(one for one in overrides(EstimatorParameters()) if one.name == name)
    desk.estimator.set_parameters([good])
    assert desk.estimator.trigger_configure() is SUCCESS


@pytest.mark.parametrize("how", ["trigger_deactivate", "trigger_shutdown", "destroy_node"])
def test_when_stopped_in_a_trial_expect_a_closed_bag_and_an_invalid_result(
    desk: Desk, how: str
) -> None:
    desk.bring_up()
    part = MADE_UP[: ONE_TRIAL + 4 * (SETTLE + 40)]
    desk.play(part)
    samples = sum(topic == topics.PERTURBATION for topic, _, _ in part)
    counts = desk.estimator._synchronizer._counts
    desk.until(lambda: counts()[topics.PERTURBATION] == samples, "all that was sent")

    getattr(desk.estimator, how)()
    summary = desk.conclude()

    assert summary.problems[0].code is ProblemCode.RECORDING_STOPPED
    assert not summary.valid
    assert desk.conclusions[0].level == bytes([Level.ERROR])
    assert len(desk.bags) == 2
    (cut,) = read_bag(desk.bags[-1]).trials
    assert 35 <= cut.segments[0].samples <= 40


def test_what_came_before_the_activation_does_not_count(desk: Desk) -> None:
    """Perturbations that still wait for their callback would be paired with later commands."""
    desk.make()
    assert desk.estimator.trigger_configure() is SUCCESS
    desk.wait_for_estimator()
    for topic, _, raw in MADE_UP[1 : 1 + 4 * 30]:
        desk.publishers[topic].publish(raw)

    assert desk.estimator.trigger_activate() is SUCCESS
    desk.conclude(MADE_UP)

    (first, _) = desk.bags
    with AnyReader([first]) as reader:
        wanted = [one for one in reader.connections if one.topic.endswith(COMMANDS)]
        recorded = [bytes(raw) for _, _, raw in reader.messages(connections=wanted)]
    sent = [raw for topic, _, raw in MADE_UP if topic == COMMANDS]
    assert len(recorded) >= SETTLE + TICKS
    assert recorded == sent[: len(recorded)]


def begin(desk: Desk, *phases: Phase) -> None:
    desk.bring_up()
    for phase in phases:
        desk.announce(phase)
    estimator = desk.estimator
    desk.until(
        lambda: (
            estimator._recording.status is not None
            and (Phase.DONE not in phases or estimator._done_at < math.inf)
        ),
        "the statuses",
    )


def test_when_it_is_lost_expect_a_conclusion_with_the_reason(desk: Desk) -> None:
    begin(desk, Phase.PERTURB)
    report(desk.estimator._controller, alive=1, silent=0)
    assert desk.estimator.result is None

    report(desk.estimator._controller, alive=0, silent=1)

    problem = str(desk.conclude().problems[0])
    assert problem.startswith("imbic_controller gave no sign of life for")


def test_when_it_leaves_after_the_end_expect_no_complaint(desk: Desk) -> None:
    begin(desk, Phase.PERTURB, Phase.DONE)
    report(desk.estimator._controller, alive=1, silent=0)

    report(desk.estimator._controller, alive=0, silent=0)

    assert ProblemCode.NODE_FAILED not in codes(desk.conclude().problems)
