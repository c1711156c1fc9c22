"""Periods of a perturbation that repeats itself, found in the perturbation as it was recorded.

A multisine of period P has power at some multiples of 1/P only, its lines. Of an arm that is linear
and doesn't change, whole periods then show answers at these lines alone. What is between the
multiples of 1/P differs from period to period: noise, and change over time. What is at multiples
without a line comes back in every period: distortion, at even ones by what is even in the angle, at
odd ones by what is odd (Pintelon & Schoukens, *System Identification: A Frequency Domain Approach*,
2nd ed., ch. 3 and 4).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import reduce

import numpy as np
from numpy.typing import NDArray

from armimp_common.arrays import BoolArray, FloatArray

_SAME = 1e-9
"""Power of the difference of two periods, relative to that of the signal, that rounding explains.

Perturbations that are recorded with six digits are within it.
"""
_FADES_IN = 0.25
"""Largest part of a record in which a perturbation may fade in."""
_LINE = 1e-3
"""Amplitude relative to the largest from which on a harmonic is a line."""
_POWERLESS = 1e-4
"""Amplitude relative to the largest below which what does not repeat itself has no power."""
_ENOUGH = 4
_FEWEST_COMMON = 8
FEWEST_LINES = 3


@dataclass(frozen=True, kw_only=True, eq=False)
class Periods:
    """How a perturbation repeats itself."""

    samples: int
    """In a period."""
    count: int
    """Whole periods in the record, which has them at its end; 2 or more."""
    lines: NDArray[np.intp]
    """Harmonics that have power; shape (n_lines,)."""

    @property
    def used(self) -> int:
        """Samples of all whole periods."""
        return self.samples * self.count

    @property
    def segment(self) -> int:
        """Samples of a segment with a Hann window in which no line reaches the bin of another.

        Where there are too few periods for that, neighbours do.
        """
        apart = np.min(np.diff(self.lines)) > 1
        return self.samples if apart or self.count < _ENOUGH else 2 * self.samples

    def frequencies(self, rate: float) -> FloatArray:
        """Those of the lines, Hz."""
        return np.asarray(self.lines * float(rate / self.samples), dtype=np.float64)

    def lines_in(self, rate: float, band: tuple[float, float]) -> NDArray[np.intp]:
        """Lines in a band, both ends included, Hz."""
        f = self.frequencies(rate)
        inside = (f >= band[0] * (1.0 - 1e-12)) & (f <= band[1] * (1.0 + 1e-12))
        return np.asarray(self.lines[inside])

    @classmethod
    def of(cls, signal: FloatArray) -> Periods | None:
        """Find those of a signal, (N,), which may fade in.

        Returns
        -------
        Periods or None
            None if fewer than two are there, or fewer than three lines.
        """
        size = signal.size
        samples = _period(signal) or _period(signal[int(_FADES_IN * size) :])
        if not samples:
            return None
        changes = (signal[samples:] - signal[:-samples])[size % samples :]
        differs = np.sum(changes.reshape(-1, samples) ** 2, axis=1)[::-1] >= _SAME * signal @ signal
        count = 1 + int(np.argmax(np.append(differs, True)))
        amplitudes = np.abs(np.fft.rfft(signal[size - samples :]))
        lines = 1 + np.flatnonzero(amplitudes[1:] > _LINE * np.max(amplitudes[1:]))
        if lines.size < FEWEST_LINES:
            return None
        return cls(samples=samples, count=count, lines=lines)


def _period(signal: FloatArray) -> int:
    """Samples after which a signal, (N,), repeats itself, at least twice; 0 if it doesn't."""
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
    # A smooth signal hardly changes within a sample or two.
    differs = np.flatnonzero(common - 2.0 * correlation > 0.01 * total)
    same = np.flatnonzero(common - 2.0 * correlation < _SAME * total)
    same = same[same > differs[0]] if differs.size else same[:0]
    return int(same[0]) if same.size else 0


def common_periods(found: Sequence[Periods | None]) -> Periods | None:
    """Return the first of several trials if all have the same period and lines, else None."""
    first = found[0] if found else None
    if first is None:
        return None
    same = all(
        one is not None and one.samples == first.samples and np.array_equal(one.lines, first.lines)
        for one in found
    )
    return first if same else None


def common_lines(
    found: Iterable[Periods | None], rate: float, band: tuple[float, float]
) -> FloatArray | None:
    """Frequencies in a band, Hz, at which all perturbations that are periodic have lines.

    Returns
    -------
    ndarray or None
        None if none is periodic, or they have too few in common.
    """
    lines: list[FloatArray] = [
        np.asarray(one.lines_in(rate, band) * (rate / one.samples), dtype=np.float64)
        for one in found
        if one is not None
    ]
    if not lines:
        return None
    same: FloatArray = reduce(lambda f, g: f[np.isin(np.round(f, 9), np.round(g, 9))], lines)
    return same if same.size >= min(_FEWEST_COMMON, *(f.size for f in lines)) else None


def has_power(amplitudes: FloatArray) -> BoolArray:
    """Where a signal has power, from the amplitudes of its spectrum, (n_freq,)."""
    return np.asarray(amplitudes > _POWERLESS * np.max(amplitudes))
