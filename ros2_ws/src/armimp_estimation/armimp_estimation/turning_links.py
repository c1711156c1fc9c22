"""Torques of an inertia that changes with the angles, as that of links that turn.

The inertia ``M_ij + Σ_l G_ijl θ_l`` of any jointed arm causes Coriolis torques and the like. They
are even in the motion, so no part of M, B and K, but distort the lines of a multisine, and look
like a stiffness that depends on the direction where locked joints move.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import permutations

import numpy as np

from armimp_common.arrays import ComplexArray, FloatArray
from armimp_estimation.hold_correction import HoldCorrection
from armimp_estimation.mbk import MBK
from armimp_estimation.record import TrialRecord
from armimp_estimation.residual_torque import Residual, parts_of

_HIGHEST = 25.0
"""Frequency up to which motion counts with which the inertia changes, Hz."""
_BEYOND_CHANCE = 5.0
"""Standard errors from which on an inertia changes with the angles."""


def at_posture(
    records: Sequence[TrialRecord], arm: MBK, jump: HoldCorrection | None
) -> tuple[TrialRecord, ...]:
    """Return trials with the torques of an arm whose inertia stays that at the posture.

    For the arm and its jumps see :meth:`Residual.of`. None are returned if the inertia doesn't
    change beyond chance, for one joint, and for trials of less than 3 s.
    """
    turning = _turning_inertia(records, arm, jump) if records[0].joints > 1 else None
    if turning is None:
        return ()
    spectra = [turning @ np.moveaxis(_torques(one), 0, 1) for one in records]
    return tuple(
        replace(one, torque=one.torque - np.fft.irfft(spectrum, one.samples))
        for one, spectrum in zip(records, spectra, strict=True)
    )


def _turning_inertia(
    records: Sequence[TrialRecord], arm: MBK, jump: HoldCorrection | None
) -> FloatArray | None:
    """Estimate the 2 n (n - 1) elements of G, kg·m²/rad; None if it is not beyond chance.

    The torques that an arm leaves in all trials are regressed on those of each element. G_iii is 0:
    the own inertia of a joint doesn't depend on its angle.
    """
    parts = []
    for residual in [Residual.of(record, arm, jump) for record in records]:
        if residual is None:
            return None
        record, band = residual.record, residual.band
        terms = _torques(record)[..., band.bins] * band.passed / record.samples
        for rest, term in zip(residual.torques, np.moveaxis(terms, 1, 0), strict=True):
            weights = band.weights(band.inner(band.signal(rest)))
            parts += parts_of(band.signal(weights * np.vstack((term, rest)))[:, band.kept])
    inverse = np.linalg.pinv(sum(part[:-1] @ part[:-1].T for part in parts), hermitian=True)
    found: FloatArray = inverse @ sum(part[:-1] @ part[-1] for part in parts)
    scores = [part[:-1] @ (part[-1] - found @ part[:-1]) for part in parts]
    errors = np.linalg.norm(scores @ inverse, axis=0)
    return found if (np.abs(found) > _BEYOND_CHANCE * errors).any() else None


def _torques(record: TrialRecord) -> ComplexArray:
    """Spectra, (terms, n, bins), of the torques for each element of G as 1, to 50 Hz.

    They are those of the kinetic energies ``θ_j θ̇_i²`` and ``θ_i θ̇_i θ̇_j``, as Lagrange's
    equations give them, and 0 where the perturbed joint has no part in that. Where it has one, and
    two other joints, these move little.
    """
    k = record.perturbed_joint
    size = round(4.0 * _HIGHEST * record.duration)
    s = 2j * np.pi * np.arange(size // 2 + 1) / record.duration
    moved = np.fft.rfft(record.position - record.position.mean(axis=1, keepdims=True))
    moved = moved[:, : s.size] * (np.abs(s) <= 2.0 * np.pi * _HIGHEST) * (size / record.samples)
    angle, speed = (np.fft.irfft(one, size) for one in (moved, s * moved))
    terms = []
    for i, j in permutations(range(record.joints), 2):
        for first, second, at in ((i, i, j), (i, j, i)):
            terms.append(np.zeros_like(moved))
            if k in (i, j):
                for one, other in ((first, second), (second, first)):
                    terms[-1][one] += s * np.fft.rfft(angle[at] * speed[other])
                terms[-1][at] -= np.fft.rfft(speed[first] * speed[second])
    return np.asarray(np.stack(terms) * (record.samples / size))
