"""Time traces of a trial."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armimp_common.contract import PERIOD_NS
from armimp_estimation.assemble import AssembledTrial
from armimp_estimation.record import TrialRecord
from armimp_estimation.report.curves import envelope
from armimp_estimation.report.look import joint_colour
from armimp_estimation.report.plots import Plot, Stroke, Trace, View, axis, even_line, stacked

FloatArray = NDArray[np.float64]
PERIOD: float = PERIOD_NS / 1e9
"""Time from one sample to the next, s."""
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


def rows_of(segments: Sequence[TrialRecord], start_ns: int) -> list[Row]:
    """Signals of a trial as a reader wants to see them: angles in degrees, about their mean.

    Joints that were to be held still have a row of their own, as their motion is far smaller.

    Parameters
    ----------
    segments : sequence of TrialRecord
        Parts of the trial without gaps, at least one.
    start_ns : int
        Stamp of the first sample of the trial (ns).
    """
    k, n = segments[0].perturbed_joint, segments[0].joints
    everyone = tuple(range(n))
    perturbation = _whole(segments, start_ns, "perturbation")
    perturbed = tuple(j for j in everyone if j == k or np.nan_to_num(perturbation[j]).any())
    held = tuple(j for j in everyone if j not in perturbed)
    angle = np.degrees(_whole(segments, start_ns, "position"))
    angle -= np.nanmean(angle, axis=1, keepdims=True)
    torque = _whole(segments, start_ns, "torque")
    rows = [
        _row("perturbation", "N·m", perturbed, perturbation),
        _row("angle", "°", perturbed, angle),
    ]
    if held:
        rows.append(_row("held joints", "°", held, angle))
    rows.append(_row("torque on arm", "N·m", everyone, torque))
    if all(segment.command is not None for segment in segments):
        command = _whole(segments, start_ns, "command")
        rows.append(_row("command", "N·m", everyone, command))
    return rows


def trace_plot(trial: AssembledTrial, identifier: str) -> Plot:
    """Plot of a trial over time: the whole of it thinned out, and both ends in full.

    Parameters
    ----------
    trial : AssembledTrial
        With at least one segment.
    identifier : str
        Of the plot, unique in its page.
    """
    rows = rows_of(trial.segments, trial.window.start_ns)
    names = trial.segments[0].joint_names
    span = rows[0].values.shape[1]
    views = [_view("whole trial", rows, names, 0, span)]
    if span > 2 * _EXCERPT:
        length = f"{_EXCERPT * PERIOD:g} s"
        views.append(_view(f"first {length}", rows, names, 0, _EXCERPT))
        views.append(_view(f"last {length}", rows, names, span - _EXCERPT, span))
    return Plot(
        identifier=identifier,
        caption="Signals over time",
        description=(
            f"Perturbation, angles, torques and commands of trial {trial.trial} over "
            f"{span * PERIOD:.4g} s."
        ),
        views=views,
        height=130 * len(rows) + 50,
    )


def _view(name: str, rows: Sequence[Row], names: Sequence[str], start: int, stop: int) -> View:
    ordinates = [
        (1.0, axis(f"{row.title}<br>({row.unit})", hoverformat=".4~g", nticks=5)) for row in rows
    ]
    abscissa = axis(
        "time since the perturbation began (s)",
        range=[start * PERIOD, stop * PERIOD],
        hoverformat=".3f",
    )
    layout = stacked(abscissa, ordinates, gap=0.03, left=78)
    # Zooming into one view says nothing about the others.
    layout["uirevision"] = name
    return View(name=name, data=list(_lines(rows, names, start, stop)), layout=layout)


def _lines(rows: Sequence[Row], names: Sequence[str], start: int, stop: int) -> Iterator[Trace]:
    for number, row in enumerate(rows, 1):
        for joint, values in zip(row.joints, row.values, strict=True):
            thinned, step = envelope(values[start:stop], _BUCKETS)
            name = f"{row.title}, {names[joint]}"
            stroke = Stroke(name=name, colour=joint_colour(joint), width=1.0)
            yield even_line(start * PERIOD, step * PERIOD, thinned, stroke, row=number)


def _row(title: str, unit: str, joints: tuple[int, ...], values: FloatArray) -> Row:
    return Row(title=title, unit=unit, joints=joints, values=values[list(joints)])


def _whole(segments: Sequence[TrialRecord], start_ns: int, field: str) -> FloatArray:
    """Put a signal of all segments together, with NaN in the gaps; shape (n, N)."""
    starts = [round((segment.start_ns - start_ns) / PERIOD_NS) for segment in segments]
    span = max(start + part.samples for start, part in zip(starts, segments, strict=True))
    whole = np.full((segments[0].joints, span), np.nan)
    for start, segment in zip(starts, segments, strict=True):
        whole[:, start : start + segment.samples] = getattr(segment, field)
    return whole
