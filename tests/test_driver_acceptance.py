"""The experiment on the driver template, with the sensors of a real rig: calibration decides."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from armimp_bringup.config import Declared, ExperimentConfig
from armimp_bringup.offline_estimate import estimate_bags
from armimp_bringup.orchestrator import run_experiment
from armimp_common.topics import CONTROLLER_NODE, ESTIMATOR_NODE
from armimp_estimation.bags.reader import read_bag
from armimp_estimation.problems import ProblemCode
from armimp_estimation.result import Result
from armimp_estimation.scores import vaf
from support import known
from support.problems import codes
from support.synthetic_trials import TWO_JOINT_ARM, made_estimate, worst_errors

pytestmark = [pytest.mark.usefixtures("environment"), pytest.mark.slow]

MOCK = {
    "mock.offset": "[0.8, -0.5]",
    "mock.drift": "[0.01, -0.005]",
    "mock.delay": "0.0017",
    "mock.cutoff": "200.0",
    "mock.lag": "0.0003",
}
"""Imperfections of transducers and drives."""
CALIBRATION: dict[str, Any] = {
    "imbic_controller": {
        "tare": {"duration": 1.0},
        "known": {"torque_delay": 0.0017, "torque_cutoff": 200.0, "actuator_lag": 0.0003},
    },
}
"""What the experiment is told of these imperfections."""
LEAST = {"VAF": 99.98, "R2": 0.9998, "coherence": 0.94}


def good_figures(told: Result) -> dict[str, float]:
    """Worst figures of merit of `lpm_full` over all elements, which must be good.

    The test knows the arm. They are printed as docs/drivers.md has them; M, B and K are errors, %.
    """
    result, estimate = told.summary.estimators["lpm_full"], told.curves["lpm_full"]
    found = {
        "VAF": float(np.min(vaf(made_estimate(estimate.f, estimate.Z), TWO_JOINT_ARM))),
        "R2": float(np.min(np.array(result.r2))),
        "coherence": float(np.min(result.coherence_derived)),
        **{name: 100.0 * error for name, error in worst_errors(result, TWO_JOINT_ARM).items()},
    }
    print(*(f"{name} {value:.5g}" for name, value in found.items()))
    assert [name for name, least in LEAST.items() if found[name] < least] == []
    return found


@pytest.mark.timeout(900)
def test_offset_drift_delay_filter_and_lag_are_calibrated_out_or_found(
    start: Callable[..., object], start_node: Callable[[str], object], tmp_path: Path
) -> None:
    """The row of `lpm_full` but for the coherence, which leakage lowers in trials this short."""
    options = [part for name, value in MOCK.items() for part in ("-p", f"{name}:={value}")]
    start(["-m", "armimp_driver_template.node"], *options)
    for node in (CONTROLLER_NODE, ESTIMATOR_NODE):
        start_node(node)
    config = {"duration": 15.0, "processes": "external", **CALIBRATION}
    summary = run_experiment(ExperimentConfig.model_validate(config), tmp_path / "out").summary

    assert summary.valid
    # Nobody declared how well the transducers are calibrated.
    found_wrong = set(codes(summary.problems))
    assert ProblemCode.CALIBRATION_ASSUMED in found_wrong
    assert found_wrong <= {ProblemCode.CALIBRATION_ASSUMED, ProblemCode.GAIN_UNCONFIRMED}
    assert summary.truth is None
    assert known(summary.torque_reading).delay == 0.0017
    bags = [tmp_path / "out" / str(trial.bag) for trial in summary.trials]
    # The tare is in the bag, and the torques are raw.
    for number, bag in enumerate(bags):
        (trial,) = read_bag(bag).trials
        seconds = number * 17.5 + 1.0
        expected = (0.8 + 0.01 * seconds, -0.5 - 0.005 * seconds)
        assert trial.window.tare == pytest.approx(expected, abs=0.03)

    told = estimate_bags(bags, ("lpm_full",))
    assert told.summary.estimators["lpm_full"] == summary.estimators["lpm_full"]
    found = good_figures(told)
    assert max(found[name] for name in ("M", "B", "K")) <= 0.15

    not_told = estimate_bags(bags, ("lpm_full",), declared=Declared(torque_delay=0.0))
    # The records refute that delay, and correct it.
    assert not_told.summary.valid, not_told.summary.problems
    assert ProblemCode.DELAY_CORRECTED in codes(not_told.summary.problems)
    found = good_figures(not_told)
    assert found["M"] <= 0.8
    assert found["B"] <= 1.8
    assert found["K"] <= 0.3
