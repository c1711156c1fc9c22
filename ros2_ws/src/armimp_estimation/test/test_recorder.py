"""Recording: a bag for each trial, closed whatever happens, and running figures meanwhile."""

import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from armimp_common.cdr import (
    JointStateDecoder,
    JointStateEncoder,
    decode_trial_status,
    encode_trial_status,
)
from armimp_common.errors import BagError
from armimp_common.status import NOTICE_TICKS, Phase, StoppingDecision
from armimp_common.topics import (
    DATA_STREAMS,
    JOINT_STATES,
    PERIOD_NS,
    PERTURBATION,
    TORQUE_SENSORS,
    TRIAL,
    VALUE_FIELD,
)
from armimp_estimation.alignment.assemble import Trial
from armimp_estimation.alignment.streams import Streams
from armimp_estimation.bags.reader import read_bag
from armimp_estimation.bags.writer import definitions
from armimp_estimation.parameters import EstimatorParameters
from armimp_estimation.problems import Problem, ProblemCode
from armimp_estimation.record import TrialRecord
from armimp_estimation.recorder import TrialRecorder, largest_error, record_so_far
from support import known
from support.bag_files import iterate_messages
from support.problems import codes
from support.streams import changed, fed_synchronizer, record
from support.synthetic_bags import (
    Message,
    assert_same,
    recorded_arm,
    recording_of,
    synthetic_recording,
)
from support.synthetic_trials import LPM, SyntheticConfig, part_of, synthetic_trial
from support.synthetic_trials import TWO_JOINT_ARM as ARM

SETTLE, TICKS, REST = 10, 100, 10
MADE_UP = synthetic_recording(perturbed=(0, 1), ticks=TICKS, settle=SETTLE, rest=REST)
NAMES = ("shoulder", "elbow")
ENCODE = {t: JointStateEncoder(NAMES, VALUE_FIELD[t]).encode for t in VALUE_FIELD}
METADATA = {"seed": "7", "joint_names": json.dumps(NAMES), "torque_timing": '"simultaneous"'}
ARM_RECORDING = recorded_arm()
ARM_NAMES = ARM_RECORDING.records[0].joint_names
SAMPLES = ARM_RECORDING.records[0].samples
STREAMS = (PERTURBATION, JOINT_STATES, TORQUE_SENSORS)


class Desk:
    """A recorder with a list of what it handed over."""

    def __init__(self, directory: Path | None, *, together: int = 1, **options: Any) -> None:
        self.directory, self.together = directory, together
        self.finished: list[Trial] = []
        self.problems: list[Problem] = []
        settings = EstimatorParameters(
            directory=str(directory or ""), metadata=json.dumps(METADATA), **options
        )
        self.recorder = TrialRecorder(settings, self.on_finished)

    def on_finished(self, trial: Trial | Problem) -> None:
        if isinstance(trial, Problem):
            self.problems.append(trial)
        else:
            self.finished.append(trial)

    def feed(self, messages: Iterable[Message]) -> None:
        record(self.recorder, messages, self.together)

    def record(self, messages: Iterable[Message]) -> None:
        """Feed all there is."""
        self.feed(messages)
        self.recorder.stop()

    @property
    def bags(self) -> list[Path]:
        return sorted((known(self.directory) / "bags").iterdir())

    def assert_handed_over(self, records: Iterable[TrialRecord]) -> None:
        for trial, expected in zip(self.finished, records, strict=True):
            assert_same(trial.intact()[0], expected)

    def assert_bags_read_as_handed_over(self) -> None:
        directory = known(self.directory)
        for trial in self.finished:
            assert trial.bag == f"bags/trial_{trial.trial}_joint_{trial.trial}"
            assert 0.0 < trial.rtf < math.inf
            if not all(trial.statistics.streams[topic].received for topic in STREAMS):
                with pytest.raises(BagError, match="no "):
                    read_bag(directory / trial.bag)
                continue
            content = read_bag(directory / trial.bag)
            assert content.metadata.items() >= METADATA.items()
            (read,) = content.trials
            assert (read.window, read.statistics) == (trial.window, trial.statistics)
            assert read.problems == trial.problems
            for one, other in zip(read.segments, trial.segments, strict=True):
                assert_same(one, other)


def test_messages_of_a_stream_may_differ_in_length(tmp_path: Path) -> None:
    desk = Desk(tmp_path, together=50)
    desk.feed(
        (topic, time_ns, raw + bytes(4) if topic == TORQUE_SENSORS and place % 90 < 4 else raw)
        for place, (topic, time_ns, raw) in enumerate(MADE_UP.messages)
    )
    desk.assert_bags_read_as_handed_over()
    desk.assert_handed_over(MADE_UP.records)


@settings(max_examples=30, deadline=None)
@given(
    late=st.fixed_dictionaries(dict.fromkeys((*DATA_STREAMS, TRIAL), st.integers(0, 15))),
    together=st.sampled_from([1, 7, 20]),
    rest=st.sampled_from([2, REST]),
)
def test_however_late_a_stream_is_each_trial_has_exactly_its_samples_also_replayed(
    tmp_path_factory: pytest.TempPathFactory, late: Mapping[str, int], together: int, rest: int
) -> None:
    recording = synthetic_recording(perturbed=(0, 1), ticks=TICKS, settle=rest, rest=rest)
    desk, again = Desk(tmp_path_factory.mktemp("late"), together=together), Desk(None, together=50)
    desk.record(sorted(recording.messages, key=lambda m: m[1] + late[m[0]] * PERIOD_NS))
    again.record(message for bag in desk.bags for message in iterate_messages(bag))
    for one in (desk, again):
        one.assert_handed_over(recording.records)
        assert all(trial.segments[0].command is not None for trial in one.finished)


@pytest.mark.parametrize("stamp_ns", [0, 60_000_000_000], ids=["past", "future"])
@pytest.mark.parametrize("place", [SETTLE + TICKS + REST // 2, 2 * SETTLE + TICKS + REST - 2])
def test_a_perturbation_of_somebody_else_between_trials_is_found_and_costs_no_sample(
    stamp_ns: int, place: int
) -> None:
    recording = synthetic_recording(
        perturbed=(0, 1), ticks=TICKS, settle=SETTLE, rest=REST, start_ns=30_000_000_000
    )
    at_ns = recording.messages[0][1] + place * PERIOD_NS
    stray = ENCODE[PERTURBATION](stamp_ns, (0.1, 0.1))
    desk = Desk(None)
    desk.record(sorted((*recording.messages, (PERTURBATION, at_ns, stray)), key=lambda m: m[1]))
    found = [set(codes(trial.problems)) for trial in desk.finished]
    assert found == [set(), {ProblemCode.PERTURBATIONS_FOREIGN}]
    assert_same(desk.finished[1].segments[0], recording.records[1])


@settings(max_examples=20, deadline=None)
@given(
    lost=st.fixed_dictionaries(
        dict.fromkeys(DATA_STREAMS, st.sets(st.integers(0, 2 * TICKS), max_size=12))
    ),
    together=st.sampled_from([1, 7, 50]),
)
def test_bags_read_as_what_was_handed_over_whatever_was_lost(
    tmp_path_factory: pytest.TempPathFactory, lost: Mapping[str, set[int]], together: int
) -> None:
    desk = Desk(tmp_path_factory.mktemp("lost"), together=together)
    start_ns = MADE_UP.messages[0][1]
    desk.record(
        message
        for message in MADE_UP.messages
        if (message[1] - start_ns) // PERIOD_NS not in lost.get(message[0], ())
    )
    desk.assert_bags_read_as_handed_over()
    for trial, expected in zip(desk.finished, MADE_UP.records, strict=True):
        first = (expected.start_ns - start_ns) // PERIOD_NS
        for topic in STREAMS:
            missing = {tick for tick in lost[topic] if first <= tick < first + TICKS}
            assert trial.statistics.streams[topic].lost == len(missing)


@pytest.mark.parametrize("together", [1, 50])
def test_when_a_stream_falls_silent_expect_the_next_trial_whole_but_for_that(
    tmp_path: Path, together: int
) -> None:
    recording = synthetic_recording(perturbed=(0, 1), ticks=50, settle=5, rest=2050)
    last_ns = recording.records[0].start_ns + 20 * PERIOD_NS
    desk = Desk(tmp_path, together=together)
    desk.record(m for m in recording.messages if m[0] != TORQUE_SENSORS or m[1] < last_ns)
    for trial, expected in zip(desk.finished, (30, 50), strict=True):
        lost = {topic: one.lost for topic, one in trial.statistics.streams.items()}
        assert lost == {**dict.fromkeys(DATA_STREAMS, 0), TORQUE_SENSORS: expected}
    assert desk.problems == []
    desk.assert_bags_read_as_handed_over()
    states = {raw for topic, _, raw in iterate_messages(desk.bags[1]) if topic == JOINT_STATES}
    first = 5 + 50 + 2050 + 5
    assert states >= set(recording.by_topic()[JOINT_STATES][first : first + 50])


@pytest.mark.parametrize("together", [1, 7, 50])
@pytest.mark.parametrize("settle", [0, 10])
def test_trials_may_come_in_any_order_of_their_times(
    tmp_path: Path, settle: int, together: int
) -> None:
    recording = synthetic_recording(perturbed=(0, 1), ticks=3000, settle=settle, rest=70)
    second = next(
        place
        for place, (topic, _, raw) in enumerate(recording.messages)
        if topic == TRIAL and decode_trial_status(raw).trial == 2
    )
    desk = Desk(tmp_path, together=together)
    desk.record([*recording.messages[second:], *recording.messages[:second]])
    desk.assert_handed_over(recording.records[::-1])
    desk.assert_bags_read_as_handed_over()


@pytest.mark.parametrize("announced", [False, True])
@pytest.mark.parametrize("together", [1, 7, 20])
def test_a_trial_that_ends_early_has_no_sample_of_the_rest_nor_has_its_bag(
    tmp_path: Path, announced: bool, together: int
) -> None:
    def longer(message: Message) -> list[Message]:
        """With statuses of trials that were planned to be twice as long."""
        topic, time_ns, raw = message
        if topic != TRIAL or (status := decode_trial_status(raw)).phase is Phase.REST:
            return [message]
        planned = (topic, time_ns, encode_trial_status(changed(status, ticks=2 * TICKS)))
        return [planned, *([message] if announced and status.phase is Phase.PERTURB else [])]

    desk = Desk(tmp_path, together=together)
    desk.feed(told for message in MADE_UP.messages for told in longer(message))
    desk.assert_handed_over(MADE_UP.records)
    assert [trial.window.saved for trial in desk.finished] == [TICKS, TICKS]
    desk.recorder.stop()
    desk.assert_bags_read_as_handed_over()


@pytest.mark.parametrize("drift", [-1e-4, 1e-4])
def test_clock_of_a_driver_may_drift(drift: float) -> None:
    recording = synthetic_recording(ticks=5000, settle=10, rest=10)
    start_ns = recording.records[0].start_ns

    def drifting(message: Message) -> Message:
        topic, time_ns, raw = message
        if topic in ENCODE:
            stamp_ns, values = JointStateDecoder(NAMES, VALUE_FIELD[topic]).decode(raw)
            raw = ENCODE[topic](stamp_ns + round(drift * (stamp_ns - start_ns)), values)
        return topic, time_ns, raw

    desk = Desk(None, together=50)
    desk.feed(map(drifting, recording.messages))
    assert [trial.intact()[0].samples for trial in desk.finished] == [5000]


def test_stamps_that_make_no_sense_hold_nothing_up_and_messages_without_are_refused() -> None:
    wrong = ENCODE[JOINT_STATES](10**15, (0.0, 0.0))
    messages = list(MADE_UP.messages)
    for raw in (wrong, b"\0\1"):
        messages.insert(4 * (SETTLE + 5) + 2, (JOINT_STATES, 0, raw))
    refused: list[str] = []
    desk = Desk(None)
    desk.recorder._refuse = lambda topic, error: refused.append(f"{topic}: {error}")
    desk.feed(messages)
    assert [line[:33] for line in refused] == ["joint_states: message has 2 bytes"]
    for trial, expected in zip(desk.finished, MADE_UP.records, strict=True):
        assert_same(trial.segments[0], expected)


@pytest.mark.parametrize("together", [1, 10, 50])
def test_when_a_trial_ends_depends_on_its_first_samples_and_the_trials_before(
    together: int,
) -> None:
    considered = 6000 - NOTICE_TICKS
    desk = Desk(None, joints=ARM_NAMES, target_error=0.5, least_duration=6.0)
    made: list[StoppingDecision | None] = []
    messages = ARM_RECORDING.messages
    record(desk.recorder, messages, together, lambda: made.append(desk.recorder.decide()))
    decisions = [decision for decision in made if decision is not None]
    told = [(one.trial, one.samples, one.enough) for one in decisions]
    assert told == [(k, samples, samples > 0) for k in (1, 2) for samples in (0, considered)]
    past: list[TrialRecord] = []
    for decision, whole in zip(decisions[1::2], ARM_RECORDING.records, strict=True):
        column = LPM.column(with_commands(part_of(whole, 0, considered)), past)
        assert (decision.largest, decision.element) == largest_error(column)
        past.append(with_commands(whole))


def with_commands(record: TrialRecord) -> TrialRecord:
    """Commands are the perturbation alone."""
    return replace(record, command=record.perturbation)


def so_far(messages: Mapping[str, list[bytes]], samples: int) -> TrialRecord | None:
    """The first so many samples of a trial of the first joint."""
    streams = Streams(ARM_NAMES)
    for topic in DATA_STREAMS:
        streams[topic].add(messages[topic])
    return record_so_far(streams, [decode_trial_status(messages[TRIAL][1])], samples)


ARM_MESSAGES = recording_of(ARM_RECORDING.records[:1], settle=0, rest=0).by_topic()


@pytest.mark.parametrize(
    "bad",
    [
        b"rubbish",
        JointStateEncoder(("a",), "effort").encode(0, (1.0,)),
        JointStateEncoder(ARM_NAMES, "effort").encode(0, (float("nan"), 0.0)),
        None,
    ],
)
@pytest.mark.parametrize("topic", STREAMS)
def test_when_a_sample_is_missing_or_cannot_be_used_expect_silence(
    topic: str, bad: bytes | None
) -> None:
    spoiled = list(ARM_MESSAGES[topic])
    spoiled[100:101] = [] if bad is None else [bad]
    assert so_far({**ARM_MESSAGES, topic: spoiled}, 5000) is None


def test_the_last_trial_accounts_for_motion_of_locked_joints_and_the_first_says_so() -> None:
    # A soft lock, so that without the trials before the column is far off.
    config = SyntheticConfig(samples=SAMPLES, lock_stiffness=2e3, torque_noise=0.01)
    records = [synthetic_trial(ARM, joint, config, seed=joint) for joint in range(2)]
    true = np.stack([matrix[:, 1] for matrix in (ARM.M, ARM.B, ARM.K)])
    alone, last = LPM.column(records[1]), LPM.column(records[1], records[:1])
    assert alone.preliminary
    assert not last.preliminary
    assert (np.abs(alone.values - true) / np.abs(true)).max() > 0.3
    assert (np.abs(last.values - true) / last.errors).max() < 4.0


def test_no_trial_waits_for_definitions_of_messages(tmp_path: Path) -> None:
    definitions.cache_clear()
    Desk(tmp_path)
    assert definitions.cache_info().currsize == 1


def test_nothing_waits_for_perturbations_that_stay_away() -> None:
    synchronizer, deliver = fed_synchronizer()
    for topic in set(DATA_STREAMS) - {PERTURBATION}:
        for _ in range(10_000):
            deliver[topic](b"1")
    assert len(synchronizer.take()[JOINT_STATES]) == 8000


def test_once_closed_nothing_more_is_taken_and_what_waits_is_kept() -> None:
    synchronizer, deliver = fed_synchronizer()
    for message in (b"1", b"2"):
        for topic in DATA_STREAMS:
            deliver[topic](message)
        synchronizer.close()
    synchronizer.poll()
    assert synchronizer.take() == {topic: [b"1"] for topic in DATA_STREAMS}
