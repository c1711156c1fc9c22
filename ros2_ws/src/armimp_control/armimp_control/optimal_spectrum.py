"""Spectrum of a multisine that tells most of M, B and K of a joint, beside what a person does.

While joint k is perturbed and the others are locked, its angle answers the perturbation by
``R = 1/(Z_rd + Z_kk)``, with the target impedance and that of the arm. With lines of power p_l
(N·m)² and a disturbance of the spectral density S, a second has the Fisher information

    F = Σ_l 2 p_l |R_l|²/S_l Re(conj(φ_l) φ_lᵀ) ,    φ = (s², s, 1)

about M, B and K of any row of column k. The powers are those for which the largest of the relative
standard errors ``sqrt((F⁻¹)_aa)/x_a`` is least, with the prior arm for x, under limits of the rms
torque, ``Σ p_l ≤ T²``, and of the rms angle, ``Σ p_l |R_l|² ≤ A²``. The problem is convex. Of each
parameter and of each limit the weight grows while it is the worst, and the powers follow by the
multiplicative algorithm for A-optimal designs, ``p_l ← p_l sqrt(g_l/c_l)``, with the sensitivity g
of the weighted sum of variances and the cost c of the weighted limits (Silvey, Titterington &
Torsney, Commun. Statist. Theory Methods A7, 1978; Pintelon & Schoukens, *System Identification: A
Frequency Domain Approach*, 2nd ed., section 5.4).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from armimp_common.arrays import ComplexArray, FloatArray

Array = FloatArray

_ROUNDS = 500
_EVERYWHERE = 2e-3
"""Disturbance at all frequencies, relative to that at the lowest; an assumption."""


@dataclass(frozen=True, kw_only=True)
class JointPrior:
    """What is expected of a joint while it is perturbed: M, B and K, SI units."""

    arm: tuple[float, float, float]
    """Of the arm, diagonal elements."""
    target: tuple[float, float, float]
    """Of the target impedance, with which the robot yields."""

    def response(self, f: Array) -> ComplexArray:
        """Angle over perturbation at frequencies (Hz), rad/(N·m)."""
        M, B, K = np.add(self.arm, self.target)
        s = 2j * np.pi * f
        return np.asarray(1.0 / ((M * s + B) * s + K))

    def rms_angle(self, f: Array, power: Array) -> float:
        """Rms of the angle that torque of some power (N·m)² at each frequency makes, rad."""
        return float(np.sqrt(np.sum(power * np.abs(self.response(f)) ** 2)))


def disturbance(f: Array, cutoff: float) -> Array:
    """Spectral density of what a person does, up to a factor: low-pass noise of second order.

    Beside tremor, sensors and the friction of a robot it doesn't go on to fall.
    """
    return np.asarray(1.0 / (1.0 + (f / cutoff) ** 4) + _EVERYWHERE)


def _covariance(slopes: ComplexArray, weights: Array) -> Array:
    return np.linalg.inv(((slopes * weights) @ slopes.conj().T).real)


def _slopes(f: Array, prior: JointPrior, cutoff: float) -> tuple[ComplexArray, Array]:
    """Derivatives of Z by ln M, ln B and ln K, (3, n), and what the power of each line tells."""
    s = 2j * np.pi * f
    slopes = np.array(prior.arm)[:, None] * np.stack([s**2, s, np.ones_like(s)])
    told = np.abs(prior.response(f)) ** 2 / disturbance(f, cutoff)
    return slopes, told


def optimal_power(
    f: Array, prior: JointPrior, *, torque: float, angle: float, cutoff: float, spread: float
) -> Array:
    """Powers of the lines for which the worst relative error of M, B and K is least.

    Parameters
    ----------
    f : (n,) lines, Hz
    prior : JointPrior
    torque, angle : largest rms of the perturbation and of the motion, N·m and rad
    cutoff : of the disturbance, Hz
    spread : share of the power, as the limits count it, that all lines have in equal parts

    Returns
    -------
    (n,) NDArray
        (N·m)²; one of the limits is reached.
    """
    slopes, told = _slopes(f, prior, cutoff)
    limits = np.stack([np.ones(f.size) / torque**2, np.abs(prior.response(f)) ** 2 / angle**2])
    of_limits, of_errors = np.full(2, 0.5), np.full(3, 1.0 / 3.0)
    free = np.full(f.size, 1.0 / f.size)
    for _ in range(_ROUNDS):
        cost = of_limits @ limits
        free *= (1.0 - spread) / (cost @ free)
        power = free + spread / np.sum(cost)
        covariance = _covariance(slopes, told * power)
        of_errors = of_errors * np.diag(covariance)
        of_errors /= np.sum(of_errors)
        used = limits @ power
        of_limits = of_limits * np.sqrt(used)
        of_limits /= np.sum(of_limits)
        change = covariance @ (of_errors[:, None] * covariance)
        sensitivity = told * np.sum((slopes.conj() * (change @ slopes)).real, axis=0)
        free *= np.sqrt(sensitivity / cost)
    return np.asarray(power / np.max(limits @ power))
