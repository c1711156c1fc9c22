"""One experiment, whichever way it runs: the same samples and results to the last bit."""

from typing import Any

import numpy as np
import pytest

from armimp_bringup.config import ExperimentConfig
from armimp_bringup.offline import run_offline
from armimp_bringup.parameters import node_parameters
from armimp_estimation.bags.reader import read_bag
from armimp_estimation.record import TrialRecord
from armimp_estimation.summary import read_frf
from support.runs import FinishedRun, Run

TICKS = 2_000


def offline(**options: Any) -> list[TrialRecord]:
    config = ExperimentConfig.model_validate({"duration": TICKS / 1000, **options})
    return run_offline([node_parameters(config, None)])[0]


BOUND, LEAST, PLANNED = 0.05, 8_000, 30_000
EARLY = {
    "duration": PLANNED / 1000,
    "target_error": BOUND,
    "impedance_estimator": {"least_duration": LEAST / 1000},
}
"""Trials end once their standard errors are small enough."""


@pytest.mark.parametrize(
    "options",
    [{}, pytest.param(EARLY, marks=pytest.mark.slow)],
    ids=["default", "early end"],
)
def test_composed_and_separate_processes_record_the_same_bits_and_give_the_same_results(
    run: Run, options: dict[str, Any]
) -> None:
    composed, separate = run(**options), run(**options, processes="separate")
    composed.assert_same_streams(separate)
    assert composed.summary.problems == separate.summary.problems
    assert composed.summary.estimators == separate.summary.estimators
    assert composed.summary.truth == separate.summary.truth
    curves, others = (read_frf(one.directory / "frf.npz") for one in (composed, separate))
    assert set(curves) == set(others) == set(composed.summary.estimators) != set()
    for name, curve in curves.items():
        np.testing.assert_array_equal(curve.Z, others[name].Z)
        np.testing.assert_array_equal(curve.variance, others[name].variance)


@pytest.mark.slow
def test_trials_end_early_and_the_result_is_valid_and_as_good_as_was_asked_for(run: Run) -> None:
    early = run(**EARLY)
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


def test_graph_and_loop_without_ros_give_the_same_bits(composed: FinishedRun) -> None:
    composed.assert_same_as_offline(offline())


@pytest.mark.slow
@pytest.mark.parametrize(
    "options",
    [
        {"perturbation_kind": "optimal", "duration": 5.0},
        {
            "rig": "realistic",
            "arm_sim": {
                "sensors.torque": {"offset": [0.8, -0.5], "drift": [0.4, 0.2]},
                "voluntary.rms": 0.02,  # or there is no tare
            },
            "imbic_controller": {"tare": {"duration": 0.6, "wait": 0.4}},
        },
        {"joints": 3},
    ],
    ids=["optimal multisine", "realistic rig with a tare", "three joints"],
)
def test_other_experiments_give_the_same_bits_either_way(run: Run, options: dict[str, Any]) -> None:
    finished = run(**options)

    records = offline(**options)
    finished.assert_same_as_offline(records)
    assert {trial.lost for trial in finished.summary.trials} == {0}
    perturbed = [np.flatnonzero(one.perturbation.any(axis=1)).tolist() for one in records]
    assert perturbed == [[k] for k in range(options.get("joints", 2))]
    tares = [len(read_bag(bag).trials[0].window.tare) for bag in finished.bags]
    assert tares == [2 * ("imbic_controller" in options)] * len(records)
