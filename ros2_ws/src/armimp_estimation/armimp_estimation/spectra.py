"""Segment-averaged cross-spectra of several channels.

The convention is that of :func:`scipy.signal.csd`: ``G_xy = E[conj(X) Y]``, one-sided density.
"""

import functools
from dataclasses import dataclass, replace
from typing import Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from armimp_common.arrays import ComplexArray, FloatArray
from armimp_common.errors import ConfigurationError, DataError
from armimp_estimation.periods import among

Values = TypeVar("Values", FloatArray, ComplexArray)

BAND: Final = (0.122, 15.0)
"""Band of all estimates, Hz, both ends included. It excludes the zero-frequency bin, which holds
only what is left of the mean. Its lower end is the first bin above zero of the default segment at
1 kHz."""
SEGMENT: Final = 8192
"""Samples in one segment by default (Hann window, periodic)."""
# The correlation of a Hann-windowed spectrum is below 0.1 % beyond three bins.
_MAX_LAG = 3
_SHORTEST_SEGMENT = 1024
"""Fewest samples of a segment at 1 kHz."""


def segment_for_samples(*lengths: int, rate: float = 1000.0) -> int:
    """Choose a segment length, in samples, for a record of one or several stretches.

    The default length is used if the record is at least four times as long. A shorter record gets
    the largest power of two that fits four times, so that there is something to average, but no
    fewer than 1024 samples. Only stretches that hold a whole segment count. At rates (Hz) other
    than 1 kHz, segments have about the same duration.
    """
    scale = 2.0 ** round(np.log2(rate / 1000.0))
    segment = int(SEGMENT * scale)
    while segment > _SHORTEST_SEGMENT * scale:
        if 4 * segment <= sum(length for length in lengths if length >= segment):
            break
        segment //= 2
    return segment


def step_of(segment: int) -> int:
    """Samples from the start of one segment to that of the next, which overlaps it by 3/4."""
    return segment - segment * 3 // 4


def bins_in_band(samples: int, rate: float, f_low: float, f_high: float) -> NDArray[np.intp]:
    """Bins of the Fourier transform of a record that lie in a band, both ends included.

    Zero frequency and the Nyquist frequency are never among them.
    """
    resolution = rate / samples
    first = max(1, int(np.ceil(f_low / resolution * (1.0 - 1e-12))))
    last = min((samples - 1) // 2, int(np.floor(f_high / resolution * (1.0 + 1e-12))))
    return np.arange(first, last + 1)


def sums_within(f: FloatArray, values: Values, reach: float) -> tuple[Values, NDArray[np.intp]]:
    """Sums of values, (..., n_freq), at all frequencies within `reach`, and how many these are.

    Frequencies f, (n_freq,), and the reach on either side of each are in Hz.
    """
    low, high = np.searchsorted(f, f - reach), np.searchsorted(f, f + reach, side="right")
    sums: Values = np.zeros((*values.shape[:-1], f.size + 1), dtype=values.dtype)
    np.cumsum(values, axis=-1, out=sums[..., 1:])
    return sums[..., high] - sums[..., low], high - low


def hann(length: int) -> FloatArray:
    """Periodic Hann window, shape (length,)."""
    return 0.5 - 0.5 * np.cos(2.0 * np.pi * np.arange(length) / length)


@functools.lru_cache(maxsize=32)
def _ambiguity(segment: int, step: int) -> FloatArray:
    """Overlap ``|A(j, l)|²`` of windows j steps and l bins apart, relative to ``|A(0, 0)|²``.

    ``A(j, l) = Σ_n w(n) w(n + j·step) exp(-2πi·l·n/segment)``; rows are j, columns are l.
    """
    window = hann(segment)
    turn = -2j * np.pi * np.arange(segment) / segment
    rows = []
    for shift in range(0, segment, step):
        common = window[: segment - shift] * window[shift:]
        rows.append(
            [
                abs(complex(np.sum(common * np.exp(lag * turn[: segment - shift])))) ** 2
                for lag in range(_MAX_LAG + 1)
            ]
        )
    return np.array(rows) / rows[0][0]


def segment_averages(segment: int, *runs: int) -> tuple[float, FloatArray]:
    """Effective number of averages over overlapping segments, and correlation between bins.

    Welch (1967): K segments are worth ``K / (1 + 2 Σ_j (1 - j/K) ρ_j)`` independent averages, with
    ``ρ_j = (Σ w(n) w(n + jD))² / (Σ w²)²``. A 50 s record at 1 kHz has 21 segments of the default
    length, worth 11.2 averages. With one segment, products such as ``conj(X)·N`` are correlated by
    ``|Σ w² exp(-2πi·l·n/N)|² / (Σ w²)²``, that is 1, 4/9, 1/36 at lags of 0, 1, 2 bins. Windows of
    overlapping segments are correlated across bins as well, which raises the correlation a little:
    to 1, 0.488, 0.048 for the default length and 50 s.

    Parameters
    ----------
    segment : int
        Samples in one segment.
    runs : int
        Number of segments in each stretch without a gap, at least one in all. Segments of different
        stretches have no sample in common.

    Returns
    -------
    averages : float
        Equivalent number of independent averages.
    correlation : ndarray, shape (4,)
        Correlation at lags of 0, 1, 2 and 3 bins; it is negligible beyond.
    """
    # Mean of |A(p - q, l)|² over all pairs (p, q) of segments, for each lag l.
    total = np.zeros(_MAX_LAG + 1)
    for shift, row in enumerate(_ambiguity(segment, step_of(segment))):
        for segments in runs:
            pairs = (segments - shift) * (1 if shift == 0 else 2)
            if pairs > 0:
                total += pairs * row
    total /= sum(runs) ** 2
    return float(1.0 / total[0]), total / float(total[0])


@dataclass(frozen=True, kw_only=True, eq=False)
class CrossSpectra:
    """Cross-spectral matrix of C channels."""

    f: FloatArray
    """Frequencies, Hz; shape (n_freq,)."""
    matrix: ComplexArray
    """``matrix[x, y] = G_xy = E[conj(X) Y]``, one-sided, in units of x times units of y per Hz;
    shape (C, C, n_freq)."""
    segments: int
    """Number of averaged segments."""
    effective_averages: float
    """Number of independent averages that the segments are worth."""
    bin_correlation: FloatArray
    """Correlation between averages at each bin and at the one 0, 1, 2... places above it; shape
    (lags, n_freq)."""

    def at(self, f: FloatArray) -> "CrossSpectra":
        """Return the spectra at some frequencies, Hz, such as the lines of a periodic signal."""
        kept = np.flatnonzero(among(self.f, f))
        correlation = np.zeros((len(self.bin_correlation), kept.size))
        for lag in range(min(correlation.shape)):
            lower, upper = kept[: kept.size - lag], kept[lag:]
            near = np.flatnonzero(upper - lower < len(correlation))
            correlation[lag, near] = self.bin_correlation[(upper - lower)[near], lower[near]]
        return replace(
            self,
            f=self.f[kept],
            matrix=np.ascontiguousarray(self.matrix[:, :, kept]),
            bin_correlation=correlation,
        )

    def power(self, channel: int) -> FloatArray:
        """Power density of one channel, shape (n_freq,)."""
        return np.ascontiguousarray(self.matrix[channel, channel].real)


def cross_spectra(*stretches: FloatArray, rate: float, segment: int = SEGMENT) -> CrossSpectra:
    """Average the cross-spectra of C channels over all segments, none of which spans a gap.

    Parameters
    ----------
    stretches : ndarray, shape (C, N)
        Stretches of samples without a gap; N may differ.
    rate : float
        Samples per second, Hz.
    segment : int
        Samples in one segment.

    Raises
    ------
    ConfigurationError
        If no bin falls into the band.
    DataError
        If no stretch is as long as one segment.
    """
    window, places = hann(segment), bins_in_band(segment, rate, *BAND)
    if not places.size:
        raise ConfigurationError(f"no frequency of {segment} samples at {rate} Hz is in the band")
    bins = slice(int(places[0]), int(places[-1]) + 1)
    channels = len(stretches[0])
    total = np.zeros((channels, channels, bins.stop - bins.start), dtype=np.complex128)
    runs = []
    for stretch in stretches:
        starts = range(0, stretch.shape[1] - segment + 1, step_of(segment))
        runs.append(len(starts))
        for start in starts:
            samples = stretch[:, start : start + segment]
            tapered = (samples - samples.mean(axis=1, keepdims=True)) * window
            spectrum = np.fft.rfft(tapered, axis=1)[:, bins]
            total += np.conj(spectrum)[:, None, :] * spectrum[None, :, :]
    if not any(runs):
        raise DataError(
            f"record of {sum(stretch.shape[1] for stretch in stretches)} samples is shorter than "
            f"one segment of {segment}",
            "record_too_short",
        )
    density = 1.0 / (rate * float(np.sum(window**2)))
    averages, correlation = segment_averages(segment, *runs)
    return CrossSpectra(
        f=places.astype(np.float64) * float(rate / segment),
        matrix=total * (2.0 * density / sum(runs)),
        segments=sum(runs),
        effective_averages=averages,
        bin_correlation=np.repeat(correlation[:, None], places.size, axis=1),
    )
