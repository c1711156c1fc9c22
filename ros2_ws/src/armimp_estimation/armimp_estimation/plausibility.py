"""Checks whether matrices and angles can be those of a human arm.

A passive arm has a kinetic energy ``½ q̇ᵀ M q̇ > 0`` for any motion, so the symmetric part of M has
positive eigenvalues. Torques or angles in the wrong order make the elements off the diagonal
larger than those on it, and a wrong sign makes one on it negative; the eigenvalues show both. And
``M = Mᵀ``, unless torques and angles belong to different coordinates, as where one of two angles is
absolute or contains a share of the other, or one of two gains is wrong. Errors that all joints
have in common, such as a wrong unit, show only in the size of the values.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np

from armimp_common.arrays import TINY, BoolArray, FloatArray
from armimp_estimation.estimators.estimate import ImpedanceEstimate
from armimp_estimation.fit import Calibration, MBKFit
from armimp_estimation.mbk import UNITS
from armimp_estimation.problems import Problem, ProblemCode, Severity, problem
from armimp_estimation.record import APART, TrialRecord

RANGES: Final = {"M": (1e-4, 10.0), "B": (0.0, 150.0), "K": (0.0, 1500.0)}
"""Possible values of a joint, from a wrist to a stiff ankle and ten times beyond; SI units."""
LARGEST_POSTURE = 2.0 * np.pi
"""Angle beyond which a posture isn't in radians, rad."""
TURN = 0.9 * 2.0 * np.pi
"""Step between two samples that no joint makes, but an encoder that begins another turn, rad."""
LARGEST_MOTION = 1.5
"""Peak to peak motion beyond which angles aren't in radians, rad: linear models end far below."""
ASYMMETRY = 0.07
"""Share of ``√(M_ii M_jj)`` by which M_ij and M_ji may differ, beside chance. For the arm of the
paper it is 0.05."""
_TOP = 0.8  # share of the highest frequency at which the upper end of the band begins
_ERRORS = 5.0  # standard errors by which a value must be outside a range to be refused
_UNEVEN = 3.0  # standard errors beyond which an asymmetry is refused
_NOTICED = 2.0  # standard errors beyond which an asymmetry adds to the standard errors


def judge_matrices(
    names: Sequence[str], estimate: ImpedanceEstimate, fit: MBKFit, apart: float
) -> Iterator[Problem]:
    """Find matrices that no arm has.

    Trials have postures that are `apart`, rad: between them M_ij changes by at most this share of
    ``√(M_ii M_jj)``.
    """
    impossible = False
    pairs = zip(fit.values, fit.errors, strict=True)
    matrices = dict(zip(RANGES, pairs, strict=True))
    own = [(letter, np.diag(one), np.diag(se)) for letter, (one, se) in matrices.items()]
    for letter, values, errors in [("M", *_quick_inertia(estimate)), *own]:
        low, high = RANGES[letter]
        for name, value, error in zip(names, values, errors, strict=True):
            margin = _ERRORS * error
            # Written so that NaN is a problem, too.
            if not (value + margin >= low and value - margin <= high):
                impossible = True
                yield problem(
                    ProblemCode.IMPLAUSIBLE_VALUE,
                    estimator=estimate.name,
                    matrix=letter,
                    name=name,
                    value=float(value),
                    unit=UNITS[letter],
                    low=low,
                    high=high,
                )
    if impossible:
        return
    least = {letter: least_eigenvalue(*pair) for letter, pair in matrices.items()}
    negative = {letter for letter, (value, error) in least.items() if value < -_ERRORS * error}
    # Muscles may drive a motion (B < 0) or let the arm fall (K < 0), but not both.
    letter = "M" if "M" in negative else "K"
    if "M" in negative or {"B", "K"} <= negative:
        value, error = least[letter]
        yield problem(
            ProblemCode.IMPLAUSIBLE_INERTIA,
            estimator=estimate.name,
            matrix=letter,
            value=value,
            error=error,
            unit=UNITS[letter],
        )
    M, M_se = matrices["M"]
    for i, j in np.argwhere(np.triu(uneven(M, M_se, ASYMMETRY + apart, _UNEVEN))):
        yield problem(
            ProblemCode.UNEVEN_INERTIA,
            estimator=estimate.name,
            name=f"{names[i]} and {names[j]}",
            value=float(M[i, j]),
            other=float(M[j, i]),
        )


def _quick_inertia(estimate: ImpedanceEstimate) -> tuple[FloatArray, FloatArray]:
    """Apparent inertia of each joint at the upper end of the band, and its standard error, (n,).

    It is ``|Z|/ω²``, or the upper limit of `RANGES` if stiffness makes that larger. A torque behind
    a low-pass shows no inertia there, whatever else may be wrong with it.
    """
    top = estimate.f >= _TOP * estimate.f[-1]
    square = (2.0 * np.pi * estimate.f[top]) ** 2
    Z = np.einsum("iif->if", estimate.Z)[:, top] / square
    variance = np.einsum("iif->if", estimate.noise)[:, top] / square**2
    error = np.sqrt(np.mean(variance, axis=1) / square.size)
    return np.minimum(np.median(np.abs(Z), axis=1), RANGES["M"][1]), error


def uneven(M: FloatArray, errors: FloatArray, share: float, chance: float = _ERRORS) -> BoolArray:
    """Whether M_ij and M_ji of an inertia differ by more than a share of √(M_ii M_jj), (n, n).

    The number `chance` of standard errors of the difference is added to what is allowed.
    """
    size = np.sqrt(np.abs(np.outer(np.diag(M), np.diag(M))))
    return np.asarray(np.abs(M - M.T) > share * size + chance * np.hypot(errors, errors.T))


def mixed_channels(fit: MBKFit, calibration: Calibration) -> list[FloatArray]:
    """Changes of M, B and K by cross-talk of angles or torques that would explain an asymmetric M.

    An encoder i that also shows c times the angle of joint j takes ``c Z_li`` off each ``Z_lj``,
    and so ``c M_ii`` off M_ij, but nothing off M_ji. A transducer i that also shows c times the
    torque of joint j adds ``c Z_jl`` to each ``Z_il``. Standard errors that the calibration adds
    don't count as chance here, since they explain cross-talk of torques, but not of angles.

    Returns
    -------
    list of ndarray, shape (3, n, n)
        Changes for each pair of joints, as far as the asymmetry is beyond chance.
    """
    matrices = fit.values
    M = matrices[0]
    own = np.maximum(np.abs(np.diag(M)), TINY)
    of_torques = sum(np.abs(one[:, :, 0]) ** 2 for one in calibration.effects(M[:, :, None] + 0j))
    error = np.sqrt(np.maximum(fit.errors[0] ** 2 - of_torques, 0.0))
    error = np.hypot(error, error.T)
    beyond = np.sqrt(np.maximum((M - M.T) ** 2 - (_NOTICED * error) ** 2, 0.0))
    changes = []
    for i, j in np.argwhere(beyond > 0.0):
        angle, torque = np.zeros((2, *matrices.shape))
        angle[:, :, j] = beyond[i, j] / own[i] * matrices[:, :, i]
        torque[:, i] = beyond[i, j] / own[j] * matrices[:, j]
        changes += [angle, torque]
    return changes


def other_postures(
    records: Sequence[TrialRecord], fit: MBKFit, apart: float
) -> tuple[list[Problem], list[FloatArray]]:
    """Report postures that are `apart`, rad, with the change of M, B and K that this may cause.

    Each column of M is the inertia at the posture of its trial, which differs from that at another
    one by up to that distance times ``√(M_ii M_jj)``. Only more than twice the distance between the
    halves of any trial counts, as slow motion about one posture makes less.
    """
    halves = [np.array_split(record.position, 2, axis=1) for record in records]
    within = max(np.max(np.abs(a.mean(axis=1) - b.mean(axis=1))) for a, b in halves)
    if not apart > max(APART, 2.0 * float(within)):
        return [], []
    change = np.zeros_like(fit.values)
    own = np.sqrt(np.abs(np.diag(fit.mbk.M)))
    change[0] = apart / np.sqrt(3.0) * np.outer(own, own)
    return [problem(ProblemCode.POSTURES_DIFFER, severity=Severity.NOTE, apart=apart)], [change]


def least_eigenvalue(matrix: FloatArray, errors: FloatArray) -> tuple[float, float]:
    """Least eigenvalue of the symmetric part of a matrix A, and its standard error.

    With the unit eigenvector v it is ``vᵀ A v``; the error follows from those of the elements.
    """
    values, vectors = np.linalg.eigh(0.5 * (matrix + matrix.T))
    v = vectors[:, 0]
    square = float(np.sum((np.outer(v, v) * errors) ** 2))
    return float(values[0]), float(np.sqrt(square))


def judge_angles(record: TrialRecord) -> Iterator[Problem]:
    """Find angles of a trial that aren't in radians, jump to another turn, or never change."""
    for name, angle in zip(record.joint_names, record.position, strict=True):
        posture, motion = float(np.abs(np.median(angle))), float(np.ptp(angle))
        step = float(np.max(np.abs(np.diff(angle)), initial=0.0))
        for code, value, limit in (
            (ProblemCode.ANGLE_JUMPS, step, TURN),
            (ProblemCode.ANGLE_TOO_LARGE, posture, LARGEST_POSTURE),
            (ProblemCode.MOTION_TOO_LARGE, motion, LARGEST_MOTION),
        ):
            if value > limit:
                yield problem(code, trial=record.trial, name=name, value=value)
                break
        if not motion and name != record.joint_names[record.perturbed_joint]:
            code = ProblemCode.ANGLE_CONSTANT
            yield problem(code, severity=Severity.NOTE, trial=record.trial, name=name)
