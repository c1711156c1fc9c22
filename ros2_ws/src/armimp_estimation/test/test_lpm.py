"""The estimator ``lpm_full`` against closed loops with known truth."""

import dataclasses

import numpy as np
import pytest
from numpy.typing import NDArray

from armimp_estimation.estimators.lpm import LpmConfig, LpmFull
from armimp_estimation.fit import MBKFit, fit_mbk
from armimp_estimation.record import TrialRecord
from armimp_estimation.torque_timing import TorqueReading, TorqueTiming
from armimp_estimation.trial import TrialData
from support.synthetic_trials import (
    LOOP,
    TWO_JOINT_ARM,
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
            # The whole estimate weighs by the noise at the fitted impedance.
            fitted = getattr(whole.mbk, name)[:, k]
            np.testing.assert_allclose(column.values[row], fitted, rtol=5e-3)
            # It takes the mean over all trials of each correlation of bins, and knows of reflexes
            # that noise may hide, which make errors of the joint's own torque larger, and of cuffs.
            errors = getattr(whole, f"{name}_se")[:, k]
            apart = np.arange(len(errors)) != k
            np.testing.assert_allclose(column.errors[row][apart], errors[apart], rtol=0.1)
            assert (column.errors[row] < 1.02 * errors).all()
