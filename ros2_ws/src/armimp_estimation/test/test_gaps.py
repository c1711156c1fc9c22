"""Trials with gaps: refused with the reason, or estimated from their intact parts when asked."""

import json
import re
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from armimp_common.errors import ConfigurationError, DataError
from armimp_common.status import Cause, Phase, TrialStatus
from armimp_common.topics import (
    COMMANDS,
    DATA_STREAMS,
    JOINT_STATES,
    PERIOD_NS,
    PERTURBATION,
    TORQUE_SENSORS,
    TRIAL,
    VALUE_FIELD,
)
from armimp_estimation.alignment.assemble import AssembledTrial, assemble_trials
from armimp_estimation.alignment.gaps import GapConfig, judge_gaps, segments_for
from armimp_estimation.alignment.trial_windows import windows_from_statuses
from armimp_estimation.bags import read_bag
from armimp_estimation.bags.statuses import decode_trial_status
from armimp_estimation.conclusion import Conclusion, FinishedTrial, conclude
from armimp_estimation.record import TrialRecord
from armimp_estimation.recording import LEDGER, Recording
from armimp_estimation.results import Summary
from armimp_estimation.spectra import WelchConfig, bin_correlation, effective_averages
from armimp_estimation.trial import TrialData
from support.recordings import recorded_arm
from support.synthetic_bags import Message, synthetic_recording
from support.synthetic_trials import TWO_JOINT_ARM, SyntheticConfig, synthetic_trial

RECORDING = recorded_arm()
NAMES = RECORDING.records[0].joint_names
SAMPLES = RECORDING.records[0].samples
SETTLE = 60
METADATA = {
    "joint_names": json.dumps(NAMES),
    "truth": json.dumps({name: getattr(TWO_JOINT_ARM, name).tolist() for name in ("M", "B", "K")}),
}
ALLOWED = GapConfig(allow=True)


def without(
    messages: Iterable[Message], topic: str, trial: int, ticks: Iterable[int]
) -> list[Message]:
    """The messages without those of a topic in some ticks of a trial."""
    start_ns = RECORDING.records[trial - 1].start_ns
    lost = {start_ns + tick * PERIOD_NS for tick in ticks}
    return [(t, time, raw) for t, time, raw in messages if t != topic or time not in lost]


def recorded(
    messages: Iterable[Message],
    directory: Path | None = None,
    *,
    reason: str = "",
    cause: Cause = Cause.OTHER,
) -> list[FinishedTrial]:
    """The trials as a recorder hands them over; with a reason the controller finds them invalid."""
    trials: list[FinishedTrial] = []

    def keep(trial: FinishedTrial | None, problem: str) -> None:
        assert trial is not None, problem
        trials.append(trial)

    recording = Recording(NAMES, directory, METADATA, keep)
    for topic, _, raw in messages:
        if topic == TRIAL:
            status = decode_trial_status(raw)
            if reason and status.phase is Phase.REST:
                status = replace(status, valid=False, reason=reason, cause=cause)
            recording.add_status(status)
        else:
            recording.add(topic, raw)
    recording.stop()
    return trials


def conclusion_of(
    trials: Sequence[FinishedTrial],
    gaps: GapConfig | None = None,
    estimators: tuple[str, ...] = ("welch_siso", "lpm_full"),
) -> Conclusion:
    return conclude(
        trials,
        metadata=METADATA,
        joint_names=("shoulder", "elbow"),
        estimators=estimators,
        gaps=gaps,
    )


def curves(conclusion: Conclusion) -> list[bytes]:
    assert conclusion.identification is not None
    return [one.estimate.Z.tobytes() for one in conclusion.identification.estimators.values()]


GAP = without(RECORDING.messages, JOINT_STATES, 2, range(4000, 4037))


class TestRefusal:
    def test_the_reason_names_stream_count_and_time(self) -> None:
        summary = conclusion_of(recorded(GAP)).summary
        assert summary.problems == [
            "trial 2: 37 samples of joint_states are missing between 4.000 s and 4.037 s; "
            "--allow-gaps uses the intact parts"
        ]
        assert summary.estimators == {}

    def test_what_gaps_do_not_explain_is_refused_even_if_gaps_are_allowed(self) -> None:
        trials = recorded(GAP, reason="torque limit exceeded")
        summary = conclusion_of(trials, ALLOWED).summary
        assert summary.problems == ["trial 1: not valid: torque limit exceeded"]

    def test_samples_that_did_not_reach_the_controller_are_a_gap_like_any_other(self) -> None:
        trials = recorded(GAP, reason="37 samples did not arrive", cause=Cause.SAMPLES_LOST)
        assert conclusion_of(trials).summary.problems == [
            "trial 1: not valid: 37 samples did not arrive; --allow-gaps uses the intact parts"
        ]
        assert conclusion_of(trials, ALLOWED).summary.valid

    def test_parts_that_are_too_short_are_refused(self) -> None:
        messages = without(RECORDING.messages, JOINT_STATES, 1, range(0, SAMPLES, 900))
        summary = conclusion_of(recorded(messages), ALLOWED).summary
        assert not summary.valid
        assert re.fullmatch(
            "trial 1: .* shorter than one segment of 1024 in 12 intact parts", summary.problems[0]
        )

    def test_a_trial_without_any_usable_sample_is_refused(self) -> None:
        messages = without(RECORDING.messages, JOINT_STATES, 1, range(1, SAMPLES, 2))
        (first, _) = recorded(messages)
        with pytest.raises(DataError, match=r"^trial 1: 5000 samples of joint_states are missing"):
            first.assembled.intact(allow_gaps=True)


class TestIntactParts:
    def test_of_a_record_without_gaps_the_result_is_the_same_to_the_bit(self) -> None:
        trials = recorded(RECORDING.messages)
        strict, lenient = conclusion_of(trials), conclusion_of(trials, ALLOWED)
        assert curves(strict) == curves(lenient)
        assert strict.summary == lenient.summary
        assert strict.summary.trials[0].excluded == 0.0
        assert strict.summary.trials[0].stretches == 1

    def test_gap_is_counted_and_the_rest_estimated(self) -> None:
        summary = conclusion_of(recorded(GAP), ALLOWED).summary
        assert summary.valid, summary.problems
        first, second = summary.trials
        assert (first.lost, first.excluded, first.stretches) == (0, 0.0, 1)
        assert (second.lost, second.excluded, second.stretches) == (37, 37 / SAMPLES, 2)
        assert second.streams[JOINT_STATES].lost == 37
        assert second.streams[TORQUE_SENSORS].lost == 0
        for estimator in summary.estimators.values():
            assert estimator.vaf is not None
            assert np.min(estimator.vaf) > 99.0

    def test_live_and_read_from_the_bag_the_result_is_the_same_to_the_bit(
        self, tmp_path: Path
    ) -> None:
        live = recorded(GAP, tmp_path)
        bags = [read_bag(tmp_path / str(trial.bag)) for trial in live]
        offline = [
            FinishedTrial(assembled=bag.trials[0], bag=trial.bag, rtf=trial.rtf)
            for bag, trial in zip(bags, live, strict=True)
        ]
        assert curves(conclusion_of(live, ALLOWED)) == curves(conclusion_of(offline, ALLOWED))
        assert conclusion_of(live, ALLOWED).summary == conclusion_of(offline, ALLOWED).summary
        for bag, trial in zip(bags, live, strict=True):
            assert bag.metadata[LEDGER] == trial.assembled.ledger.to_json()
            assert bag.trials[0].ledger == trial.assembled.ledger
            assert json.loads(bag.metadata[LEDGER])["streams"] == trial.assembled.ledger.to_dict()

    def test_segments_of_all_parts_are_averaged_and_none_spans_a_gap(self) -> None:
        config = WelchConfig(segment=1024, overlap=768)
        whole = RECORDING.records[0]
        parts = [part(whole, 0, 3000), part(whole, 3100, 3600), part(whole, 4000, 9000)]
        data = TrialData.from_stretches(parts, config)
        alone = [TrialData.from_stretches([one], config).spectra.spectra for one in parts[::2]]
        counts = [config.segments_in(3000), config.segments_in(5000)]
        assert [one.segments for one in alone] == counts
        mean = sum(one.matrix * one.segments for one in alone) / sum(counts)
        np.testing.assert_allclose(data.spectra.spectra.matrix, mean, rtol=1e-12)
        assert data.spectra.spectra.segments == sum(counts)
        assert data.record is parts[2]

    def test_parts_are_worth_the_sum_of_their_averages(self) -> None:
        # Of equal parts exactly; segments on either side of a gap have nothing in common.
        config = WelchConfig()
        assert effective_averages(config, 8, 8) == pytest.approx(2 * effective_averages(config, 8))
        assert effective_averages(config, 8, 8) > effective_averages(config, 16)
        np.testing.assert_allclose(bin_correlation(config, 8, 8), bin_correlation(config, 8))
        assert effective_averages(config, 0, 8, 0) == effective_averages(config, 8)

    @pytest.mark.parametrize(
        ("lengths", "segment"),
        [
            ([50_000], 8192),
            ([32_767], 4096),
            ([20_000, 29_000], 8192),
            ([8191] * 6, 4096),
            ([100] * 500, 1024),
        ],
    )
    def test_segment_length_is_that_of_which_four_fit_into_long_enough_parts(
        self, lengths: list[int], segment: int
    ) -> None:
        assert WelchConfig.for_stretches(lengths).segment == segment
        if len(lengths) == 1:
            assert WelchConfig.for_samples(lengths[0]) == WelchConfig.for_stretches(lengths)

    def test_all_trials_get_the_segments_of_the_one_that_can_have_least(self) -> None:
        whole = synthetic_trial(TWO_JOINT_ARM, 0, SyntheticConfig(samples=33_000), 1)
        assert segments_for([[whole]]).segment == 8192
        assert segments_for([[whole], [part(whole, 0, 9000)]]).segment == 2048

    def test_duplicates_and_disorder_are_put_right_when_gaps_are_allowed(
        self, tmp_path: Path
    ) -> None:
        messages = list(RECORDING.messages)
        torque = [i for i, m in enumerate(messages) if m[0] == TORQUE_SENSORS]
        i, j = torque[SETTLE + 50], torque[SETTLE + 51]
        messages[i], messages[j] = messages[j], messages[i]
        messages.insert(torque[SETTLE + 90], messages[torque[SETTLE + 80]])
        trials = recorded(messages, tmp_path)
        (read,) = read_bag(tmp_path / str(trials[0].bag)).trials
        assert read.ledger == trials[0].assembled.ledger
        assert conclusion_of(trials).summary.problems == [
            "trial 1: 1 sample of torque_sensors came more than once; "
            "1 sample of torque_sensors came out of order; --allow-gaps uses the intact parts"
        ]
        healed = conclusion_of(trials, ALLOWED)
        assert (healed.summary.trials[0].duplicated, healed.summary.trials[0].reordered) == (1, 1)
        assert curves(healed) == curves(conclusion_of(recorded(RECORDING.messages)))


class TestExcludedShare:
    def test_a_result_from_too_little_of_a_trial_is_not_valid(self) -> None:
        messages = without(RECORDING.messages, TORQUE_SENSORS, 1, range(600))
        summary = conclusion_of(recorded(messages), ALLOWED).summary
        assert summary.problems == ["trial 1: 6 % of its samples are excluded (limit 5 %)"]
        assert summary.estimators
        lenient = GapConfig(allow=True, most_excluded=0.06)
        assert conclusion_of(recorded(messages), lenient).summary.valid

    @pytest.mark.parametrize("share", [-0.1, 1.1, float("nan")])
    def test_limit_that_is_no_share_is_refused(self, share: float) -> None:
        with pytest.raises(ConfigurationError, match="most_excluded"):
            GapConfig(most_excluded=share)


def clipped_trial(intervals: str, count: int) -> AssembledTrial:
    made_up = synthetic_recording(ticks=50)
    topics = made_up.by_topic()
    statuses = [decode_trial_status(raw) for raw in topics[TRIAL]]
    told = replace(statuses[-1], clipped=count, clipped_intervals=intervals)
    (trial,) = assemble_trials(("shoulder", "elbow"), topics, [*statuses[:-1], told])
    return trial


class TestClippedCommands:
    def test_what_follows_them_is_left_out_without_being_asked(self) -> None:
        trial = clipped_trial("10-12 40-40", 5)
        assert trial.problem == ""
        assert trial.record is None
        # Each acts until the next sample.
        assert [one.samples for one in trial.intact()] == [10, 26, 8]
        assert (trial.ledger.clipped, trial.ledger.excluded, trial.ledger.stretches) == (5, 6, 3)
        assert trial.ledger.excluded_share == 6 / 50
        assert trial.ledger.lost == 0
        with pytest.raises(DataError, match="intervals that are excluded"):
            trial.require()

    def test_more_than_the_limit_is_a_problem_in_words(self) -> None:
        trial = clipped_trial("10-12 40-40", 5)
        assert judge_gaps(trial, GapConfig()) == [
            "trial 1: 12 % of its samples are excluded (limit 5 %)"
        ]
        assert judge_gaps(trial, GapConfig(most_excluded=0.12)) == []

    def test_clipped_at_an_unknown_time_is_a_problem(self) -> None:
        assert judge_gaps(clipped_trial("", 3), GapConfig()) == [
            "trial 1: 3 commands were clipped, and it is not known when"
        ]

    def test_interval_beyond_the_end_does_no_harm(self) -> None:
        assert [one.samples for one in clipped_trial("48-70", 9).intact()] == [48]

    def test_last_status_of_a_trial_counts(self) -> None:
        (window,) = windows_from_statuses(
            [
                TrialStatus(
                    phase=phase,
                    trial=1,
                    trials=1,
                    joint=0,
                    joint_name="shoulder",
                    tick=0,
                    start_ns=0,
                    ticks=50,
                    seed=1,
                    valid=True,
                    clipped=count,
                    clipped_intervals=intervals,
                )
                for phase, count, intervals in (
                    (Phase.PERTURB, 0, ""),
                    (Phase.PERTURB, 1, "3-3"),
                    (Phase.REST, 2, "3-3 7-7"),
                )
            ]
        )
        assert (window.clipped, window.clipped_intervals) == (2, ((3, 3), (7, 7)))


def test_samples_taken_late_are_counted_but_no_gap() -> None:
    made_up = synthetic_recording(ticks=50)
    shifted = synthetic_recording(ticks=50, start_ns=10**9 + 300_000)
    topics, late = made_up.by_topic(), shifted.by_topic()
    for topic in VALUE_FIELD:
        topics[topic][20] = late[topic][20]
    statuses = [decode_trial_status(raw) for raw in topics[TRIAL]]
    (trial,) = assemble_trials(("shoulder", "elbow"), topics, statuses)
    assert trial.problem == ""
    assert trial.require().samples == 50
    counts = trial.ledger.streams
    assert {topic: counts[topic].late for topic in DATA_STREAMS} == {
        JOINT_STATES: 1,
        TORQUE_SENSORS: 1,
        PERTURBATION: 1,
        COMMANDS: 0,
    }
    assert trial.ledger.total("late") == 3
    assert trial.ledger.clean


def test_summaries_from_before_the_ledger_was_in_them_are_read(tmp_path: Path) -> None:
    summary = conclusion_of(recorded(RECORDING.messages), estimators=("welch_siso",)).summary
    stored = json.loads(summary.model_dump_json(by_alias=True))
    for trial in stored["trials"]:
        for key in ("duplicated", "reordered", "late", "clipped", "excluded", "stretches"):
            del trial[key]
        del trial["streams"]
    read = Summary.model_validate(stored)
    assert read.trials[0].ticks == SAMPLES
    assert (read.trials[0].excluded, read.trials[0].streams) == (0.0, {})


def part(record: TrialRecord, start: int, stop: int) -> TrialRecord:
    return replace(
        record,
        perturbation=record.perturbation[:, start:stop],
        position=record.position[:, start:stop],
        torque=record.torque[:, start:stop],
        command=None if record.command is None else record.command[:, start:stop],
        start_ns=record.start_ns + start * PERIOD_NS,
    )
