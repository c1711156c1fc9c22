"""Weighted sums over frequency, whose terms have errors that are correlated between bins."""

from __future__ import annotations

import math

import numpy as np

from armimp_common.arrays import EPS, TINY, ComplexArray, FloatArray
from armimp_estimation.spectra import Values, sums_within

_SMOOTHING = 0.3
"""Half width of the band over which variances are averaged before they serve as weights, Hz."""


def fit_weights(
    f: FloatArray,
    impedance: ComplexArray,
    variance: FloatArray,
    weight_floor: float,
    power: FloatArray | float = 1.0,
    *,
    reach: float = _SMOOTHING,
) -> FloatArray:
    """Inverse of the variance, smoothed over frequency (geometric mean) and floored, at most 1.

    The variance at one frequency comes from few averages. Weights that followed its fluctuations
    would favour frequencies whose variance is too small by chance, and make standard errors too
    small. Its variation with the inverse of the power is known, and so is not smoothed.

    Parameters
    ----------
    f, impedance, variance, power : ndarray, shape (..., n_freq)
        Frequencies, Hz, values, their variances, and the power of the perturbation behind each.
    weight_floor : float
        Standard deviation, relative to the impedance, that is added; less where power is above its
        mean, as errors for which it stands, such as harmonics of friction, don't grow with power.
    reach : float
        Half width of the smoothing, Hz.
    """
    power = np.broadcast_to(power, variance.shape)
    usual = np.mean(power, axis=-1, keepdims=True)
    size = np.abs(impedance)
    floor = weight_floor * np.exp(_smooth(f, np.log(size + TINY), reach))
    # Even without a floor, a variance below rounding errors means nothing.
    rounding = EPS * np.max(size, axis=-1, keepdims=True)
    noise = np.exp(_smooth(f, np.log(variance * power + TINY), reach)) / power
    total = noise + floor**2 * np.minimum(1.0, usual / power) + rounding**2
    return np.asarray(np.min(total, axis=-1, keepdims=True) / total)


def _smooth(f: FloatArray, logarithm: FloatArray, reach: float) -> FloatArray:
    """Mean over all frequencies within `reach`, Hz, on either side of each; (..., n_freq)."""
    sums, count = sums_within(f, logarithm, reach * (1.0 + 1e-9))
    return np.asarray(sums / count)


def real_sums(functionals: ComplexArray, values: ComplexArray) -> FloatArray:
    """``Re Σ_f conj(b_f) y_f`` along the last axis."""
    parts = functionals.real * values.real + functionals.imag * values.imag
    return np.asarray(np.sum(parts, axis=-1))


def covariance_of_sums(spread: Values, correlation: FloatArray) -> FloatArray:
    """Covariance of ``Re Σ conj(b) δZ`` where errors δZ of neighbouring bins are correlated.

    Parameters
    ----------
    spread : ndarray, shape (p, ..., n_freq)
        For each sum, b times the standard deviations of the complex δZ. Errors along axes other
        than the last are independent.
    correlation : ndarray, shape (lags, n_freq)
        Correlation of the errors of each bin and the one 0, 1, 2... places above it.

    Returns
    -------
    ndarray, shape (p, p)
    """
    left = np.conj(spread).reshape(len(spread), -1)
    right = with_neighbours(spread, correlation).reshape(len(spread), -1)
    return np.asarray(0.5 * (left @ right.T).real)


def with_neighbours(values: Values, correlation: FloatArray) -> Values:
    """Sums ``Σ_g ρ_fg values_g`` over neighbouring bins, (..., n_freq).

    Parameters
    ----------
    values : ndarray, shape (..., n_freq)
    correlation : ndarray, shape (lags, n_freq)
        Correlation of each bin and the one 0, 1, 2... places above it.
    """
    total: Values = values.copy()
    bins = values.shape[-1]
    for lag, of_lag in enumerate(correlation[1:bins], start=1):
        rho = of_lag[: bins - lag]
        total[..., : bins - lag] += rho * values[..., lag:]
        total[..., lag:] += rho * values[..., : bins - lag]
    return total


def spread_of_mean(correlation: FloatArray) -> float:
    """Standard deviation of the mean of F correlated powers, relative to that of one power."""
    frequencies = int(correlation.shape[1])
    return math.sqrt(frequencies + 2.0 * float(np.sum(correlation[1:] ** 2))) / frequencies


def root_of(covariance: Values) -> Values:
    """Matrices F, (..., p, p), with ``F Fᴴ`` a covariance, which rounding may make indefinite."""
    sizes, directions = np.linalg.eigh(covariance)
    root: Values = directions * np.sqrt(np.maximum(sizes, 0.0))[..., None, :]
    return root
