"""Trials that end once their standard errors are small enough, through the whole graph."""

import json
from pathlib import Path

import numpy as np
import pytest

from armimp_bringup.cli import main
from armimp_estimation.summary import Summary
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


def test_bags_estimate_and_replay_to_the_same_result(early: FinishedRun, tmp_path: Path) -> None:
    bags = [str(bag) for bag in early.bags]
    for command in ("estimate", "replay"):
        out = tmp_path / command
        assert main([command, *bags, "--out", str(out), "--json"]) == 0
        summary = Summary.model_validate(json.loads((out / "summary.json").read_text()))
        assert summary.estimators == early.summary.estimators
        assert summary.valid
        assert [(one.ticks, one.saved) for one in summary.trials] == [
            (one.ticks, one.saved) for one in early.summary.trials
        ]


def test_separate_processes_end_at_the_same_sample_with_the_same_bits(
    early: FinishedRun, run: Run
) -> None:
    separate = run(**OPTIONS, processes="separate")

    assert separate.summary.problems == []
    separate.assert_same_streams(early)
    assert separate.summary.estimators == early.summary.estimators
