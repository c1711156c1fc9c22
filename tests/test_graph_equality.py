"""One experiment, whichever way it runs: the same samples and results to the last bit."""

from typing import Any

import numpy as np
import pytest

from armimp_bringup.config import ExperimentConfig
from armimp_bringup.offline import run_offline
from armimp_bringup.parameters import node_parameters
from armimp_estimation.bags import read_bag
from armimp_estimation.record import TrialRecord
from armimp_estimation.summary import read_frf
from support.runs import FinishedRun, Run

TICKS = 2_000


def offline(**options: Any) -> list[TrialRecord]:
    config = ExperimentConfig.model_validate({"duration": TICKS / 1000, **options})
    return run_offline([node_parameters(config, None)])[0]


def test_composed_and_separate_processes_record_the_same_bits_and_give_the_same_results(
    composed: FinishedRun, separate: FinishedRun
) -> None:
    composed.assert_same_streams(separate)
    assert composed.summary.problems == separate.summary.problems
    assert composed.summary.estimators == separate.summary.estimators
    assert composed.summary.truth == separate.summary.truth
    curves, others = (read_frf(run.directory / "frf.npz") for run in (composed, separate))
    assert set(curves) == set(others) == set(composed.summary.estimators) != set()
    for name, curve in curves.items():
        np.testing.assert_array_equal(curve.Z, others[name].Z)
        np.testing.assert_array_equal(curve.variance, others[name].variance)


def test_graph_and_loop_without_ros_give_the_same_bits(composed: FinishedRun) -> None:
    composed.assert_same_as_offline(offline())


@pytest.mark.slow
def test_an_optimal_multisine_goes_the_same_way(run: Run) -> None:
    options: dict[str, Any] = {"perturbation_kind": "optimal", "duration": 5.0}
    finished = run(**options)

    records = offline(**options)
    finished.assert_same_as_offline(records)
    assert [one.periods.count for one in records if one.periods is not None] == [4, 4]
    assert finished.summary.problems == []


@pytest.mark.slow
def test_a_realistic_rig_with_a_tare_goes_the_same_way(run: Run) -> None:
    transducer = {"offset": [0.8, -0.5], "drift": [0.4, 0.2]}
    options: dict[str, Any] = {
        "rig": "realistic",
        "arm_sim": {"sensors.torque": transducer, "voluntary.rms": 0.02},  # or there is no tare
        "imbic_controller": {"tare": {"duration": 0.6, "wait": 0.4}},
    }
    finished = run(**options)

    finished.assert_same_as_offline(offline(**options))
    first, second = (read_bag(bag).trials[0].window.tare for bag in finished.bags)
    # The readings were taken 0.7 s into the trial on average; one lasts 4 s.
    assert first == pytest.approx((0.8 + 0.28, -0.5 + 0.14), abs=0.03)
    assert second[0] - first[0] == pytest.approx(0.4 * 4.0, abs=0.03)


@pytest.mark.slow
def test_three_joints_go_the_same_way(run: Run) -> None:
    finished = run(joints=3)

    assert [trial.k for trial in finished.summary.trials] == [1, 2, 3]
    assert [(trial.ticks, trial.lost) for trial in finished.summary.trials] == [(TICKS, 0)] * 3
    for result in finished.summary.estimators.values():
        assert np.shape(result.K) == (3, 3)
        assert np.isfinite(result.K).all()
    finished.assert_same_as_offline(offline(joints=3))
    perturbed = [
        np.flatnonzero(record.perturbation.any(axis=1)).tolist() for record in finished.records()
    ]
    assert perturbed == [[0], [1], [2]]
