from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats
from scipy.signal import butter, freqs

from armimp_common.arrays import ComplexArray, FloatArray
from armimp_common.errors import DataError
from armimp_estimation.estimators.estimate import ImpedanceEstimate
from armimp_estimation.fit import Calibration, MBKFit, fit_impedance, fit_mbk
from armimp_estimation.mbk import MBK
from armimp_estimation.unfitted_terms import hidden_square
from armimp_estimation.weighted_fit import WeightedFit, r_squared
from support.synthetic_trials import TWO_JOINT_ARM, made_estimate, off, stacked

F: FloatArray = np.linspace(0.122, 14.884, 122)
S: ComplexArray = np.asarray(2j * np.pi * F, dtype=np.complex128)
TRUTH = stacked(TWO_JOINT_ARM)
TRUE = TWO_JOINT_ARM.impedance(F)


def estimate_of(Z: ComplexArray, variance: FloatArray | None = None) -> ImpedanceEstimate:
    return made_estimate(F, Z, noise=np.ones(Z.shape) if variance is None else variance)


def noisy(Z: ComplexArray, deviation: FloatArray, seed: int = 3) -> ImpedanceEstimate:
    """An estimate whose errors have the standard deviations (n_freq,) that it states."""
    rng, size = np.random.default_rng(seed), deviation * np.ones((2, 2, 1))
    noise = rng.standard_normal(Z.shape) + 1j * rng.standard_normal(Z.shape)
    return estimate_of(Z + np.sqrt(0.5) * size * noise, size**2)


elements = st.floats(-20.0, 20.0, allow_subnormal=False)


@settings(max_examples=50, deadline=None)
@given(st.lists(elements, min_size=12, max_size=12), st.integers(0, 1000))
def test_without_noise_any_matrices_come_back_whatever_the_variances(
    values: list[float], seed: int
) -> None:
    M, B, K = np.reshape(values, (3, 2, 2))
    variance = np.random.default_rng(seed).uniform(0.1, 10.0, (2, 2, F.size))
    fit = fit_mbk(estimate_of(MBK(M=M, B=B, K=K).impedance(F), variance))
    np.testing.assert_allclose(stacked(fit.mbk)[:2], (M, B), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(fit.mbk.K, K, rtol=1e-9, atol=1e-6)


def test_equal_variances_give_ordinary_least_squares_with_its_standard_errors() -> None:
    rng = np.random.default_rng(4)
    noise = rng.standard_normal((1, 1, F.size)) + 1j * rng.standard_normal((1, 1, F.size))
    truth = MBK(M=np.array([[0.2]]), B=np.array([[0.7]]), K=np.array([[8.0]]))
    Z = truth.impedance(F) + noise
    fit = fit_mbk(replace(estimate_of(Z, np.full(Z.shape, 2.0)), weight_floor=0.0))
    omega = 2.0 * np.pi * F
    design = np.zeros((2 * F.size, 3))
    design[: F.size, 0] = -(omega**2)
    design[: F.size, 2] = 1.0
    design[F.size :, 1] = omega
    y = np.concatenate((Z[0, 0].real, Z[0, 0].imag))
    expected = np.linalg.lstsq(design, y, rcond=None)[0]
    np.testing.assert_allclose(stacked(fit.mbk)[:, 0, 0], expected, rtol=1e-9)
    covariance = np.linalg.inv(design.T @ design)  # each part has half of the variance of 2
    # A reflex that the noise may hide adds a thousandth to B, a soft cuff a twentieth to M.
    ratio = fit.errors[:, 0, 0] / np.sqrt(np.diag(covariance))
    assert (ratio > 1.0).all()
    assert (ratio < [1.06, 1.002, 1.005]).all()


def test_floor_of_weights_bounds_what_time_skew_does_to_viscosity() -> None:
    # Half a millisecond between torque and angle; variances tiny at high frequencies.
    Z = TRUE * np.exp(-1j * np.pi * F * 1e-3)
    variance = np.full(Z.shape, 1e-4)
    viscosity = fit_mbk(estimate_of(Z, variance)).mbk.B / TWO_JOINT_ARM.B
    unlimited = fit_mbk(replace(estimate_of(Z, variance), weight_floor=0.0)).mbk.B
    assert (np.abs(viscosity - 1.0) < 0.08).all()
    assert (unlimited / TWO_JOINT_ARM.B > 1.25).all()


@pytest.mark.parametrize(("noise", "left"), [(0.02, 0.1), (1e6, 1.0)])
def test_a_bounded_systematic_error_is_corrected_as_far_as_the_data_tell_it(
    noise: float, left: float
) -> None:
    bound = np.zeros_like(TRUE)
    bound[:, 1] = 2e-6 * S**3 * TRUE[:, 0]
    biased = noisy(TRUE + 0.8 * bound, noise * np.ones(F.size), seed=5)
    biased = replace(biased, systematics=(bound,))
    told, fit = fit_impedance(replace(biased, bounded=1))
    believed = fit_mbk(biased)
    assert off(fit).max() < 4.0
    assert np.linalg.norm(told.systematics[0]) <= left * np.linalg.norm(bound)
    if left < 1.0:
        assert (fit.errors[:, :, 1] < 0.5 * believed.errors[:, :, 1]).all()
    else:
        np.testing.assert_allclose(fit.errors, believed.errors, rtol=1e-3)


@pytest.mark.parametrize(("order", "cutoff"), [(2, 50.0), (3, 40.0)])
def test_an_unknown_low_pass_of_the_torques_is_corrected_where_noise_hides_low_frequencies(
    order: int, cutoff: float
) -> None:
    b, a = butter(order, 2.0 * np.pi * cutoff, analog=True)
    low_pass = freqs(b, a, 2.0 * np.pi * F)[1]
    late = noisy(TRUE * low_pass, np.where(F < 2.0, 10.0, 1.0))
    fit = fit_mbk(replace(late, delay_uncertainty=5e-4, delay_unknown=5e-4, weight_floor=0.005))
    assert off(fit).max() < 3.0
    assert (fit.errors < 0.4 * TRUTH).all()


@pytest.mark.parametrize("seed", range(3))
def test_a_torque_that_passed_a_high_pass_where_noise_hides_it_is_in_the_standard_errors(
    seed: int,
) -> None:
    w = 2.0 * np.pi * 0.3
    passed = np.array([S / (S + w), np.ones_like(S)])[:, None]
    first, errors = (np.array([True, False]), np.zeros(2, dtype=np.bool_)), []
    for share, possible in ((passed, first), (1.0, first), (1.0, ())):
        found = noisy(share * TRUE, np.where(F < 2.0, 3.0, 0.3), seed)
        fit = fit_mbk(replace(found, without_slow=possible))
        assert off(fit).max() < 3.5
        errors.append(fit.errors[1, 0, 0])
    assert errors[0] > 2.0 * errors[1] > 2.0 * errors[2]


def test_a_transducer_that_creeps_where_noise_hides_it_is_in_the_standard_errors_of_B() -> None:
    creeping = 1.0 + 0.06 / (1.0 + S * 0.1)
    found = noisy(creeping * TRUE, np.where(F < 2.0, 0.6, 0.02), seed=1)
    _, linear = fit_impedance(found, Calibration(linearity=0.001))
    _, unknown = fit_impedance(found, Calibration())
    assert (linear.errors[1] < 0.8 * unknown.errors[1]).any()
    assert off(unknown)[1].max() < 2.5


def test_a_second_mode_where_noise_hides_it_is_in_the_standard_errors_of_M_and_B() -> None:
    w = 6.0 * np.pi
    swinging = -0.1 * TWO_JOINT_ARM.M[:, :, None] * S**4 / (S**2 + 0.8 * w * S + w**2)
    found = noisy(TRUE + swinging, np.where(F < 6.0, 6.0, 0.2), seed=1)
    plain, told = (fit_mbk(replace(found, unbiased=one)) for one in (False, True))
    assert off(plain)[0].max() > 20.0
    assert off(told).max() < 5.0


def test_two_joints_share_no_more_of_a_second_mode_than_their_own_elements_allow() -> None:
    noise, own = np.where(F < 6.0, 6.0, 0.2), np.eye(2, dtype=np.bool_)
    found = noisy(TRUE, np.where(own[..., None], 0.1, 1.0) * noise, seed=1)
    plain, told = (fit_mbk(replace(found, unbiased=one)) for one in (False, True))
    assert (told.errors[:2, ~own] < 1.1 * plain.errors[:2, ~own]).all()


def test_stiffness_that_relaxes_where_noise_hides_it_is_in_the_standard_errors_of_K() -> None:
    spring = np.diag([3.0, 3.0])[:, :, None] * S * 0.3 / (1.0 + S * 0.3)

    def fit_of(relaxing: ComplexArray | float, low: float, high: float = 0.2) -> MBKFit:
        return fit_mbk(noisy(TRUE + relaxing, np.where(F < 1.0, low, high)))

    assert off(fit_of(spring, 10.0, 0.05))[2].max() < 3.5
    seen = fit_of(spring, 0.2)
    assert (seen.lack > seen.lack_limit).any()
    without = fit_of(0.0, 0.2)
    assert (np.diag(without.errors[2] / TWO_JOINT_ARM.K) < 0.03).all()


def test_an_arm_that_relaxes_is_neither_a_high_pass_nor_a_transducer_that_creeps() -> None:
    spring = 0.5 * TWO_JOINT_ARM.K[:, :, None] * S * 0.2 / (1.0 + S * 0.2)
    found, fit = fit_impedance(noisy(TRUE + spring, np.full(F.size, 0.02)), Calibration())
    assert not fit.of_form
    assert fit.high_pass == (0.0, np.inf)
    assert np.median(np.sqrt(found.variance) / np.abs(found.Z)) < 0.1


def test_bands_hold_an_impedance_that_is_late_itself_where_no_jumps_tell() -> None:
    late = noisy(TRUE * np.exp(-S * 0.001), np.full(F.size, 0.05))
    found, fit = fit_impedance(replace(late, delay_uncertainty=1e-3, delay_unknown=1e-3))
    assert fit.late == pytest.approx(0.001, rel=0.05)
    assert np.mean(np.abs(found.Z - late.Z) ** 2 > 3.0 * found.variance) < 0.05


@pytest.mark.parametrize(
    ("torques", "angles"), [((1, 1), (0, 0)), ((0, 1), (0, 0)), ((0, 0), (1, 0))]
)
def test_bands_hold_the_impedance_behind_filters_that_nobody_declared(
    torques: tuple[int, int], angles: tuple[int, int]
) -> None:
    orders = np.subtract.outer(torques, angles)
    filtered = noisy(TRUE / (1.0 + S * 0.005) ** orders[..., None], np.full(F.size, 0.002))
    errors = (5e-4 * S * TRUE, 2e-6 * S**2 * TRUE)
    late = replace(filtered, delay_uncertainty=5e-4, delay_unknown=5e-4, systematics=errors)
    found, fit = fit_impedance(late)
    assert fit.of_form
    assert (fit.lateness > 0.003)[orders != 0].all()
    assert np.mean(np.abs(found.Z - TRUE) ** 2 > 3.0 * found.variance) < 0.05


def test_a_reflex_whose_two_parts_nearly_cancel_is_in_the_standard_errors_of_B_and_K() -> None:
    noise = np.where(F < 5.0, 0.4, 10.0)
    gains = 0.28 * TWO_JOINT_ARM.B[:, :, None] * S + 0.32 * TWO_JOINT_ARM.K[:, :, None]
    reflex = np.eye(2)[:, :, None] * gains * np.exp(-0.03 * S) / (1.0 + S / 37.0) ** 2
    fit, plain = (fit_mbk(noisy(TRUE + one, noise)) for one in (reflex, 0.0))
    assert (fit.lack < fit.lack_limit).all()
    assert (np.abs(fit.mbk.K - TWO_JOINT_ARM.K) > 3.0 * plain.errors[2]).any()
    assert off(fit).max() < 2.5


def test_a_high_pass_of_the_torques_that_noise_hides_is_in_the_standard_errors() -> None:
    found = [noisy(TRUE * S / (S + w), 0.3 / F**1.5) for w in (0.3, 0.0)]
    passed, plain = (fit_mbk(replace(one, weight_floor=0.005)) for one in found)
    assert (np.abs(stacked(passed.mbk) - TRUTH)[1] > 4.0 * plain.errors[1]).any()
    assert off(passed).max() < 3.0
    assert (plain.errors[1] < 0.5 * passed.errors[1]).all()
    for fit, corner in ((passed, 0.3), (plain, 0.0)):
        value, error = np.multiply(fit.high_pass, 2.0 * np.pi)
        assert abs(value - corner) < 3.0 * error + 0.2 * corner


def test_terms_that_look_alike_without_noise_keep_their_prior_difference() -> None:
    fit = WeightedFit(estimate=noisy(TRUE, 1e-15 * np.ones(F.size)))
    late = np.stack([1e-3 * S * TRUE, 1e-3 * S * TRUE, 1e-7 * S**3 * np.ones_like(TRUE)])
    _, covariance = fit.common_coefficients(late, np.zeros(3))
    known = [[0.5, -0.5, 0.0], [-0.5, 0.5, 0.0], [0.0, 0.0, 0.0]]
    np.testing.assert_allclose(covariance, known, atol=1e-6)
    assert (np.diag(covariance) > 0.0).all()


def test_r_squared_is_one_for_a_perfect_fit_and_zero_for_the_mean() -> None:
    values = np.array([1.0 + 2.0j, 3.0 - 4.0j, 0.5 + 1.0j])
    mean = float(np.mean([values.real, values.imag]))
    assert r_squared(values, values) == 1.0
    assert r_squared(values, np.full(3, mean * (1 + 1j))) == pytest.approx(0.0, abs=1e-15)
    # Σ(y - ŷ)² = 1, y = (1, 3, 0.5, 2, -4, 1): Σ(y - mean)² = 31.25 - 6·(3.5/6)²
    shifted = values + np.array([0.0, 0.0, 1.0])
    assert r_squared(values, shifted) == pytest.approx(1.0 - 1.0 / (31.25 - 3.5**2 / 6.0))


def test_when_values_are_not_finite_expect_data_error() -> None:
    variance = np.ones(TRUE.shape)
    variance[1, 0, 5] = np.inf
    with pytest.raises(DataError, match="made: impedance or its variance is not finite"):
        fit_mbk(estimate_of(TRUE, variance))


def test_an_effect_that_noise_may_hide_counts_by_its_evidence_in_the_data() -> None:
    assert hidden_square(0.0, 1e6, 0.05)[0] == pytest.approx(0.05)
    assert hidden_square(2.0, 0.01, 0.05)[0] == pytest.approx(4.0, rel=1e-3)
    assert hidden_square(0.01, 0.01, 0.05)[0] < 1e-6
    assert hidden_square(-2.0, 0.01, 0.05, positive=True)[0] < 1e-6
    assert hidden_square(2.0, 0.01, 0.05, elsewhere=-np.inf)[0] == 0.0

    # By the integral over all sizes and both cases.
    told, error, likely, usual = 0.6, 0.3, 0.05, (0.1, 1.0)
    sizes = np.linspace(-10.0, 10.0, 200_001)
    there = np.mean([stats.norm.pdf(sizes, scale=one) for one in usual], axis=0)
    there *= stats.norm.pdf(told, sizes, error) * (sizes[1] - sizes[0])
    absent = stats.norm.pdf(told, 0.0, error)
    square, evidence = hidden_square(told, error, likely, sizes=usual)
    beside = (1.0 - likely) / likely * absent
    assert square == pytest.approx(np.sum(there * sizes**2) / (np.sum(there) + beside), rel=1e-6)
    assert evidence == pytest.approx(np.log(np.sum(there) / absent), rel=1e-6)

    # If other data make it nine times as likely as not, these still tell how large it is.
    sure, _ = hidden_square(told, error, 0.5, sizes=usual, elsewhere=np.log(9.0))
    assert sure == pytest.approx(hidden_square(told, error, 0.9, sizes=usual)[0], rel=1e-6)
