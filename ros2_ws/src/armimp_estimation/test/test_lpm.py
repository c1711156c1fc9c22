"""The estimator ``lpm_full`` against closed loops with known truth."""

import dataclasses

import numpy as np
import pytest
import scipy.stats
from numpy.typing import NDArray

from armimp_common.errors import ConfigurationError, DataError
from armimp_estimation.estimators.estimate import confidence_radius
from armimp_estimation.estimators.local_polynomial import LocalPolynomialConfig
from armimp_estimation.estimators.lpm import LpmConfig, LpmFull
from armimp_estimation.estimators.registry import IdentifyConfig, make_estimator
from armimp_estimation.estimators.welch import WelchFull
from armimp_estimation.fit import FitConfig, MBKFit, fit_mbk
from armimp_estimation.mbk import MBK
from armimp_estimation.record import TrialRecord
from armimp_estimation.spectra import WelchConfig
from armimp_estimation.torque_timing import TorqueReading, TorqueTiming
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

FloatArray = NDArray[np.float64]

SIMULTANEOUS = TorqueReading(timing=TorqueTiming.SIMULTANEOUS)
LPM = LpmFull(config=LpmConfig(reading=SIMULTANEOUS))


def with_records(data: list[TrialData], **changes: object) -> list[TrialData]:
    """The trials with a field of their records changed; their spectra do not matter here."""
    return [
        dataclasses.replace(trial, record=dataclasses.replace(trial.record, **changes))  # type: ignore[arg-type]
        for trial in data
    ]


def stacked(fit: MBKFit) -> FloatArray:
    return np.stack((fit.mbk.M, fit.mbk.B, fit.mbk.K))


@pytest.mark.parametrize("lock_stiffness", [1e9, 1000.0], ids=["still", "giving way"])
@pytest.mark.parametrize("arm", [TWO_JOINT_ARM, THREE_JOINT_ARM], ids=["two", "three"])
def test_without_noise_the_true_impedance_is_found_also_when_locked_joints_move(
    arm: MBK, lock_stiffness: float
) -> None:
    data = synthetic_trials(dataclasses.replace(LOOP, lock_stiffness=lock_stiffness), arm=arm)
    estimate = LPM.estimate(data)
    assert estimate.name == LPM.name == "lpm_full"
    assert estimate.Z.shape == (arm.joints, arm.joints, 732)
    assert relative_error(estimate, arm) < (0.001 if lock_stiffness > 1e6 else 0.01)
    assert relative_error(estimate, arm) < 0.3 * relative_error(WelchFull().estimate(data), arm)


def test_parameters_of_a_noiseless_loop_are_found_within_a_few_tenths_of_a_per_cent() -> None:
    arm = TWO_JOINT_ARM
    found = stacked(fit_mbk(LPM.estimate(synthetic_trials())))
    error = np.abs(found / np.stack((arm.M, arm.B, arm.K)) - 1.0)
    assert np.max(error[0]) < 0.001
    assert np.max(error[1:]) < 0.005


def test_when_the_subject_pushes_expect_errors_within_the_confidence_circles_but_no_bias() -> None:
    loop = dataclasses.replace(LOOP, voluntary=1.0)
    estimates = [LPM.estimate(synthetic_trials(loop, seed)) for seed in range(30)]
    low = estimates[0].f < 2.0
    true = TWO_JOINT_ARM.impedance(estimates[0].f)[:, :, low]
    errors = np.array([estimate.Z[:, :, low] - true for estimate in estimates])
    # The median, as a bin where the arm hardly moved is far out.
    scatter = np.median(np.abs(errors), axis=0)
    assert (np.mean(scatter / np.abs(true), axis=2) > 0.1).all()
    bias = np.abs(np.median(errors.real, axis=0) + 1j * np.median(errors.imag, axis=0))
    # The median of 30 is off by a quarter of the scatter on the mean.
    assert (np.mean(bias / scatter, axis=2) < 0.4).all()


@pytest.mark.parametrize(
    "lock_stiffness",
    [pytest.param(1e9, marks=pytest.mark.slow), 300.0],
    ids=["still", "giving way"],
)
def test_variance_is_that_of_repeated_experiments(lock_stiffness: float) -> None:
    # Voluntary torque is kept small: the variance is one of first order.
    loop = dataclasses.replace(LOOP, torque_noise=0.3, voluntary=0.1, lock_stiffness=lock_stiffness)
    estimates = [LPM.estimate(synthetic_trials(loop, seed)) for seed in range(40)]
    true = TWO_JOINT_ARM.impedance(estimates[0].f)
    squares = np.mean([np.abs(e.Z - true) ** 2 for e in estimates], axis=0)
    variance = np.mean([e.variance for e in estimates], axis=0)
    # 40 runs with some 60 independent bins.
    ratio = np.mean(variance, axis=2) / np.mean(squares, axis=2)
    assert (np.abs(ratio - 1.0) < 0.1).all()
    assert estimates[0].averages == 20.0
    inside = np.mean(
        [np.abs(e.Z - true) <= confidence_radius(e.variance, e.averages, 0.95) for e in estimates]
    )
    assert 0.94 < inside < 0.965
    inside = np.mean(
        [np.abs(e.Z - true) <= confidence_radius(e.variance, e.averages, 0.5) for e in estimates]
    )
    assert 0.47 < inside < 0.54


RUNS = 120


def coverage_accepted(inside: NDArray[np.bool_]) -> bool:
    """Whether intervals can be said to cover 92 to 98 %, each parameter and all together.

    The share of a single parameter scatters by 2 % over 120 runs, so its count is only held
    against what chance allows (1 in 1000 at either end); that of all 12 together scatters by 0.8 %.
    """
    counts = np.sum(inside, axis=0)
    lowest = scipy.stats.binom.ppf(0.001, len(inside), 0.92)
    highest = scipy.stats.binom.ppf(0.999, len(inside), 0.98)
    return bool(
        (counts >= lowest).all() and (counts <= highest).all() and 0.92 < inside.mean() < 0.98
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    "changes",
    [{"voluntary": 1.0}, {"voluntary": 0.5, "torque_noise": 0.5, "lock_stiffness": 300.0}],
    ids=["voluntary", "mixed"],
)
def test_95_per_cent_intervals_of_parameters_cover_the_truth_as_often(
    changes: dict[str, float],
) -> None:
    loop = dataclasses.replace(LOOP, **changes)  # type: ignore[arg-type]
    truth = np.stack((TWO_JOINT_ARM.M, TWO_JOINT_ARM.B, TWO_JOINT_ARM.K))
    fits = [fit_mbk(LPM.estimate(synthetic_trials(loop, 1000 + seed))) for seed in range(RUNS)]
    error = np.abs([stacked(fit) - truth for fit in fits])
    deviation = np.array([np.stack((fit.M_se, fit.B_se, fit.K_se)) for fit in fits])
    assert coverage_accepted(error <= 1.96 * deviation)
    # The check itself must notice standard errors that are wrong by a quarter or a third.
    assert not coverage_accepted(error <= 0.75 * 1.96 * deviation)
    assert not coverage_accepted(error <= 1.33 * 1.96 * deviation)


def test_a_delay_of_all_torques_is_corrected() -> None:
    delayed = []
    for trial in synthetic_trials():
        samples = trial.record.samples
        late = np.exp(-1j * np.pi * np.fft.rfftfreq(samples))  # half a sample
        torque = np.fft.irfft(np.fft.rfft(trial.record.torque, axis=1) * late, samples, axis=1)
        delayed += with_records([trial], torque=torque)
    arm = TWO_JOINT_ARM
    truth = np.stack((arm.M, arm.B, arm.K))
    told = LpmConfig(reading=TorqueReading(timing=TorqueTiming.INTERVAL_MEAN))
    corrected = stacked(fit_mbk(LpmFull(config=told).estimate(delayed)))
    np.testing.assert_allclose(corrected, truth, rtol=0.005)
    fit = fit_mbk(LpmFull().estimate(delayed))
    assert fit.delay is not None
    assert fit.delay.delay == pytest.approx(0.004, rel=0.02)
    errors = np.stack((fit.M_se, fit.B_se, fit.K_se))
    assert (np.abs(stacked(fit) - truth) < 3.5 * errors).all()
    raw = dataclasses.replace(LPM.estimate(delayed), delay_uncertainty=None)
    assert (stacked(fit_mbk(raw))[1] > 1.2 * arm.B).all()


def test_when_everything_is_late_commands_are_of_no_concern() -> None:
    config = LpmConfig(reading=TorqueReading(timing=TorqueTiming.INTERVAL_MEAN))
    data = synthetic_trials()
    commanded = with_records(data, command=np.random.default_rng(1).standard_normal((2, 6144)))
    one = LpmFull(config=config).estimate(data)
    assert one.Z.tobytes() == LpmFull(config=config).estimate(commanded).Z.tobytes()
    # If commands do not explain the torques, nothing is corrected.
    assert LpmFull().estimate(commanded).Z.tobytes() == LPM.estimate(data).Z.tobytes()


def test_in_short_records_fewer_bins_take_part() -> None:
    config = LpmConfig()
    assert [config.local_for(seconds).half_width for seconds in (200.0, 50.0, 30.0, 10.0)] == [
        12,
        12,
        7,
        5,
    ]
    loop = dataclasses.replace(LOOP, samples=1250)
    data = [
        TrialData.from_record(
            synthetic_trial(TWO_JOINT_ARM, joint, loop, 1), WelchConfig.for_samples(1250)
        )
        for joint in range(2)
    ]
    estimate = LPM.estimate(data)
    assert estimate.averages == 6.0
    wide = LpmFull(config=LpmConfig(reading=SIMULTANEOUS, span=10.0)).estimate(data)
    assert wide.averages == 20.0
    assert relative_error(estimate, TWO_JOINT_ARM) < 0.5 * relative_error(wide, TWO_JOINT_ARM)


def cut_to(record: TrialRecord, samples: int) -> TrialRecord:
    arrays = {
        name: getattr(record, name)[:, :samples] for name in ("perturbation", "position", "torque")
    }
    return dataclasses.replace(record, **arrays)


def test_of_trials_of_different_length_each_is_used_whole_at_frequencies_of_the_shortest() -> None:
    loop = dataclasses.replace(LOOP, voluntary=0.3)
    whole = synthetic_trials(loop)
    shorter = [TrialData.from_record(cut_to(trial.record, 3072), WELCH) for trial in whole]
    mixed = LPM.estimate([whole[0], shorter[1]])
    both_short = LPM.estimate(shorter)

    assert mixed.f.tobytes() == both_short.f.tobytes()
    assert relative_error(mixed, TWO_JOINT_ARM) < 0.1
    # The longer trial has the smaller errors; the other column stays as it was.
    errors, before = (fit_mbk(one) for one in (mixed, both_short))
    for name in ("M_se", "B_se", "K_se"):
        ratio = getattr(errors, name) / getattr(before, name)
        assert (ratio[:, 0] < 0.9).all()
        np.testing.assert_allclose(ratio[:, 1], 1.0, rtol=0.05)


def locked(record: TrialRecord) -> TrialRecord:
    """The same with joints at rest that were not perturbed."""
    perturbed = np.arange(record.joints)[:, None] == record.perturbed_joint
    return dataclasses.replace(record, position=np.where(perturbed, record.position, 0.0))


def test_column_of_one_trial_is_that_of_the_whole_estimate_where_joints_are_locked() -> None:
    data = synthetic_trials(dataclasses.replace(LOOP, voluntary=0.3))
    data = [dataclasses.replace(trial, record=locked(trial.record)) for trial in data]
    # Without a delay, which each trial alone would tell another way.
    exact = LpmFull(config=dataclasses.replace(LPM.config, timing_uncertainty=0.0))
    whole = fit_mbk(exact.estimate(data))
    for k, trial in enumerate(data):
        column = exact.column(trial.record)
        assert column.joint == k
        for row, name in enumerate("MBK"):
            np.testing.assert_allclose(column.values[row], getattr(whole.mbk, name)[:, k])
            # The whole estimate takes the mean correlation of bins of all trials.
            errors = getattr(whole, f"{name}_se")[:, k]
            np.testing.assert_allclose(column.errors[row], errors, rtol=0.01)


def test_when_the_joint_does_not_move_expect_its_number() -> None:
    record = synthetic_trials()[1].record
    with pytest.raises(DataError, match="joint 2 does not move"):
        LPM.column(dataclasses.replace(record, position=np.zeros_like(record.position)))


def test_neither_order_of_trials_nor_place_in_memory_changes_a_bit() -> None:
    def moved(record: TrialRecord, by: int) -> TrialRecord:
        arrays = {}
        for name in ("perturbation", "position", "torque"):
            values = getattr(record, name)
            room = np.empty(values.size + by)
            room[by:] = values.ravel()
            arrays[name] = room[by:].reshape(values.shape)
        return dataclasses.replace(record, **arrays)

    data = synthetic_trials(dataclasses.replace(LOOP, voluntary=0.5), arm=THREE_JOINT_ARM)
    one = LPM.estimate(data)
    others = [
        dataclasses.replace(data[k], record=moved(data[k].record, by))
        for k, by in ((2, 1), (0, 3), (1, 7))
    ]
    other = LPM.estimate(others)
    for name in ("f", "Z", "variance", "R", "T", "bin_correlation"):
        assert getattr(one, name).tobytes() == getattr(other, name).tobytes()


def test_registry_gives_it_the_band_and_its_options() -> None:
    options = IdentifyConfig(
        welch=WelchConfig(f_low=1.0, f_high=5.0),
        lpm=LpmConfig(local=LocalPolynomialConfig(order=1), reading=SIMULTANEOUS),
    )
    estimator = make_estimator("lpm_full", options)
    estimate = estimator.estimate(synthetic_trials())
    assert estimator.name == "lpm_full"
    assert (estimate.f[0], estimate.f[-1]) == pytest.approx((1.0, 5.0), abs=0.03)
    assert estimate.averages == 22.0


def test_fit_takes_the_floor_of_weights_that_the_estimate_carries() -> None:
    estimate = LPM.estimate(synthetic_trials(dataclasses.replace(LOOP, torque_noise=0.3)))
    assert estimate.weight_floor == 0.005
    own = stacked(fit_mbk(estimate))
    same = dataclasses.replace(estimate, weight_floor=None)
    np.testing.assert_array_equal(own, stacked(fit_mbk(same, FitConfig(weight_floor=0.005))))
    assert (own != stacked(fit_mbk(same))).all()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"span": 0.0}, "span must be positive"),
        ({"span": float("inf")}, "span must be positive"),
        ({"weight_floor": -0.1}, "weight_floor must not be negative"),
        ({"weight_floor": float("nan")}, "weight_floor must not be negative"),
    ],
)
def test_when_an_option_is_nonsense_expect_configuration_error(
    options: dict[str, float], message: str
) -> None:
    with pytest.raises(ConfigurationError, match=message):
        LpmConfig(**options)  # type: ignore[arg-type]
