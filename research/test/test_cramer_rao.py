"""The Cramér-Rao bound: closed forms, and an estimator that reaches it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from armimp_common.errors import DataError
from armimp_estimation.record import TrialRecord
from research.cramer_rao import (
    SensorNoise,
    cramer_rao_bound,
    error_covariance,
    motion_in_band,
)
from support.synthetic_trials import TWO_JOINT_ARM, SyntheticConfig, stacked, synthetic_trial

pytestmark = pytest.mark.slow

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

BAND = (0.122, 15.0)
SAMPLES = 8192
NOISE = SensorNoise(angle=2e-5, torque=5e-3)


def motion(joints: int, trials: int) -> tuple[FloatArray, ComplexArray]:
    random = np.random.default_rng(3)
    f = 0.122 * np.arange(1, 120, dtype=np.float64)
    parts = random.standard_normal((2, trials, joints, f.size))
    theta: ComplexArray = parts[0] + 1j * parts[1]
    return f, theta


def test_joints_that_cannot_be_told_apart_are_refused() -> None:
    f, theta = motion(2, 1)
    covariance = error_covariance(TWO_JOINT_ARM, f, SAMPLES, NOISE)
    with pytest.raises(DataError, match="does not move"):
        cramer_rao_bound(f, theta * np.array([1.0, 0.0])[None, :, None], covariance)
    with pytest.raises(DataError, match="apart"):
        cramer_rao_bound(f, np.repeat(theta[:, :1], 2, axis=1), covariance)


def _likeliest(records: list[TrialRecord], covariance: ComplexArray) -> FloatArray:
    """M, B and K, (3, n, n), that minimise ``Σ e* Σ⁻¹ e`` with a known covariance."""
    f, theta = motion_in_band(records, BAND)
    _, torque = motion_in_band([replace(r, position=r.torque) for r in records], BAND)
    s = 2j * np.pi * f
    root = np.conj(np.swapaxes(np.linalg.cholesky(np.linalg.inv(covariance)), 1, 2))
    slopes = np.concatenate((s**2 * theta, s * theta, theta), axis=1)
    trials, columns, bins = slopes.shape
    n = theta.shape[1]
    whitened = np.einsum("fwi,taf->tfwia", root, slopes).reshape(trials * bins * n, n * columns)
    target = np.einsum("fwi,tif->tfw", root, torque).ravel()
    found = np.linalg.lstsq(
        np.concatenate((whitened.real, whitened.imag)),
        np.concatenate((target.real, target.imag)),
        rcond=None,
    )[0]
    return np.moveaxis(found.reshape(n, 3, n), 1, 0)


def test_least_squares_with_known_noise_reach_the_bound_with_rounded_readings() -> None:
    """100 experiments with sensors of resolution level 3; both trials differ in every one."""
    angle, torque = 1.227e-4, 0.02
    config = SyntheticConfig(samples=SAMPLES, perturbation=3.0, lock_stiffness=100.0)
    noise = SensorNoise.of_rounding(angle=angle, torque=torque)
    squares = []
    for seed in range(100):
        trials = [
            synthetic_trial(TWO_JOINT_ARM, joint, config, 2 * seed + joint) for joint in (0, 1)
        ]
        rounded = [
            replace(
                one,
                position=angle * np.rint(one.position / angle),
                torque=torque * np.rint(one.torque / torque),
            )
            for one in trials
        ]
        f, theta = motion_in_band(trials, BAND)
        covariance = error_covariance(TWO_JOINT_ARM, f, SAMPLES, noise)
        bound = cramer_rao_bound(f, theta, covariance)
        squares.append(((_likeliest(rounded, covariance) - stacked(TWO_JOINT_ARM)) / bound) ** 2)
    found = np.mean(squares, axis=0)
    # Of each parameter, chi squared with 100 degrees of freedom over 100; 12 parameters, level 1 %.
    lower, upper = stats.chi2.ppf([0.005 / 12, 1.0 - 0.005 / 12], 100) / 100
    assert (found > lower).all(), found
    assert (found < upper).all(), found
