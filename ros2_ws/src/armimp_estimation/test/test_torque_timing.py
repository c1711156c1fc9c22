"""Torques that are read late, filtered or before the update: what that does, and its cure."""

from __future__ import annotations

import functools
import json
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
from numpy.typing import NDArray
from scipy import signal

from armimp_estimation.estimators.lpm import LpmConfig, LpmFull
from armimp_estimation.fit import fit_mbk
from armimp_estimation.hold_correction import update_jump
from armimp_estimation.metadata import Metadata
from armimp_estimation.parameters import EstimatorParameters, TorqueParameters
from armimp_estimation.record import TrialRecord
from armimp_estimation.torque_timing import TorqueReading, TorqueTiming
from armimp_estimation.trial import TrialData
from support.synthetic_trials import TWO_JOINT_ARM as ARM
from support.synthetic_trials import made_record, off, worst_errors

FloatArray = NDArray[np.float64]

SAMPLES, PERIOD, RATE = 30_000, 1e-3, 1e3
F = np.array([0.122, 1.0, 5.0, 15.0])
ROBOT = np.array([[0.354, 0.191], [0.191, 0.180]])
FRICTION = np.diag([3.0, 1.5])  # N·m·s/rad: only the robot has it
TRANSMISSION = ARM.M @ np.linalg.inv(ARM.M + ROBOT)
"""Share of a command that is torque on the arm at once."""
PROMPT = TorqueReading()


@functools.cache
def rig_record(
    joint: int,
    reading: TorqueReading = PROMPT,
    *,
    chatter: float = 1.0,
    count: float = 0.0,
) -> TrialRecord:
    """Simulate an arm, a robot, drives and transducers under commands that are held and chatter.

    The exact solution of the trial of a joint (0-based), without control.
    """
    rng = np.random.default_rng((1, joint))
    sos = signal.butter(8, 15.0, fs=RATE, output="sos")
    perturbation = np.zeros((2, SAMPLES))
    perturbation[joint] = 10.0 * signal.sosfilt(sos, rng.uniform(-1.0, 1.0, SAMPLES))
    command = perturbation + chatter * rng.standard_normal((2, SAMPLES))

    inverse = np.linalg.inv(ARM.M + ROBOT)
    eye, zero = np.eye(2), np.zeros((2, 2))
    lag = reading.actuator_lag
    # θ, v, torque of the drives; then the filter. Inputs: commands.
    fall = -eye / lag if lag else zero
    damping = ARM.B + FRICTION
    a = np.block(
        [
            [zero, eye, zero],
            [-inverse @ ARM.K, -inverse @ damping, inverse if lag else zero],
            [zero, zero, fall],
        ]
    )
    b = np.concatenate([zero, zero if lag else inverse, eye / lag if lag else zero])
    # Torque on the arm from these.
    load = np.concatenate(
        [
            ARM.K - ARM.M @ inverse @ ARM.K,
            ARM.B - ARM.M @ inverse @ damping,
            ARM.M @ inverse if lag else zero,
        ],
        axis=1,
    )
    direct = zero if lag else ARM.M @ inverse
    out, out_direct = load, direct
    if reading.cutoff:
        zpk = signal.butter(reading.order, 2.0 * np.pi * reading.cutoff, analog=True, output="zpk")
        fa, fb, fc, _ = signal.zpk2ss(*zpk)
        fa, fb, fc = (np.kron(m, eye) for m in (fa, fb, fc))
        a = np.block([[a, np.zeros((6, len(fa)))], [fb @ load, fa]])
        b = np.concatenate([b, fb @ direct])
        out, out_direct = np.concatenate([np.zeros((2, 6)), fc], axis=1), zero
    states = len(a)
    whole = int(np.floor(reading.delay / PERIOD + 1e-9))
    phase = PERIOD * (1.0 - (reading.delay / PERIOD - whole))

    def over(time: float) -> tuple[FloatArray, FloatArray]:
        system = np.block([[a, b], [np.zeros((2, states + 2))]])
        found = scipy.linalg.expm(time * system)
        return found[:states, :states], found[:states, states:]

    transition, driven = over(PERIOD)
    part, part_driven = over(phase)
    values, vectors = np.linalg.eig(transition)
    modal = np.linalg.solve(vectors, driven) @ command
    modes = [signal.lfilter([0.0, 1.0], [1.0, -v], x) for v, x in zip(values, modal, strict=True)]
    state = (vectors @ np.stack(modes)).real
    # Read within the period that a command begins, and known at its end or later.
    read = out @ (part @ state + part_driven @ command) + out_direct @ command
    torque = np.zeros((2, SAMPLES))
    torque[:, whole + 1 :] = read[:, : SAMPLES - whole - 1]
    position = np.round(state[:2] / count) * count if count else state[:2]
    told = {"trial": joint + 1, "perturbed_joint": joint, "command": command}
    return made_record(position, torque, perturbation, **told)


LATE = {
    "whole periods": TorqueReading(delay=0.002),
    "part of a period": TorqueReading(delay=0.0013),
    "filter": TorqueReading(cutoff=200.0),
    "filter of second order, late": TorqueReading(cutoff=200.0, order=2, delay=0.0007),
    "drives lag": TorqueReading(actuator_lag=0.001),
    "everything": TorqueReading(cutoff=250.0, delay=0.0016, actuator_lag=0.0007),
}
late = pytest.mark.parametrize("reading", LATE.values(), ids=LATE.keys())
latest = pytest.mark.parametrize(
    "reading",
    [
        pytest.param(one, id=name, marks=() if name == "everything" else pytest.mark.slow)
        for name, one in LATE.items()
    ],
)


def images(reading: TorqueReading, power: int) -> NDArray[np.complex128]:
    """What sampling folds back, as the sum over the images of the spectrum, symmetric about 0."""
    m = np.concatenate([np.arange(-100_000, 0), np.arange(1, 100_001)])[:, None]
    omega = 2.0 * np.pi * (F + m * RATE)
    response = reading.response(omega / (2.0 * np.pi)) / (1.0 + 1j * omega * reading.actuator_lag)
    return np.asarray(-np.sum(response / (1j * omega) ** power, axis=0) * RATE**power)


@late
def test_what_sampling_folds_back_is_the_sum_over_the_images(reading: TorqueReading) -> None:
    # Where a jump falls on a reading, this sum takes it as half there; it is read just before.
    on_the_jump = 0.5 if reading == LATE["whole periods"] else 0.0
    edge, bend = reading.folded(F, RATE)
    at_tick = on_the_jump * np.exp(-2j * np.pi * F / RATE * 2)
    np.testing.assert_allclose(edge, images(reading, 1) + at_tick, atol=1e-5)
    np.testing.assert_allclose(bend, images(reading, 2), atol=1e-6)


@latest
def test_jumps_are_found_behind_delay_and_filter(reading: TorqueReading) -> None:
    jump = update_jump([rig_record(joint, reading) for joint in range(2)], reading)
    assert jump is not None
    np.testing.assert_allclose(jump.torque, TRANSMISSION, atol=0.03 * np.max(TRANSMISSION))


@latest
def test_known_delay_and_filter_leave_no_error_and_unknown_ones_do(reading: TorqueReading) -> None:
    records = [rig_record(joint, reading) for joint in range(2)]
    known = [TrialData.of(record, reading=reading) for record in records]
    estimate = LpmFull(config=LpmConfig(reading=reading)).estimate(known)
    told = worst_errors(fit_mbk(estimate).mbk, ARM)
    assert told["M"] < 0.002
    assert told["B"] < 0.005
    assert told["K"] < 0.015
    # What nobody told is found as a common delay, or in the standard errors.
    data = [TrialData.of(record) for record in records]
    fit = fit_mbk(LpmFull().estimate(data))
    assert off(fit).max() < 3.5 or (fit.lack > 2.0).any()


def test_spectra_are_corrected_for_delay_and_filter_and_coherences_stay() -> None:
    reading = TorqueReading(delay=0.003, cutoff=50.0)
    prompt, slow = (rig_record(0, one) for one in (TorqueReading(), reading))
    plain = TrialData.of(prompt).spectra.matrix
    raw = TrialData.of(slow).spectra.matrix
    corrected = TrialData.of(slow, reading=reading).spectra.matrix

    # But for the skew of half a sample, which is not corrected here.
    np.testing.assert_allclose(np.abs(corrected[0, 3:]), np.abs(plain[0, 3:]), rtol=0.03)
    np.testing.assert_allclose(corrected[0, 3:], plain[0, 3:], rtol=0.06)
    assert np.max(np.abs(raw[0, 3:] / plain[0, 3:] - 1.0)) > 0.3
    # In the order of scipy: G_xy = E[conj(X) Y].
    np.testing.assert_allclose(corrected, np.conj(np.swapaxes(corrected, 0, 1)), rtol=1e-12)
    np.testing.assert_array_equal(corrected[:3, :3], raw[:3, :3])

    def coherence(matrix: NDArray[np.complex128]) -> FloatArray:
        power = np.abs(matrix[0, 3]) ** 2
        return np.asarray(power / (matrix[0, 0].real * matrix[3, 3].real))

    np.testing.assert_allclose(coherence(corrected), coherence(raw), rtol=1e-10)


def test_metadata_tell_all_of_it_and_parameters_prevail() -> None:
    metadata = {
        "torque_timing": '"interval_mean"',
        "torque_delay": "0.002",
        "torque_cutoff": "150",
        "torque_order": "2",
        "actuator_lag": "0.001",
    }
    expected = TorqueReading(
        timing=TorqueTiming.INTERVAL_MEAN, delay=0.002, cutoff=150, order=2, actuator_lag=0.001
    )
    assert Metadata.of(metadata).reading == expected
    given = EstimatorParameters(
        metadata=json.dumps(metadata), torque=TorqueParameters(delay=0.004)
    ).bag_metadata()
    assert Metadata.of(given).reading == expected.model_copy(update={"delay": 0.004})
    assert Metadata.of(EstimatorParameters().bag_metadata()).reading == TorqueReading()


# --- Skew of torques that are read just before the command is updated: what it is, and its cure


@pytest.fixture(scope="module")
def chattering() -> list[TrialRecord]:
    return [rig_record(joint, chatter=1.0, count=1e-5) for joint in range(2)]


@pytest.fixture(scope="module")
def smooth() -> list[TrialRecord]:
    return [rig_record(joint, chatter=0.0) for joint in range(2)]


def viscosity(records: list[TrialRecord], config: LpmConfig | None = None) -> FloatArray:
    """Fitted viscosity relative to the true one."""
    data = [TrialData.of(record) for record in records]
    estimator = LpmFull() if config is None else LpmFull(config=config)
    return fit_mbk(estimator.estimate(data)).mbk.B / ARM.B


def test_chatter_of_the_command_tells_how_far_torques_jump(chattering: list[TrialRecord]) -> None:
    found = update_jump(chattering)
    assert found is not None
    np.testing.assert_allclose(found.torque, TRANSMISSION, atol=0.02 * np.max(TRANSMISSION))


def test_without_chatter_the_motion_tells(smooth: list[TrialRecord]) -> None:
    found = update_jump(smooth)
    assert found is not None
    np.testing.assert_allclose(found.torque, TRANSMISSION, atol=0.08 * np.max(TRANSMISSION))


@pytest.mark.parametrize("rig", ["chattering", pytest.param("smooth", marks=pytest.mark.slow)])
def test_viscosity_is_right_with_commands_and_nearly_so_without(
    rig: str, request: pytest.FixtureRequest
) -> None:
    records: list[TrialRecord] = request.getfixturevalue(rig)
    before = LpmConfig(reading=TorqueReading(timing=TorqueTiming.BEFORE_UPDATE))
    np.testing.assert_allclose(viscosity(records, before), 1.0, atol=0.005)
    without = [replace(record, command=None) for record in records]
    np.testing.assert_allclose(viscosity(without), 1.0, atol=0.025)
    # Where the records refute what is declared, it is not believed.
    simultaneous = LpmConfig(reading=TorqueReading(timing=TorqueTiming.SIMULTANEOUS))
    np.testing.assert_allclose(viscosity(without, simultaneous), 1.0, atol=0.025)


FOREIGN: dict[str, Callable[[FloatArray], FloatArray]] = {
    "noise": lambda command: np.random.default_rng(1).standard_normal(command.shape),
    "of the next sample": lambda command: np.roll(command, -1, axis=1),
    "of the last sample": lambda command: np.roll(command, 1, axis=1),
    "of the other joint": lambda command: command[::-1],
}


@pytest.mark.parametrize("command_of", FOREIGN.values(), ids=FOREIGN)
def test_when_commands_do_not_drive_the_torques_expect_none(
    chattering: list[TrialRecord], command_of: Callable[[FloatArray], FloatArray]
) -> None:
    foreign = [replace(one, command=command_of(np.array(one.command))) for one in chattering]
    assert update_jump(foreign) is None


def test_when_a_filter_took_the_jumps_off_angles_and_torques_alike_expect_none(
    chattering: list[TrialRecord],
) -> None:
    low_pass = signal.butter(2, 15.0, fs=chattering[0].rate, output="sos")
    filtered = [
        replace(
            record,
            position=signal.sosfilt(low_pass, record.position),
            torque=signal.sosfilt(low_pass, record.torque),
        )
        for record in chattering
    ]
    assert update_jump(filtered) is None
