"""Plots of a result: impedance with the distance of the estimates, coherence, signals over time."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from armimp_common.topics import PERIOD_NS
from armimp_estimation.alignment.assemble import Trial
from armimp_estimation.curves import ImpedanceCurve
from armimp_estimation.mbk import MBK
from armimp_estimation.record import TrialRecord
from armimp_estimation.report.curves import (
    distances,
    element_curve,
    envelope,
    magnitude_range,
    phase_range,
    phase_step,
    true_curve,
)
from armimp_estimation.report.formats import symbol
from armimp_estimation.report.look import joint_variable, looks
from armimp_estimation.report.plots import (
    Plot,
    Stroke,
    View,
    axis,
    band,
    frequency_axis,
    line,
    log_axis,
    stacked,
)
from armimp_estimation.spectra import WelchConfig

FloatArray = NDArray[np.float64]
BANDS = "bands"
"""Tag of confidence bands."""
TRUTH = "truth"
"""Tag of true curves."""
SIDE_BY_SIDE = 3
"""Joints up to which the elements of a matrix are shown beside each other."""
_IMPEDANCE = "N·m/rad"
PERIOD: float = PERIOD_NS / 1e9
"""Time from one sample to the next, s."""
BAND = 2.0 * WelchConfig.f_high
"""Up to where signals are shown: what is estimated ends at half of it, Hz."""
_ORDER = 4
_BUCKETS = 1000
_EXCERPT = 2000
"""Samples at either end that are shown in full."""


def estimator_tag(name: str) -> str:
    """Tag of everything that an estimator found."""
    return f"estimator:{name}"


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


def bode_plot(curves: Mapping[str, ImpedanceCurve], truth: MBK | None, i: int, k: int) -> Plot:
    """Bode plot of ``Z_ik``: every estimate with its 95 % band, the truth, and how far they part.

    Parameters
    ----------
    curves : mapping of str to ImpedanceCurve
        By name of the estimator; at least one.
    truth : MBK or None
        True matrices.
    i, k : int
        Element, 0-based: torque of joint i over angle of joint k.
    """
    grids = [curve.f for curve in curves.values()]
    parted = distances(curves, truth, i, k)
    data, every = [], []
    for name, look in looks(curves).items():
        tags = [estimator_tag(name)]
        stroke = Stroke(name=name, colour=look.variable, dash=look.dash, tags=tags)
        one = element_curve(curves[name], i, k)
        for row, values, ends, unit in (
            (1, one.magnitude, one.magnitude_band, _IMPEDANCE),
            (2, one.phase, one.phase_band, "°"),
        ):
            data.append(band(one.f, ends, look.variable, [*tags, BANDS], row=row))
            data.append(line(one.f, values, stroke, row=row, unit=unit, ends=ends))
        f, off, radius = parted.lines[name]
        data.append(band(f, (np.full(f.size, 1e-6), radius), look.variable, [*tags, BANDS], row=3))
        if off is not None:
            thin, ends = replace(stroke, width=1.1), (np.zeros(f.size), radius)
            data.append(line(f, off, thin, row=3, unit="%", ends=ends))
        every.append(one)
    if truth is not None:
        true = true_curve(truth, max(grids, key=len), i, k)
        stroke = Stroke(name="truth", colour="--ink", dash="dot", tags=[TRUTH])
        data.append(line(true.f, true.magnitude, stroke, unit=_IMPEDANCE))
        data.append(line(true.f, true.phase, stroke, row=2, unit="°"))
        every.append(true)
    phases = phase_range(every)
    rows = [
        (3.0, log_axis("magnitude (N·m/rad)", magnitude_range(every), ".4~g")),
        (
            2.0,
            axis(
                "phase (°)",
                range=list(phases),
                tick0=0,
                dtick=phase_step(phases, most=5),
                hoverformat=".1f",
            ),
        ),
        (2.4, log_axis("distance (%)", parted.ends, ".3~g")),
    ]
    sizes = np.concatenate([one.magnitude for one in every])
    return Plot(
        identifier=f"bode-{i + 1}-{k + 1}",
        caption=symbol("Z", i + 1, k + 1),
        description=(
            f"Magnitude and phase of Z {i + 1} {k + 1} over frequency: from {np.nanmin(sizes):.3g} "
            f"to {np.nanmax(sizes):.3g} N·m/rad, and the distance of the estimates."
        ),
        views=[View(data=data, layout=stacked(frequency_axis(grids), rows))],
        height=500,
    )


def coherence_plot(
    curves: Mapping[str, ImpedanceCurve], i: int, k: int, joint_names: Sequence[str], level: float
) -> Plot:
    """Coherences behind ``Z_ik`` over frequency.

    Parameters
    ----------
    curves : mapping of str to ImpedanceCurve
        By name of the estimator; at least one.
    i, k : int
        Element, 0-based.
    joint_names : sequence of str
        Names of the joints.
    level : float
        Coherence below which signals count as unrelated.
    """
    common = next(iter(curves.values())).coherence
    f, motion, torque = common.f, common.motion[k], common.torque[i, k]
    strokes = [
        Stroke(name=f"perturbation → angle of {joint_names[k]}", colour="--signal-0", width=1.3),
        Stroke(name=f"perturbation → torque of {joint_names[i]}", colour="--signal-1", width=1.3),
    ]
    shown = [motion, torque]
    for name, look in looks(curves).items():
        strokes.append(
            Stroke(
                name=f"derived, {name}",
                colour=look.variable,
                dash=look.dash,
                tags=[estimator_tag(name)],
            )
        )
        shown.append(curves[name].coherence.derived[i, k])
    data = [line(f, values, stroke) for values, stroke in zip(shown, strokes, strict=True)]
    limit = Stroke(name="unrelated signals stay below", colour="--soft", dash="dot", width=1.0)
    data.append(line(f[[0, -1]], np.full(2, level), limit) | {"hoverinfo": "skip"})
    ordinate = axis("coherence γ²", range=[0.0, 1.02], hoverformat=".4f")
    return Plot(
        identifier=f"coherence-{i + 1}-{k + 1}",
        caption=symbol("Z", i + 1, k + 1),
        description=(
            f"Coherences behind Z {i + 1} {k + 1} over frequency; the lowest is "
            f"{np.nanmin(shown):.2g}."
        ),
        views=[View(data=data, layout=stacked(frequency_axis([f]), [(1.0, ordinate)]))],
        height=250,
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Row:
    """Signals that are drawn over each other.

    Attributes
    ----------
    title, unit : str
        Of the axis.
    joints : tuple of int
        Joint of each signal, 0-based.
    values : ndarray, shape (len(joints), N)
        One value for each control period; NaN where there is none.
    """

    title: str
    unit: str
    joints: tuple[int, ...]
    values: FloatArray


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

    Parameters
    ----------
    trial : Trial
        With at least one segment.
    prefix : str
        Of the names of the views.
    buckets : int
        Parts into which long signals are thinned out, see `envelope`.
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
        _view(f"{prefix}{name}", rows, names, (start, stop), buckets)
        for name, rows, start, stop in parts
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


def _view(
    name: str, rows: Sequence[Row], names: Sequence[str], part: tuple[int, int], buckets: int
) -> View:
    start, stop = part
    data = []
    for number, row in enumerate(rows, 1):
        for joint, values in zip(row.joints, row.values, strict=True):
            title, colour = f"{row.title}, {names[joint]}", joint_variable(joint)
            stroke = Stroke(name=title, colour=colour, width=1.0)
            thinned, step = envelope(values[start:stop], buckets)
            place = (start * PERIOD, step * PERIOD)
            data.append(line(place, thinned, stroke, row=number, unit=row.unit))
    abscissa = axis(
        "time since the perturbation began (s)",
        range=[start * PERIOD, stop * PERIOD],
        hoverformat=".3f",
        unifiedhovertitle={"text": "%{x} s"},
    )
    ordinates = [
        (1.0, axis(f"{row.title}<br>({row.unit})", hoverformat=".4~g", nticks=5)) for row in rows
    ]
    layout = stacked(abscissa, ordinates, gap=0.03, left=78)
    # Zooming into one view says nothing about the others.
    return View(name=name, data=data, layout=layout | {"uirevision": name})
