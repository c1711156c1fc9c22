"""Trials of an arm, a robot, drives and transducers under commands that are held and chatter."""

import functools

import numpy as np
import scipy.linalg
from numpy.typing import NDArray
from scipy import signal

from armimp_estimation.record import TrialRecord
from armimp_estimation.torque_timing import TorqueReading
from support.synthetic_trials import TWO_JOINT_ARM as ARM
from support.synthetic_trials import made_record

FloatArray = NDArray[np.float64]

SAMPLES, PERIOD, RATE = 30_000, 1e-3, 1e3
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
    """Simulate the trial of a joint (0-based): the exact solution, without control."""
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
