"""Detection of the periods of a periodic perturbation, from the perturbation as it was recorded.

A multisine of period P has power only at some multiples of 1/P, its lines. A linear arm that does
not change then responds, over whole periods, at these lines only. Power between the multiples of
1/P differs from period to period: it is noise, or change over time. Power at multiples without a
line repeats in every period: it is distortion, at even multiples by terms even in the angle, at odd
ones by odd terms (Pintelon & Schoukens, *System Identification: A Frequency Domain Approach*, 2nd
ed., ch. 3 and 4).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import reduce

import numpy as np
from numpy.typing import NDArray

from armimp_common.arrays import BoolArray, FloatArray

_SAME = 1e-9
"""Power of the difference between two periods, relative to that of the signal, below which rounding
explains it; this also holds for perturbations that are recorded with six digits."""
_FADES_IN = 0.25
"""Largest share of a record in which a perturbation may fade in."""
_FADING, _CLEARLY = 1e-5, 20.0
"""Difference of two periods where one fades: relative to the largest value, and in medians."""
_LINE = 1e-3
"""Least amplitude of a line, relative to the largest harmonic."""
_POWERLESS = 1e-4
"""Amplitude, relative to the largest, up to which an aperiodic signal counts as powerless."""
_ENOUGH = 4
"""Fewest periods with which segments may be two periods long."""
_FEWEST_COMMON = 8
"""Fewest lines that trials must share, unless one has fewer in the band."""
FEWEST_LINES = 3
"""Fewest lines of a signal that counts as periodic."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Periods:
    """Period, number of periods and lines of a periodic perturbation."""

    samples: int
    """Samples of a period."""
    count: int
    """Whole periods, one after the other; 2 or more."""
    lines: NDArray[np.intp]
    """Harmonics that have power; shape (n_lines,)."""
    end: int
    """Sample after the last period: the number of samples unless a rest follows."""

    def alike(self, other: Periods | None) -> bool:
        """Whether another perturbation has the same period and lines."""
        return (
            other is not None
            and self.samples == other.samples
            and np.array_equal(self.lines, other.lines)
        )

    @property
    def used(self) -> int:
        """Samples of all whole periods."""
        return self.samples * self.count

    @property
    def stretch(self) -> slice:
        """All whole periods among the samples of the signal."""
        return slice(self.end - self.used, self.end)

    @property
    def segment(self) -> int:
        """Samples of a Hann-windowed segment in which no line leaks into the bin of another.

        If there are too few periods for that, neighbouring lines do leak.
        """
        apart = np.min(np.diff(self.lines)) > 1
        return self.samples if apart or self.count < _ENOUGH else 2 * self.samples

    def frequencies(self, rate: float) -> FloatArray:
        """Frequencies of the lines, Hz."""
        return np.asarray(self.lines * float(rate / self.samples), dtype=np.float64)

    def lines_in(self, rate: float, band: tuple[float, float]) -> NDArray[np.intp]:
        """Lines in a band, both ends included, Hz."""
        f = self.frequencies(rate)
        inside = (f >= band[0] * (1.0 - 1e-12)) & (f <= band[1] * (1.0 + 1e-12))
        return np.asarray(self.lines[inside])

    @classmethod
    def of(cls, signal: FloatArray) -> Periods | None:
        """Find the periods of a signal, (N,), which may fade in, and rest or fade out afterwards.

        Returns
        -------
        Periods or None
            None if there are fewer than two periods, or fewer than three lines.
        """
        size, edge = signal.size, int(_FADES_IN * signal.size)
        samples = _period(signal) or _period(signal[edge:]) or _period(signal[edge : size - edge])
        if not samples:
            return None
        end = _end(signal, samples)
        signal = signal[:end]
        changes = (signal[samples:] - signal[:-samples])[end % samples :]
        differs = np.sum(changes.reshape(-1, samples) ** 2, axis=1)[::-1] >= _SAME * signal @ signal
        count = 1 + int(np.argmax(np.append(differs, True)))
        amplitudes = np.abs(np.fft.rfft(signal[end - samples :]))
        lines = 1 + np.flatnonzero(amplitudes[1:] > _LINE * np.max(amplitudes[1:]))
        if count < 2 or lines.size < FEWEST_LINES:
            return None
        return cls(samples=samples, count=count, lines=lines, end=end)


def _end(signal: FloatArray, samples: int) -> int:
    """Where the last period of a signal, (N,), ends, of which a period has some `samples`."""
    power, change = (
        np.concatenate((np.zeros(samples), np.cumsum(one**2)))
        for one in (signal, signal[samples:] - signal[:-samples])
    )
    # Of the periods that end at any sample, those that are full and like the ones before them.
    full = power[2 * samples :] - power[samples:-samples]
    alike = change[samples:] - change[:-samples] < _SAME * power[-1]
    ends = np.flatnonzero(alike & (full > 0.5 * np.max(full)))
    if ends.size == 0:
        return signal.size
    # Where it fades out, the first samples have too little power to show in that sum.
    end = int(ends[-1]) + samples + 1
    apart = np.abs(signal[samples:end] - signal[: end - samples])
    least = _FADING * float(np.max(np.abs(signal))) + _CLEARLY * float(np.median(apart))
    fading = np.flatnonzero(apart[-samples:] > least)
    return end - samples + int(fading[0]) if fading.size else end


def _period(signal: FloatArray) -> int:
    """Period, in samples, of which a signal, (N,), holds at least two; 0 if there is none."""
    total = float(np.sum(signal**2))
    if not total > 0.0:
        return 0
    # Σ (x(n) - x(n - lag))², from the sums of squares and the correlation.
    size = signal.size
    spectrum = np.fft.rfft(signal, 2 * size)
    correlation = np.fft.irfft(np.abs(spectrum) ** 2, 2 * size)[: size // 2 + 1]
    squares = np.concatenate(([0.0], np.cumsum(signal**2)))
    lags = np.arange(size // 2 + 1)
    common = (squares[-1] - squares[lags]) + squares[size - lags]
    # A smooth signal hardly changes within a few samples, so such lags are no periods.
    differs = np.flatnonzero(common - 2.0 * correlation > 0.01 * total)
    same = np.flatnonzero(common - 2.0 * correlation < _SAME * total)
    same = same[same > differs[0]] if differs.size else same[:0]
    return int(same[0]) if same.size else 0


def common_lines(
    found: Iterable[Periods | None], rate: float, band: tuple[float, float]
) -> FloatArray | None:
    """Frequencies in a band, Hz, at which all periodic perturbations have lines.

    Returns
    -------
    ndarray or None
        None if no perturbation is periodic, or they have too few lines in common.
    """
    lines: list[FloatArray] = [
        np.asarray(one.lines_in(rate, band) * (rate / one.samples), dtype=np.float64)
        for one in found
        if one is not None
    ]
    if not lines:
        return None
    same: FloatArray = reduce(lambda f, g: f[among(f, g)], lines)
    return same if same.size >= min(_FEWEST_COMMON, *(f.size for f in lines)) else None


def among(f: FloatArray, others: FloatArray) -> BoolArray:
    """Mask of the frequencies `f` that are among `others`, up to rounding errors; both in Hz."""
    return np.asarray(np.isin(np.round(f, 9), np.round(others, 9)))


def has_power(amplitudes: FloatArray) -> BoolArray:
    """Mask of the frequencies at which a signal has power, from its amplitudes, (n_freq,)."""
    return np.asarray(amplitudes > _POWERLESS * np.max(amplitudes))
