"""Records of a linear arm under closed-loop control with known truth, to check estimators with.

No physics engine: the loop is solved in the frequency domain over one period of a periodic
perturbation, so the only errors of an estimate are those of the estimator.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from armimp_common.arrays import ComplexArray, FloatArray
from armimp_estimation.estimators.estimate import ImpedanceEstimate, confidence_radius
from armimp_estimation.estimators.lpm import LpmFull
from armimp_estimation.fit import MBKFit
from armimp_estimation.mbk import MBK
from armimp_estimation.record import TrialRecord
from armimp_estimation.torque_timing import TorqueReading, TorqueTiming
from armimp_estimation.trial import TrialData
from armimp_sim.presets import human_arm

_STUDY = human_arm(2)
SIMULTANEOUS = TorqueReading(timing=TorqueTiming.SIMULTANEOUS)
TWO_JOINT_ARM = MBK(M=_STUDY.M, B=_STUDY.B, K=_STUDY.K)
"""Arm of Table I of Kang & Zhang."""


@dataclass(frozen=True, kw_only=True)
class SyntheticConfig:
    """Controlled arm and disturbances of a synthetic trial; SI units."""

    rate: float = 1000.0
    samples: int = 50_000
    """Of the record, which is one period."""
    perturbation: float = 3.0
    """Rms, with power from the lowest frequency to the bandwidth."""
    lowest: float = 0.0
    bandwidth: float = 15.0
    inertia: float = 0.2
    viscosity: float = 2.0
    stiffness: float = 10.0
    """Inertia, viscosity and stiffness are what the controller gives to the perturbed joint."""
    lock_stiffness: float = 1e9
    """Of the locked joints, which give way to the torque of the arm."""
    voluntary: float = 0.0
    """Rms of each joint, below 2 Hz; it moves the arm through the loop."""
    torque_noise: float = 0.0
    """Of the sensors, white and outside the loop."""
    position_noise: float = 0.0


def synthetic_trial(arm: MBK, joint: int, config: SyntheticConfig, seed: int) -> TrialRecord:
    """Simulate the trial that perturbs one joint.

    The loop is ``(Y + Z) θ = x e_k - d``, where Y is the diagonal impedance that the controller
    gives to each joint, and the torque on the arm is ``τ = Z θ + d``.
    """
    n, samples = arm.joints, config.samples
    rng = np.random.default_rng((seed, joint))
    f: FloatArray = np.asarray(np.fft.rfftfreq(samples, 1.0 / config.rate), dtype=np.float64)
    s = 2j * np.pi * f
    impedance = np.moveaxis(arm.impedance(f), -1, 0)
    control = np.zeros(impedance.shape, dtype=np.complex128)
    for i in range(n):
        control[:, i, i] = config.lock_stiffness
    control[:, joint, joint] = config.inertia * s**2 + config.viscosity * s + config.stiffness

    force = np.zeros((n, f.size), dtype=np.complex128)
    shape = (f >= config.lowest) / np.sqrt(1.0 + (f / config.bandwidth) ** 16)
    force[joint] = _noise(rng, samples, shape, config.perturbation)
    shape = 1.0 / np.sqrt(1.0 + (f / 2.0) ** 2)
    voluntary = np.stack([_noise(rng, samples, shape, config.voluntary) for _ in range(n)])

    angles = np.linalg.solve(control + impedance, (force - voluntary).T[:, :, None])
    torques = (impedance @ angles)[:, :, 0].T + voluntary
    position = np.fft.irfft(angles[:, :, 0].T, samples, axis=1)
    torque = np.fft.irfft(torques, samples, axis=1)
    return made_record(
        position + config.position_noise * rng.standard_normal((n, samples)),
        torque + config.torque_noise * rng.standard_normal((n, samples)),
        np.fft.irfft(force, samples, axis=1),
        trial=joint + 1,
        perturbed_joint=joint,
        rate=config.rate,
        reading=SIMULTANEOUS,
    )


def made_record(
    position: FloatArray,
    torque: FloatArray | None = None,
    perturbation: FloatArray | None = None,
    /,
    **changes: Any,
) -> TrialRecord:
    """A trial that perturbs the first joint, with zeros for what is not given."""
    none = np.zeros(position.shape)
    values: dict[str, Any] = {
        "trial": 1,
        "perturbed_joint": 0,
        "rate": 1000.0,
        "joint_names": tuple(f"joint_{i + 1}" for i in range(len(position))),
        "perturbation": none if perturbation is None else perturbation,
        "position": position,
        "torque": none if torque is None else torque,
        "start_ns": 0,
    }
    return TrialRecord(**{**values, **changes})


def part_of(record: TrialRecord, start: int, stop: int) -> TrialRecord:
    """The samples `start` to `stop` of a trial, without its commands."""
    return replace(record.part(start, stop), command=None)


def made_estimate(f: FloatArray, Z: ComplexArray, **changes: Any) -> ImpedanceEstimate:
    """An estimate with errors of variance 1 that are independent over frequency."""
    values: dict[str, Any] = {
        "noise": np.ones(Z.shape),
        "bin_correlation": np.ones((1, f.size)),
        "averages": 11.0,
    }
    return ImpedanceEstimate(name="made", f=f, Z=Z, T=Z, R=Z, **{**values, **changes})


def _noise(rng: np.random.Generator, samples: int, shape: FloatArray, rms: float) -> ComplexArray:
    """Spectrum of a zero-mean uniform random signal, filtered by `shape`, of the given rms."""
    spectrum = np.fft.rfft(rng.uniform(-1.0, 1.0, samples)) * shape
    spectrum[0] = 0.0
    actual = float(np.std(np.fft.irfft(spectrum, samples)))
    return spectrum * (rms / actual)


# Like 50 s at 1 kHz in resolution, band and number of segments, with an eighth of the samples.
SEGMENT = 1024
LPM = LpmFull()
LOOP = SyntheticConfig(rate=125.0, samples=6144, viscosity=4.0, stiffness=30.0)
THREE_JOINT_ARM = MBK(
    M=np.array([[0.3, 0.1, 0.02], [0.09, 0.1, 0.015], [0.021, 0.014, 0.01]]),
    B=np.array([[0.9, 0.3, 0.05], [0.25, 0.5, 0.06], [0.04, 0.07, 0.1]]),
    K=np.array([[12.0, 4.0, 0.8], [3.0, 8.0, 1.1], [0.9, 0.7, 2.0]]),
)


def synthetic_trials(
    loop: SyntheticConfig = LOOP, seed: int = 1, arm: MBK = TWO_JOINT_ARM
) -> list[TrialData]:
    """Trials of all joints of an arm, with their spectra."""
    return [
        TrialData.of(synthetic_trial(arm, joint, loop, seed), segment=SEGMENT)
        for joint in range(arm.joints)
    ]


def relative_error(estimate: ImpedanceEstimate, arm: MBK) -> float:
    """Worst element of the rms error over frequency, relative to the rms of the element."""
    true = arm.impedance(estimate.f)
    error = np.sum(np.abs(estimate.Z - true) ** 2, axis=2) / np.sum(np.abs(true) ** 2, axis=2)
    return float(np.sqrt(np.max(error)))


def share_within(estimates: Sequence[ImpedanceEstimate], true: ComplexArray, level: float) -> float:
    """Share of values that are within their confidence circle about the truth, N·m/rad."""
    inside = [
        np.abs(one.Z - true) <= confidence_radius(one.variance, one.averages, level)
        for one in estimates
    ]
    return float(np.mean(inside))


def stacked(arm: MBK) -> FloatArray:
    """M, B and K of an arm, (3, n, n)."""
    return np.stack((arm.M, arm.B, arm.K))


def off(fit: MBKFit, arm: MBK = TWO_JOINT_ARM) -> FloatArray:
    """By how many of their standard errors M, B and K miss those of the arm, (3, n, n)."""
    return np.abs(stacked(fit.mbk) - stacked(arm)) / fit.errors


def with_readings(trial: TrialData, **arrays: Any) -> TrialData:
    """The trial with some readings replaced, and its spectra unchanged."""
    return replace(trial, record=replace(trial.record, **arrays))


def worst_errors(found: Any, true: Any) -> dict[str, float]:
    """Largest relative error of M, of B and of K."""
    pairs = {letter: (getattr(found, letter), getattr(true, letter)) for letter in "MBK"}
    return {name: float(np.max(np.abs(np.array(a) / b - 1.0))) for name, (a, b) in pairs.items()}
