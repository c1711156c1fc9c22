"""Plots of a result: impedance with the distance of the estimates, coherence, signals over time."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from armimp_common.arrays import ComplexArray, FloatArray
from armimp_common.topics import PERIOD_NS
from armimp_estimation.alignment.assemble import Trial
from armimp_estimation.curves import ImpedanceCurve
from armimp_estimation.distortion import Distortion
from armimp_estimation.estimators.estimate import confidence_radius
from armimp_estimation.mbk import MBK
from armimp_estimation.record import TrialRecord
from armimp_estimation.report.formats import symbol
from armimp_estimation.report.look import joint_colour, strokes
from armimp_estimation.report.plots import (
    Axis,
    Chart,
    Line,
    Plot,
    Stroke,
    View,
    frequency_axis,
)
from armimp_estimation.spectra import WelchConfig

TRUTH = "truth"
"""Tag of true curves."""
TRUE = Stroke(name="truth", colour="--ink", dash="dot", tags=[TRUTH])
MOTION = Stroke(name="perturbation → angle", colour="--signal-0", width=1.3)
TORQUE = Stroke(name="perturbation → torque", colour="--signal-1", width=1.3)
UNRELATED = Stroke(name="unrelated signals stay below", colour="--soft", dash="dot", width=1.0)
IMPEDANCE = "N·m/rad"
SIDE_BY_SIDE = 3
"""Joints up to which the elements of a matrix are shown beside each other."""
PERIOD: float = PERIOD_NS / 1e9
"""Time from one sample to the next, s."""
BAND = 2.0 * WelchConfig.f_high
"""Up to where signals are shown: what is estimated ends at half of it, Hz."""
_ORDER = 4
_BUCKETS = 1000
_EXCERPT = 2000
"""Samples at either end that are shown in full."""
Band = tuple[FloatArray, FloatArray]
"""Lower and upper end."""
Distance = tuple[FloatArray, FloatArray | None, FloatArray]
"""Frequencies (Hz), distance, None for the reference, and radius of the 95 % circle (%)."""
_REFERENCE = "lpm_full"


def plot_matrix(joints: int, plot: Callable[[int, int], Plot]) -> list[Plot]:
    """Plots of all elements (0-based), row by row; with many joints one plot to choose from."""
    plots = {(i, k): plot(i, k) for i in range(joints) for k in range(joints)}
    if joints <= SIDE_BY_SIDE:
        return list(plots.values())
    first = plots[0, 0]
    views = [
        replace(view, name=f"Z{i + 1}{k + 1}") for (i, k), p in plots.items() for view in p.views
    ]
    return [replace(first, caption="Element", views=views, height=first.height + 60)]


def bode_chart(curves: Mapping[str, ImpedanceCurve], truth: MBK | None, i: int, k: int) -> Chart:
    """Bode plot of ``Z_ik``: every estimate with its 95 % band, the truth, and how far they part.

    There is at least one curve, by name of the estimator. The element is 0-based: torque of joint i
    over angle of joint k.
    """
    grids = [curve.f for curve in curves.values()]
    parted, ends = distances(curves, truth, i, k)
    lines, every = [], []
    for name, stroke in strokes(curves).items():
        one = element_curve(curves[name], i, k)
        f, off, radius = parted[name]
        lines += [
            Line(x=one.f, y=one.magnitude, stroke=stroke, unit=IMPEDANCE, ends=one.magnitude_band),
            Line(x=one.f, y=one.phase, stroke=stroke, row=2, unit="°", ends=one.phase_band),
            Line(
                x=f,
                y=off,
                stroke=replace(stroke, width=1.1),
                row=3,
                unit="%",
                ends=(np.zeros(f.size), radius),
            ),
        ]
        every.append(one)
    if truth is not None:
        true = true_curve(truth, max(grids, key=len), i, k)
        lines.append(Line(x=true.f, y=true.magnitude, stroke=TRUE, unit=IMPEDANCE))
        lines.append(Line(x=true.f, y=true.phase, stroke=TRUE, row=2, unit="°"))
        every.append(true)
    phases = phase_range(every)
    phase = Axis(title="phase (°)", ends=phases, step=phase_step(phases), hoverformat=".1f")
    rows = [
        (3.0, Axis(title="magnitude (N·m/rad)", ends=magnitude_range(every), log=True)),
        (2.0, phase),
        (2.4, Axis(title="distance (%)", ends=ends, log=True, hoverformat=".3~g")),
    ]
    return Chart(abscissa=frequency_axis(grids), rows=rows, lines=lines)


def bode_plot(curves: Mapping[str, ImpedanceCurve], truth: MBK | None, i: int, k: int) -> Plot:
    """Plot of a page with the chart of `bode_chart`."""
    chart = bode_chart(curves, truth, i, k)
    sizes = chart.values()
    return Plot(
        identifier=f"bode-{i + 1}-{k + 1}",
        caption=symbol("Z", i + 1, k + 1),
        description=(
            f"Magnitude and phase of Z {i + 1} {k + 1} over frequency: from {np.nanmin(sizes):.3g} "
            f"to {np.nanmax(sizes):.3g} N·m/rad, and the distance of the estimates."
        ),
        views=[chart.view()],
        height=500,
    )


def coherence_chart(
    curves: Mapping[str, ImpedanceCurve], i: int, k: int, joint_names: Sequence[str], level: float
) -> Chart:
    """Coherences behind ``Z_ik`` (0-based) over frequency, of at least one estimator by name.

    Below `level` signals count as unrelated.
    """
    common = next(iter(curves.values())).coherence
    shown = [
        (common.motion[k], replace(MOTION, name=f"{MOTION.name} of {joint_names[k]}")),
        (common.torque[i, k], replace(TORQUE, name=f"{TORQUE.name} of {joint_names[i]}")),
    ]
    for name, stroke in strokes(curves).items():
        derived = curves[name].coherence.derived[i, k]
        shown.append((derived, replace(stroke, name=f"derived, {name}")))
    lines = [Line(x=common.f, y=values, stroke=stroke) for values, stroke in shown]
    lines.append(Line(x=common.f[[0, -1]], y=np.full(2, level), stroke=UNRELATED))
    ordinate = Axis(title="coherence γ²", ends=(0.0, 1.02), hoverformat=".4f")
    return Chart(abscissa=frequency_axis([common.f]), rows=[(1.0, ordinate)], lines=lines)


def coherence_plot(
    curves: Mapping[str, ImpedanceCurve], i: int, k: int, joint_names: Sequence[str], level: float
) -> Plot:
    """Plot of a page with the chart of `coherence_chart`."""
    chart = coherence_chart(curves, i, k, joint_names, level)
    lowest = np.nanmin(np.concatenate([one.y for one in chart.lines[:-1] if one.y is not None]))
    return Plot(
        identifier=f"coherence-{i + 1}-{k + 1}",
        caption=symbol("Z", i + 1, k + 1),
        description=(
            f"Coherences behind Z {i + 1} {k + 1} over frequency; the lowest is {lowest:.2g}."
        ),
        views=[chart.view()],
        height=250,
    )


def distortion_plot(found: Distortion, trial: int) -> Plot:
    """Torque at the lines of the perturbation, at harmonics between them, and noise there."""
    odd, even = found.beside["odd"], found.beside["even"]
    shown = [
        (found.lines, Stroke(name="at lines", colour="--soft", symbol="circle")),
        (odd, Stroke(name="odd harmonics", colour="--element-1", symbol="square")),
        (even, Stroke(name="even harmonics", colour="--element-0", symbol="diamond")),
    ]
    lines = [Line(x=one.f, y=one.amplitude, stroke=mark, unit="N·m") for one, mark in shown]
    f = np.concatenate([one.f for one, _ in shown])
    order = np.argsort(f)
    noise = np.concatenate([one.noise for one, _ in shown])
    floor = Stroke(name="noise between harmonics", colour="--ink", dash="dot", width=1.0)
    lines.append(Line(x=f[order], y=noise[order], stroke=floor, unit="N·m"))
    ordinate = Axis(title="torque (N·m)", log=True, hoverformat=".3~g")
    return Plot(
        identifier=f"distortion-{trial}",
        caption=f"Trial {trial}",
        description=(
            f"Torque at the harmonics of the perturbation: {found.lines.rms:.3g} N·m at its lines, "
            f"{odd.rms:.3g} at odd and {even.rms:.3g} at even ones beside them."
        ),
        views=[Chart(abscissa=frequency_axis([f]), rows=[(1.0, ordinate)], lines=lines).view()],
        height=280,
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Row:
    """Signals that are drawn over each other."""

    title: str
    unit: str
    """Of the axis."""
    joints: tuple[int, ...]
    """Joint of each signal, 0-based."""
    values: FloatArray
    """One value for each control period; NaN where there is none; shape (len(joints), N)."""


def rows_of(
    segments: Sequence[TrialRecord], start_ns: int, *, cutoff: float | None = BAND
) -> list[Row]:
    """Signals of a trial as a reader wants to see them: angles in degrees, about their mean.

    Joints that were to be held still have a row of their own, as their motion is far smaller.
    Commands and torques chatter far above the band in which the arm is perturbed, so that all of
    them would be solid bars.

    Parameters
    ----------
    segments : sequence of TrialRecord
        Parts of the trial without gaps, at least one.
    start_ns : int
        Stamp of the first sample of the trial (ns).
    cutoff : float or None
        Of the low-pass that the signals are seen through, Hz; None shows them as recorded.
    """
    starts = [round((segment.start_ns - start_ns) / PERIOD_NS) for segment in segments]
    span = max(start + part.samples for start, part in zip(starts, segments, strict=True))

    def signal(field: str) -> FloatArray:
        """Signal of all segments, with NaN in the gaps; shape (n, span)."""
        whole = np.full((segments[0].joints, span), np.nan)
        for start, segment in zip(starts, segments, strict=True):
            values = getattr(segment, field)
            seen = values if cutoff is None else _smoothed(values, cutoff / segment.rate)
            whole[:, start : start + segment.samples] = seen
        return whole

    def row(title: str, unit: str, joints: tuple[int, ...], values: FloatArray) -> Row:
        return Row(title=title, unit=unit, joints=joints, values=values[list(joints)])

    everyone = tuple(range(segments[0].joints))
    perturbation, angle = signal("perturbation"), np.degrees(signal("position"))
    angle -= np.nanmean(angle, axis=1, keepdims=True)
    k = segments[0].perturbed_joint
    perturbed = tuple(j for j in everyone if j == k or np.nan_to_num(perturbation[j]).any())
    held = tuple(j for j in everyone if j not in perturbed)
    rows = [
        row("perturbation", "N·m", perturbed, perturbation),
        row("angle", "°", perturbed, angle),
        *([row("held joints", "°", held, angle)] if held else []),
        row("torque on arm", "N·m", everyone, signal("torque")),
    ]
    if all(segment.command is not None for segment in segments):
        rows.append(row("command", "N·m", everyone, signal("command")))
    return rows


def _smoothed(values: FloatArray, cutoff: float) -> FloatArray:
    """Signals without what is above a frequency, cycles per sample; neither early nor late."""
    # A sampled Butterworth filter there and back, on the signal and its mirror image. That of
    # scipy.signal does the same, but takes longer to import than the whole report to write.
    mirrored = np.concatenate((values, values[:, ::-1]), axis=1)
    ratio = np.tan(np.pi * np.fft.rfftfreq(mirrored.shape[1])) / np.tan(np.pi * cutoff)
    seen = np.fft.irfft(np.fft.rfft(mirrored) / (1.0 + ratio ** (2 * _ORDER)), mirrored.shape[1])
    return seen[:, : values.shape[1]]


def trace_views(trial: Trial, prefix: str = "", buckets: int = _BUCKETS) -> list[View]:
    """Views of a trial over time: the whole of it, its ends, and what was recorded.

    The trial has at least one segment. The names of the views begin with the prefix; long signals
    are thinned out into so many parts, see `envelope`.
    """
    start_ns, names = trial.window.start_ns, trial.segments[0].joint_names
    seen = rows_of(trial.segments, start_ns)
    recorded = rows_of(trial.segments, start_ns, cutoff=None)
    span = seen[0].values.shape[1]
    short = min(_EXCERPT, span)
    parts = [("whole trial", seen, 0, span)]
    if span > _EXCERPT:
        length = f"{_EXCERPT * PERIOD:g} s"
        parts.append((f"first {length}", seen, 0, short))
        parts.append((f"last {length}", seen, span - short, span))
    parts.append((f"last {short * PERIOD:g} s as recorded", recorded, span - short, span))
    return [
        # Zooming into one view says nothing about the others.
        trace_chart(rows, names, part, buckets).view(f"{prefix}{name}", uirevision=name)
        for name, rows, *part in parts
    ]


def trace_plot(identifier: str, description: str, views: Sequence[View]) -> Plot:
    """Plot of views of one or several trials."""
    rows = max(sum(key.startswith("yaxis") for key in view.layout) for view in views)
    return Plot(
        identifier=identifier,
        caption="Signals over time",
        description=description,
        views=views,
        height=125 * rows + 50,
    )


def trace_chart(
    rows: Sequence[Row], names: Sequence[str], part: Sequence[int], buckets: int = _BUCKETS
) -> Chart:
    """Signals over time, of joints with these names.

    Shown are the samples from the first of `part` to the one before the second, thinned out into so
    many parts, see `envelope`.
    """
    start, stop = part
    lines = []
    for number, row in enumerate(rows, 1):
        for joint, values in zip(row.joints, row.values, strict=True):
            name, colour = f"{row.title}, {names[joint]}", joint_colour(joint)
            stroke = Stroke(name=name, colour=colour, width=1.0)
            thinned, step = envelope(values[start:stop], buckets)
            place = (start * PERIOD, step * PERIOD)
            lines.append(Line(x=place, y=thinned, stroke=stroke, row=number, unit=row.unit))
    abscissa = Axis(
        title="time since the perturbation began (s)",
        ends=(start * PERIOD, stop * PERIOD),
        hoverformat=".3f",
        unit="s",
    )
    ordinates = [(1.0, Axis(title=f"{row.title}<br>({row.unit})")) for row in rows]
    return Chart(abscissa=abscissa, rows=ordinates, lines=lines)


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


def reference_of(curves: Mapping[str, ImpedanceCurve], truth: MBK | None) -> str:
    """Tell what estimates are compared with: the truth (empty), or an estimator by its name."""
    if truth is not None:
        return ""
    return _REFERENCE if _REFERENCE in curves else next(iter(curves))


def distances(
    curves: Mapping[str, ImpedanceCurve], truth: MBK | None, i: int, k: int
) -> tuple[dict[str, Distance], tuple[float, float]]:
    """Distance of every estimate of ``Z_ik`` (0-based) from its reference, see `reference_of`.

    And the ends of a logarithmic axis that shows them, %.
    """
    reference = reference_of(curves, truth)
    lines: dict[str, Distance] = {}
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
    return lines, (float(min(low, 0.15 * high)), float(1.5 * high))


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
