"""Curves as they are drawn, in the report and in the figures of a paper alike."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from armimp_common.arrays import ComplexArray, FloatArray
from armimp_estimation.curves import ImpedanceCurve
from armimp_estimation.estimators.estimate import confidence_radius
from armimp_estimation.mbk import MBK

Band = tuple[FloatArray, FloatArray]
"""Lower and upper end."""
_REFERENCE = "lpm_full"


@dataclass(frozen=True, kw_only=True, eq=False)
class BodeCurve:
    """Magnitude and phase of one element of the impedance matrix over frequency."""

    f: FloatArray
    """Frequencies, Hz; shape (n_freq,)."""
    magnitude: FloatArray
    phase: FloatArray
    """Magnitude (N·m/rad) and phase (degrees), each of shape (n_freq,)."""
    radius: FloatArray
    """Radius of the circle about each value that holds the truth in 95 %, N·m/rad; NaN if unknown;
    shape (n_freq,)."""

    @property
    def magnitude_band(self) -> Band:
        """The 95 % band of the magnitude, N·m/rad."""
        # A logarithmic axis has no zero: the lower end stays positive, far below the curve.
        lower = np.maximum(self.magnitude - self.radius, 1e-3 * self.magnitude)
        return lower, self.magnitude + self.radius

    @property
    def phase_band(self) -> Band:
        """The 95 % band of the phase, degrees."""
        with np.errstate(divide="ignore", invalid="ignore"):
            sine = self.radius / self.magnitude
        # The circle is seen from the origin under this angle; from within it, all around.
        spread = np.degrees(np.where(sine < 1.0, np.arcsin(np.minimum(sine, 1.0)), np.pi))
        return self.phase - spread, self.phase + spread


def element_curve(curve: ImpedanceCurve, i: int, k: int) -> BodeCurve:
    """Curve of the estimate of ``Z_ik`` (0-based)."""
    radius = np.full(curve.f.size, np.nan)
    if curve.averages > 1.0:
        radius = confidence_radius(curve.variance[i, k], curve.averages)
    return _bode(curve.f, curve.Z[i, k], radius)


def true_curve(truth: MBK, f: FloatArray, i: int, k: int) -> BodeCurve:
    """Curve of the true ``Z_ik`` (0-based)."""
    return _bode(f, truth.impedance(f)[i, k], np.zeros(f.size))


def _bode(f: FloatArray, z: ComplexArray, radius: FloatArray) -> BodeCurve:
    phase = np.degrees(np.unwrap(np.angle(z)))
    # The turn in which the unwrapped phase begins is chance, most of all where noise begins it.
    phase = phase - 360.0 * np.round(np.median(phase) / 360.0)
    return BodeCurve(f=f, magnitude=np.abs(z), phase=phase, radius=radius)


def phase_about(truth: ComplexArray, z: ComplexArray) -> FloatArray:
    """Phase of an estimate, degrees, counted from that of the truth so that it never jumps a turn.

    Both have shape (n_freq,), at the same frequencies, N·m/rad.
    """
    return np.degrees(np.unwrap(np.angle(truth)) + np.angle(z / truth))


def deviation_percent(truth: ComplexArray, z: ComplexArray) -> FloatArray:
    """Distance of an estimate from the truth in the complex plane, % of the truth."""
    return 100.0 * np.abs(z / truth - 1.0)


@dataclass(frozen=True, kw_only=True, eq=False)
class Distances:
    """How far the estimates of one element are from their reference."""

    lines: Mapping[str, tuple[FloatArray, FloatArray | None, FloatArray]]
    """By name of the estimator: frequencies (Hz), distance (%), and radius of the 95 % confidence
    circle (%). The reference itself has no distance."""
    ends: tuple[float, float]
    """Of a logarithmic axis that shows them, %."""


def reference_of(curves: Mapping[str, ImpedanceCurve], truth: MBK | None) -> str:
    """Tell what estimates are compared with: the truth (empty), or an estimator by its name."""
    if truth is not None:
        return ""
    return _REFERENCE if _REFERENCE in curves else next(iter(curves))


def distances(curves: Mapping[str, ImpedanceCurve], truth: MBK | None, i: int, k: int) -> Distances:
    """Distance of every estimate of ``Z_ik`` (0-based) from its reference, see `reference_of`."""
    reference = reference_of(curves, truth)
    lines: dict[str, tuple[FloatArray, FloatArray | None, FloatArray]] = {}
    found = []
    for name, curve in curves.items():
        if truth is not None:
            centre = truth.impedance(curve.f)[i, k]
        else:
            other = curves[reference]
            centre = np.interp(curve.f, other.f, other.Z[i, k])
        off = None if name == reference else deviation_percent(centre, curve.Z[i, k])
        radius = 100.0 * element_curve(curve, i, k).radius / np.abs(centre)
        lines[name] = curve.f, off, radius
        found += [radius] if off is None else [radius, off]
    values = np.concatenate(found)
    values = values[np.isfinite(values) & (values > 0.0)]
    low, high = np.quantile(values, (0.02, 0.995)) if values.size else (0.01, 60.0)
    return Distances(lines=lines, ends=(float(min(low, 0.15 * high)), float(1.5 * high)))


# The ranges follow the curves, not their bands: one wild band must not flatten everything else.
def magnitude_range(curves: Sequence[BodeCurve]) -> tuple[float, float]:
    """Range of a logarithmic axis that shows all of the magnitudes, N·m/rad."""
    values = np.concatenate([one.magnitude for one in curves])
    low, high = _range(np.log10(values[np.isfinite(values) & (values > 0.0)]), 0.06, 0.02)
    return 10.0**low, 10.0**high


def phase_range(curves: Sequence[BodeCurve]) -> tuple[float, float]:
    """Range of an axis that shows all of the phases, degrees."""
    values = np.concatenate([one.phase for one in curves])
    return _range(values[np.isfinite(values)], 0.08, 2.0)


def phase_step(ends: tuple[float, float]) -> float:
    """Distance of ticks on an axis of phases, degrees, so that there are five of them at most."""
    span = ends[1] - ends[0]
    return next((step for step in (15.0, 30.0, 45.0, 90.0) if span <= 5.0 * step), 180.0)


def _range(values: FloatArray, share: float, least: float) -> tuple[float, float]:
    if not values.size:
        return 0.0, 1.0
    low, high = float(values.min()), float(values.max())
    margin = share * (high - low) + least
    return low - margin, high + margin


def envelope(values: FloatArray, buckets: int) -> tuple[FloatArray, float]:
    """Thin out a signal so that it looks the same where there are no more pixels than buckets.

    Parameters
    ----------
    values : ndarray, shape (N,)
        The signal; NaN where there is a gap.
    buckets : int
        Number of parts; each gives its smallest and its largest value, in their order in time.

    Returns
    -------
    thinned : ndarray, shape (at most 2·buckets,)
        The signal itself if it is no longer than that.
    step : float
        Distance of the thinned values, in samples of the signal.
    """
    if values.size <= 2 * buckets:
        return values, 1.0
    size = -(-values.size // buckets)
    padded = np.full(-(-values.size // size) * size, np.nan)
    padded[: values.size] = values
    parts = padded.reshape(-1, size)
    gaps = np.isnan(parts)
    lowest = np.argmin(np.where(gaps, np.inf, parts), axis=1)
    highest = np.argmax(np.where(gaps, -np.inf, parts), axis=1)
    order = np.sort(np.stack([lowest, highest], axis=1), axis=1)
    return np.take_along_axis(parts, order, axis=1).ravel(), size / 2
