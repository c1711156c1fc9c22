"""Segment-averaged cross-spectra of several channels.

The convention is that of :func:`scipy.signal.csd`: ``G_xy = E[conj(X) Y]``, one-sided density.
"""

import functools
import math
from dataclasses import dataclass, replace

import numpy as np

from armimp_common.arrays import ComplexArray, FloatArray
from armimp_common.errors import ConfigurationError, DataError

# The correlation of a Hann-windowed spectrum is below 0.1 % beyond three bins.
_MAX_LAG = 3
_SHORTEST_SEGMENT = 1024


@dataclass(frozen=True, kw_only=True)
class WelchConfig:
    """Segments and band of the averaged spectra."""

    segment: int = 8192
    """Samples in one segment (Hann window, periodic); the frequency resolution is rate/segment."""
    overlap: int = 6144
    """Samples that neighbouring segments share."""
    f_low: float = 0.122
    f_high: float = 15.0
    """Band that is kept, Hz, both ends included. The zero-frequency bin is never kept: it only
    holds what is left of the mean. The default lower end is the first bin above zero of the default
    segment at 1 kHz."""

    def __post_init__(self) -> None:
        if self.segment < 8:
            raise ConfigurationError(f"segment must be 8 samples or more, got {self.segment}")
        if not 0 <= self.overlap < self.segment:
            raise ConfigurationError(
                f"overlap must lie between 0 and segment - 1 = {self.segment - 1}, "
                f"got {self.overlap}"
            )
        if not 0.0 <= self.f_low < self.f_high < math.inf:
            raise ConfigurationError(
                f"band must satisfy 0 <= f_low < f_high, got {self.f_low!r} to {self.f_high!r} Hz"
            )

    @classmethod
    def for_samples(cls, *lengths: int, rate: float = 1000.0) -> "WelchConfig":
        """Segments that suit a record of so many samples, in one stretch or in several.

        The default from four segments' length on; a shorter record takes the largest power of two
        that fits four times, so that there is something to average, down to 1024 samples. Only
        stretches that hold a whole segment count. At other rates than 1 kHz (in Hz) segments are of
        about the same time.
        """
        scale = 2.0 ** round(np.log2(rate / 1000.0))
        segment = int(cls.segment * scale)
        while segment > _SHORTEST_SEGMENT * scale:
            if 4 * segment <= sum(length for length in lengths if length >= segment):
                break
            segment //= 2
        return cls(segment=segment, overlap=segment * 3 // 4)

    @property
    def step(self) -> int:
        """Samples from the beginning of one segment to that of the next."""
        return self.segment - self.overlap

    def frequencies(self, rate: float) -> FloatArray:
        """Frequencies of the kept bins, Hz, for a sampling rate in Hz."""
        first, stop = self.bins(rate)
        bins: FloatArray = np.arange(first, stop, dtype=np.float64)
        return bins * float(rate / self.segment)

    def bins(self, rate: float) -> tuple[int, int]:
        """First kept bin and the one after the last, for a sampling rate in Hz.

        Raises
        ------
        ConfigurationError
            If no bin falls into the band.
        """
        resolution = rate / self.segment
        first = max(1, math.ceil(self.f_low / resolution * (1.0 - 1e-12)))
        last = min(self.segment // 2, math.floor(self.f_high / resolution * (1.0 + 1e-12)))
        if last < first:
            raise ConfigurationError(
                f"no frequency between {self.f_low} and {self.f_high} Hz at a resolution of "
                f"{resolution:.4g} Hz"
            )
        return first, last + 1


def hann(length: int) -> FloatArray:
    """Periodic Hann window, shape (length,)."""
    return 0.5 - 0.5 * np.cos(2.0 * np.pi * np.arange(length) / length)


@functools.lru_cache(maxsize=32)
def _ambiguity(segment: int, step: int) -> FloatArray:
    """Common energy ``|A(j, l)|²`` of windows j steps and l bins apart, over ``|A(0, 0)|²``.

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


def segment_averages(config: WelchConfig, *runs: int) -> tuple[float, FloatArray]:
    """Worth of averages over overlapping segments, and their correlation between bins.

    Welch (1967): ``K / (1 + 2 Σ_j (1 - j/K) ρ_j)`` independent averages with
    ``ρ_j = (Σ w(n) w(n + jD))² / (Σ w²)²``. A 50 s record at 1 kHz has 21 segments in the default
    configuration, worth 11.2 averages. Averaged products (such as ``conj(X)·N``) are correlated by
    ``|Σ w² exp(-2πi·l·n/N)|² / (Σ w²)²`` if there is one segment, that is 1, 4/9, 1/36 at lags of
    0, 1, 2 bins. Overlapping segments, whose windows are correlated across bins as well, raise it a
    little: 1, 0.488, 0.048 for the default configuration and 50 s.

    Parameters
    ----------
    config : WelchConfig
        Segments.
    runs : int
        Number of segments in each stretch without a gap, at least one in all; those of different
        stretches have no sample in common.

    Returns
    -------
    averages : float
        Number of independent averages.
    correlation : ndarray, shape (4,)
        Correlation at lags of 0, 1, 2 and 3 bins; it is negligible beyond.
    """
    # Mean of |A(p - q, l)|² over all pairs (p, q) of segments, for each lag l.
    total = np.zeros(_MAX_LAG + 1)
    for shift, row in enumerate(_ambiguity(config.segment, config.step)):
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
    """Number of independent averages that these are worth."""
    bin_correlation: FloatArray
    """Correlation of averages at each bin and the one 0, 1, 2... places above it; shape
    (lags, n_freq)."""

    def at(self, f: FloatArray) -> "CrossSpectra":
        """Return those at some frequencies, Hz, such as the lines of a periodic signal."""
        kept = np.flatnonzero(np.isin(np.round(self.f, 9), np.round(f, 9)))
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


def cross_spectra(
    *stretches: FloatArray, rate: float, config: WelchConfig | None = None
) -> CrossSpectra:
    """Average the cross-spectra of C channels over all segments, none of which spans a gap.

    Parameters
    ----------
    stretches : ndarray, shape (C, N)
        Samples without a gap, of any length N each.
    rate : float
        Samples per second, Hz.
    config : WelchConfig, optional
        Segments and band.

    Raises
    ------
    ConfigurationError
        If no bin falls into the band.
    DataError
        If no stretch is as long as one segment.
    """
    options = config if config is not None else WelchConfig()
    segment = options.segment
    window = hann(segment)
    bins = slice(*options.bins(rate))
    channels = len(stretches[0])
    total = np.zeros((channels, channels, bins.stop - bins.start), dtype=np.complex128)
    runs = []
    for stretch in stretches:
        starts = range(0, stretch.shape[1] - segment + 1, options.step)
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
    one_sided = np.full(total.shape[-1], 2.0 * density / sum(runs))
    if segment % 2 == 0 and bins.stop == segment // 2 + 1:
        one_sided[-1] *= 0.5  # the Nyquist bin has no negative twin
    averages, correlation = segment_averages(options, *runs)
    return CrossSpectra(
        f=options.frequencies(rate),
        matrix=total * one_sided,
        segments=sum(runs),
        effective_averages=averages,
        bin_correlation=np.repeat(correlation[:, None], one_sided.size, axis=1),
    )
