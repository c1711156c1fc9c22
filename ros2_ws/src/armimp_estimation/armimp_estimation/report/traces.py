"""Time traces of a trial."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armimp_common.topics import PERIOD_NS
from armimp_estimation.alignment.assemble import Trial
from armimp_estimation.record import TrialRecord
from armimp_estimation.report.curves import envelope
from armimp_estimation.report.look import joint_variable
from armimp_estimation.report.plots import Plot, Stroke, View, axis, line, stacked
from armimp_estimation.spectra import WelchConfig

FloatArray = NDArray[np.float64]
PERIOD: float = PERIOD_NS / 1e9
"""Time from one sample to the next, s."""
BAND = 2.0 * WelchConfig.f_high
"""Up to where signals are shown: what is estimated ends at half of it, Hz."""
_ORDER = 4
_BUCKETS = 1000
_EXCERPT = 2000
"""Samples at either end that are shown in full."""


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
