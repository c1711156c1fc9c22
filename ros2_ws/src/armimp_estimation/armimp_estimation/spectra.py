"""Segment-averaged cross-spectra of several channels, gathered while the samples arrive.

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
def _ambiguity(segment: int, step: int) -> tuple[tuple[float, ...], ...]:
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
    whole = rows[0][0]
    return tuple(tuple(value / whole for value in row) for row in rows)


def _overlap_sums(config: WelchConfig, *runs: int) -> FloatArray:
    """Mean of ``|A(p - q, l)|²`` over all pairs (p, q) of segments, for each lag l of bins.

    Segments of different runs have no sample in common.
    """
    total = np.zeros(_MAX_LAG + 1)
    for shift, row in enumerate(_ambiguity(config.segment, config.step)):
        for segments in runs:
            pairs = (segments - shift) * (1 if shift == 0 else 2)
            if pairs > 0:
                total += pairs * np.array(row)
    return total / sum(runs) ** 2


def effective_averages(config: WelchConfig, *runs: int) -> float:
    """Number of independent averages that so many overlapping segments are worth.

    Of a record with gaps, the number of segments in each run without one.

    Welch (1967): ``K / (1 + 2 Σ_j (1 - j/K) ρ_j)`` with
    ``ρ_j = (Σ w(n) w(n + jD))² / (Σ w²)²``. A 50 s record at 1 kHz has 21 segments in the default
    configuration, worth 11.2 averages.
    """
    if sum(runs) < 1:
        return 0.0
    return float(1.0 / _overlap_sums(config, *runs)[0])


def bin_correlation(config: WelchConfig, *runs: int) -> FloatArray:
    """Correlation between averaged products (such as ``conj(X)·N``) of neighbouring bins.

    For one segment it is ``|Σ w² exp(-2πi·l·n/N)|² / (Σ w²)²``, that is 1, 4/9, 1/36 at lags of
    0, 1, 2 bins. Overlapping segments, whose windows are correlated across bins as well,
    raise it a little: 1, 0.488, 0.048 for the default configuration and 50 s.

    Returns
    -------
    ndarray, shape (4,)
        Correlation at lags of 0, 1, 2 and 3 bins; it is negligible beyond.
    """
    sums = _overlap_sums(config, *(runs if sum(runs) else (1,)))
    return sums / float(sums[0])


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


class SpectralAccumulator:
    """Averages the cross-spectra of C channels while blocks of samples are pushed.

    Each segment is processed when its last sample arrives, always from the same buffer and in
    the same order, so that the result is bit-identical however the record was cut into blocks.

    Parameters
    ----------
    channels : int
        Number of channels C.
    rate : float
        Samples per second, Hz.
    config : WelchConfig
        Segments and band.
    """

    def __init__(self, channels: int, rate: float, config: WelchConfig | None = None) -> None:
        self._config = config if config is not None else WelchConfig()
        self._rate = rate
        self._bins = slice(*self._config.bins(rate))
        self._window = hann(self._config.segment)
        self._buffer = np.zeros((channels, self._config.segment))
        self._filled = 0
        self._samples = 0
        self._segments = 0
        self._earlier_runs: tuple[int, ...] = ()
        self._sum = np.zeros(
            (channels, channels, self._bins.stop - self._bins.start), dtype=np.complex128
        )

    @property
    def samples(self) -> int:
        """Number of samples pushed so far."""
        return self._samples

    @property
    def segments(self) -> int:
        """Number of segments averaged so far."""
        return self._segments

    def push(self, block: FloatArray) -> None:
        """Append samples, shape (C, m) with any m.

        Raises
        ------
        DataError
            If the number of channels is wrong or a sample is not finite. Nothing is appended then.
        """
        channels, segment = self._buffer.shape
        if block.ndim != 2 or block.shape[0] != channels:
            raise DataError(f"block has shape {block.shape}, expected ({channels}, m)")
        if not np.isfinite(block).all():
            channel, sample = np.argwhere(~np.isfinite(block))[0]
            raise DataError(
                f"channel {channel} is {block[channel, sample]} at sample {self._samples + sample}"
            )
        taken = 0
        while taken < block.shape[1]:
            count = min(segment - self._filled, block.shape[1] - taken)
            self._buffer[:, self._filled : self._filled + count] = block[:, taken : taken + count]
            self._filled += count
            taken += count
            if self._filled == segment:
                self._add_segment()
                kept = self._config.overlap
                self._buffer[:, :kept] = self._buffer[:, segment - kept :].copy()
                self._filled = kept
        self._samples += block.shape[1]

    def interrupt(self) -> None:
        """Begin anew after a gap: no segment shall hold samples of both sides."""
        run = self._segments - sum(self._earlier_runs)
        self._earlier_runs += (run,) if run else ()
        self._filled = 0

    def _add_segment(self) -> None:
        tapered = self._buffer - self._buffer.mean(axis=1, keepdims=True)
        tapered *= self._window
        spectrum = np.fft.rfft(tapered, axis=1)[:, self._bins]
        self._sum += np.conj(spectrum)[:, None, :] * spectrum[None, :, :]
        self._segments += 1

    def result(self) -> CrossSpectra:
        """Averages over the segments so far; more samples may be pushed afterwards.

        Raises
        ------
        DataError
            If the record is shorter than one segment.
        """
        if self._segments == 0:
            raise DataError(
                f"record of {self._samples} samples is shorter than one segment of "
                f"{self._config.segment}",
                "record_too_short",
            )
        runs = (*self._earlier_runs, self._segments - sum(self._earlier_runs))
        density = 1.0 / (self._rate * float(np.sum(self._window**2)))
        one_sided = np.full(self._sum.shape[-1], 2.0 * density / self._segments)
        if self._config.segment % 2 == 0 and self._bins.stop == self._config.segment // 2 + 1:
            one_sided[-1] *= 0.5  # the Nyquist bin has no negative twin
        return CrossSpectra(
            f=self._config.frequencies(self._rate),
            matrix=self._sum * one_sided,
            segments=self._segments,
            effective_averages=effective_averages(self._config, *runs),
            bin_correlation=np.repeat(
                bin_correlation(self._config, *runs)[:, None], one_sided.size, axis=1
            ),
        )
