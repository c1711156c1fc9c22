"""Trials that end once their standard errors are small enough, through the whole graph."""

import numpy as np
import pytest

from support.runs import FinishedRun, Run

pytestmark = pytest.mark.slow

BOUND = 0.05
LEAST = 8_000
PLANNED = 30_000
OPTIONS = {
    "duration": PLANNED / 1000,
    "target_error": BOUND,
    "impedance_estimator": {"least_duration": LEAST / 1000},
}


@pytest.fixture(scope="module")
def early(run: Run) -> FinishedRun:
    return run(**OPTIONS)


def test_trials_end_early_and_the_result_is_valid_and_as_good_as_was_asked_for(
    early: FinishedRun,
) -> None:
    assert early.summary.problems == []
    for trial in early.summary.trials:
        assert LEAST <= trial.ticks < PLANNED
        assert trial.saved == (PLANNED - trial.ticks) / 1000
        assert trial.lost == 0
        assert {count.received for count in trial.streams.values()} == {trial.ticks}
    # The result knows the other columns, which changes the errors a little.
    result = early.summary.estimators["lpm_full"]
    for name in "MBK":
        errors = np.array(getattr(result, f"{name}_se")) / np.abs(getattr(result, name))
        assert errors.max() < 1.05 * BOUND


def test_separate_processes_end_at_the_same_sample_with_the_same_bits(
    early: FinishedRun, run: Run
) -> None:
    separate = run(**OPTIONS, processes="separate")

    assert separate.summary.problems == []
    separate.assert_same_streams(early)
    assert separate.summary.estimators == early.summary.estimators
