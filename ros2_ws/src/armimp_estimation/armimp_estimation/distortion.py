"""Noise, and even and odd distortion, that a periodic perturbation reveals in a torque.

The residual torque of the perturbed joint, ``E = T_k - Σ_j Z_kj Θ_j`` over whole periods, is noise
between the harmonics of the period. Nonlinearity that is even in the motion adds to the even
harmonics, and that which is odd to the odd harmonics that are left out of the perturbation
(Pintelon & Schoukens, *System Identification: A Frequency Domain Approach*, 2nd ed., ch. 4).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from armimp_common.arrays import BoolArray, FloatArray
from armimp_estimation.mbk import MBK
from armimp_estimation.record import TrialRecord

_CHANCE = 3.0
"""Number of standard deviations of the mean of ``|E|²`` that chance hardly exceeds."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Harmonics:
    """Torque at some harmonics."""

    f: FloatArray
    """Frequencies, Hz; shape (n_harmonics,)."""
    amplitude: FloatArray
    """Amplitudes, N·m; shape (n_harmonics,)."""
    noise: FloatArray
    """Rms amplitude of the noise around each harmonic, N·m; shape (n_harmonics,)."""

    @property
    def rms(self) -> float:
        """Rms torque of all these harmonics, N·m."""
        return float(np.sqrt(0.5 * np.sum(self.amplitude**2)))

    @property
    def expected(self) -> float:
        """Rms torque expected from the noise alone, N·m."""
        return float(np.sqrt(0.5 * np.sum(self.noise**2)))

    @property
    def ratio(self) -> float:
        """Mean power relative to that of the noise; 1 is expected if there is only noise."""
        return float(np.mean((self.amplitude / self.noise) ** 2))

    @property
    def limit(self) -> float:
        """Value of `ratio` that chance hardly exceeds."""
        return 1.0 + _CHANCE / float(np.sqrt(self.f.size))


@dataclass(frozen=True, kw_only=True, eq=False)
class Distortion:
    """Torque of the perturbed joint in one trial, by its origin."""

    period: float
    """Length of a period, s."""
    count: int
    """Number of whole periods."""
    lines: Harmonics
    """Measured torque at the lines of the perturbation."""
    odd: Harmonics
    """Residual torque at the other odd harmonics."""
    even: Harmonics
    """Residual torque at the other even harmonics."""
    noise: float
    """Rms residual torque between the harmonics, N·m."""

    @classmethod
    def of(cls, record: TrialRecord, arm: MBK) -> Distortion | None:
        """Sort the torque of a trial by its origin, given the fitted arm.

        Return None without periods or noise, or if all odd or all even harmonics are lines.
        """
        periods = record.periods
        if periods is None:
            return None
        record, k = record.whole_periods, record.perturbed_joint
        count = periods.count
        last = int(periods.lines[-1]) * count
        bins = np.arange(1, last + count)
        f = np.asarray(bins * (record.rate / record.samples), dtype=np.float64)
        centred = np.concatenate([record.position, record.torque[k : k + 1]])
        centred = centred - centred.mean(axis=1, keepdims=True)
        *angles, torque = np.fft.rfft(centred)[:, bins] * (2.0 / record.samples)
        left = np.abs(torque - np.sum(arm.impedance(f)[k] * np.array(angles), axis=0))
        harmonic = bins % count == 0
        # Noise falls steeply with frequency, so its level is that of the bins next to a harmonic.
        between = np.add.reduceat(
            np.where(harmonic, 0.0, left**2), np.arange(0, bins.size, count)
        ) / (count - 1)
        level = np.sqrt(0.5 * (between[:-1] + between[1:]))
        orders = np.arange(1, last // count + 1)
        is_line = np.isin(orders, periods.lines)
        at = count * orders - 1

        def harmonics(which: BoolArray, amplitude: FloatArray) -> Harmonics:
            return Harmonics(f=f[at[which]], amplitude=amplitude[at[which]], noise=level[which])

        odd, even = ~is_line & (orders % 2 == 1), ~is_line & (orders % 2 == 0)
        if not (odd.any() and even.any() and (level > 0.0).all()):
            return None
        return cls(
            period=periods.samples / record.rate,
            count=count,
            lines=harmonics(is_line, np.abs(torque)),
            odd=harmonics(odd, left),
            even=harmonics(even, left),
            noise=float(np.sqrt(0.5 * np.sum(left[~harmonic] ** 2))),
        )
