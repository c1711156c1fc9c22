"""Stiffness that depends on amplitude or changes over time, from what a linear arm leaves over.

With the fitted arm, ``e = τ_k - Σ_j Z_kj θ_j`` is what it doesn't explain of the torque of the
perturbed joint, in the band. If stiffness falls or grows with the angle, e follows ``θ³``; if a
spring of short range yields, ``θ̇³``, too; if stiffness changes over the trial, ``θ t``. The
regressors are taken without what is in proportion to the angle or its first three derivatives, so
that a linear arm gives zero on average, whatever the person does beside. What readings lack because
torques jump with commands is put right before: commands that overcome friction would make it look
like a bent spring. The trial is cut into parts, in each of which the coefficient is found anew: its
scatter is its error, with no assumption about the spectrum of e.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from armimp_estimation.hold_correction import HoldCorrection, command_steps
from armimp_estimation.mbk import MBK
from armimp_estimation.problems import Concern, Problem, ProblemCode, Severity
from armimp_estimation.record import TrialRecord
from armimp_estimation.torque_timing import TorqueReading

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

BAND = (0.3, 15.0)
"""Part of the spectrum that is looked at, Hz: below, a person's own torque is most of it."""
SIGNIFICANT = 4.5
LARGE = {"amplitude": 0.01, "speed": 0.01, "time": 0.05}
"""Shares of the stiffness beyond which M, B and K are those of this amplitude, or time, alone."""
_PARTS = 20
_NEGLIGIBLE = 0.003
_LEAST = 10.0


def unexplained_torque(
    record: TrialRecord,
    arm: MBK,
    jump: HoldCorrection | None = None,
    reading: TorqueReading | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Motion of the perturbed joint and what the arm leaves of its torque, both within the band.

    Parameters
    ----------
    record : TrialRecord
        One trial.
    arm : MBK
        What was fitted.
    jump : HoldCorrection, optional
        How torques jump with the commands, if that is known.
    reading : TorqueReading, optional
        How torques were read.

    Returns
    -------
    motion : ndarray, shape (4, N)
        Angle, rad, and its first three derivatives.
    torque : ndarray, shape (N,)
        N·m.
    """
    k, samples = record.perturbed_joint, record.samples
    whole = np.asarray(np.fft.rfftfreq(samples, 1.0 / record.rate), dtype=np.float64)
    inside = (whole >= BAND[0]) & (whole <= BAND[1])
    f = whole[inside]

    def within(signal: FloatArray) -> ComplexArray:
        spectrum: ComplexArray = np.fft.rfft(signal - signal.mean(axis=-1, keepdims=True))
        return spectrum[..., inside]

    def signal_of(values: ComplexArray) -> FloatArray:
        spectrum = np.zeros((*values.shape[:-1], whole.size), dtype=np.complex128)
        spectrum[..., inside] = values
        signal: FloatArray = np.fft.irfft(spectrum, samples)
        return signal

    angle, torque = within(record.position), within(record.torque[k])
    if jump is not None:
        lacking = jump.missing(f, record.rate, reading)[k]
        torque = torque + np.sum(lacking * within(command_steps(record, samples)), axis=0)
        torque = torque / (reading or TorqueReading()).response(f)
    motion = angle[k] * (2j * np.pi * f) ** np.arange(4)[:, None]
    return signal_of(motion), signal_of(torque - np.sum(arm.impedance(f)[k] * angle, axis=0))


def change_of_stiffness(
    record: TrialRecord,
    arm: MBK,
    jump: HoldCorrection | None = None,
    reading: TorqueReading | None = None,
) -> dict[str, tuple[float, float]]:
    """Change of the stiffness of the perturbed joint, and its standard error.

    Parameters are those of :func:`unexplained_torque`.

    Returns
    -------
    dict of str to (float, float)
        ``"amplitude"``: from rest to the rms angle; ``"speed"``: of the torque, from rest to the
        rms velocity; ``"time"``: from begin to end; as shares of the stiffness. Empty for trials of
        less than 10 s.
    """
    if record.duration < _LEAST:
        return {}
    motion, rest = unexplained_torque(record, arm, jump, reading)
    size = float(np.std(motion[0]))
    stiffness = float(arm.K[record.perturbed_joint][record.perturbed_joint])
    if not (size > 0.0 and stiffness > 0.0):
        return {}
    linear = motion / np.std(motion, axis=1, keepdims=True)
    x, v = linear[:2]
    t = np.linspace(-0.5, 0.5, x.size)
    found = {}
    for name, bent in (("amplitude", x**3), ("speed", v**3), ("time", x * t)):
        regressor = bent - np.linalg.lstsq(linear.T, bent, rcond=None)[0] @ linear
        products = np.array([np.sum(p * q) for p, q in _pairs(regressor, rest)])
        squares = np.array([np.sum(p * p) for p, _ in _pairs(regressor, rest)])
        slope = float(np.sum(products) / np.sum(squares))
        scatter = products - slope * squares
        error = float(np.sqrt(np.sum(scatter**2)) / np.sum(squares))
        # The slope of the torque over the angle: 3 x² of a cube, which is 3 at one rms.
        factor = 1.0 if name == "time" else 3.0
        relative = factor / (stiffness * size)
        found[name] = (relative * slope, relative * error)
    return found


def judge_stiffness(
    record: TrialRecord,
    arm: MBK,
    jump: HoldCorrection | None = None,
    reading: TorqueReading | None = None,
    *,
    resolved: bool = True,
) -> list[Problem]:
    """Find stiffness that isn't constant; parameters are those of :func:`unexplained_torque`.

    Where the motion of locked joints isn't `resolved`, its torque may look like that.
    """
    problems = []
    codes = {
        "amplitude": ProblemCode.DEPENDS_ON_AMPLITUDE,
        "speed": ProblemCode.DEPENDS_ON_SPEED,
        "time": ProblemCode.CHANGES_OVER_TIME,
    }
    for name, (share, error) in change_of_stiffness(record, arm, jump, reading).items():
        if not abs(share) > SIGNIFICANT * error or abs(share) < _NEGLIGIBLE:
            continue
        severity = Severity.ERROR if resolved and abs(share) > LARGE[name] else Severity.NOTE
        problems.append(
            Problem(
                code=codes[name],
                concern=Concern.PARAMETERS,
                severity=severity,
                trial=record.trial,
                values={
                    "name": record.joint_names[record.perturbed_joint],
                    "percent": 100.0 * share,
                    "error": 100.0 * error,
                },
            )
        )
    return problems


def _pairs(left: FloatArray, right: FloatArray) -> list[tuple[FloatArray, FloatArray]]:
    return list(zip(np.array_split(left, _PARTS), np.array_split(right, _PARTS), strict=True))
