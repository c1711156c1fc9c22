"""Frequency response of one record by the local polynomial method, without averaging segments.

Pintelon & Schoukens, *System Identification: A Frequency Domain Approach*, 2nd ed., ch. 7. A record
that is cut out of an ongoing experiment obeys, between the discrete Fourier transforms of its input
and outputs, ``Y(k) = G(k) U(k) + T(k) + V(k)``. T is the transient at the ends of the record
(leakage); like G, it is smooth over frequency, whereas U is not. Within a few bins around k, G and
T are therefore modelled as polynomials, fitted by least squares; the residual gives the noise V.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from armimp_common.arrays import TINY, BoolArray, ComplexArray, FloatArray
from armimp_common.errors import DataError
from armimp_estimation.periods import Periods, has_power
from armimp_estimation.spectra import sums_within

Mix = Callable[[FloatArray], ComplexArray]
"""Function of frequencies (n,), Hz: the coefficients (m, C, n) of m combinations of C outputs."""

ORDER = 2
"""Degree of the polynomials in frequency, for response and leakage alike."""
HALF_WIDTH = 12
"""Bins on either side of a bin that enter its estimate. At the ends of the spectrum, the window
of ``2 HALF_WIDTH + 1`` bins is not centred."""
_ENOUGH = 19
"""Degrees of freedom with which noise counts as well known: those of windows of 25 bins."""
_NEIGHBOURS = 1.1
"""Largest distance over which noise levels are averaged, Hz."""
# Ratio of standard errors of a response with and without its changes over frequency, at most.
_DEARER = 1.5
# Ratio of diagonal elements of the triangular factor below which regressors count as collinear.
_DEGENERATE = 1e-9
# Lines on either side over which a polynomial is fitted, and over which its scatter is averaged.
_LINES, _ALIKE = 6, 10
# The same in windows that do not overlap, of the responses to a sweep.
_WINDOWS = 3
# Share of the record that informs of a response, below which the input was a sweep.
_LOCAL = 0.25


@dataclass(frozen=True, kw_only=True, eq=False)
class LocalResponse:
    """Responses of C outputs to one input."""

    f: FloatArray
    """Frequencies, Hz; shape (n_freq,)."""
    response: ComplexArray
    """Frequency responses, in units of output over input; shape (C, n_freq)."""
    noise: ComplexArray
    """Noise covariance ``E[V_c conj(V_d)]`` of the Fourier transforms of the outputs, estimated
    from the residuals; shape (C, C, n_freq)."""
    weights: ComplexArray
    """``response = Σ_w weights[:, w] · Y(first + w)`` for any output Y; shape (n_freq, window)."""
    first: NDArray[np.intp]
    """First bin of each window; shape (n_freq,)."""
    freedom: int
    """Complex degrees of freedom behind the noise, at the frequency that has the fewest."""
    at_lines: bool = False
    """Whether the frequencies are the lines of a periodic input."""

    @property
    def gain(self) -> FloatArray:
        """Variance of a response per unit of noise variance: ``Σ_w |weights|²``, (n_freq,)."""
        gain: FloatArray = np.sum(np.abs(self.weights) ** 2, axis=1)
        return gain

    @property
    def variance(self) -> FloatArray:
        """Variance of each response, (C, n_freq)."""
        return np.asarray(self.gain * np.einsum("ccf->cf", self.noise).real)

    def at(self, kept: BoolArray) -> LocalResponse:
        """Return the responses at the frequencies that a mask selects."""
        return replace(
            self,
            f=self.f[kept],
            response=np.ascontiguousarray(self.response[:, kept]),
            noise=np.ascontiguousarray(self.noise[:, :, kept]),
            weights=self.weights[kept],
            first=self.first[kept],
        )

    @property
    def share(self) -> float:
        """Share of the record that informs of a response; a half, if that is all of it by chance.

        The weights are the transform of a window in time: that in which an input had the frequency.
        """
        window = np.abs(np.fft.ifft(self.weights, 2 * self.weights.shape[1])) ** 2
        return float(np.median(np.mean(window, axis=1) ** 2 / np.mean(window**2, axis=1)))

    def with_scatter(self, outputs: slice) -> LocalResponse:
        """Raise the noise of some outputs to the scatter of their responses, where that is larger.

        Distortion that repeats in each period, as from friction and rounding, does not show in the
        scatter between periods. A sweep passes a frequency within an instant, in which noise may be
        larger than in the rest of the record. But where the response is smooth over frequency,
        either makes it deviate from what its neighbours predict (Pintelon & Schoukens, ch. 7: the
        robust method).

        Parameters
        ----------
        outputs : slice
            Outputs whose responses are smooth over frequency.
        """
        size, step = self.f.size, 1 if self.at_lines else self.weights.shape[1]
        reach, alike = (_LINES, _ALIKE) if self.at_lines else (_WINDOWS, _WINDOWS * step // 2)
        window = 2 * reach + 1
        if size < step * window or not (self.at_lines or self.share < _LOCAL):
            return self
        bins: FloatArray = np.arange(size, dtype=np.float64)
        noise = plain = np.einsum("ccf->cf", self.noise[outputs, outputs]).real
        if not self.at_lines:  # the response takes a burst at a frequency for its own
            noise, count = sums_within(bins, plain, alike)
            noise = noise / count
        first = np.arange(size) - step * reach
        beyond = first + step * (window - 1) - (size - 1)
        first += step * (np.maximum(-(first // step), 0) - np.maximum(-(-beyond // step), 0))
        places = first[:, None] + step * np.arange(window)
        distance = (self.f[places] - self.f[:, None]) / (self.f[-1] - self.f[0])
        powers = distance[:, :, None] ** np.arange(ORDER + 1) * window ** np.arange(ORDER + 1)
        root = 1.0 / np.sqrt(self.gain[places])[:, :, None]
        fitted = np.linalg.pinv(root * powers)[:, :1] @ (root * np.eye(window))
        apart = (places == np.arange(size)[:, None]) - fitted[:, 0]
        left = np.abs(np.sum(apart * self.response[outputs][:, places], axis=2)) ** 2
        chance = np.sum(apart**2 * (self.gain * noise)[:, places], axis=2)
        spare = (self.freedom - 1.0) / self.freedom
        ratio = np.divide(spare * left, chance, out=np.ones_like(left), where=chance > TINY)
        total, count = sums_within(bins, ratio, alike)
        factors = np.ones((len(self.noise), size))
        factors[outputs] = np.sqrt(np.maximum(total / count * noise / np.maximum(plain, TINY), 1.0))
        return replace(self, noise=factors[:, None] * factors[None] * self.noise)

    def bin_correlation(self) -> FloatArray:
        """Correlation between the errors at each bin and at the one 0, 1, 2... places above it.

        Noise of different bins is uncorrelated, so the covariance of two estimates is the sum of
        the products of their weights over the bins that both use.

        Returns
        -------
        ndarray, shape (lags, n_freq)
            From 1 at lag 0 to the largest lag at which windows overlap; 0 where there is no bin.
        """
        size, window = self.weights.shape
        deviation = np.sqrt(self.gain)
        correlation = np.zeros((min(window, size), size))
        correlation[0] = 1.0
        for lag in range(1, len(correlation)):
            lower, upper = self.weights[:-lag], np.conj(self.weights[lag:])
            sums = np.empty(size - lag)
            # Windows are as far apart as their bins, unless the end of the spectrum shifts one.
            shift = self.first[lag:] - self.first[:-lag]
            for apart in np.unique(shift):
                rows = shift == apart
                products = lower[rows, apart:] * upper[rows, : max(window - apart, 0)]
                sums[rows] = np.sum(products, axis=1).real
            correlation[lag, :-lag] = sums / (deviation[lag:] * deviation[:-lag])
        overlapping = np.flatnonzero(correlation.any(axis=1))
        return correlation[: overlapping[-1] + 1]


def local_response(
    source: FloatArray,
    outputs: FloatArray,
    rate: float,
    band: tuple[float, float],
    f: FloatArray,
    half_width: int = HALF_WIDTH,
    periods: Periods | None = None,
    mix: Mix | None = None,
) -> LocalResponse:
    """Estimate the responses of outputs to one input at frequencies where it has power.

    Parameters
    ----------
    source : ndarray, shape (N,)
        Input, known without error.
    outputs : ndarray, shape (C, N)
        Outputs.
    rate : float
        Samples per second, Hz.
    band : tuple of float
        Lowest and highest frequency, Hz.
    f : ndarray, shape (n_freq,)
        Frequencies in the band, Hz, which need not be bins of the record.
    half_width : int
        Bins on either side of a bin that enter its estimate, at least ``ORDER + 1``.
    periods : Periods, optional
        Periods of a periodic input; the estimates are then at all its lines in the band instead.
    mix : callable, optional
        Gives the coefficients of the combinations that take the place of the outputs.

    Raises
    ------
    DataError
        If the record is too short, or the input has no power or too few lines in the band.
    """
    if periods is not None:
        return _periodic_response(source, outputs, rate, band, half_width, periods, mix)
    samples, window = source.size, 2 * half_width + 1
    centres = f * (samples / rate)
    bins = np.rint(centres).astype(np.intp)
    highest = (samples - 1) // 2
    if bins.size == 0 or highest < window:
        raise DataError(
            f"{samples} samples are too few for local polynomials over {window} bins "
            f"between {band[0]:.4g} and {band[1]:.4g} Hz",
            "record_too_short",
        )
    first = np.clip(bins - half_width, 1, highest - window + 1)
    places = first[:, None] + np.arange(window)

    transformed = _transform(source)
    amplitudes = np.abs(transformed[bins])
    largest = float(np.max(amplitudes))
    if not largest > 0.0:
        raise DataError(f"no perturbation between {band[0]:.4g} and {band[1]:.4g} Hz")
    perturbed = has_power(amplitudes)
    inputs = transformed[places]
    scale = np.sqrt(np.mean(np.abs(inputs) ** 2, axis=1))
    scale[~perturbed] = largest
    observed = _observed(outputs, rate, places, mix)
    distance = (places - centres[:, None]) / half_width
    powers = distance[:, :, None] ** np.arange(ORDER + 1)
    scaled = inputs / scale[:, None]
    basis, triangle = np.linalg.qr(np.concatenate((scaled[:, :, None] * powers, powers), axis=2))
    diagonal = np.abs(np.diagonal(triangle, axis1=1, axis2=2))
    poor = np.min(diagonal, axis=1) < _DEGENERATE * np.max(diagonal, axis=1)
    perturbed &= ~poor
    triangle[poor] = np.eye(triangle.shape[1])
    adjoint = np.conj(np.swapaxes(basis, 1, 2))
    to_response = np.linalg.inv(triangle)[:, :1, :]
    weights = (to_response @ adjoint)[:, 0, :] / scale[:, None]
    residual = observed - basis @ (adjoint @ observed)
    freedom = np.full(bins.size, window - 2 * (ORDER + 1))
    width = window * float(rate / samples)
    found = _assembled(f, weights, observed, residual, freedom, first, width)
    if not perturbed.any():
        raise DataError(
            f"perturbation has too few spectral lines between {band[0]:.4g} and {band[1]:.4g} Hz; "
            "multisines of all trials need the same ones"
        )
    return found if perturbed.all() else found.at(perturbed)


def response_at_sines(
    source: FloatArray,
    outputs: FloatArray,
    rate: float,
    f: FloatArray,
    half_width: int,
    mix: Mix | None = None,
) -> LocalResponse:
    """Estimate as :func:`local_response` does, if the input is a sum of a few sines near `f`, Hz.

    A sine between two bins is in all of them, as the inverse of the distance. Times that distance
    it is a constant, like leakage. So a sine that is alone in its window doesn't tell how the
    response changes with frequency, and such terms take part only where they are told.
    """
    samples, window = source.size, 2 * half_width + 1
    centres = f * (samples / rate)
    bins = np.rint(centres).astype(np.intp)
    first = np.clip(bins - half_width, 1, (samples - 1) // 2 - window + 1)
    places = first[:, None] + np.arange(window)
    powers = ((places - centres[:, None]) / half_width)[:, :, None] ** np.arange(ORDER + 1)
    inputs = _transform(source)[places]
    scale = np.linalg.norm(inputs, axis=1)[:, None] / np.sqrt(window)
    changing = (inputs / scale)[:, :, None] * powers
    columns = np.concatenate((changing, powers), axis=2)
    columns[:, :, 1 : ORDER + 1] = 0.0
    largest = _DEARER * np.linalg.norm(np.linalg.pinv(columns)[:, 0], axis=1)
    for order in range(1, ORDER + 1):
        columns[:, :, order] = changing[:, :, order]
        dear = np.linalg.norm(np.linalg.pinv(columns)[:, 0], axis=1) > largest
        columns[dear, :, order] = 0.0
    inverse = np.linalg.pinv(columns)
    observed = _observed(outputs, rate, places, mix)
    residual = observed - columns @ (inverse @ observed)
    freedom = window - np.count_nonzero(columns.any(axis=1), axis=1)
    width = window * float(rate / samples)
    return _assembled(f, inverse[:, 0] / scale, observed, residual, freedom, first, width)


def _periodic_response(
    source: FloatArray,
    outputs: FloatArray,
    rate: float,
    band: tuple[float, float],
    half_width: int,
    periods: Periods,
    mix: Mix | None,
) -> LocalResponse:
    """Estimate as :func:`local_response` does, at the lines of a periodic input.

    Between the harmonics, the spectrum of whole periods holds leakage, a polynomial in frequency,
    and noise, by which periods differ. At a line, the response is (output - leakage)/input.
    """
    window, used = 2 * half_width + 1, periods.used
    centres = periods.lines_in(rate, band) * periods.count
    if centres.size == 0 or (used - 1) // 2 < window:
        raise DataError(f"no line of the perturbation between {band[0]:.4g} and {band[1]:.4g} Hz")
    first = np.clip(centres - half_width, 1, (used - 1) // 2 - window + 1)
    places = first[:, None] + np.arange(window)
    at_line = (places == centres[:, None]).astype(np.float64)
    between = (places % periods.count != 0).astype(np.float64)
    distance = (places - centres[:, None]) / half_width
    powers = between[:, :, None] * distance[:, :, None] ** np.arange(ORDER + 1)
    basis, triangle = np.linalg.qr(powers)
    adjoint = np.swapaxes(basis, 1, 2)
    leakage = (np.linalg.inv(triangle)[:, :1, :] @ adjoint)[:, 0, :]
    inputs = _transform(source[periods.stretch])[centres]
    weights = (at_line - leakage) / inputs[:, None]
    observed = _observed(outputs[:, periods.stretch], rate, places, mix)
    residual = between[:, :, None] * observed - basis @ (adjoint @ observed)
    freedom = np.sum(between, axis=1) - (ORDER + 1)
    f = np.asarray(centres * float(rate / used), dtype=np.float64)
    width = window * float(rate / used)
    found = _assembled(f, weights.astype(np.complex128), observed, residual, freedom, first, width)
    return replace(found, at_lines=True)


def _assembled(
    f: FloatArray,
    weights: ComplexArray,
    observed: ComplexArray,
    residual: ComplexArray,
    freedom: NDArray[np.number],
    first: NDArray[np.intp],
    width: float,
) -> LocalResponse:
    """Responses and noise from weights (n_freq, window) and residuals (n_freq, window, C)."""
    noise = np.swapaxes(residual, 1, 2) @ np.conj(residual) / freedom[:, None, None]
    noise = np.ascontiguousarray(np.moveaxis(noise, 0, 2))
    noise, least = _with_neighbours(noise, f, int(np.min(freedom)), width)
    return LocalResponse(
        f=f,
        response=np.ascontiguousarray((weights[:, None, :] @ observed)[:, 0, :].T),
        noise=noise,
        weights=weights,
        first=first,
        freedom=least,
    )


def _with_neighbours(
    noise: ComplexArray, f: FloatArray, freedom: int, width: float
) -> tuple[ComplexArray, int]:
    """Average noise (C, C, n_freq) with that of windows around, up to `_ENOUGH` degrees of freedom.

    A noise level with few degrees of freedom scatters, and weights by its inverse would favour the
    windows where it is small by chance. Each window spans `width`, Hz.
    """
    reach = min(0.5 * width * _ENOUGH / freedom, _NEIGHBOURS)
    sums, count = sums_within(f, noise, reach)
    windows = min(2.0 * reach / width, int(np.min(count)))
    total = min(round(freedom * windows), _ENOUGH)
    if freedom >= total:
        return noise, freedom
    share = freedom / total
    return share * noise + (1.0 - share) * (sums / count), total


def _observed(
    outputs: FloatArray, rate: float, places: NDArray[np.intp], mix: Mix | None
) -> ComplexArray:
    """Fourier transforms of outputs (C, N), or of their combinations, by window, bin and output."""
    lowest = int(np.min(places))
    spectra = _transform(outputs)[:, lowest : int(np.max(places)) + 1]
    if mix is not None:
        f = np.arange(lowest, lowest + spectra.shape[1]) * (rate / outputs.shape[1])
        spectra = np.einsum("mcf,cf->mf", mix(f), spectra)
    return np.moveaxis(spectra[:, places - lowest], 0, 2)


def _transform(signal: FloatArray) -> ComplexArray:
    """Fourier transform along the last axis; the mean is removed, as its rounding would leak."""
    centred = signal - signal.mean(axis=-1, keepdims=True)
    transform: ComplexArray = np.fft.rfft(centred, axis=-1)
    return transform
