import dataclasses

import numpy as np
import pytest

from armimp_common.arrays import ComplexArray
from armimp_common.errors import DataError
from armimp_estimation import scores
from armimp_estimation.estimators.estimate import ImpedanceEstimate
from armimp_estimation.frf import FrfMatrix, frf_matrix
from armimp_estimation.mbk import MBK
from armimp_estimation.spectra import BAND, CrossSpectra, bins_in_band, cross_spectra
from armimp_estimation.trial import TrialData
from support.synthetic_trials import (
    SEGMENT,
    TWO_JOINT_ARM,
    SyntheticConfig,
    made_estimate,
    made_record,
    synthetic_trial,
)

F = bins_in_band(SEGMENT, 125.0, *BAND) * 125.0 / SEGMENT
TARGET = MBK(M=np.diag([0.2, 0.2]), B=np.diag([2.0, 2.0]), K=np.diag([10.0, 10.0]))


def spectra_of(matrix: ComplexArray) -> CrossSpectra:
    return CrossSpectra(
        f=np.array([1.0, 2.0]),
        matrix=np.repeat(matrix[:, :, None], 2, axis=2),
        segments=21,
        effective_averages=11.2,
        bin_correlation=np.ones((1, 2)),
    )


def test_vaf_is_100_for_the_truth_and_falls_with_the_square_of_a_relative_error() -> None:
    true = TWO_JOINT_ARM.impedance(F)
    factors = np.array([[1.0, 1.1], [1.0 + 0.1j, 3.0]])
    vaf = scores.vaf(made_estimate(F, true * factors[:, :, None]), TWO_JOINT_ARM)
    np.testing.assert_allclose(vaf, [[100.0, 99.0], [99.0, -300.0]], rtol=1e-12)


def _realised(deviation: float, covariance: ComplexArray | None = None) -> ImpedanceEstimate:
    """Responses of a robot whose impedance is larger than its target by a share."""
    Z = TWO_JOINT_ARM.impedance(F)
    shown = (1.0 + deviation) * TARGET.impedance(F)
    R = np.zeros_like(Z)
    R[[0, 1], [0, 1]] = 1.0 / (shown + Z)[[0, 1], [0, 1]]
    T = np.einsum("ijf,jkf->ikf", Z, R)
    return dataclasses.replace(made_estimate(F, Z), T=T, R=R, covariance=covariance)


def test_a_robot_that_does_what_its_law_says_has_no_deviation_from_the_target() -> None:
    silent = np.zeros((2, 4, 4, F.size), dtype=np.complex128)
    np.testing.assert_allclose(scores.realisation(_realised(0.0, silent), TARGET), 0.0, atol=1e-13)
    off = scores.realisation(_realised(0.07, silent), TARGET)
    np.testing.assert_allclose(off, np.full((2, 3), 0.07), rtol=1e-9)
    unknown = scores.realisation(_realised(0.07), TARGET)
    np.testing.assert_allclose(unknown[:, 0], 0.07, rtol=1e-9)
    assert np.isnan(unknown[:, 1:]).all()


def test_coherence_is_the_share_of_common_power() -> None:
    spectra = spectra_of(np.array([[4.0, 2j, 0.0], [-2j, 9.0, 0.0], [0.0, 0.0, 0.0]]))
    np.testing.assert_allclose(scores.coherence(spectra, 0, 1), 4.0 / 36.0)
    np.testing.assert_array_equal(scores.coherence(spectra, 0, 2), 0.0)
    np.testing.assert_array_equal(scores.coherence(spectra, 1, 1), 1.0)


def test_derived_coherence_follows_its_definition() -> None:
    # One joint: tau_delta, theta, tau.
    record = made_record(np.zeros((1, 1000)))
    matrix = np.array([[1.0, 0.0, 0.0], [0.0, 2.0, 4.0 + 2j], [0.0, 4.0 - 2j, 25.0]])
    trial = TrialData(record=record, spectra=spectra_of(matrix))
    noise = (1.0 - 20.0 / 50.0) * 25.0
    expected = 9.0 * 2.0 / (9.0 * 2.0 + noise)
    impedance = np.array([3.0, 3.0j])
    derived = scores.derived_coherence(trial, 0, trial.f, impedance)
    np.testing.assert_allclose(derived, expected)
    # On a finer grid of frequencies the impedance is interpolated.
    f, finer = np.array([0.5, 1.5, 2.5]), np.array([2.0 + 0j, 4.0, 2.0])
    np.testing.assert_allclose(scores.derived_coherence(trial, 0, f, finer), expected)


def unrelated(rng: np.random.Generator) -> CrossSpectra:
    return cross_spectra(rng.standard_normal((2, 6144)), rate=125.0, segment=SEGMENT)


def test_coherence_of_unrelated_signals_exceeds_the_significance_level_as_often_as_alpha() -> None:
    rng = np.random.default_rng(8)
    spectra = [unrelated(rng) for _ in range(150)]
    level = scores.coherence_significance(spectra[0].effective_averages)
    assert level == pytest.approx(0.2549, abs=1e-3)
    above = [scores.coherence(one, 0, 1) > level for one in spectra]
    # Taking the 21 overlapped segments for independent ones, 21 % would exceed their level.
    assert 0.035 < np.mean(above) < 0.065


def test_band_mean_of_the_coherence_of_unrelated_signals_scatters_as_expected() -> None:
    rng = np.random.default_rng(9)
    means = [np.mean(scores.coherence(unrelated(rng), 0, 1)) for _ in range(300)]
    spectra = unrelated(rng)
    spread = (scores.coherence_of_chance(spectra) - 1.0 / spectra.effective_averages) / 4.0
    assert np.mean(means) == pytest.approx(1.0 / spectra.effective_averages, abs=0.004)
    assert np.std(means) == pytest.approx(spread, rel=0.15)


def test_lock_ratio_is_the_motion_that_the_perturbation_causes_and_not_that_of_a_dither() -> None:
    loop = SyntheticConfig(rate=125.0, samples=6144, torque_noise=0.01)
    ratios = []
    for dither in (0.0, 0.02):
        records = [synthetic_trial(TWO_JOINT_ARM, k, loop, 1) for k in range(2)]
        t = np.arange(6144) / 125.0
        for record in records:
            locked = 1 - record.perturbed_joint
            record.position[locked] = 0.01 * record.position[1 - locked]
            record.position[locked] += dither * np.sin(2.0 * np.pi * 40.0 * t)
        data = [TrialData.of(one, segment=SEGMENT) for one in records]
        ratios.append(scores.lock_ratio(data, frf_matrix(data)))
    np.testing.assert_allclose(ratios[0], [[1.0, 0.01], [0.01, 1.0]], rtol=1e-6)
    np.testing.assert_allclose(ratios[1], ratios[0], rtol=0.05)


def test_a_perturbed_joint_that_stands_still_or_a_torque_that_never_changes_is_an_error() -> None:
    wave = np.sin(np.arange(1000) / 30.0)
    position = np.stack((wave, np.full(1000, 0.3)))
    with pytest.raises(DataError, match="trial 4: joint_2 is perturbed but does not move"):
        scores.require_motion(made_record(position, trial=4, perturbed_joint=1))
    with pytest.raises(DataError, match=r"torque of joint_1 reads 0.3 N·m throughout"):
        scores.require_motion(made_record(position, np.full((2, 1000), 0.3)))


def test_bias_bound_is_the_share_of_torque_that_locked_joints_make() -> None:
    R = np.array([[2.0, 0.1], [0.3, 5.0]])
    T = np.array([[8.0, 4.0], [6.0, 10.0]])
    frf = FrfMatrix(
        f=F[:2],
        R=np.repeat(R[:, :, None], 2, axis=2) + 0j,
        T=np.repeat(T[:, :, None], 2, axis=2) + 0j,
        covariance=np.zeros((2, 4, 4, 2), dtype=np.complex128),
    )
    expected = [
        [4.0 / 5.0 * 0.3 / 8.0, 8.0 / 2.0 * 0.1 / 4.0],
        [10.0 / 5.0 * 0.3 / 6.0, 6.0 / 2.0 * 0.1 / 10.0],
    ]
    np.testing.assert_allclose(scores.bias_bound(frf), expected)
