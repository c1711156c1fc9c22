"""Weighted least squares of M, B and K in each element of an impedance, and of terms beside them.

Each parameter is a sum ``Re Σ_f conj(b_f) Z_f``. So for any weights its variance is the sandwich
``½ Re Σ_fg conj(b_f) b_g σ_f σ_g ρ_fg``, with half of the complex variance for either part, and the
correlation ρ of the errors of neighbouring frequencies. The error of a correction, which is the
same at all frequencies, adds the square of ``Re Σ_f conj(b_f) δ_f`` with its standard error δ.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from armimp_common.arrays import TINY, ComplexArray, FloatArray
from armimp_common.errors import DataError
from armimp_estimation.estimators.estimate import ImpedanceEstimate
from armimp_estimation.mbk import impedance_of
from armimp_estimation.weights import (
    covariance_of_sums,
    fit_weights,
    real_sums,
    spread_of_mean,
    with_neighbours,
)

FEWEST_FREQUENCIES = 3
_LOW, _FEWEST_LOW = 1.0 / 3.0, 8
"""Lowest part of the band that is fitted alone for comparison, as a share, and its fewest bins."""
LACK_LIMIT = 2.0
"""Lack of fit beyond which an impedance is not of the fitted form; ideal runs stay below 1.5."""
_LACK_CHANCE = 5.0
_SUREST_SHARE = 1e-6
"""Least standard error that data give a coefficient, relative to its prior one."""
_SINGULAR = 1e-10
_ROUNDING = 1e-9
_EXACT = 2e-3
"""Relative error that any estimate has even without noise."""


@dataclass(frozen=True, kw_only=True, eq=False)
class WeightedFit:
    """Fit to an estimate of m columns of an impedance, (n, m, n_freq), all elements alike.

    Terms are signals over frequency, one for each element, (n, m, n_freq), in N·m/rad.

    Raises
    ------
    DataError
        If there are fewer than three frequencies, or a value or variance is not finite.
    """

    estimate: ImpedanceEstimate
    """What is fitted, with the corrections made so far and their errors."""

    def __post_init__(self) -> None:
        one = self.estimate
        if one.f.size < FEWEST_FREQUENCIES:
            raise DataError(f"{one.f.size} frequencies are too few to fit M, B and K")
        if not (np.isfinite(one.Z).all() and np.isfinite(one.variance).all()):
            raise DataError(f"{one.name}: impedance or its variance is not finite")

    def corrected(self, Z: ComplexArray, systematics: Iterable[ComplexArray]) -> WeightedFit:
        """Return the fit to a corrected impedance, with all systematic errors of that."""
        return WeightedFit(estimate=replace(self.estimate, Z=Z, systematics=tuple(systematics)))

    @cached_property
    def omega(self) -> FloatArray:
        """Angular frequencies, rad/s, (n_freq,)."""
        return 2.0 * np.pi * self.estimate.f

    @cached_property
    def _systematics(self) -> ComplexArray:
        """Systematic errors of the estimate, (S, n, m, n_freq)."""
        known = self.estimate.systematics
        return np.reshape(known, (len(known), *self.estimate.Z.shape)).astype(np.complex128)

    @property
    def shape(self) -> tuple[int, int]:
        """Numbers n and m of rows and columns."""
        n, m, _ = self.estimate.Z.shape
        return n, m

    @property
    def own(self) -> list[tuple[int, int]]:
        """Elements from a perturbed joint's angle to the torque of that joint, by column."""
        perturbed = self.estimate.perturbed or range(self.shape[1])
        return [(joint, column) for column, joint in enumerate(perturbed)]

    @cached_property
    def _weights(self) -> FloatArray:
        """Weights of the frequencies in the fit of each element."""
        one = self.estimate
        return fit_weights(one.f, one.Z, one.variance, one.weight_floor, one.power)

    @cached_property
    def functionals(self) -> ComplexArray:
        """Rows b of ``(M, B, K) = Re Σ_f conj(b_f) Z_f``, (n, m, 3, n_freq)."""
        rows = [[mbk_functionals(self.omega, one) for one in row] for row in self._weights]
        return np.array(rows)

    @cached_property
    def values(self) -> FloatArray:
        """M, B and K, (3, n, m)."""
        return self.shifts(self.estimate.Z)

    def impedance(self, values: FloatArray) -> ComplexArray:
        """Impedance, (..., n_freq), of M, B and K, (3, ...)."""
        return impedance_of(values, self.estimate.f)

    def shifts(self, terms: ComplexArray) -> FloatArray:
        """Contribution of terms to M, B and K, (3, n, m)."""
        return np.moveaxis(real_sums(self.functionals, terms[:, :, None]), -1, 0)

    def below(self) -> tuple[FloatArray, FloatArray]:
        """Difference of M, B and K from those of the lowest third of the band alone.

        Returned with its standard errors, each (3, n, m); all are 0 if that has too few bins.
        """
        low = self.omega <= _LOW * self.omega[-1]
        found = np.zeros((2, 3, *self.shape))
        for i, k in np.ndindex(self.shape) if np.count_nonzero(low) >= _FEWEST_LOW else ():
            of_low = mbk_functionals(self.omega, self._weights[i, k] * low)
            apart = self.functionals[i, k] - of_low
            found[0, :, i, k] = real_sums(apart, self.estimate.Z[i, k])
            found[1, :, i, k] = roots(self._covariance_of(apart, i, k))
        return found[0], found[1]

    def _covariance_of(self, functionals: ComplexArray, i: int, k: int) -> FloatArray:
        """Covariance, (p, p), of ``Re Σ_f conj(b_f) Z_f`` of one element; b is (p, n_freq)."""
        spread = functionals * np.sqrt(self.estimate.noise[i, k])
        shifts = real_sums(functionals, self._systematics[:, i, k, None])
        of_noise = covariance_of_sums(spread, self.estimate.bin_correlation)
        return np.asarray(of_noise + shifts.T @ shifts)

    def covariance(self, common: Iterable[ComplexArray] = ()) -> FloatArray:
        """Covariance of all M, then B, then K, row by row, (3nm, 3nm): the sum of all errors.

        The error of a correction is that of one transducer, so it is common to a row; those that
        are given are `common` to all elements.
        """
        shifts = [self.shifts(one) for one in common]
        for shift in map(self.shifts, self._systematics):
            shifts += [shift * row[:, None] for row in np.eye(self.shape[0])]
        known = np.reshape(shifts, (-1, self.values.size))
        return np.asarray(self._covariance_by_noise() + known.T @ known)

    def _covariance_by_noise(self) -> FloatArray:
        """Part of noise: ``½ Re Σ_fg conj(b_f) c_g σ_f ς_g ρ_fg (κ_f + κ_g)/2`` of two elements."""
        noise = np.sqrt(self.estimate.noise).reshape(-1, self.omega.size)
        terms = math.sqrt(0.5) * noise[:, None] * self.functionals.reshape(len(noise), 3, -1)
        spread = with_neighbours(terms, self.estimate.bin_correlation)
        kappa = self._coherency(noise)
        found = np.einsum("apf,abf,bqf->paqb", np.conj(terms), kappa, spread).real
        one_way = found.reshape(self.values.size, -1)
        return np.asarray(0.5 * (one_way + one_way.T))

    def _coherency(self, noise: FloatArray) -> ComplexArray:
        """Complex correlation κ of the errors of any two of N elements, (N, N, n_freq).

        `noise` is their standard deviation. Without covariances, elements count as independent.
        """
        disturbance, inverse = self.estimate.disturbance, self.estimate.inverse
        itself = np.eye(len(noise), dtype=np.complex128)[:, :, None]
        if disturbance is None or inverse is None:
            return np.broadcast_to(itself, (*itself.shape[:2], self.omega.size))
        shared = np.einsum("kimf,kjf,klf->ijmlf", disturbance, inverse, np.conj(inverse))
        size = noise[:, None] * noise
        shared = shared.reshape(size.shape)
        kappa = np.divide(shared, size, out=np.zeros_like(shared), where=size > 0.0)
        return np.where(itself == 1.0, 1.0, kappa)

    def _beside(self, terms: ComplexArray) -> ComplexArray:
        """Residual of terms, (..., n, m, n_freq), regressed on M, B and K of their elements.

        It is orthogonal to them with the elements' weights.
        """
        alike = real_sums(self.functionals, terms[..., None, :])
        return np.asarray(terms - self.impedance(np.moveaxis(alike, -1, 0)))

    def coefficients(self, terms: ComplexArray) -> FloatArray:
        """Coefficient of each element's term beside M, B and K, and its error, (n, m, 2)."""
        left, estimate = self._beside(terms), self.estimate
        total = np.sum(self._weights * np.abs(left) ** 2, axis=-1)
        determined = (total > TINY) & (total < math.inf)
        left = np.where(determined[..., None], left, 0.0)
        functionals = self._weights * left / np.where(determined, total, 1.0)[..., None]
        spread = functionals * np.sqrt(estimate.noise)
        variance = 0.5 * real_sums(spread, with_neighbours(spread, estimate.bin_correlation))
        variance += np.sum(real_sums(functionals, self._systematics) ** 2, axis=0)
        errors = np.sqrt(np.maximum(variance, 0.0))
        found = np.stack((real_sums(functionals, estimate.Z), errors), axis=-1)
        # Where nothing was measured, the values are not numbers either.
        return np.where(determined[..., None], found, (0.0, math.inf))

    def common_coefficient(self, terms: ComplexArray) -> tuple[float, float, float]:
        """Weighted mean of :meth:`coefficients`, its error with their scatter, and their spread.

        The spread is the standard deviation between elements beyond chance (DerSimonian & Laird,
        *Controlled Clinical Trials* 7, 1986), where one standard deviation more counts as chance.
        """
        found = self.coefficients(terms)
        values, errors = found[np.isfinite(found[..., 1]) & (found[..., 1] > 0.0)].T
        if not values.size:
            return 0.0, math.inf, 0.0
        precision = 1.0 / errors**2
        total = float(np.sum(precision))
        mean = float(np.sum(precision * values)) / total
        freedom = max(values.size - 1, 1)
        scatter = float(np.sum(precision * (values - mean) ** 2))
        spare = total - float(np.sum(precision**2)) / total
        excess = max(scatter - freedom - math.sqrt(2.0 * freedom), 0.0)
        apart = math.sqrt(excess / spare) if spare > 0.0 else 0.0
        return mean, math.sqrt(max(1.0, scatter / freedom) / total), apart

    def common_coefficients(
        self, terms: ComplexArray, expected: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Posterior means and covariance of the coefficients of terms common to all elements.

        The terms, (p, n, m, n_freq), are beside M, B and K, each scaled to its prior standard
        error about `expected`, (p,). The covariance covers the scatter over the elements.
        """
        shown = self._shown(terms)
        mean, _, _ = _posterior(expected, *shown)
        ratio = sum(float(np.sum((design @ mean - data) ** 2)) for design, data in shown)
        scatter = math.sqrt(max(1.0, ratio / (len(terms) * max(len(shown) - 1, 1))))
        scaled = ((design / scatter, data / scatter) for design, data in shown)
        mean, root, _ = _posterior(expected, *scaled)
        return mean, root @ root.T

    def own_coefficients(self, terms: ComplexArray) -> list[tuple[FloatArray, FloatArray, float]]:
        """Posterior means and covariance of the coefficients of terms in each element by itself.

        The terms are scaled as for :meth:`common_coefficients`, about 0. Last is the logarithm of
        the likelihood ratio of their presence to their absence. Elements are row by row.
        """
        found = []
        for one in self._shown(terms):
            mean, root, along = _posterior(np.zeros(len(terms)), one)
            evidence = 0.5 * float(along @ along) + float(np.linalg.slogdet(root)[1])
            found.append((mean, root @ root.T, evidence))
        return found

    def _shown(self, terms: ComplexArray) -> list[tuple[FloatArray, FloatArray]]:
        """What terms, (p, n, m, n_freq), have beside M, B and K of each element, row by row.

        Pairs of a design and of data ``design @ coefficients``, with independent errors 0 ± 1.
        """
        elements, beside = [], self._beside(terms)
        for i, k in np.ndindex(self.shape):
            term, left, weights = terms[:, i, k], beside[:, i, k], self._weights[i, k]
            size = np.sum(weights * np.abs(left) ** 2, axis=1, keepdims=True)
            functionals = weights * left / np.sqrt(size + TINY)
            # If data determined a term still better, its prior mean would be lost to rounding.
            least = np.diag(_SUREST_SHARE**2 * size[:, 0])
            errors = self._covariance_of(functionals, i, k) + least
            design = (np.conj(functionals) @ term.T).real
            variances, axes = np.linalg.eigh(errors)
            told = variances > _SINGULAR * variances[-1]
            root = axes[:, told].T / np.sqrt(variances[told])[:, None]
            data = (np.conj(functionals) @ self.estimate.Z[i, k]).real
            elements.append((root @ design, root @ data))
        return elements

    def roughly_fits(self, values: FloatArray) -> bool:
        """Whether M, B and K, with systematic errors of any shape, explain each element."""
        f = self.estimate.f
        ratio = lack_ratio(self.estimate, self.impedance(values))
        lack = np.sum(ratio, axis=-1) / max(f.size - 1.5, 1.0)
        return bool((lack <= lack_limit(self.estimate.bin_correlation)).all())


def _posterior(
    expected: FloatArray, *shown: tuple[FloatArray, FloatArray]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Combine coefficients that are `expected` ± 1 with what pairs of a design and of data show.

    Prior and data are rows of one system, as normal equations lose what is known least.

    Returns
    -------
    mean : ndarray, shape (p,)
    root : ndarray, shape (p, p)
        Root F of the covariance ``F Fᵀ``.
    along : ndarray, shape (p,)
        ``F⁻¹ mean``.
    """
    designs, data = zip((np.eye(expected.size), expected), *shown, strict=True)
    basis, triangle = np.linalg.qr(np.concatenate(designs))
    root = np.linalg.inv(triangle)
    along = basis.T @ np.concatenate(data)
    return root @ along, root, along


def mbk_functionals(omega: FloatArray, weights: FloatArray) -> ComplexArray:
    """Rows b, (3, n_freq), of ``(M, B, K) = Re Σ_f conj(b_f) Z_f``."""
    scale = omega[-1]
    relative = omega / scale
    design = np.stack((-(relative**2), np.ones(omega.size)))
    normal = (design * weights) @ design.T
    of_real = np.linalg.solve(normal, design * weights)
    of_imaginary = weights * relative / np.sum(weights * relative**2)
    return np.stack((of_real[0] / scale**2, 1j * (of_imaginary / scale), of_real[1]))


def roots(covariance: FloatArray) -> FloatArray:
    """Standard errors from a covariance."""
    return np.asarray(np.sqrt(np.maximum(np.diag(covariance), 0.0)))


def r_squared(values: ComplexArray, fitted: ComplexArray) -> FloatArray:
    """Coefficient of determination of a complex fit to each element, (...).

    Real and imaginary parts are stacked into one real vector y of twice the length:
    ``R² = 1 - Σ (y - ŷ)² / Σ (y - mean(y))²``, unweighted, with one mean for the stacked vector.

    Parameters
    ----------
    values, fitted : ndarray, shape (..., n_freq)
        Estimated and fitted values.
    """
    y = _stacked(values)
    left = np.sum((y - _stacked(fitted)) ** 2, axis=-1)
    total = np.sum((y - y.mean(axis=-1, keepdims=True)) ** 2, axis=-1)
    return np.asarray(1.0 - left / np.where(total > 0.0, total, np.nan))


def lack_limit(correlation: FloatArray) -> float:
    """Lack of fit that chance does not reach: 2, or 5 standard deviations above 1 for few bins.

    The mean of F values of ``|e|²/variance`` scatters by ``sqrt(Σ ρ²)/F``, summed over all pairs,
    with the correlation ρ, (lags, F), of the errors of each bin and those above it.
    """
    return max(LACK_LIMIT, 1.0 + _LACK_CHANCE * spread_of_mean(correlation))


def lack_of_fit(estimate: ImpedanceEstimate, fitted: ComplexArray) -> FloatArray:
    """Weighted squared residual of each element per degree of freedom, (n, m).

    It is 1 if noise explains all of it. M, B and K, and systematic errors within their standard
    errors, first explain what they can of ``Z - fit``: each has one shape over frequency, and
    explains nothing else (generalised least squares).
    """
    f = estimate.f
    variance = estimate.noise + estimate.shapeless
    weights = 1.0 / np.sqrt(_spared(estimate.Z, variance, estimate.averages - 1.0))
    relative = 1j * f / f[-1]
    shapes = np.stack((relative**2, relative, np.ones_like(relative)))
    found = np.zeros(fitted.shape[:2])
    for at in np.ndindex(found.shape):
        systematic = np.reshape([one[at] for one in estimate.systematics], (-1, f.size))
        design = _stacked(weights[at] * np.concatenate((shapes, systematic)))
        # M, B and K, the first three, have no prior.
        known = np.arange(len(design)) >= len(shapes)
        design /= np.where(known, 1.0, np.linalg.norm(design, axis=1))[:, None]
        rest = _stacked(weights[at] * (estimate.Z - fitted)[at])
        normal = design @ design.T + np.diag(np.where(known, 1.0, _ROUNDING))
        taken = np.linalg.solve(normal, design @ rest)
        found[at] = rest @ rest - taken @ design @ rest
    return found / max(f.size - 1.5, 1.0)


def lack_ratio(estimate: ImpedanceEstimate, fitted: ComplexArray) -> FloatArray:
    """``|Z - fit|²/variance`` of each element and bin, (n, m, n_freq); its mean is 1 if it fits."""
    spared = _spared(estimate.Z, estimate.variance, estimate.averages - 1.0)
    return np.asarray(np.abs(estimate.Z - fitted) ** 2 / spared)


def _spared(Z: ComplexArray, variance: FloatArray, freedom: float) -> FloatArray:
    """Variance by which to judge the residual of a fit.

    It makes up for the mean of inverse variances with m complex degrees of freedom, which is too
    large, and includes the estimator's own errors, lest they count as lack of fit without noise.
    """
    spare = (freedom - 1.0) / freedom if 1.0 < freedom < math.inf else 1.0
    least = (_EXACT * np.abs(Z)) ** 2 + TINY
    return np.asarray((variance + least) / spare)


def _stacked(values: ComplexArray) -> FloatArray:
    """Real and imaginary parts one after the other, (..., 2 n_freq)."""
    return np.concatenate((values.real, values.imag), axis=-1)
