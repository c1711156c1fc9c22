"""How far the torques on the arm jump when the command is updated, from the records themselves.

Between two updates the joints accelerate with ``θ̈ = (M_r + M_h)⁻¹ (u - ...)``, where the command u
is held and all the rest, friction included, changes steadily. So with each update the torque on
the arm jumps by ``D Δu`` with ``D = M_h (M_r + M_h)⁻¹``, and a reading just before the update is
late by just that. The steady course of the torque passes midway between before and after:

    τ_mid = τ_before + ½ D (u_k - u_{k-1})

is free of skew up to second order in ωL. A delay of half a sample, ``T exp(jωL/2)``, puts the
inertial torque right as well, but overcorrects what does not jump: it adds ``K L/2`` to B and
``B L/2`` to M, and does not know of the part of u that overcomes friction. D need not be precise:
an error of 10 % leaves 10 % of the skew.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from armimp_estimation.record import TrialRecord

FloatArray = NDArray[np.float64]

_DIFFERENCES = 4
_CHATTER_EXPLAINS = 0.9
_MOTION_EXPLAINS = 0.99


def command_steps(record: TrialRecord, samples: int) -> FloatArray:
    """Difference of each command from the one before, ``u_k - u_{k-1}``, shape (n, samples), N·m.

    The first is 0, as the command before it is not known. A difference that is wrong at one sample
    has a flat spectrum, which looks like leakage.
    """
    if record.command is None:
        raise ValueError(f"trial {record.trial} has no commands")
    command = record.command[:, :samples]
    steps: FloatArray = np.diff(command, axis=1, prepend=command[:, :1])
    return steps


def jump_transmission(records: Sequence[TrialRecord]) -> FloatArray | None:
    """Matrix D of the jumps ``D Δu`` of the torques with steps Δu of the commands.

    On a rig with encoders of finite resolution the command chatters, and fourth differences of the
    torque consist of little but the jumps that this causes: D is their regression on fourth
    differences of the steps. Without chatter, angles are so fine that the motion itself tells:

        τ_before = -½ D Δu + M (θ_{k+1} - 2θ_k + θ_{k-1})/L² + B (θ_{k+1} - θ_{k-1})/2L + K θ

    is fitted by least squares. Errors of the angles would bias that; so would a voluntary torque,
    and whichever way is taken has to explain nearly all of what it is fitted to.

    Parameters
    ----------
    records : sequence of TrialRecord
        Trials of one arm, with commands.

    Returns
    -------
    ndarray, shape (n, n), or None
        None if neither way explains the torques, or if the eigenvalues of D do not lie between 0
        and 1, as they do for any two inertias: torques then do not follow the commands like that.
    """
    for fit, enough in ((_from_chatter, _CHATTER_EXPLAINS), (_from_motion, _MOTION_EXPLAINS)):
        transmission, explained = fit(records)
        if (explained > enough).all() and _is_share_of_inertia(transmission):
            return transmission
    return None


def _is_share_of_inertia(transmission: FloatArray) -> bool:
    eigenvalues = np.linalg.eigvals(transmission)
    return bool((eigenvalues.real > 0.0).all() and (np.abs(eigenvalues) < 1.0).all())


def _from_chatter(records: Sequence[TrialRecord]) -> tuple[FloatArray, FloatArray]:
    inputs, outputs = [], []
    for record in records:
        # A jump after reading k is seen for the first time in reading k + 1.
        steps = command_steps(record, record.samples)[:, 1:-1]
        changes = np.diff(record.torque[:, 1:], axis=1)
        inputs.append(np.diff(steps, n=_DIFFERENCES, axis=1))
        outputs.append(np.diff(changes, n=_DIFFERENCES, axis=1))
    return _regress(inputs, outputs)


def _from_motion(records: Sequence[TrialRecord]) -> tuple[FloatArray, FloatArray]:
    inputs, outputs = [], []
    for record in records:
        angle = record.position - record.position.mean(axis=1, keepdims=True)
        torque = record.torque - record.torque.mean(axis=1, keepdims=True)
        before, now, after = angle[:, :-2], angle[:, 1:-1], angle[:, 2:]
        acceleration = (after - 2.0 * now + before) * record.rate**2
        velocity = 0.5 * (after - before) * record.rate
        steps = command_steps(record, record.samples)[:, 1:-1]
        inputs.append(np.concatenate((-0.5 * steps, acceleration, velocity, now)))
        outputs.append(torque[:, 1:-1])
    coefficients, explained = _regress(inputs, outputs)
    return coefficients[:, : records[0].joints], explained


def _regress(
    inputs: Sequence[FloatArray], outputs: Sequence[FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """Coefficients of outputs (m, N) on inputs (p, N), (m, p), and the shares explained, (m,)."""
    squares = sum(_products(x, x) for x in inputs)
    mixed = sum(_products(y, x) for x, y in zip(inputs, outputs, strict=True))
    total = sum(np.sum(y**2, axis=1) for y in outputs)
    scale = np.sqrt(np.diag(squares))
    scale[scale == 0.0] = 1.0
    solution = np.linalg.lstsq(squares / np.outer(scale, scale), (mixed / scale).T, rcond=None)[0]
    coefficients = solution.T / scale
    residual = total - np.sum(coefficients * (2.0 * mixed - coefficients @ squares), axis=1)
    explained = 1.0 - np.divide(residual, total, out=np.ones_like(total), where=total > 0.0)
    return coefficients, explained


def _products(left: FloatArray, right: FloatArray) -> FloatArray:
    """Scalar products of all rows; summed by numpy alone, so that every machine gets the same."""
    return np.array([[np.sum(x * y) for y in right] for x in left])
