"""Torques that a fitted arm leaves in a trial, within a band, and signals to compare them with.

Voluntary torque is mostly below that band. The edges of bands are gradual, so that ringing at the
ends of a record soon decays.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from armimp_common.arrays import EPS, TINY, ComplexArray, FloatArray
from armimp_estimation.hold_correction import HoldCorrection, command_steps, without_skew
from armimp_estimation.mbk import MBK
from armimp_estimation.record import TrialRecord

Edges: TypeAlias = tuple[tuple[float, float], tuple[float, float]]

BAND: Edges = ((0.2, 0.7), (11.0, 15.0))
"""Edges of the analysed band, Hz, over which it rises and falls."""
RATE = 200.0
"""Largest sampling rate of the analysed signals, Hz."""
_LEAST = 3.0
"""Duration of the shortest trial that is analysed, s."""
PART = 1.5
"""Length of a part, s: after it, voluntary motion and torque are hardly correlated."""
_ENDS = 3.0
"""Seconds that are left out at either end, up to the share `_MOST_ENDS` of the record."""
_MOST_ENDS = 0.2
_WIDTH = 1.0
"""Width of the bands of the linear filters, Hz."""
_SMOOTHING = 0.2
"""Standard deviation of the Gaussian that smooths weights, Hz: a voluntary rhythm is as narrow."""


class Band:
    """Signals of a record within a band, at a rate that suffices for it.

    Parameters
    ----------
    record : TrialRecord
    edges : tuple
        Edges of the band, Hz.
    by_lines : bool
        Whether each line of a periodic perturbation is a band of the linear filters. What lies
        between the lines, distortion and voluntary motion, then belongs to none: a filter of
        voluntary motion would follow voluntary torque. Nothing of the residual can remain at the
        lines, either: a slightly wrong fit leaves errors there that do not show in the scatter
        between parts of the trial. Otherwise bands are 1 Hz wide.
    """

    def __init__(self, record: TrialRecord, edges: Edges = BAND, *, by_lines: bool = True) -> None:
        f = np.fft.rfftfreq(record.samples, 1.0 / record.rate)
        (foot, top), (shoulder, end) = edges
        rise = np.clip((f - foot) / (top - foot), 0.0, 1.0)
        fall = np.clip((end - f) / (end - shoulder), 0.0, 1.0)
        passed = np.sin(0.5 * np.pi * rise) ** 2 * np.sin(0.5 * np.pi * fall) ** 2
        inside = np.flatnonzero(passed)
        self.pushes = record.perturbation[record.perturbed_joint]
        self.samples = round(record.duration * min(record.rate, RATE))
        self.bins = slice(int(inside[0]), int(inside[-1]) + 1)
        self.f = np.asarray(f[self.bins], dtype=np.float64)
        self.passed = passed[self.bins]
        ends = int(self.samples * min(_ENDS / record.duration, _MOST_ENDS))
        self.kept = slice(ends, self.samples - ends)
        """Samples without the ends, where derivatives of a truncated record ring."""
        self._hertz: NDArray[np.int64] = np.floor((self.f - self.f[0]) / _WIDTH).astype(np.int64)
        self._filter = self._hertz
        if by_lines and record.periods is not None:
            bins = np.arange(self.bins.start, self.bins.stop)
            lines = record.periods.lines * record.periods.count
            self._filter = np.where(np.isin(bins, lines), np.searchsorted(lines, bins), -1)

    @property
    def lines(self) -> NDArray[np.intp]:
        """Indices of the lines of a periodic perturbation among the bins of the band."""
        return np.flatnonzero(self._filter >= 0)

    def spectrum(self, signal: FloatArray) -> ComplexArray:
        """Spectrum, (..., bins), of a signal, (..., N), at either rate."""
        spectrum: ComplexArray = np.fft.rfft(signal - signal.mean(axis=-1, keepdims=True))
        return np.asarray(spectrum[..., self.bins] * self.passed / signal.shape[-1])

    def signal(self, spectrum: ComplexArray) -> FloatArray:
        """Signal, (..., samples), of a spectrum, (..., bins), at the lower rate, with its ends."""
        every = np.zeros((*spectrum.shape[:-1], self.samples // 2 + 1), dtype=np.complex128)
        every[..., self.bins] = spectrum * self.samples
        signal: FloatArray = np.fft.irfft(every, self.samples)
        return signal

    def inner(self, signal: FloatArray) -> FloatArray:
        """Set the ends of a signal to zero."""
        inside = np.zeros_like(signal)
        inside[self.kept] = signal[self.kept]
        return inside

    def filtered(self, spectrum: ComplexArray) -> FloatArray:
        """Split a signal, given by its spectrum, by filters; each part as it is and shifted by 90°.

        Returns
        -------
        ndarray, shape (2 filters, N)
        """
        filters = np.unique(self._filter[self._filter >= 0])
        parts = np.where(self._filter == filters[:, None], spectrum, 0.0)
        return self.signal(np.concatenate((parts, 1j * parts)))

    def varied(self, spectrum: ComplexArray) -> FloatArray:
        """Derivatives 1 and 2, (2, N), of a signal, as far as they vary within each filter."""
        s = (2j * np.pi * self.f) ** np.array([[1], [2]])
        of_filter = self._filter == np.unique(self._filter[self._filter >= 0])[:, None]
        steady = s @ (of_filter / np.sum(of_filter, axis=1, keepdims=True)).T @ of_filter
        return self.signal(np.where(self._filter >= 0, s - steady, 0.0) * spectrum)

    def caused(self, signals: FloatArray) -> FloatArray:
        """Project signals (..., samples) onto all that linear filters make of the perturbation."""
        pushes, filtered = self.spectrum(self.pushes), self._filter >= 0
        answers = np.fft.rfft(signals)[..., self.bins] / self.samples
        cross = np.where(filtered, np.conj(pushes) * answers, 0.0)
        of_filter = self._filter == np.unique(self._filter)[:, None]
        power = of_filter @ np.abs(pushes) ** 2
        gains = (cross @ of_filter.T) / np.where(power > 0.0, power, 1.0)
        return self.signal((gains @ of_filter) * pushes)

    def weights(self, *noise: FloatArray) -> FloatArray:
        """Weights by frequency that make a sum of independent signals white.

        They change gradually: signals that pass sharp edges are correlated over the whole trial,
        so that its parts would not be independent of each other.
        """
        width = _SMOOTHING / float(self.f[1] - self.f[0])
        power = np.sum([np.abs(self.spectrum(one)) ** 2 for one in noise], axis=0)
        of_noise, of_white = (
            gaussian_filter1d(one, width, mode="constant") for one in (power, self.passed**4)
        )
        return np.asarray(np.sqrt(of_white / np.maximum(of_noise, TINY)))

    def response(self, signal: FloatArray, f: FloatArray) -> ComplexArray:
        """Frequency response, (n_freq,), from the perturbation to a signal, (N,) at either rate.

        It is estimated from the cross-spectrum in bands of 1 Hz and interpolated to `f`, Hz.
        """
        pushes, answer = self.spectrum(self.pushes), self.spectrum(signal)
        cross, power = np.conj(pushes) * answer, np.abs(pushes) ** 2
        middles, real, imaginary, powers = (
            np.bincount(self._hertz, weights=one) / np.bincount(self._hertz)
            for one in (self.f, cross.real, cross.imag, power)
        )
        driven = powers > EPS * np.max(powers)
        answers = (real + 1j * imaginary)[driven] / powers[driven]
        return np.asarray(np.interp(f, middles[driven], answers), dtype=np.complex128)


def onto(forces: FloatArray) -> Callable[[FloatArray], FloatArray]:
    """Return the projection of signals (..., N) onto the rows of `forces`, (p, N)."""
    normal = np.linalg.pinv(forces @ forces.T, hermitian=True)
    return lambda signals: np.asarray((signals @ forces.T) @ normal @ forces)


@dataclass(frozen=True, kw_only=True, eq=False)
class Residual:
    """What a fitted arm leaves of the torques in one trial."""

    record: TrialRecord
    """Whole periods of the trial."""
    band: Band
    arm: MBK
    torques: ComplexArray
    """Spectra of ``τ_i - Σ_j Z_ij θ_j``, N·m; shape (n, bins)."""

    @classmethod
    def of(
        cls,
        record: TrialRecord,
        arm: MBK,
        jump: HoldCorrection | None = None,
        late: float = 0.0,
    ) -> Residual | None:
        """Subtract the torques of an arm from those of a trial; None for less than 3 s.

        Where commands overcome friction, jumps that readings miss would look like a nonlinear
        spring, so readings are corrected.

        Parameters
        ----------
        record : TrialRecord
        arm : MBK
        jump : HoldCorrection, optional
            How torques jump with the commands, if that is known.
        late : float
            Delay of the torques beyond the known one, s.
        """
        if record.duration < _LEAST:
            return None
        record = record.whole_periods
        n, band = record.joints, Band(record)
        coefficients = without_skew(band.f, record, jump, late)
        torques = np.einsum("iif,if->if", coefficients[:, :n], band.spectrum(record.torque))
        if jump is not None:
            steps = band.spectrum(command_steps(record))
            torques = torques + np.einsum("ijf,jf->if", coefficients[:, n:], steps)
        impedance, angles = arm.impedance(band.f), band.spectrum(record.position)
        torques = torques - np.einsum("ijf,jf->if", impedance, angles)
        return cls(record=record, band=band, arm=arm, torques=np.asarray(torques))


def parts_of(signals: FloatArray, seconds: float = PART) -> list[FloatArray]:
    """Split signals (..., samples) into parts, six at least, that are nearly independent."""
    count = max(round(signals.shape[-1] / (RATE * seconds)), 6)
    return np.array_split(signals, count, axis=-1)
