"""Torques that are read late, filtered or before the update: what that does, and its cure."""

import functools
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scipy import signal

import armimp
from armimp_common.arrays import ComplexArray, FloatArray
from armimp_estimation.estimators.lpm import LpmFull
from armimp_estimation.fit import MBKFit, fit_mbk
from armimp_estimation.hold_correction import update_jump
from armimp_estimation.record import TrialRecord
from armimp_estimation.torque_timing import TorqueReading, TorqueTiming
from armimp_estimation.trial import TrialData
from support import known
from support.laws import ROBOT
from support.synthetic_trials import TWO_JOINT_ARM as ARM
from support.synthetic_trials import off, worst_errors

RATE = 1e3
F = np.array([0.122, 1.0, 5.0, 15.0])
TRANSMISSION = ARM.M @ np.linalg.inv(ARM.M + ROBOT)
"""Share of a command that is torque on the arm at once."""
PROMPT = TorqueReading()


@functools.cache
def rig_records(reading: TorqueReading = PROMPT, law: str = "tde") -> list[TrialRecord]:
    """Trials of a frictionless rig with this torque reading; commands of a TDE law chatter."""
    torque = {"delay": reading.delay, "cutoff": reading.cutoff, "order": reading.order}
    lag = reading.actuator_lag
    recording = armimp.simulate(
        duration=30.0,
        seed=1,
        friction=0,
        resolution=1 if law == "tde" else 0,
        internal_model=law,
        imbic_controller={"target": {"lock_frequency": 50.0}, "law": {"gamma": 50.0}},
        arm_sim={
            "sensors": {"torque": torque},
            "actuators": {"bandwidth": 0.5 / np.pi / lag if lag else 0.0},
            "substeps": 20,
        },
    )
    return list(recording.trials)


LATE = {
    "a whole period": TorqueReading(delay=0.001),
    "part of a period": TorqueReading(delay=0.0013),
    "filter": TorqueReading(cutoff=200.0),
    "filter of second order, late": TorqueReading(cutoff=200.0, order=2, delay=0.0007),
    "drives lag": TorqueReading(actuator_lag=0.001),
    "everything": TorqueReading(cutoff=300.0, delay=0.0007, actuator_lag=0.0003),
}
late = pytest.mark.parametrize("reading", LATE.values(), ids=LATE.keys())
latest = pytest.mark.parametrize(
    "reading",
    [
        pytest.param(one, id=name, marks=() if name == "everything" else pytest.mark.slow)
        for name, one in LATE.items()
    ],
)


def told(records: Sequence[TrialRecord], reading: TorqueReading) -> list[TrialRecord]:
    """The records with what is known of their torque readings."""
    return [replace(record, reading=reading) for record in records]


def fitted(records: Sequence[TrialRecord]) -> MBKFit:
    return fit_mbk(LpmFull().estimate([TrialData.of(record) for record in records]))


def images(reading: TorqueReading, power: int) -> ComplexArray:
    """What sampling folds back, as the sum over the images of the spectrum, symmetric about 0."""
    m = np.concatenate([np.arange(-100_000, 0), np.arange(1, 100_001)])[:, None]
    omega = 2.0 * np.pi * (F + m * RATE)
    response = reading.response(omega / (2.0 * np.pi)) / (1.0 + 1j * omega * reading.actuator_lag)
    return np.asarray(-np.sum(response / (1j * omega) ** power, axis=0) * RATE**power)


@late
def test_what_sampling_folds_back_is_the_sum_over_the_images(reading: TorqueReading) -> None:
    # Where a jump falls on a reading, the sum takes half of it; the rig reads just before it.
    on_the_jump = 0.5 if reading == LATE["a whole period"] else 0.0
    edge, bend = reading.folded(F, RATE)
    at_tick = on_the_jump * np.exp(-2j * np.pi * F / RATE)
    np.testing.assert_allclose(edge, images(reading, 1) + at_tick, atol=1e-5)
    np.testing.assert_allclose(bend, images(reading, 2), atol=1e-6)


@pytest.mark.parametrize("order", [1, 3])
def test_drives_may_lag_by_the_time_constant_of_the_filter(order: int) -> None:
    reading = TorqueReading(cutoff=200.0, order=order, actuator_lag=0.5 / np.pi / 200.0)
    for power, found in enumerate(reading.folded(F, RATE), 1):
        np.testing.assert_allclose(found, images(reading, power), atol=1e-4)


@latest
def test_jumps_are_found_behind_delay_and_filter(reading: TorqueReading) -> None:
    jump = known(update_jump(told(rig_records(reading), reading)))
    np.testing.assert_allclose(jump.torque, TRANSMISSION, atol=0.03 * np.max(TRANSMISSION))


@latest
def test_known_delay_and_filter_leave_no_error_and_unknown_ones_do(reading: TorqueReading) -> None:
    records = rig_records(reading)
    worst = worst_errors(fitted(told(records, reading)).mbk, ARM)
    assert worst["M"] < 0.002
    assert worst["B"] < 0.005
    assert worst["K"] < 0.002
    # Undeclared, it is found as a common delay or is in the standard errors.
    assert off(fitted(records)).max() < 3.5


def test_spectra_are_corrected_for_delay_and_filter_and_coherences_stay() -> None:
    reading = TorqueReading(delay=0.003, cutoff=50.0)
    prompt = rig_records()[0]
    f = np.fft.rfftfreq(prompt.samples, 1.0 / RATE)
    late = np.exp(-2j * np.pi * f * reading.delay) / (1.0 + 1j * f / reading.cutoff)
    torque = np.fft.irfft(late * np.fft.rfft(prompt.torque, axis=1), prompt.samples, axis=1)
    slow = replace(prompt, torque=torque)
    plain = TrialData.of(prompt).spectra.matrix
    raw = TrialData.of(slow).spectra.matrix
    corrected = TrialData.of(replace(slow, reading=reading)).spectra.matrix

    np.testing.assert_allclose(corrected[0, 3:], plain[0, 3:], rtol=0.03)
    assert np.max(np.abs(raw[0, 3:] / plain[0, 3:] - 1.0)) > 0.3
    # In the order of scipy: G_xy = E[conj(X) Y].
    np.testing.assert_allclose(corrected, np.conj(np.swapaxes(corrected, 0, 1)), rtol=1e-12)
    np.testing.assert_array_equal(corrected[:3, :3], raw[:3, :3])

    def coherence(matrix: ComplexArray) -> FloatArray:
        power = np.abs(matrix[0, 3]) ** 2
        return np.asarray(power / (matrix[0, 0].real * matrix[3, 3].real))

    np.testing.assert_allclose(coherence(corrected), coherence(raw), rtol=1e-10)


# --- Skew of torques that are read just before the command is updated: what it is, and its cure


def viscosity(records: list[TrialRecord]) -> FloatArray:
    """Fitted viscosity relative to the true one."""
    return fitted(records).mbk.B / ARM.B


@pytest.mark.parametrize("law", ["tde", "observer"])
def test_chatter_of_the_command_or_else_the_motion_tells_how_far_torques_jump(law: str) -> None:
    found = known(update_jump(rig_records(law=law)))
    np.testing.assert_allclose(found.torque, TRANSMISSION, atol=0.01 * np.max(TRANSMISSION))


def test_commands_that_noise_of_the_angles_swamps_tell_no_jump() -> None:
    random = np.random.default_rng(4)
    noisy = [
        replace(one, position=one.position + 2e-4 * random.standard_normal(one.position.shape))
        for one in rig_records(law="observer")
    ]
    assert update_jump(noisy) is None


@pytest.mark.parametrize("law", ["tde", pytest.param("observer", marks=pytest.mark.slow)])
def test_viscosity_is_right_with_commands_and_nearly_so_without(law: str) -> None:
    records = rig_records(law=law)
    before = TorqueReading(timing=TorqueTiming.BEFORE_UPDATE)
    np.testing.assert_allclose(viscosity(told(records, before)), 1.0, atol=0.005)
    without = [replace(record, command=None) for record in records]
    np.testing.assert_allclose(viscosity(without), 1.0, atol=0.025)
    # Where the records refute what is declared, it is not believed.
    simultaneous = TorqueReading(timing=TorqueTiming.SIMULTANEOUS)
    np.testing.assert_allclose(viscosity(told(without, simultaneous)), 1.0, atol=0.025)


FOREIGN: dict[str, Callable[[FloatArray], FloatArray]] = {
    "noise": lambda command: np.random.default_rng(1).standard_normal(command.shape),
    "of the next sample": lambda command: np.roll(command, -1, axis=1),
    "of the last sample": lambda command: np.roll(command, 1, axis=1),
    "of the other joint": lambda command: command[::-1],
}


@pytest.mark.parametrize("command_of", FOREIGN.values(), ids=FOREIGN)
def test_when_commands_do_not_drive_the_torques_expect_none(
    command_of: Callable[[FloatArray], FloatArray],
) -> None:
    foreign = [replace(one, command=command_of(np.array(one.command))) for one in rig_records()]
    assert update_jump(foreign) is None


def test_when_a_filter_took_the_jumps_off_angles_and_torques_alike_expect_none() -> None:
    low = partial(signal.sosfilt, signal.butter(2, 15.0, fs=RATE, output="sos"))
    filtered = [replace(r, position=low(r.position), torque=low(r.torque)) for r in rig_records()]
    assert update_jump(filtered) is None
