"""Responses and both estimators on averaged spectra, against closed loops with known truth."""

import dataclasses

import numpy as np
import pytest

from armimp_common.errors import ConfigurationError, DataError
from armimp_estimation.estimators.estimate import Estimator, confidence_radius
from armimp_estimation.estimators.registry import IdentifyConfig, estimator_names, make_estimator
from armimp_estimation.estimators.welch import WelchFull, WelchSiso, invert, multiply
from armimp_estimation.frf import frf_matrix, order_trials
from armimp_estimation.mbk import MBK
from armimp_estimation.record import TrialRecord
from armimp_estimation.spectra import WelchConfig
from armimp_estimation.trial import TrialData
from support.synthetic_trials import (
    LOOP,
    THREE_JOINT_ARM,
    TWO_JOINT_ARM,
    WELCH,
    relative_error,
    synthetic_trial,
    synthetic_trials,
)

BOTH: list[Estimator] = [WelchSiso(), WelchFull()]


def static_record(noise: float = 0.0) -> TrialRecord:
    rng = np.random.default_rng(0)
    x = rng.standard_normal(6144)
    noises = noise * rng.standard_normal((4, 6144))
    return TrialRecord(
        trial=1,
        perturbed_joint=0,
        rate=125.0,
        joint_names=("a", "b"),
        perturbation=np.stack((x, 0.0 * x)),
        position=np.stack((0.5 * x, 0.001 * x)) + noises[:2],
        torque=np.stack((3.0 * x, -2.0 * x)) + noises[2:],
        start_ns=0,
        seed=0,
    )


def test_responses_of_a_static_system_are_its_gains() -> None:
    frf = frf_matrix([TrialData.from_record(static_record(), WELCH).spectra])
    gains = np.concatenate((frf.R, frf.T))[:, 0]
    expected = np.array([0.5, 0.001, 3.0, -2.0])[:, None] * np.ones(frf.f.size)
    np.testing.assert_allclose(gains, expected, rtol=1e-12)
    assert np.abs(frf.variance).max() < 1e-14


@pytest.mark.parametrize("estimator", BOTH, ids=lambda e: e.name)
@pytest.mark.parametrize("arm", [TWO_JOINT_ARM, THREE_JOINT_ARM], ids=["two", "three"])
def test_when_locked_joints_stand_still_expect_the_true_impedance(
    estimator: Estimator, arm: MBK
) -> None:
    estimate = estimator.estimate(synthetic_trials(arm=arm))
    assert estimate.name == estimator.name
    assert estimate.Z.shape == (arm.joints, arm.joints, 122)
    assert relative_error(estimate, arm) < 0.005


@pytest.mark.parametrize("arm", [TWO_JOINT_ARM, THREE_JOINT_ARM], ids=["two", "three"])
def test_when_locked_joints_give_way_expect_only_the_full_estimator_to_stay_right(
    arm: MBK,
) -> None:
    moving = synthetic_trials(dataclasses.replace(LOOP, lock_stiffness=1000.0), arm=arm)
    assert relative_error(WelchFull().estimate(moving), arm) < 0.05
    assert relative_error(WelchSiso().estimate(moving), arm) > 0.2


def test_when_the_subject_pushes_expect_errors_within_the_confidence_circles_but_no_bias() -> None:
    true = TWO_JOINT_ARM.impedance(WELCH.frequencies(125.0))
    loop = dataclasses.replace(LOOP, voluntary=1.0)
    errors = [WelchSiso().estimate(synthetic_trials(loop, seed)).Z - true for seed in range(60)]
    low = slice(0, 16)  # up to 2 Hz, where the subject pushes
    scatter = np.sqrt(np.mean(np.abs(errors) ** 2, axis=0))[:, :, low]
    bias = np.abs(np.mean(errors, axis=0))[:, :, low]
    assert (np.mean(scatter / np.abs(true[:, :, low]), axis=2) > 0.1).all()
    # The mean of 60 has an rms of 0.13 of the scatter; the mean over 16 bins scatters by 0.02.
    assert (np.mean(bias / scatter, axis=2) < 0.2).all()


@pytest.mark.slow
@pytest.mark.parametrize("estimator", BOTH, ids=lambda e: e.name)
def test_variance_is_that_of_repeated_experiments(estimator: Estimator) -> None:
    lock = 1e9 if estimator.name == "welch_siso" else 300.0
    loop = dataclasses.replace(LOOP, torque_noise=0.5, voluntary=0.3, lock_stiffness=lock)
    true = TWO_JOINT_ARM.impedance(WELCH.frequencies(125.0))
    found = (estimator.estimate(synthetic_trials(loop, seed)) for seed in range(150))
    estimates = [one.without_systematics() for one in found]
    squares = np.mean([np.abs(e.Z - true) ** 2 for e in estimates], axis=0)
    variance = np.mean([e.variance for e in estimates], axis=0)
    # A ratio averages 150 runs and some 60 independent bins, and so scatters by a per cent or two.
    # With n_d in the place of n_d - 1 all would be 9 % lower.
    ratio = np.mean(variance / squares, axis=2)
    assert 0.98 < ratio.mean() < 1.08
    assert (np.abs(ratio - 1.0) < 0.1).all()
    inside = np.mean(
        [np.abs(e.Z - true) <= confidence_radius(e.variance, e.averages, 0.95) for e in estimates]
    )
    assert 0.94 < inside < 0.97
    inside = np.mean(
        [np.abs(e.Z - true) <= confidence_radius(e.variance, e.averages, 0.5) for e in estimates]
    )
    assert 0.48 < inside < 0.53


@pytest.mark.slow
def test_variance_of_responses_is_that_of_repeated_experiments() -> None:
    loop = dataclasses.replace(LOOP, torque_noise=0.5, position_noise=0.1)
    s = 2j * np.pi * WELCH.frequencies(125.0)
    arm = TWO_JOINT_ARM
    motion = 1.0 / ((0.2 + arm.M[0, 0]) * s**2 + (4.0 + arm.B[0, 0]) * s + 30.0 + arm.K[0, 0])
    push = motion * (arm.M[1, 0] * s**2 + arm.B[1, 0] * s + arm.K[1, 0])
    columns = [
        frf_matrix([TrialData.from_record(synthetic_trial(arm, 0, loop, seed), WELCH).spectra])
        for seed in range(300)
    ]
    squares = np.mean([np.abs(c.R[0, 0] - motion) ** 2 for c in columns], axis=0)
    ratio = np.mean([c.variance[0, 0] for c in columns], axis=0) / squares
    assert 0.98 < ratio.mean() < 1.08
    squares = np.mean([np.abs(c.T[1, 0] - push) ** 2 for c in columns], axis=0)
    ratio = np.mean([c.variance[3, 0] for c in columns], axis=0) / squares
    assert 0.98 < ratio.mean() < 1.08


@pytest.mark.parametrize("estimator", BOTH, ids=lambda e: e.name)
def test_order_of_trials_does_not_change_a_bit(estimator: Estimator) -> None:
    data = synthetic_trials(arm=THREE_JOINT_ARM)
    one = estimator.estimate(data)
    other = estimator.estimate([data[2], data[0], data[1]])
    assert one.Z.tobytes() == other.Z.tobytes()
    assert one.variance.tobytes() == other.variance.tobytes()


def test_a_column_alone_is_that_of_the_matrix() -> None:
    data = synthetic_trials()
    estimate = WelchSiso().estimate(data)
    for k in range(2):
        column = WelchSiso().column(data[k].spectra)
        assert column.joint == k
        np.testing.assert_array_equal(column.Z, estimate.Z[:, k])
        noise = estimate.without_systematics().variance[:, k]
        np.testing.assert_allclose(column.variance, noise, rtol=1e-9)


def test_when_trials_differ_in_length_expect_the_averages_of_the_shortest() -> None:
    short = synthetic_trial(TWO_JOINT_ARM, 1, dataclasses.replace(LOOP, samples=3000), 1)
    data = [synthetic_trials()[0], TrialData.from_record(short, WELCH)]
    estimate = WelchSiso().estimate(data)
    assert estimate.averages == data[1].spectra.spectra.effective_averages < 6.0


def test_when_a_joint_has_two_trials_expect_data_error() -> None:
    data = synthetic_trials()
    with pytest.raises(DataError, match=r"2 trials perturb joint 1 \(joint_1\).*: trials 1, 1"):
        order_trials([*data, data[0]])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"joint_names": ("x", "y")}, "trial 2 has joints x, y, trial 1 has joint_1, joint_2"),
        ({"rate": 250.0}, "250.0 samples per second, trial 1 has 125.0"),
        ({"perturbation": np.ones((2, 6144))}, "trial 2 perturbs joint_1 as well as joint_2"),
    ],
)
def test_when_trials_do_not_belong_together_expect_data_error(
    change: dict[str, object], message: str
) -> None:
    first, second = synthetic_trials()
    record = dataclasses.replace(second.record, **change)  # type: ignore[arg-type]
    with pytest.raises(DataError, match=message):
        order_trials([first, dataclasses.replace(second, record=record)])


def test_when_spectra_are_at_different_frequencies_expect_data_error() -> None:
    first, second = synthetic_trials()
    other = TrialData.from_record(second.record, WelchConfig(segment=512, overlap=256))
    with pytest.raises(DataError, match="trials 1 and 2 have spectra at different frequencies"):
        order_trials([first, other])


def test_when_there_is_one_segment_only_expect_data_error() -> None:
    loop = dataclasses.replace(LOOP, samples=1100)
    with pytest.raises(DataError, match="joint 1: 1 segment gives no measure of noise"):
        WelchSiso().estimate(synthetic_trials(loop))


def test_when_there_is_no_perturbation_expect_data_error() -> None:
    record = dataclasses.replace(static_record(), perturbation=np.zeros((2, 6144)))
    with pytest.raises(DataError, match="joint 1: no perturbation at"):
        frf_matrix([TrialData.from_record(record, WELCH).spectra])


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("value", [1e160, 1e300])
def test_when_the_perturbation_is_too_large_to_be_squared_expect_data_error(value: float) -> None:
    record = static_record()
    perturbation = record.perturbation.copy()
    perturbation[0, 100] = value
    record = dataclasses.replace(record, perturbation=perturbation)
    with pytest.raises(DataError, match="joint 1: no perturbation at"):
        frf_matrix([TrialData.from_record(record, WELCH).spectra])


def test_when_the_perturbed_joint_does_not_move_expect_data_error() -> None:
    record = dataclasses.replace(static_record(), position=np.zeros((2, 6144)))
    with pytest.raises(DataError, match="joint 1 does not follow its perturbation"):
        WelchSiso().column(TrialData.from_record(record, WELCH).spectra)


def test_inverse_times_matrix_is_the_identity_at_each_frequency() -> None:
    rng = np.random.default_rng(2)
    matrix = rng.standard_normal((3, 3, 7)) + 1j * rng.standard_normal((3, 3, 7))
    f = np.arange(1.0, 8.0)
    product = multiply(matrix, invert(matrix, f))
    np.testing.assert_allclose(product, np.repeat(np.eye(3)[:, :, None], 7, axis=2), atol=1e-12)
    np.testing.assert_allclose(
        multiply(matrix, matrix), np.einsum("ijf,jkf->ikf", matrix, matrix), rtol=1e-12
    )


def test_when_motions_are_dependent_expect_the_frequency_in_the_error() -> None:
    matrix = np.repeat(np.eye(2, dtype=np.complex128)[:, :, None], 3, axis=2)
    matrix[:, :, 1] = 1.0
    with pytest.raises(DataError, match=r"linearly dependent at 2.5 Hz"):
        invert(matrix, np.array([2.0, 2.5, 3.0]))


def test_confidence_radius_tends_to_that_of_a_known_variance() -> None:
    known = np.sqrt(-np.log(0.05) * 4.0)
    radius = confidence_radius(np.array([4.0]), 1e7, 0.95)
    np.testing.assert_allclose(radius, known, rtol=1e-5)
    assert confidence_radius(np.array([4.0]), 11.0)[0] > 1.05 * known


@pytest.mark.parametrize("level", [0.0, 1.0, -0.5, float("nan")])
def test_when_the_level_is_no_probability_expect_configuration_error(level: float) -> None:
    with pytest.raises(ConfigurationError, match="confidence level"):
        confidence_radius(np.array([1.0]), 11.0, level)


def test_registry_makes_each_estimator_by_its_name() -> None:
    names = estimator_names()
    assert {"welch_siso", "welch_full"} <= set(names)
    assert [make_estimator(name, IdentifyConfig()).name for name in names] == list(names)


def test_when_the_name_is_unknown_expect_the_known_ones_in_the_error() -> None:
    with pytest.raises(ConfigurationError, match=r"unknown estimator 'welsh'.*welch_siso"):
        make_estimator("welsh", IdentifyConfig())
