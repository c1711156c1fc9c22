"""The paper's estimator meets its targets: every element, in trials of 50 s."""

from typing import Any

import numpy as np
import pytest

from armimp_bringup.config import ExperimentConfig
from armimp_bringup.offline import SimulatedExperiment, simulate
from armimp_estimation.identify import EstimatorResult
from armimp_estimation.mbk import MBK
from support.runs import Run

pytestmark = pytest.mark.slow


def offline(**levels: Any) -> tuple[SimulatedExperiment, EstimatorResult]:
    """An experiment without the graph, and what the estimator of the paper makes of it."""
    (experiment,) = simulate([ExperimentConfig.model_validate(levels)])
    found = experiment.identify(["welch_siso"])
    assert found.problems == ()
    return experiment, found.estimators["welch_siso"]


def assert_accurate(result: EstimatorResult, truth: MBK) -> None:
    assert result.vaf is not None
    assert np.min(result.vaf) >= 99.5
    assert np.min(result.fit.r2) >= 0.99
    assert np.min(result.coherence_derived) >= 0.985
    for name, tolerance in (("M", 0.03), ("B", 0.08), ("K", 0.03)):
        error = getattr(result.fit.mbk, name) / getattr(truth, name) - 1.0
        assert np.abs(error).max() <= tolerance, f"{name}: {error}"


def test_default_experiment_through_the_graph_gives_what_is_accurate_without_it(run: Run) -> None:
    summary = run(duration=50.0).summary
    experiment, result = offline()
    assert_accurate(result, experiment.truth)
    assert summary.problems == []
    assert [(trial.ticks, trial.lost) for trial in summary.trials] == [(50_000, 0)] * 2
    for trial in summary.trials:
        assert min(trial.lock_ratio) <= 0.005
    through = summary.estimators["welch_siso"]
    for name in ("M", "B", "K"):
        assert getattr(through, name) == getattr(result.fit.mbk, name).tolist()


@pytest.mark.parametrize(
    "levels",
    [{"friction": 0, "resolution": 0, "perturbation": 1}, {"joints": 3}],
    ids=str,
)
def test_other_levels_and_arms(levels: dict[str, int]) -> None:
    experiment, result = offline(**levels)
    assert_accurate(result, experiment.truth)
