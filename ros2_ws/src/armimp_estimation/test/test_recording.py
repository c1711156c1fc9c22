"""Recording: a bag for each trial, closed whatever happens, and the trial handed over."""

import math
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pytest

from armimp_common.errors import BagError, MalformedMessageError
from armimp_common.status import NOTICE_TICKS, Phase, StoppingDecision
from armimp_common.topics import DATA_STREAMS, JOINT_STATES, PERTURBATION, TORQUE_SENSORS, TRIAL
from armimp_estimation.alignment.synchronizer import HandedInbox
from armimp_estimation.bags import read_bag
from armimp_estimation.bags.statuses import decode_trial_status, decode_trial_statuses
from armimp_estimation.conclusion import FinishedTrial
from armimp_estimation.estimators.lpm import LpmFull
from armimp_estimation.record import TrialRecord
from armimp_estimation.recording import Recording
from armimp_estimation.stopping import PrecisionGoal, largest_error
from support.recordings import recorded_arm
from support.synthetic_bags import Message, synthetic_recording

SETTLE, TICKS, REST = 10, 100, 10
SAMPLES = 4 * (SETTLE + TICKS + REST)
MADE_UP = synthetic_recording(perturbed=(0, 1), ticks=TICKS, settle=SETTLE, rest=REST)
NAMES = ("shoulder", "elbow")
METADATA = {"seed": "7", "joint_names": '["shoulder", "elbow"]'}
BAG_NAMES = ("trial_1_joint_1", "trial_2_joint_2")


@dataclass
class Desk:
    """A recording with a list of what it handed over."""

    directory: Path | None
    names: tuple[str, ...] = NAMES
    finished: list[FinishedTrial] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)
    goal: PrecisionGoal | None = None
    together: int = 1
    inbox: HandedInbox = field(default_factory=HandedInbox)
    judgements: list[StoppingDecision] = field(default_factory=list)
    led: int = 0

    def __post_init__(self) -> None:
        self.recording = Recording(
            self.names, self.directory, METADATA, self.on_finished, goal=self.goal
        )

    def on_finished(self, trial: FinishedTrial | None, problem: str) -> None:
        if trial is None:
            self.problems.append(problem)
        else:
            self.finished.append(trial)

    def feed(self, messages: Iterable[Message]) -> None:
        for topic, _, raw in messages:
            if topic == TRIAL:
                self.recording.add_many(self.inbox.take(), self.refuse)
                self.recording.add_status(decode_trial_status(raw))
            elif self.together > 1:
                self.inbox.receiver(topic)(raw)
                self.led += topic == PERTURBATION
                if topic == PERTURBATION and self.led % self.together == 0:
                    self.recording.add_many(self.inbox.take(), self.refuse)
            else:
                self.recording.add(topic, raw)
                if (judgement := self.recording.judge()) is not None:
                    self.judgements.append(judgement)

    def refuse(self, topic: str, error: MalformedMessageError) -> None:
        raise error

    @property
    def bags(self) -> list[Path]:
        assert self.directory is not None
        return sorted((self.directory / "bags").iterdir())


def assert_equal(record: TrialRecord, expected: TrialRecord, samples: int | None = None) -> None:
    for name in ("position", "torque", "perturbation"):
        np.testing.assert_array_equal(
            getattr(record, name), getattr(expected, name)[:, slice(samples)]
        )
    assert record.start_ns == expected.start_ns
    assert record.perturbed_joint == expected.perturbed_joint


@pytest.mark.parametrize("together", [1, 10, 50])
def test_each_trial_gets_a_bag_that_reads_as_what_was_handed_over(
    tmp_path: Path, together: int
) -> None:
    desk = Desk(tmp_path, together=together)

    desk.feed(MADE_UP.messages)

    assert desk.problems == []
    assert [bag.name for bag in desk.bags] == list(BAG_NAMES)
    for number, (path, trial) in enumerate(zip(desk.bags, desk.finished, strict=True), 1):
        assert trial.bag == f"bags/{path.name}"
        assert 0.0 < trial.rtf < math.inf
        assert_equal(trial.assembled.require(), MADE_UP.records[number - 1])
        content = read_bag(path)
        (read,) = content.trials
        assert_equal(read.require(), trial.assembled.require())
        assert read.window == trial.assembled.window
        assert read.ledger == trial.assembled.ledger
        assert content.metadata.items() >= METADATA.items()
        assert content.notes == ()


@pytest.mark.parametrize("together", [1, 10, 50])
def test_bag_holds_the_messages_of_its_trial_and_its_statuses(
    tmp_path: Path, together: int
) -> None:
    desk = Desk(tmp_path, together=together)
    desk.feed(MADE_UP.messages)

    for number, path in enumerate(desk.bags, 1):
        topics: dict[str, list[bytes]] = {}
        for topic, _, raw in read_bag(path).messages():
            topics.setdefault(topic, []).append(raw)
        first = (number - 1) * (SETTLE + TICKS + REST) + SETTLE
        for topic in DATA_STREAMS:
            assert topics[topic] == MADE_UP.by_topic()[topic][first : first + TICKS]
        statuses, problem = decode_trial_statuses(topics[TRIAL])
        assert not problem
        assert [(status.phase, status.trial) for status in statuses] == [
            (phase, number) for phase in (Phase.SETTLE, Phase.PERTURB, Phase.REST)
        ]


@pytest.mark.parametrize("late", [False, True])
def test_statuses_may_come_before_or_after_all_data(tmp_path: Path, late: bool) -> None:
    desk = Desk(tmp_path)

    desk.feed(sorted(MADE_UP.messages, key=lambda message: (message[0] == TRIAL) == late))

    assert desk.problems == []
    assert [bag.name for bag in desk.bags] == list(BAG_NAMES)
    for path, trial, expected in zip(desk.bags, desk.finished, MADE_UP.records, strict=True):
        assert trial.bag == f"bags/{path.name}"
        assert_equal(trial.assembled.require(), expected)
        assert_equal(read_bag(path).records()[0], expected)


def test_without_a_directory_trials_are_handed_over_and_nothing_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    desk = Desk(None)

    desk.feed(MADE_UP.messages)

    assert [trial.bag for trial in desk.finished] == [None, None]
    for trial, expected in zip(desk.finished, MADE_UP.records, strict=True):
        assert_equal(trial.assembled.require(), expected)
    assert list(tmp_path.iterdir()) == []


def test_when_stopped_in_a_trial_expect_its_bag_closed_and_readable(tmp_path: Path) -> None:
    desk = Desk(tmp_path)
    whole = 40
    desk.feed(MADE_UP.messages[: 2 + 4 * (SETTLE + whole) + 1])

    desk.recording.stop()
    desk.recording.stop()

    (trial,) = desk.finished
    assert_equal(trial.assembled.require(), MADE_UP.records[0], whole)
    assert trial.assembled.shortfall == TICKS - whole
    (bag,) = desk.bags
    assert (bag / "metadata.yaml").exists()
    assert_equal(read_bag(bag).records()[0], MADE_UP.records[0], whole)


def test_when_stopped_while_settling_expect_no_trial_and_no_open_bag(tmp_path: Path) -> None:
    desk = Desk(tmp_path)
    desk.feed(MADE_UP.messages[: 4 * (SETTLE - 2)])
    assert desk.recording.status is not None

    desk.recording.stop()

    assert (desk.finished, desk.problems) == ([], [])
    assert desk.recording.status is None
    (bag,) = desk.bags
    with pytest.raises(BagError, match=bag.name):
        read_bag(bag)


def test_when_aborted_expect_the_reason_in_the_trial_and_in_the_bag(tmp_path: Path) -> None:
    desk = Desk(tmp_path)
    desk.feed(MADE_UP.messages[: 2 + 4 * (SETTLE + 40)])
    perturb = decode_trial_status(MADE_UP.by_topic()[TRIAL][1])

    desk.recording.add_status(
        replace(perturb, phase=Phase.ABORTED, valid=False, reason="a fault", tick=50)
    )

    (trial,) = desk.finished
    assert trial.assembled.problem == "aborted: a fault"
    (read,) = read_bag(desk.bags[0]).trials
    assert read.problem == "aborted: a fault"
    assert read.record is not None
    assert_equal(read.record, MADE_UP.records[0], 40)


def test_lost_samples_are_in_the_ledger_of_the_trial_and_of_its_bag(tmp_path: Path) -> None:
    desk = Desk(tmp_path)
    messages = list(MADE_UP.messages)
    lost = [i for i, (topic, _, _) in enumerate(messages) if topic == TORQUE_SENSORS]
    for i in reversed(lost[SETTLE + 20 : SETTLE + 23]):
        del messages[i]

    desk.feed(messages)

    first, second = desk.finished
    assert first.assembled.ledger.lost == 3
    assert first.assembled.problem.startswith("3 samples of torque_sensors are missing")
    assert second.assembled.problem == ""
    assert read_bag(desk.bags[0]).trials[0].ledger == first.assembled.ledger


def test_when_nothing_of_a_stream_can_be_used_expect_the_reason_instead_of_a_trial(
    tmp_path: Path,
) -> None:
    desk = Desk(tmp_path)

    desk.feed(message for message in MADE_UP.messages if message[0] != JOINT_STATES)
    desk.recording.stop()

    assert desk.finished == []
    assert desk.problems == ["no messages of joint_states"] * 2
    assert [bag.name for bag in desk.bags] == list(BAG_NAMES)


def test_when_the_bag_exists_expect_an_error_with_the_first_status(tmp_path: Path) -> None:
    (tmp_path / "bags" / BAG_NAMES[0]).mkdir(parents=True)
    desk = Desk(tmp_path)

    with pytest.raises(BagError, match="trial_1_joint_1"):
        desk.feed(MADE_UP.messages[:3])

    assert desk.recording.status is None


def test_progress_is_told_while_a_trial_is_recorded() -> None:
    desk = Desk(None)
    assert (desk.recording.samples, desk.recording.rate) == (0, 0.0)
    assert desk.recording.status is None
    assert desk.recording.update() is None

    desk.feed(MADE_UP.messages[: 2 + 4 * (SETTLE + 40) + 1])

    assert desk.recording.samples == 40
    assert desk.recording.rate > 0.0
    assert desk.recording.status is not None
    assert desk.recording.status.phase is Phase.PERTURB
    assert desk.recording.update() is None  # too few samples for a spectrum


def test_coherence_begins_anew_with_each_trial() -> None:
    recording = recorded_arm()
    desk = Desk(None, names=recording.records[0].joint_names)
    told: list[tuple[float, float] | None] = []
    for i, message in enumerate(recording.messages):
        desk.feed([message])
        if i % 8000 == 7999:
            told.append(desk.recording.update())

    assert told[0] is None
    assert told[5] is None
    for coherence in (*told[2:4], *told[7:9]):
        assert coherence is not None
        assert min(coherence) > 0.9


def test_when_nothing_comes_any_more_expect_all_of_it_in_the_file(tmp_path: Path) -> None:
    desk = Desk(tmp_path)
    desk.feed(MADE_UP.messages[: 2 + 4 * (SETTLE + 7)])
    with pytest.raises(BagError, match="no messages"):
        read_bag(desk.bags[0])

    desk.recording.flush_if_idle()  # Something has come since it was made.
    desk.recording.flush_if_idle()

    assert_equal(read_bag(desk.bags[0]).records()[0], MADE_UP.records[0], 7)
    desk.recording.stop()


def test_each_trial_is_judged_by_its_first_samples_and_the_trials_before() -> None:
    recording = recorded_arm()
    judged = 6000 - NOTICE_TICKS
    desk = Desk(None, recording.records[0].joint_names, goal=PrecisionGoal(bound=0.5, least=6.0))

    desk.feed(recording.messages)

    told = [(one.trial, one.samples, one.enough) for one in desk.judgements]
    assert told == [(k, samples, samples > 0) for k in (1, 2) for samples in (0, judged)]
    past: list[TrialRecord] = []
    for judgement, record in zip(desk.judgements[1::2], recording.records, strict=True):
        cut = {
            name: getattr(record, name)[:, :judged]
            for name in ("position", "torque", "perturbation")
        }
        column = LpmFull().column(replace(record, **cut, command=cut["perturbation"]), past)
        assert (judgement.largest, judgement.element) == largest_error(column)
        past.append(replace(record, command=record.perturbation))


def test_without_a_goal_nothing_is_judged() -> None:
    desk = Desk(None)
    desk.feed(MADE_UP.messages)
    assert desk.judgements == []


def test_column_is_made_anew_at_most_once_a_second(monkeypatch: pytest.MonkeyPatch) -> None:
    now = 100.0
    monkeypatch.setattr("armimp_estimation.recording.time.monotonic", lambda: now)
    recording = recorded_arm()
    desk = Desk(None, recording.records[0].joint_names)
    messages = iter(recording.messages)
    assert desk.recording.column() is None
    desk.feed(next(messages) for _ in range(20_000))

    first = desk.recording.column()
    desk.feed(next(messages) for _ in range(4000))
    now += 0.9
    assert first is not None
    assert desk.recording.column() is first
    now += 0.2
    second = desk.recording.column()
    assert second is not None
    assert second is not first


def test_while_there_are_too_few_samples_expect_the_column_as_soon_as_there_are_enough(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("armimp_estimation.recording.time.monotonic", lambda: 100.0)
    recording = recorded_arm()
    desk = Desk(None, recording.records[0].joint_names)
    messages = iter(recording.messages)

    desk.feed(next(messages) for _ in range(1000))
    assert desk.recording.column() is None
    desk.feed(next(messages) for _ in range(20_000))

    assert desk.recording.column() is not None
