from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from armimp_common.errors import DataError
from armimp_common.status import Phase, TrialStatus
from armimp_common.topics import JOINT_STATES, PERIOD_NS, PERTURBATION, TORQUE_SENSORS, TRIAL
from armimp_estimation.alignment.assemble import AssembledTrial, assemble_trials
from armimp_estimation.alignment.trial_windows import (
    MOST_TICKS,
    TrialWindow,
    infer_windows,
    tick_numbers,
    windows_from_statuses,
)
from armimp_estimation.bags.statuses import decode_trial_statuses
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


class TestWindows:
    def test_statuses_give_one_window_per_perturbation(self) -> None:
        several = synthetic_recording(perturbed=(1, 0), ticks=9, settle=3, rest=2, seed=4)
        assert windows_from_statuses(statuses_of(several)) == tuple(
            TrialWindow(
                trial=number,
                joint=record.perturbed_joint,
                joint_name=NAMES[record.perturbed_joint],
                start_ns=record.start_ns,
                ticks=9,
                seed=4,
                ended=True,
            )
            for number, record in enumerate(several.records, 1)
        )

    def test_a_trial_that_ends_early_has_the_samples_that_were_announced_last(self) -> None:
        settle, perturb, rest, *others = statuses_of(
            synthetic_recording(perturbed=(1, 0), ticks=9, settle=3, rest=2)
        )
        sooner, earlier = replace(perturb, ticks=7), replace(rest, ticks=6)
        for statuses, ticks in (
            ([settle, perturb, sooner], 7),
            ([settle, perturb, sooner, earlier, *others], 6),
            ([settle, perturb, earlier, *others], 6),
            ([settle, perturb, rest, replace(earlier, phase=Phase.DONE)], 6),
        ):
            window = windows_from_statuses(statuses)[0]
            assert (window.ticks, window.saved) == (ticks, 9 - ticks)
            assert window.ended == (len(statuses) > 3)
        # What was planned for the next one has no part in it.
        second = windows_from_statuses([settle, perturb, earlier, *others])[1]
        assert (second.ticks, second.saved) == (9, 0)

    def test_samples_beyond_an_early_end_do_not_count(self) -> None:
        settle, perturb, rest = statuses_of(RECORDING)[:3]
        early = [settle, perturb, replace(rest, ticks=25)]
        trial = assemble(RECORDING.by_topic(), early)
        assert trial.problem == trial.note == ""
        assert_part(trial.require(), RECORDING.records[0], 0, 25)
        assert {count.received for count in trial.ledger.streams.values()} == {25}

    def test_window_is_open_until_something_follows(self) -> None:
        statuses = statuses_of(synthetic_recording(perturbed=(1, 0), ticks=9, settle=3, rest=2))
        ended = [windows_from_statuses(statuses[:count]) for count in range(7)]
        assert [[window.ended for window in windows] for windows in ended] == [
            [],
            [],
            [False],
            [True],
            [True],
            [True, False],
            [True, True],
        ]

    def test_progress_and_repeated_statuses_change_nothing(self) -> None:
        statuses = statuses_of(RECORDING)
        settle, perturb, rest = statuses
        done = replace(rest, phase=Phase.DONE, start_ns=None)
        progress = replace(perturb, tick=perturb.tick + 20)
        more = [settle, perturb, progress, progress, rest, done, done]
        assert windows_from_statuses(more) == windows_from_statuses(statuses)
        latched = [rest, *more]
        assert len(windows_from_statuses(latched)) == 1

    def test_abort_before_the_perturbation_gives_no_window(self) -> None:
        settle = statuses_of(RECORDING)[0]
        aborted = replace(settle, phase=Phase.ABORTED, valid=False, reason="late")
        assert windows_from_statuses([settle, aborted]) == ()

    @pytest.mark.parametrize(("ticks", "start"), [(MOST_TICKS + 1, START), (10, 10**30)])
    def test_impossible_announcements_are_refused(self, ticks: int, start: int) -> None:
        statuses = [
            replace(status, ticks=ticks, start_ns=status.start_ns and start)
            for status in statuses_of(RECORDING)
        ]
        with pytest.raises(DataError, match="trial 1 cannot"):
            windows_from_statuses(statuses)

    def test_inferred_windows_are_those_of_the_statuses(self) -> None:
        several = synthetic_recording(perturbed=(0, 1, 1), ticks=50, settle=200, rest=60)
        topics = several.by_topic()
        del topics[TRIAL]
        trials = assemble_trials(NAMES, topics, [])
        assert [trial.trial for trial in trials] == [1, 2, 3]
        for trial, expected in zip(trials, several.records, strict=True):
            assert trial.require().perturbed_joint == expected.perturbed_joint
            assert_part(trial.require(), expected, 0, 50)

    def test_short_pause_within_a_perturbation_does_not_divide_it(self) -> None:
        stamps = START + np.arange(1000, dtype=np.int64) * PERIOD_NS
        perturbation = np.zeros((2, 1000))
        perturbation[1, 10:400] = 1.0
        perturbation[1, 649:990] = 1.0
        (window,) = infer_windows(stamps, perturbation)
        assert (window.joint, window.ticks) == (1, 980)
        perturbation[1, 649] = 0.0
        assert [window.ticks for window in infer_windows(stamps, perturbation)] == [390, 340]

    def test_next_joint_begins_a_trial_without_a_pause(self) -> None:
        stamps = START + np.arange(100, dtype=np.int64) * PERIOD_NS
        perturbation = np.zeros((2, 100))
        perturbation[0, :50] = 1.0
        perturbation[1, 50:] = 1.0
        windows = infer_windows(stamps, perturbation)
        assert [(window.joint, window.ticks) for window in windows] == [(0, 50), (1, 50)]

    def test_loss_inside_an_inferred_window_is_found(self) -> None:
        recording = synthetic_recording(ticks=50, settle=5, rest=5)
        topics = recording.by_topic()
        del topics[TRIAL], topics[PERTURBATION][20:23]
        trial = assemble(topics, [])
        assert trial.ledger.streams[PERTURBATION].lost == 3
        assert trial.window.ticks == 50

    def test_inferred_trial_may_be_cut_within_its_last_period(self) -> None:
        recording = synthetic_recording(ticks=50)
        topics = recording.by_topic()
        del topics[TRIAL], topics[TORQUE_SENSORS][-1]
        trial = assemble(topics, [])
        assert_part(trial.require(), recording.records[0], 0, 49)
        assert trial.ledger.lost == 0

    def test_nothing_perturbed_cannot_be_inferred(self) -> None:
        with pytest.raises(DataError, match="no joint is perturbed"):
            infer_windows(np.array([START], np.int64), np.zeros((2, 1)))

    def test_two_joints_at_once_cannot_be_inferred(self) -> None:
        with pytest.raises(DataError, match="joints 1, 3 are perturbed at once"):
            infer_windows(np.array([START], np.int64), np.array([[1.0], [0.0], [2.0]]))

    def test_slow_clock_does_not_add_up_to_a_gap(self) -> None:
        stamps = START + np.arange(5000, dtype=np.int64) * 1_000_300
        assert tick_numbers(stamps).tolist() == list(range(5000))
