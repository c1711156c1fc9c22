import random
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from armimp_common.cdr import CommandEncoder, JointStateEncoder
from armimp_common.errors import DataError
from armimp_common.status import Phase, TrialStatus
from armimp_common.topics import (
    COMMANDS,
    DATA_STREAMS,
    JOINT_STATES,
    PERIOD_NS,
    PERTURBATION,
    TORQUE_SENSORS,
    TRIAL,
)
from armimp_estimation.alignment.assemble import AssembledTrial, assemble_trial, assemble_trials
from armimp_estimation.alignment.trial_streams import decode_streams
from armimp_estimation.alignment.trial_windows import (
    windows_from_statuses,
)
from armimp_estimation.bags.statuses import decode_trial_statuses
from armimp_estimation.problems import ProblemCode
from armimp_estimation.record import TrialRecord
from support.synthetic_bags import SyntheticRecording, synthetic_recording

NAMES = ("shoulder", "elbow")
STAMPED = (JOINT_STATES, TORQUE_SENSORS, PERTURBATION)
TICKS = 40
RECORDING = synthetic_recording(ticks=TICKS, settle=10, rest=10)
FIRST = 10
START = RECORDING.records[0].start_ns

Topics = dict[str, list[bytes]]


def statuses_of(recording: SyntheticRecording) -> list[TrialStatus]:
    statuses, problem = decode_trial_statuses(recording.by_topic()[TRIAL])
    assert not problem
    return statuses


def assemble(
    topics: Topics,
    statuses: Sequence[TrialStatus] | None = None,
) -> AssembledTrial:
    (trial,) = assemble_trials(
        NAMES, topics, statuses_of(RECORDING) if statuses is None else statuses
    )
    return trial


def assert_part(record: TrialRecord, expected: TrialRecord, start: int, stop: int) -> None:
    for name in ("position", "torque", "perturbation"):
        values = getattr(record, name)
        assert values.flags.c_contiguous
        np.testing.assert_array_equal(values, getattr(expected, name)[:, start:stop])
    assert record.start_ns == expected.start_ns + start * PERIOD_NS


def effort(stamp_ns: int, values: Sequence[float]) -> bytes:
    return JointStateEncoder(NAMES, "effort").encode(stamp_ns, values)


class TestWholeTrials:
    def test_record_holds_exactly_the_samples_of_the_trial(self) -> None:
        trial = assemble(RECORDING.by_topic())
        record = trial.require()
        assert_part(record, RECORDING.records[0], 0, TICKS)
        assert (record.trial, record.perturbed_joint, record.seed) == (1, 0, 1)
        assert (record.rate, record.joint_names) == (1000.0, NAMES)
        assert trial.segments == (record,)
        assert trial.problem == trial.note == ""
        assert trial.ledger.clean
        for topic in DATA_STREAMS:
            count = trial.ledger.to_dict()[topic]
            assert count == {
                "expected": TICKS,
                "received": TICKS,
                "lost": 0,
                "duplicated": 0,
                "contradictory": 0,
                "reordered": 0,
                "late": 0,
            }

    def test_messages_of_one_trial_alone_give_the_same_bits_as_a_whole_recording(self) -> None:
        several = synthetic_recording(perturbed=(0, 1, 0), ticks=TICKS, settle=7, rest=5)
        statuses = statuses_of(several)
        together = assemble_trials(NAMES, several.by_topic(), statuses)
        assert [trial.trial for trial in together] == [1, 2, 3]
        for number, trial in enumerate(together, 1):
            first = (number - 1) * (TICKS + 12) + 7
            alone = {
                topic: raws[first : first + TICKS] if topic != TRIAL else raws
                for topic, raws in several.by_topic().items()
            }
            own = [status for status in statuses if status.trial == number]
            (single,) = assemble_trials(NAMES, alone, own)
            for name in ("position", "torque", "perturbation"):
                np.testing.assert_array_equal(
                    getattr(single.require(), name), getattr(trial.require(), name)
                )
            assert_part(trial.require(), several.records[number - 1], 0, TICKS)
            assert single.ledger == trial.ledger

    @given(jitter=st.lists(st.integers(-400_000, 400_000), min_size=60, max_size=60))
    @settings(max_examples=50, deadline=None)
    def test_jitter_below_half_a_period_is_no_gap(self, jitter: list[int]) -> None:
        # Stamps of a rig: irregular, but the same in all streams.
        stamps = [START + k * PERIOD_NS + shift // 2 for k, shift in enumerate(jitter)]
        raws = [effort(stamp, (1.0, 0.0)) for stamp in stamps]
        states = [JointStateEncoder(NAMES, "position").encode(stamp, (0, 0)) for stamp in stamps]
        topics = {
            JOINT_STATES: states,
            TORQUE_SENSORS: raws,
            PERTURBATION: raws,
        }
        window = replace(windows_from_statuses(statuses_of(RECORDING))[0], start_ns=stamps[0])
        trial = assemble_trial(window, decode_streams(NAMES, topics))
        assert trial.require().samples == TICKS

    def test_perturbed_joint_goes_by_its_name(self) -> None:
        topics = RECORDING.by_topic()
        (trial,) = assemble_trials(("elbow", "shoulder"), topics, statuses_of(RECORDING))
        assert trial.require().perturbed_joint == 1
        np.testing.assert_array_equal(trial.require().torque, RECORDING.records[0].torque[::-1])


class TestLedger:
    @settings(max_examples=150, deadline=None)
    @given(data=st.data())
    def test_every_injected_fault_is_counted_and_only_those(self, data: st.DataObject) -> None:
        topics = RECORDING.by_topic()
        ticks = st.integers(0, TICKS - 1)
        missing: set[int] = set()
        expected: dict[str, tuple[int, int]] = {}
        for topic in STAMPED:
            raws = topics[topic]
            lost = data.draw(st.sets(ticks, max_size=5), label=f"lost {topic}")
            doubled = data.draw(st.lists(ticks, max_size=5), label=f"doubled {topic}")
            doubled = [tick for tick in doubled if tick not in lost]
            for tick in doubled:
                raws.append(raws[FIRST + tick])
            for tick in sorted(lost, reverse=True):
                del raws[FIRST + tick]
            random.Random(data.draw(st.integers(0, 9))).shuffle(raws)
            expected[topic] = (len(lost), len(doubled))
            missing |= lost
        trial = assemble(topics)
        for topic, (lost_count, doubled_count) in expected.items():
            count = trial.ledger.streams[topic]
            assert count.expected == TICKS
            assert (count.lost, count.duplicated) == (lost_count, doubled_count)
            assert count.received == count.expected - count.lost + count.duplicated
        assert trial.ledger.clean is (trial.problem == "")
        present = sorted(set(range(TICKS)) - missing)
        runs = np.split(np.array(present), np.flatnonzero(np.diff(present) > 1) + 1)
        long_runs = [run for run in runs if run.size > 1]
        assert len(trial.segments) == len(long_runs)
        for segment, run in zip(trial.segments, long_runs, strict=True):
            assert_part(segment, RECORDING.records[0], int(run[0]), int(run[-1]) + 1)
        if missing:
            assert trial.record is None
            with pytest.raises(DataError, match=r"trial 1: .* missing "):
                trial.require()
        else:
            assert trial.record is trial.segments[0]

    @pytest.mark.parametrize("topic", STAMPED)
    def test_exchange_of_two_samples_is_one_reordered(self, topic: str) -> None:
        topics = RECORDING.by_topic()
        raws = topics[topic]
        raws[FIRST + 5], raws[FIRST + 6] = raws[FIRST + 6], raws[FIRST + 5]
        trial = assemble(topics)
        count = trial.ledger.streams[topic]
        assert (count.lost, count.duplicated, count.reordered) == (0, 0, 1)
        assert trial.problem == f"1 sample of {topic} came out of order"
        assert trial.record is not None
        assert_part(trial.record, RECORDING.records[0], 0, TICKS)

    def test_late_repetition_is_duplicated_and_not_reordered(self) -> None:
        topics = RECORDING.by_topic()
        raws = topics[TORQUE_SENSORS]
        raws.insert(FIRST + 20, raws[FIRST + 3])
        count = assemble(topics).ledger.streams[TORQUE_SENSORS]
        assert (count.received, count.duplicated, count.reordered) == (TICKS + 1, 1, 0)

    def test_a_message_that_came_twice_is_used_once(self) -> None:
        topics = RECORDING.by_topic()
        raws = topics[TORQUE_SENSORS]
        raws.insert(FIRST + 4, raws[FIRST + 3])
        trial = assemble(topics)
        assert trial.ledger.total("contradictory") == 0
        assert trial.record is not None
        assert_part(trial.record, RECORDING.records[0], 0, TICKS)

    @pytest.mark.parametrize("after", [0, 1, 9])
    @pytest.mark.parametrize("value", [99.0, np.nan])
    def test_of_two_messages_that_contradict_each_other_none_is_used(
        self, after: int, value: float
    ) -> None:
        topics = RECORDING.by_topic()
        other = effort(START + 3 * PERIOD_NS, (99.0, value))
        topics[TORQUE_SENSORS].insert(FIRST + 3 + after, other)
        trial = assemble(topics)
        assert trial.record is None
        assert [segment.samples for segment in trial.segments] == [3, TICKS - 4]
        assert_part(trial.segments[1], RECORDING.records[0], 4, TICKS)
        count = trial.ledger.streams[TORQUE_SENSORS]
        assert (count.lost, count.duplicated, count.contradictory) == (0, 1, 1)
        assert trial.ledger.excluded == 1
        assert "1 sample of torque_sensors contradicts itself at 0.003 s" in trial.problem
        assert trial.fault == ""

    def test_period_lost_by_all_streams_is_counted(self) -> None:
        topics = RECORDING.by_topic()
        for raws in topics.values():
            if len(raws) > TICKS:
                del raws[FIRST + 12 : FIRST + 15]
        trial = assemble(topics)
        assert [trial.ledger.streams[topic].lost for topic in STAMPED] == [3, 3, 3]
        assert [segment.samples for segment in trial.segments] == [12, TICKS - 15]
        assert trial.problem == (
            "3 samples of joint_states, torque_sensors and imbic_controller/perturbation "
            "are missing between 0.012 s and 0.015 s"
        )

    @pytest.mark.parametrize("lost", [0, TICKS - 1])
    def test_loss_at_the_edge_of_an_ended_trial_is_counted(self, lost: int) -> None:
        topics = RECORDING.by_topic()
        for topic in STAMPED:
            del topics[topic][FIRST + lost]
        trial = assemble(topics)
        assert [trial.ledger.streams[topic].lost for topic in STAMPED] == [1, 1, 1]
        (segment,) = trial.segments
        assert segment.samples == TICKS - 1
        assert segment.start_ns == START + (PERIOD_NS if lost == 0 else 0)

    def test_fewer_commands_than_samples_are_a_problem_that_gaps_may_heal(self) -> None:
        recording = synthetic_recording(ticks=TICKS)
        topics = recording.by_topic()
        del topics[COMMANDS][7:9]
        trial = assemble(topics, statuses_of(recording))
        assert trial.ledger.streams[COMMANDS].lost == 2
        assert trial.ledger.lost == 2
        assert (trial.problem, trial.fault) == ("2 commands fewer than samples", "")
        assert_part(trial.intact(allow_gaps=True)[0], recording.records[0], 0, TICKS)

    def test_more_commands_than_samples_are_a_problem_that_nothing_heals(self) -> None:
        recording = synthetic_recording(ticks=TICKS)
        topics = recording.by_topic()
        topics[COMMANDS][7:7] = topics[COMMANDS][:3]
        trial = assemble(topics, statuses_of(recording))
        assert trial.fault == trial.problem
        assert "of effort_controller/commands too many" in trial.fault
        with pytest.raises(DataError, match="somebody else commanded"):
            trial.intact(allow_gaps=True)

    @pytest.mark.parametrize("number", [0, 1, 7, 8])
    def test_a_numbered_command_of_somebody_else_is_found_though_as_many_are_left(
        self, number: int
    ) -> None:
        recording = synthetic_recording(ticks=TICKS)
        topics = recording.by_topic()
        encode = CommandEncoder(len(recording.records[0].joint_names)).encode
        commands = [encode((0.0, 0.0), one) for one in range(1, TICKS + 1)]
        topics[COMMANDS] = commands
        assert not assemble(topics, statuses_of(recording)).problem
        topics[COMMANDS] = [*commands[:7], encode((0.0, 0.0), number), *commands[7:-1]]
        assert "somebody else commanded" in assemble(topics, statuses_of(recording)).fault

    @pytest.mark.parametrize("number", [0, 1, FIRST, 2 * TICKS])
    def test_a_command_of_somebody_else_before_the_trial_is_found_too(self, number: int) -> None:
        topics = RECORDING.by_topic()
        encode = CommandEncoder(len(RECORDING.records[0].joint_names)).encode
        count = len(topics[COMMANDS])
        commands = [encode((0.0, 0.0), one) for one in range(1, count + 1)]
        stray = encode((0.0, 0.0), number)
        topics[COMMANDS] = [*commands[: FIRST - 1], stray, *commands[FIRST - 1 :]]
        assert "somebody else commanded" in assemble(topics).fault

    @pytest.mark.parametrize("stray", [0, FIRST - 1, -1])
    def test_a_perturbation_of_another_time_that_displaces_the_commands_is_found(
        self, stray: int
    ) -> None:
        topics = RECORDING.by_topic()
        perturbations = topics[PERTURBATION]
        perturbations.insert(FIRST - 1, perturbations[stray])
        assert "cannot be matched: somebody else published" in assemble(topics).fault

    def test_numbered_commands_that_were_lost_are_nobody_elses(self) -> None:
        recording = synthetic_recording(ticks=TICKS)
        topics = recording.by_topic()
        encode = CommandEncoder(len(recording.records[0].joint_names)).encode
        commands = [encode((0.0, 0.0), one) for one in range(1, TICKS + 1)]
        topics[COMMANDS] = [*commands[:7], *commands[9:]]
        trial = assemble(topics, statuses_of(recording))
        assert (trial.problem, trial.fault) == ("2 commands fewer than samples", "")

    def test_malformed_messages_count_as_lost_and_are_named(self) -> None:
        topics = RECORDING.by_topic()
        topics[JOINT_STATES][FIRST + 2] = b"\0\1\0\0rubbish"
        topics[JOINT_STATES][FIRST + 3] = b""
        trial = assemble(topics)
        assert trial.ledger.streams[JOINT_STATES].lost == 2
        assert "2 malformed of joint_states: JointState is truncated" in trial.problem

    def test_stream_without_any_good_message_is_an_error(self) -> None:
        topics = RECORDING.by_topic()
        topics[JOINT_STATES] = [b"rubbish"] * 3
        with pytest.raises(DataError, match="joint_states: none of 3 messages can be decoded"):
            assemble(topics)

    def test_missing_stream_is_an_error(self) -> None:
        topics = RECORDING.by_topic()
        del topics[TORQUE_SENSORS]
        with pytest.raises(DataError, match="no messages of torque_sensors"):
            assemble(topics)

    def test_samples_that_are_not_finite_divide_the_record(self) -> None:
        topics = RECORDING.by_topic()
        for tick in (9, 20):
            topics[TORQUE_SENSORS][FIRST + tick] = effort(
                START + tick * PERIOD_NS, (float("inf"), 0.0)
            )
        trial = assemble(topics)
        assert trial.ledger.clean
        assert trial.record is None
        assert [segment.samples for segment in trial.segments] == [9, 10, TICKS - 21]
        assert trial.problem == (
            "2 samples of torque_sensors are not finite in 2 places between 0.009 s and 0.021 s"
        )

    def test_streams_with_clocks_of_their_own_are_refused(self) -> None:
        topics = RECORDING.by_topic()
        topics[TORQUE_SENSORS] = [
            effort(START + (k - FIRST) * PERIOD_NS + 70, (0.0, 0.0)) for k in range(TICKS + 20)
        ]
        trial = assemble(topics)
        assert f"{TICKS} stamps do not agree, the first 70 ns from its neighbour" in trial.problem

    def test_other_rate_is_named(self) -> None:
        topics = RECORDING.by_topic()
        for topic in STAMPED:
            topics[topic] = topics[topic][::2]
        (finding,) = assemble(topics).findings
        assert finding.code is ProblemCode.RATE_UNPLANNED
        assert (finding.values["rate"], finding.values["planned"]) == (500.0, 1000.0)

    def test_perturbation_of_zero_is_refused(self) -> None:
        topics = RECORDING.by_topic()
        topics[PERTURBATION] = [
            effort(START + (k - FIRST) * PERIOD_NS, (0.0, 0.0)) for k in range(TICKS + 20)
        ]
        assert assemble(topics).problem == "the perturbation is zero throughout"

    def test_unknown_perturbed_joint_is_refused(self) -> None:
        statuses = [replace(status, joint_name="wrist") for status in statuses_of(RECORDING)]
        trial = assemble(RECORDING.by_topic(), statuses)
        assert "perturbed joint is not among the joints shoulder, elbow: wrist" in trial.problem
        assert trial.segments == ()
        with pytest.raises(DataError):
            trial.require()

    def test_source_is_named(self) -> None:
        topics = RECORDING.by_topic()
        del topics[JOINT_STATES][FIRST]
        (trial,) = assemble_trials(NAMES, topics, statuses_of(RECORDING), source="some.bag")
        with pytest.raises(DataError, match=r"^some\.bag: trial 1: 1 sample of joint_states"):
            trial.require()


class TestEarlyEnds:
    @settings(max_examples=60, deadline=None)
    @given(cut=st.integers(1, 4 * (TICKS + 10)))
    def test_cut_recording_gives_all_complete_periods(self, cut: int) -> None:
        recording = synthetic_recording(ticks=TICKS, settle=10)
        messages = recording.messages[:-cut]
        topics: Topics = {}
        for topic, _, raw in messages:
            topics.setdefault(topic, []).append(raw)
        statuses, _ = decode_trial_statuses(topics.get(TRIAL, []))
        trials = assemble_trials(NAMES, topics, statuses) if PERTURBATION in topics else ()
        if not any(status.phase is Phase.PERTURB for status in statuses):
            assert trials == ()
            return
        (trial,) = trials
        complete = min(len(topics[topic]) for topic in STAMPED) - 10
        assert trial.shortfall == TICKS - complete
        assert trial.ledger.lost == 0
        if complete > 1:
            assert_part(trial.require(), recording.records[0], 0, complete)
        if complete < TICKS:
            assert trial.note == f"trial 1 is cut short: {complete} of {TICKS} samples"

    def test_aborted_trial_keeps_what_came_before(self) -> None:
        statuses = statuses_of(RECORDING)
        statuses[-1] = replace(
            statuses[-1], phase=Phase.ABORTED, valid=False, reason="no sensor sample"
        )
        topics = RECORDING.by_topic()
        for tick in range(25, TICKS):
            topics[PERTURBATION][FIRST + tick] = effort(START + tick * PERIOD_NS, (0.0, 0.0))
        trial = assemble(topics, statuses)
        assert trial.problem == "aborted: no sensor sample"
        assert trial.shortfall == TICKS - 25
        assert trial.record is not None
        assert_part(trial.record, RECORDING.records[0], 0, 25)
        with pytest.raises(DataError, match="trial 1: aborted: no sensor sample"):
            trial.require()

    def test_trial_marked_invalid_is_refused(self) -> None:
        statuses = statuses_of(RECORDING)
        statuses.insert(2, replace(statuses[1], valid=False, reason="torque clipped"))
        trial = assemble(RECORDING.by_topic(), statuses)
        assert trial.problem == "not valid: torque clipped"
        assert trial.record is not None
        assert trial.record.samples == TICKS

    def test_trials_before_the_recording_began_are_passed_over(self) -> None:
        # A latched topic repeats the statuses of trials that are over.
        several = synthetic_recording(perturbed=(0, 1), ticks=TICKS, settle=10, rest=10)
        topics = several.by_topic()
        for topic in DATA_STREAMS:
            del topics[topic][: TICKS + 15]
        (trial,) = assemble_trials(NAMES, topics, statuses_of(several))
        assert_part(trial.require(), several.records[1], 0, TICKS)

    def test_trial_whose_beginning_was_not_recorded_is_refused(self) -> None:
        topics = RECORDING.by_topic()
        for topic in DATA_STREAMS:
            del topics[topic][: FIRST + 15]
        trial = assemble(topics)
        assert [trial.ledger.streams[topic].lost for topic in STAMPED] == [15] * 3
        (segment,) = trial.segments
        assert_part(segment, RECORDING.records[0], 15, TICKS)

    def test_ended_trial_without_any_sample_is_refused(self) -> None:
        topics = RECORDING.by_topic()
        for topic in STAMPED:
            del topics[topic][FIRST:]
        trial = assemble(topics)
        assert trial.segments == ()
        assert [trial.ledger.streams[topic].lost for topic in STAMPED] == [TICKS] * 3
        with pytest.raises(DataError, match=r"are missing between 0\.000 s and 0\.040 s"):
            trial.require()

    def test_trial_cut_before_its_first_sample_is_refused(self) -> None:
        topics = RECORDING.by_topic()
        for topic in STAMPED:
            del topics[topic][FIRST:]
        trial = assemble(topics, statuses_of(RECORDING)[:2])
        with pytest.raises(DataError, match="no samples of it were recorded"):
            trial.require()
