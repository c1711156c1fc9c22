"""What all estimators promise, against closed loops with known truth."""

import dataclasses
import functools
from collections.abc import Mapping

import numpy as np
import pytest

from armimp_common.arrays import FloatArray
from armimp_common.errors import DataError
from armimp_estimation.estimators.estimate import Estimator
from armimp_estimation.estimators.welch import WelchFull, WelchSiso
from armimp_estimation.fit import fit_mbk
from armimp_estimation.frf import stands_out
from armimp_estimation.mbk import MBK
from armimp_estimation.systematics import rounding_lead
from armimp_estimation.torque_timing import TorqueReading, TorqueTiming
from armimp_estimation.trial import TrialData
from research.direct import Direct
from support import known
from support.synthetic_trials import (
    LOOP,
    LPM,
    SEGMENT,
    THREE_JOINT_ARM,
    TWO_JOINT_ARM,
    off,
    relative_error,
    share_within,
    synthetic_trials,
    with_readings,
    worst_errors,
)

SISO, FULL, DIRECT = WelchSiso(), WelchFull(), Direct()
UNBIASED: list[Estimator] = [SISO, FULL, LPM]
slow = functools.partial(pytest.param, marks=pytest.mark.slow)
every = pytest.mark.parametrize("estimator", [*UNBIASED, DIRECT], ids=lambda one: one.name)
arms = pytest.mark.parametrize("arm", [TWO_JOINT_ARM, THREE_JOINT_ARM], ids=["two", "three"])


@every
@arms
def test_when_locked_joints_stand_still_expect_the_true_impedance(
    estimator: Estimator, arm: MBK
) -> None:
    estimate = estimator.estimate(synthetic_trials(arm=arm))
    assert estimate.name == estimator.name
    assert estimate.Z.shape == (arm.joints, arm.joints, 732 if estimator is LPM else 122)
    assert relative_error(estimate, arm) < (0.001 if estimator is LPM else 0.005)


@arms
def test_when_locked_joints_give_way_expect_only_the_full_estimators_to_stay_right(
    arm: MBK,
) -> None:
    moving = synthetic_trials(dataclasses.replace(LOOP, lock_stiffness=1000.0), arm=arm)
    siso, full, lpm = (relative_error(one.estimate(moving), arm) for one in UNBIASED)
    assert siso > 0.2
    assert full < 0.05
    assert lpm < min(0.01, 0.3 * full)


def test_when_the_subject_pushes_expect_bias_of_the_direct_estimator_alone() -> None:
    # Real parts of relative errors, averaged over the band where the subject pushes.
    errors: dict[str, list[FloatArray]] = {}
    for seed in range(30):
        data = synthetic_trials(dataclasses.replace(LOOP, voluntary=1.0), seed)
        for estimator in (*UNBIASED, DIRECT):
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
    for estimator in UNBIASED:
        assert (np.abs(mean[estimator.name]) < 4.0 * uncertain[estimator.name]).all()
        assert (np.abs(np.diag(mean[estimator.name])) < 0.3 * np.abs(bias)).all()


def test_standard_errors_of_the_direct_estimator_cover_the_bias_of_the_loop() -> None:
    found = DIRECT.estimate(synthetic_trials(dataclasses.replace(LOOP, voluntary=6.0)))
    noisy = dataclasses.replace(found, systematics=())
    for estimate, held in ((found, True), (noisy, False)):
        fit = fit_mbk(estimate)
        off = np.abs(fit.mbk.M - TWO_JOINT_ARM.M) / fit.errors[0]
        assert bool(off[0, 0] < 1.96) is held


@pytest.mark.parametrize(
    ("estimator", "changes", "runs"),
    [
        # Voluntary torque is kept small: the variance is one of first order.
        slow(SISO, {"torque_noise": 0.5, "voluntary": 0.3}, 150),
        slow(FULL, {"torque_noise": 0.5, "voluntary": 0.3, "lock_stiffness": 300.0}, 150),
        slow(LPM, {"torque_noise": 0.3, "voluntary": 0.1}, 40),
        slow(LPM, {"torque_noise": 0.3, "voluntary": 0.1, "lock_stiffness": 300.0}, 40),
        # Outside the loop.
        (DIRECT, {"torque_noise": 0.5}, 80),
    ],
    ids=["welch_siso", "welch_full", "lpm_full, still", "lpm_full", "direct"],
)
def test_variance_is_that_of_repeated_experiments(
    estimator: Estimator, changes: Mapping[str, float], runs: int
) -> None:
    loop = dataclasses.replace(LOOP, **changes)  # type: ignore[arg-type]
    found = [estimator.estimate(synthetic_trials(loop, seed)) for seed in range(runs)]
    noisy = [dataclasses.replace(one, systematics=()) for one in found]
    estimates = found if estimator is LPM else noisy
    true = TWO_JOINT_ARM.impedance(estimates[0].f)
    squares = np.mean([np.abs(e.Z - true) ** 2 for e in estimates], axis=0)
    variance = np.mean([e.variance for e in estimates], axis=0)
    # Means over the runs and some 60 independent bins. With n_d in the place of n_d - 1 averaged
    # spectra would state 9 % less.
    if estimator is LPM:
        ratio = np.mean(variance, axis=2) / np.mean(squares, axis=2)
    else:
        ratio = np.mean(variance / squares, axis=2)
    assert (np.abs(ratio - 1.0) < (0.15 if estimator is DIRECT else 0.1)).all()
    assert 0.94 < share_within(estimates, true, 0.95) < 0.97
    assert 0.47 < share_within(estimates, true, 0.5) < 0.54


@every
def test_neither_order_of_trials_nor_place_in_memory_changes_a_bit(estimator: Estimator) -> None:
    def moved(trial: TrialData, by: int) -> TrialData:
        arrays = {}
        for name in ("perturbation", "position", "torque"):
            values = getattr(trial.record, name)
            room = np.empty(values.size + by)
            room[by:] = values.ravel()
            arrays[name] = room[by:].reshape(values.shape)
        return with_readings(trial, **arrays)

    data = synthetic_trials(dataclasses.replace(LOOP, voluntary=0.5), arm=THREE_JOINT_ARM)
    one = estimator.estimate(data)
    other = estimator.estimate([moved(data[k], by) for k, by in ((2, 1), (0, 3), (1, 7))])
    for name in ("f", "Z", "variance", "R", "T", "bin_correlation"):
        assert getattr(one, name).tobytes() == getattr(other, name).tobytes()


def test_a_response_stands_out_where_its_power_is_beyond_that_of_its_noise() -> None:
    rng = np.random.default_rng(3)
    f = np.arange(1.0, 801.0) * 0.02
    size = np.where(f < 5.0, 10.0, np.where(f < 10.0, 0.5, 0.0))
    noise = np.sqrt(0.5) * (rng.standard_normal(f.size) + 1j * rng.standard_normal(f.size))
    found = stands_out(f, size + noise, np.ones(f.size))
    assert found[f < 5.0 - 0.6].all()
    assert not found[f > 5.0 + 0.6].any()
    # Every fifth is a line, and what is between them is leakage.
    variance = np.where(np.arange(f.size) % 5, 1e4, 1e-4)
    lines = stands_out(f, 0.1 + np.sqrt(variance) * noise, variance)
    np.testing.assert_array_equal(lines, variance < 1.0)


def test_when_the_perturbed_joint_does_not_move_expect_its_number_in_the_error() -> None:
    moving, resting = synthetic_trials()
    record = with_readings(resting, position=np.zeros_like(resting.record.position)).record
    data = [moving, TrialData.of(record, segment=SEGMENT)]
    with pytest.raises(DataError, match="joint 2 does not follow its perturbation"):
        SISO.estimate(data)
    with pytest.raises(DataError, match=r"joint 2 does not move at 0\.1221 Hz"):
        DIRECT.estimate(data)
    with pytest.raises(DataError, match="at only 0 of"):
        LPM.column(record)


def test_a_delay_of_all_torques_is_corrected() -> None:
    delayed = []
    for trial in synthetic_trials():
        samples = trial.record.samples
        late = np.exp(-1j * np.pi * np.fft.rfftfreq(samples))  # half a sample
        torque = np.fft.irfft(np.fft.rfft(trial.record.torque, axis=1) * late, samples, axis=1)
        # Its spectra do not matter here.
        delayed.append(with_readings(trial, torque=torque))
    mean, unknown = (
        [with_readings(one, reading=TorqueReading(timing=timing)) for one in delayed]
        for timing in (TorqueTiming.INTERVAL_MEAN, TorqueTiming.UNKNOWN)
    )
    corrected = fit_mbk(LPM.estimate(mean)).mbk
    assert max(worst_errors(corrected, TWO_JOINT_ARM).values()) < 0.005
    fit = fit_mbk(LPM.estimate(unknown))
    assert known(fit.delay).delay == pytest.approx(0.004, rel=0.02)
    assert off(fit).max() < 3.5
    raw = dataclasses.replace(LPM.estimate(delayed), delay_uncertainty=None)
    assert (fit_mbk(raw).mbk.B > 1.2 * TWO_JOINT_ARM.B).all()


def test_stiffness_and_viscosity_of_a_locked_joint_may_differ_by_5_percent_between_trials() -> None:
    found = LPM.estimate(synthetic_trials(dataclasses.replace(LOOP, lock_stiffness=1000.0)))
    tension = TWO_JOINT_ARM.K[:, 1:] + 2j * np.pi * found.f * TWO_JOINT_ARM.B[:, 1:]
    expected = 0.05 * tension[:, None] * known(found.R)[1, 0] * known(found.inverse)[0]
    gaps = [np.linalg.norm(one - expected) for one in found.systematics]
    assert min(gaps) < 0.05 * np.linalg.norm(expected)


def test_the_lead_of_rounded_angles_of_a_locked_joint_is_found_within_its_error() -> None:
    rate, step, lock, band_end = 1000.0, 4e-4, 80.0, 15.0
    records = [trial.record for trial in synthetic_trials()]
    records = [dataclasses.replace(one, command=None, rate=rate) for one in records]
    load = 2.0 * records[0].perturbation[0] / np.std(records[0].perturbation[0])
    angle, torque = np.empty((2, load.size))
    place = speed = command = last = shown = 0.0
    for k, push in enumerate(load):
        reading = step * np.rint(place / step)
        shown += 0.4 * ((reading - last) * rate - shown)
        angle[k], torque[k], last = place, push + command, reading
        command = -(lock**2) * reading - 2.0 * lock * shown
        for _ in range(10):
            speed += 0.1 / rate * (push + command)
            place += 0.1 / rate * speed
    readings = step * np.rint(angle / step)
    resting = np.zeros(load.size)
    # All of the torque acts on an arm of 1 kg·m².
    held = np.stack([resting, readings])
    records[0] = dataclasses.replace(records[0], position=held, torque=np.stack([resting, torque]))
    records[1] = dataclasses.replace(records[1], position=held)
    lead, error = rounding_lead(records, np.eye(2), band_end)
    f = np.fft.rfftfreq(load.size, 1.0 / rate)
    band = (f > 0.5) & (f < band_end)
    cause, moved, rounded = (np.fft.rfft(x)[band] for x in (load, angle, readings - angle))
    # Of what follows from the load, summed over ten lines (1.6 Hz).
    moved, rounded = (
        np.add.reduceat(np.conj(cause) * one, np.arange(0, cause.size, 10))
        for one in (2j * np.pi * f[band] * moved, rounded)
    )
    true = np.sum((np.conj(moved) * rounded).real) / np.sum(np.abs(moved) ** 2)
    assert true > 1e-3
    assert abs(lead[1, 0] - true) < 2.0 * error[1, 0] < 1.2 * true
    # It changes nothing if a logger interpolated between readings.
    ticks = np.arange(load.size)
    logged = np.stack([resting, np.interp(ticks + 0.37, ticks, readings)])
    records = [dataclasses.replace(one, position=logged) for one in records]
    told = rounding_lead(records, np.eye(2), band_end)
    np.testing.assert_allclose(told, (lead, error), rtol=0.1)


def test_column_of_one_trial_is_that_of_the_whole_estimate_where_joints_are_locked() -> None:
    data = []
    # So little noise hides few reflexes.
    for k, trial in enumerate(synthetic_trials(dataclasses.replace(LOOP, voluntary=0.03))):
        # An angle that never changed might not have been recorded.
        moves = np.where(np.arange(2)[:, None] == k, 1.0, 1e-9)
        position = moves * trial.record.position
        # Without a delay, of which each trial alone would find a different one.
        exact = trial.record.reading.model_copy(update={"uncertainty": 0.0})
        data.append(with_readings(trial, position=position, reading=exact))
    whole = fit_mbk(LPM.estimate(data))
    for k, trial in enumerate(data):
        column = LPM.column(trial.record)
        assert column.joint == k
        # The whole estimate weighs by the noise at the fitted impedance.
        np.testing.assert_allclose(column.values, whole.values[:, :, k], rtol=5e-3)
        for row in range(3):
            # The whole estimate averages the correlation of bins over all trials, and allows for
            # cuffs and for reflexes that noise may hide, above all those of the joint itself.
            errors = whole.errors[row, :, k]
            apart = np.arange(len(errors)) != k
            np.testing.assert_allclose(column.errors[row][apart], errors[apart], rtol=0.1)
            assert (column.errors[row] < 1.02 * errors).all()
