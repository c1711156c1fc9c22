"""Inertia, viscosity and stiffness from an impedance estimate, by weighted least squares."""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from armimp_common.errors import ConfigurationError, DataError
from armimp_estimation.estimate import ImpedanceEstimate
from armimp_estimation.mbk import MBK

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]


@dataclass(frozen=True, kw_only=True)
class FitConfig:
    """Options of the fit of ``M s² + B s + K``.

    Parameters
    ----------
    smoothing : float
        Half width of the band over which variances are averaged before they serve as weights, Hz.
        The variance at one frequency comes from few averages; weights that follow its chance
        fluctuations would favour the frequencies whose variance came out too small, and the
        standard errors would come out too small with them.
    weight_floor : float
        Relative standard deviation that is added, in quadrature, to that of each value before it
        serves as a weight. The variance does not know of errors in proportion to the impedance
        itself, such as leakage bias and time skew of the sensors; without a floor the frequencies
        whose random errors are tiny decide alone and bring in those errors. With 0 the skew of
        half a millisecond biases B by up to 55 % on a quiet simulated rig, with 0.2 by 7 %.
        Where the random errors are larger than the floor, weights are those of the variance.
        An estimate that knows better carries a floor of its own, which takes precedence.
    """

    smoothing: float = 0.6
    weight_floor: float = 0.2

    def __post_init__(self) -> None:
        if not 0.0 <= self.weight_floor < math.inf:
            raise ConfigurationError(
                f"weight_floor must not be negative, got {self.weight_floor!r}"
            )
        if not 0.0 <= self.smoothing < math.inf:
            raise ConfigurationError(f"smoothing must not be negative, got {self.smoothing!r} Hz")


@dataclass(frozen=True, kw_only=True, eq=False)
class MBKFit:
    """Fitted parameters, their standard errors and the quality of the fit.

    Attributes
    ----------
    mbk : MBK
        Fitted matrices, in kg·m², N·m·s/rad and N·m/rad.
    M_se, B_se, K_se : ndarray, shape (n, n)
        Standard errors, in the same units.
    r2 : ndarray, shape (n, n)
        Coefficient of determination, see :func:`r_squared`.
    Z : ndarray, shape (n, n, n_freq)
        Fitted impedance at the frequencies of the estimate, N·m/rad.
    covariance : ndarray, shape (3n², 3n²)
        Of all parameters: those of M row by row, then B, then K.
    """

    mbk: MBK
    M_se: FloatArray
    B_se: FloatArray
    K_se: FloatArray
    r2: FloatArray
    Z: ComplexArray
    covariance: FloatArray


def r_squared(values: ComplexArray, fitted: ComplexArray) -> float:
    """Coefficient of determination of a complex fit.

    Real and imaginary parts are stacked into one real vector y of twice the length:
    ``R² = 1 - Σ (y - ŷ)² / Σ (y - mean(y))²``, unweighted, with one mean for the stacked vector.

    Parameters
    ----------
    values, fitted : ndarray, shape (n_freq,)
        Estimated and fitted values.
    """
    y = np.concatenate((values.real, values.imag))
    residual = y - np.concatenate((fitted.real, fitted.imag))
    total = float(np.sum((y - y.mean()) ** 2))
    return 1.0 - float(np.sum(residual**2)) / total if total > 0.0 else math.nan


def fit_mbk(estimate: ImpedanceEstimate, config: FitConfig | None = None) -> MBKFit:
    """Fit ``Z_ij(jω) = K - M ω² + jω B`` to each element by variance-weighted least squares.

    The real part gives M and K, the imaginary part B. Weights are inverse variances, smoothed and
    limited as :class:`FitConfig` says. Each parameter is then a sum ``Σ_f a_f y_f``, so whatever
    the weights, its variance is the sandwich ``½ Σ_fg a_f a_g σ_f σ_g ρ(|f - g|)``: half of the
    complex variance for either part, and the correlation ρ of neighbouring frequencies, which
    windowing causes. The error of a correction, which is the same at all frequencies, adds the
    square of ``Σ_f a_f s_f`` with its standard error s.

    Parameters
    ----------
    estimate : ImpedanceEstimate
        Impedance with variances; all of its frequencies are used.
    config : FitConfig
        Options.

    Raises
    ------
    DataError
        If there are fewer than three frequencies, or a value or variance is not finite.
    """
    if estimate.f.size < 3:
        raise DataError(f"{estimate.f.size} frequencies are too few to fit M, B and K")
    if not (np.isfinite(estimate.Z).all() and np.isfinite(estimate.variance).all()):
        raise DataError(f"{estimate.name}: impedance or its variance is not finite")
    options = config if config is not None else FitConfig()
    if estimate.weight_floor is not None:
        options = replace(options, weight_floor=estimate.weight_floor)
    n = estimate.joints
    values = np.zeros((3, n, n))
    errors = np.zeros((3, n, n))
    coefficients = np.zeros((n, n, 3, estimate.f.size))
    systematic = estimate.systematic
    if systematic is None:
        systematic = np.zeros_like(estimate.Z)
    for i in range(n):
        for j in range(n):
            values[:, i, j], errors[:, i, j], coefficients[i, j] = _fit_element(
                estimate.f,
                estimate.Z[i, j],
                estimate.variance[i, j] - np.abs(systematic[i, j]) ** 2,
                systematic[i, j],
                estimate.bin_correlation,
                options,
            )
    mbk = MBK(M=values[0], B=values[1], K=values[2])
    fitted = mbk.impedance(estimate.f)
    quality = [[r_squared(estimate.Z[i, j], fitted[i, j]) for j in range(n)] for i in range(n)]
    return MBKFit(
        mbk=mbk,
        M_se=errors[0],
        B_se=errors[1],
        K_se=errors[2],
        r2=np.array(quality),
        Z=fitted,
        covariance=_parameter_covariance(estimate, coefficients),
    )


def _parameter_covariance(estimate: ImpedanceEstimate, coefficients: FloatArray) -> FloatArray:
    """Covariance of all parameters, from coefficients of shape (n, n, 3, n_freq).

    As the sandwich of one element, with the coherency κ of two: ``½ Σ_fg a_f b_g σ_f ς_g
    ρ(|f - g|) (κ_f + κ_g)/2``, of which errors of like parts take the real and others the
    imaginary part. An estimate without covariances has independent elements. The error of a
    correction is that of one transducer, so it is common to a row.
    """
    n, size = estimate.joints, estimate.f.size
    common = np.zeros_like(estimate.Z) if estimate.systematic is None else estimate.systematic
    deviation = np.sqrt(estimate.variance - np.abs(common) ** 2)
    terms = coefficients * (np.sqrt(0.5) * deviation)[:, :, None]
    rho = estimate.bin_correlation[: min(estimate.bin_correlation.size, size)]
    kernel = np.concatenate((rho[:0:-1], rho))
    spread = np.apply_along_axis(np.convolve, 3, terms, kernel)[..., rho.size - 1 :][..., :size]
    shifts = np.stack([np.stack([_apply(coefficients[i, j], common[i, j]) for j in range(n)])
                       for i in range(n)])  # fmt: skip
    # Whether the parts are unlike, and the sign of the imaginary part: M and K are real, B is not.
    imaginary = np.array([[0, -1, 0], [1, 0, 1], [0, -1, 0]])
    covariance = np.zeros((3, n, n, 3, n, n))
    for i, j, m, l in np.ndindex(n, n, n, n):
        if (i, j) > (m, l):
            continue
        coherency = _coherency(estimate, (i, j), (m, l), deviation)
        a, b = terms[i, j], terms[m, l]
        wide_a, wide_b = spread[i, j], spread[m, l]
        both = 0.5 * ((a * coherency) @ wide_b.T + (wide_a * coherency) @ b.T)
        block = np.where(imaginary == 0, both.real, imaginary * both.imag)
        if i == m:
            block = block + np.outer(shifts[i, j], shifts[m, l])
        covariance[:, i, j, :, m, l] = block
        covariance[:, m, l, :, i, j] = block.T
    return covariance.reshape(3 * n * n, 3 * n * n)


def _coherency(
    estimate: ImpedanceEstimate, one: tuple[int, int], other: tuple[int, int], sigma: FloatArray
) -> ComplexArray:
    """Correlation of the errors of two elements at each frequency."""
    if one == other:
        return np.ones(estimate.f.size, dtype=np.complex128)
    if estimate.disturbance is None or estimate.inverse is None:
        return np.zeros(estimate.f.size, dtype=np.complex128)
    (i, j), (m, l) = one, other
    shared: ComplexArray = np.sum(
        estimate.disturbance[:, i, m] * estimate.inverse[:, j] * np.conj(estimate.inverse[:, l]),
        axis=0,
    )
    size = sigma[one] * sigma[other]
    ratio: ComplexArray = np.divide(shared, size, out=np.zeros_like(shared), where=size > 0.0)
    return ratio


def fit_column(
    f: FloatArray,
    impedance: ComplexArray,
    variance: FloatArray,
    systematic: ComplexArray,
    correlation: FloatArray,
    config: FitConfig,
) -> tuple[FloatArray, FloatArray]:
    """Fit the elements of one column as :func:`fit_mbk` does those of a matrix.

    Parameters
    ----------
    f : ndarray, shape (n_freq,)
        Frequencies, Hz.
    impedance, variance, systematic : ndarray, shape (n, n_freq)
        As those of an :class:`ImpedanceEstimate`.
    correlation : ndarray, shape (lags,)
        Of the errors of neighbouring frequencies.
    config : FitConfig
        Options.

    Returns
    -------
    values, errors : ndarray, shape (3, n)
        M, B, K of each element, and their standard errors, SI units.

    Raises
    ------
    DataError
        As :func:`fit_mbk`.
    """
    if f.size < 3:
        raise DataError(f"{f.size} frequencies are too few to fit M, B and K")
    if not (np.isfinite(impedance).all() and np.isfinite(variance).all()):
        raise DataError("impedance or its variance is not finite")
    fits = [
        _fit_element(f, Z, total - np.abs(common) ** 2, common, correlation, config)
        for Z, total, common in zip(impedance, variance, systematic, strict=True)
    ]
    values = np.stack([value for value, _, _ in fits], axis=1)
    return values, np.stack([error for _, error, _ in fits], axis=1)


def _fit_element(
    f: FloatArray,
    impedance: ComplexArray,
    variance: FloatArray,
    systematic: ComplexArray,
    correlation: FloatArray,
    options: FitConfig,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return (M, B, K) of one element, their standard errors and the coefficients behind them."""
    omega = 2.0 * np.pi * f
    scale = omega[-1]
    relative = omega / scale
    weights = _weights(f, impedance, variance, options)
    # Rows of coefficients a: (M, K) act on the real part, B on the imaginary part.
    design = np.stack((-(relative**2), np.ones(f.size)))
    normal = (design * weights) @ design.T
    of_real = np.linalg.solve(normal, design * weights)
    of_imaginary = weights * relative / np.sum(weights * relative**2)
    coefficients = np.stack((of_real[0] / scale**2, of_imaginary / scale, of_real[1]))
    values = _apply(coefficients, impedance)
    common = _apply(coefficients, systematic)
    errors = np.sqrt(_sandwich(coefficients, variance, correlation) + common**2)
    return values, errors, coefficients


def _apply(coefficients: FloatArray, values: ComplexArray) -> FloatArray:
    """Values of (M, B, K) from those of an impedance."""
    parts = np.stack((values.real, values.imag, values.real))
    applied: FloatArray = np.sum(coefficients * parts, axis=1)
    return applied


def _weights(
    f: FloatArray, impedance: ComplexArray, variance: FloatArray, options: FitConfig
) -> FloatArray:
    """Inverse of the floored variance, smoothed over frequency (geometric mean), at most 1."""
    # Even with no floor a variance below rounding means nothing.
    rounding = np.finfo(np.float64).eps * float(np.max(np.abs(impedance)))
    floor = (options.weight_floor * np.abs(impedance)) ** 2 + rounding**2
    logarithm = np.log(np.maximum(variance + floor, np.finfo(np.float64).tiny))
    reach = options.smoothing * (1.0 + 1e-9)
    below = np.searchsorted(f, f - reach, side="left")
    above = np.searchsorted(f, f + reach, side="right")
    sums = np.concatenate(([0.0], np.cumsum(logarithm)))
    smooth = (sums[above] - sums[below]) / (above - below)
    weights: FloatArray = np.exp(np.min(smooth) - smooth)
    return weights


def _sandwich(
    coefficients: FloatArray, variance: FloatArray, correlation: FloatArray
) -> FloatArray:
    """Variance of ``Σ_f a_f y_f`` for each row a, shape (rows,); y is a real or imaginary part."""
    terms = coefficients * np.sqrt(0.5 * variance)
    total = np.sum(terms**2, axis=1)
    for lag in range(1, min(correlation.size, variance.size)):
        total += 2.0 * correlation[lag] * np.sum(terms[:, lag:] * terms[:, :-lag], axis=1)
    variances: FloatArray = np.maximum(total, 0.0)
    return variances
