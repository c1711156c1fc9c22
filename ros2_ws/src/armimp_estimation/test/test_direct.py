"""The baseline that ignores the loop: right without disturbance, biased with one."""

import dataclasses

import numpy as np
import pytest
from numpy.typing import NDArray

from armimp_common.errors import DataError
from armimp_estimation.estimators.direct import Direct
from armimp_estimation.estimators.estimate import Estimator, confidence_radius
from armimp_estimation.estimators.lpm import LpmConfig, LpmFull
from armimp_estimation.estimators.welch import WelchFull, WelchSiso
from armimp_estimation.fit import fit_mbk
from armimp_estimation.record import TrialRecord
from armimp_estimation.torque_timing import TorqueReading, TorqueTiming
from armimp_estimation.trial import TrialData
from support.synthetic_trials import (
    LOOP,
    TWO_JOINT_ARM,
    WELCH,
    synthetic_trials,
)

FloatArray = NDArray[np.float64]

PUSHED = dataclasses.replace(LOOP, voluntary=1.0)
SIMULTANEOUS = TorqueReading(timing=TorqueTiming.SIMULTANEOUS)
OTHERS: list[Estimator] = [
    WelchSiso(),
    WelchFull(),
    LpmFull(config=LpmConfig(reading=SIMULTANEOUS)),
]


def pushed_record(seed: int) -> TrialRecord:
    """A static loop: stiffness 4 against one of 6, perturbation x, voluntary torque d."""
    x, d = np.random.default_rng(seed).standard_normal((2, 6144))
    angle = (x - d) / (4.0 + 6.0)
    return TrialRecord(
        trial=1,
        perturbed_joint=0,
        rate=125.0,
        joint_names=("a",),
        perturbation=x[None],
        position=angle[None],
        torque=(4.0 * angle + d)[None],
        start_ns=0,
        seed=seed,
    )


def test_without_disturbance_it_finds_the_true_impedance() -> None:
    estimate = Direct().estimate(synthetic_trials(LOOP))
    true = TWO_JOINT_ARM.impedance(estimate.f)
    error = np.sum(np.abs(estimate.Z - true) ** 2, axis=2) / np.sum(np.abs(true) ** 2, axis=2)
    assert np.sqrt(np.max(error)) < 0.005
    assert estimate.name == "direct"
    assert estimate.Z.shape == (2, 2, 122)


def test_bias_is_that_of_theory() -> None:
    """``G_θτ/G_θθ = (Z G_xx - Y G_dd)/(G_xx + G_dd)``: with equal powers halfway from Z to -Y."""
    data = [TrialData.from_record(pushed_record(seed), WELCH) for seed in range(30)]
    found = np.mean([Direct().estimate([one]).Z for one in data])
    assert abs(found - (4.0 - 6.0) / 2.0) < 0.1
    unbiased = np.mean([WelchSiso().estimate([one]).Z.real for one in data])
    assert abs(unbiased - 4.0) < 0.4


def test_when_the_subject_pushes_expect_bias_here_and_none_in_the_others() -> None:
    # Real parts of relative errors, averaged over the band where the subject pushes.
    errors: dict[str, list[FloatArray]] = {}
    for seed in range(30):
        data = synthetic_trials(PUSHED, seed)
        for estimator in (Direct(), *OTHERS):
            estimate = estimator.estimate(data)
            band = estimate.f < 2.0
            true = TWO_JOINT_ARM.impedance(estimate.f)[:, :, band]
            relative = (estimate.Z[:, :, band] - true) / np.abs(true)
            errors.setdefault(estimator.name, []).append(np.median(relative.real, axis=2))
    mean = {name: np.mean(values, axis=0) for name, values in errors.items()}
    uncertain = {name: np.std(v, axis=0, ddof=1) / np.sqrt(len(v)) for name, v in errors.items()}
    bias = np.diag(mean["direct"])
    assert (bias < -0.3).all()
    assert (bias < -10.0 * np.diag(uncertain["direct"])).all()
    for estimator in OTHERS:
        assert (np.abs(mean[estimator.name]) < 4.0 * uncertain[estimator.name]).all()
        assert (np.abs(np.diag(mean[estimator.name])) < 0.3 * np.abs(bias)).all()


def test_its_standard_errors_do_not_know_of_the_bias() -> None:
    fit = fit_mbk(Direct().estimate(synthetic_trials(dataclasses.replace(LOOP, voluntary=3.0))))
    off = np.abs(fit.mbk.B - TWO_JOINT_ARM.B) / fit.B_se
    assert off[0, 0] > 4.0


def test_variance_is_that_of_repeated_experiments_outside_the_loop() -> None:
    loop = dataclasses.replace(LOOP, torque_noise=0.5)
    estimates = [Direct().estimate(synthetic_trials(loop, seed)) for seed in range(80)]
    true = TWO_JOINT_ARM.impedance(estimates[0].f)
    squares = np.mean([np.abs(e.Z - true) ** 2 for e in estimates], axis=0)
    ratio = np.mean(np.mean([e.variance for e in estimates], axis=0) / squares, axis=2)
    assert (np.abs(ratio - 1.0) < 0.15).all()
    inside = np.mean(
        [np.abs(e.Z - true) <= confidence_radius(e.variance, e.averages, 0.95) for e in estimates]
    )
    assert 0.94 < inside < 0.97


def test_when_the_perturbed_joint_does_not_move_expect_data_error() -> None:
    record = dataclasses.replace(pushed_record(1), position=np.zeros((1, 6144)))
    with pytest.raises(DataError, match=r"joint 1 does not move at 0\.1221 Hz"):
        Direct().estimate([TrialData.from_record(record, WELCH)])
