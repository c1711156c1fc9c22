"""Figures of a result for a paper: one or two columns wide, as PNG and PDF."""

from __future__ import annotations

import functools
import io
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import LogLocator, NullLocator
from matplotlib.transforms import ScaledTranslation

from armimp_estimation.alignment.assemble import Trial
from armimp_estimation.atomic_write import write_atomically
from armimp_estimation.report.formats import plain
from armimp_estimation.report.plots import (
    CONFIDENCE,
    MOTION,
    TORQUE,
    TRUE,
    UNRELATED,
    Axis,
    Chart,
    Stroke,
    bode_chart,
    coherence_chart,
    joint_strokes,
    printed,
    rows_of,
    strokes,
    trace_chart,
)
from armimp_estimation.result import Result

TWO_COLUMNS = 7.16
"""Width of a two-column figure, inches."""
_STYLE = Path(__file__).with_name("paper.mplstyle")
DASHES: dict[str, Any] = {
    "solid": "solid",
    "dash": (0, (4, 1.5)),
    "dashdot": (0, (5, 1.5, 1, 1.5)),
    "longdash": (0, (8, 2)),
    "longdashdot": (0, (8, 2, 1, 2)),
    "dot": (0, (1, 1.2)),
}
"""Dash patterns of matplotlib by their names in the report."""
MARKERS = {
    "circle": "o",
    "square": "s",
    "triangle-up": "^",
    "diamond": "D",
    "triangle-down": "v",
    "cross": "P",
    "x": "X",
}
"""Markers of matplotlib by their names in the report."""
_THINNER = 0.65
"""Line width on paper, in points, per pixel of line width on a page."""
_SECONDS = 5.0
"""Length of the signals shown, from the start of the perturbation."""


@rc_context(fname=_STYLE)
def matrix_figure(
    charts: Sequence[Sequence[Chart]],
    titles: Sequence[Sequence[str]],
    legend: Iterable[Stroke],
    *,
    row_height: float,
    width: float = TWO_COLUMNS,
) -> Figure:
    """Draw a grid of charts with a common legend of their strokes.

    Parameters
    ----------
    charts, titles : charts by row and column, and the titles above them in matplotlib's markup
    legend : iterable of Stroke
    row_height : height of an axis whose relative height is 1, inches
    width : width of the figure, inches
    """
    rows, columns = len(charts), len(charts[0])
    keys: list[Any] = [Line2D([], [], **_drawn(one), label=_tex(one.name)) for one in legend]
    first = charts[0][0]
    if any(line.band(first.rows[line.row - 1][1]) is not None for line in first.lines):
        keys.append(Patch(color="#c9cdd2", label=CONFIDENCE.name))
    # All measures are in inches, so that they hold for any grid.
    left, right, top, gap = 0.72, 0.1, 0.22, 0.42
    entries = min(len(keys), 4 if rows * columns > 1 else 8)
    bottom = 0.48 + 0.17 * math.ceil(len(keys) / entries)
    tallest = row_height * max(sum(part for part, _ in one.rows) for row in charts for one in row)
    widest = (width - left - right - gap * (columns - 1)) / columns
    height = rows * tallest + (rows - 1) * gap + top + bottom
    figure = Figure(figsize=(width, height))
    figure.legend(handles=keys, loc="lower center", ncols=entries, frameon=False)
    # With places given, matplotlib does not look for room beside the numbers at the ticks.
    below, beside = (
        ScaledTranslation(*inches, figure.dpi_scale_trans)
        for inches in ((0.0, -0.26), (0.03 - left, 0.0))
    )
    grid = figure.add_gridspec(
        rows,
        columns,
        left=left / width,
        right=1.0 - right / width,
        top=1.0 - top / height,
        bottom=bottom / height,
        wspace=gap / widest,
        hspace=gap / tallest,
    )
    for (i, k), title in np.ndenumerate(np.array(titles)):
        chart = charts[i][k]
        heights = [height for height, _ in chart.rows]
        inner = grid[i, k].subgridspec(len(heights), 1, height_ratios=heights, hspace=0.12)
        panels = [figure.add_subplot(inner[row]) for row in range(len(heights))]
        _draw(chart, panels)
        # With y given, it spends no time on checking whether the title collides either.
        panels[0].set_title(title, pad=3, y=1.0)
        for panel in panels:
            panel.xaxis.set_label_coords(0.5, 0.0, panel.transAxes + below)
            panel.yaxis.set_label_coords(0.0, 0.5, panel.transAxes + beside)
        for panel in panels[:-1]:
            panel.tick_params(labelbottom=False)
        if k == 0:
            for panel, (_, axis) in zip(panels, chart.rows, strict=True):
                panel.set_ylabel(axis.title.replace("<br>", "\n"), va="top")  # from the left
        if i == rows - 1:
            panels[-1].set_xlabel(chart.abscissa.title)
    return figure


def element_figure(
    joints: int, chart: Callable[[int, int], Chart], legend: Iterable[Stroke], **size: float
) -> Figure:
    """Draw charts of all n x n elements (0-based), arranged like the impedance matrix.

    Height and width are those of `matrix_figure`.
    """
    each = range(joints)
    titles = [[f"$Z_{{{i + 1}{k + 1}}}$" for k in each] for i in each]
    return matrix_figure([[chart(i, k) for k in each] for i in each], titles, legend, **size)


def impedance_figure(result: Result) -> Figure:
    """Draw a `bode_chart` of every element of Z_h, for a result with curves."""
    curves, truth, n = result.curves, result.summary.truth, result.summary.joints
    keys = [*strokes(curves).values(), *([] if truth is None else [TRUE])]
    return element_figure(n, lambda i, k: bode_chart(curves, truth, i, k), keys, row_height=0.38)


def coherence_figure(result: Result) -> Figure:
    """Draw the coherences behind every element of Z_h, for a result with curves."""
    derived = [replace(one, name=f"derived, {one.name}") for one in strokes(result.curves).values()]
    return element_figure(
        result.summary.joints,
        lambda i, k: coherence_chart(result, i, k),
        [MOTION, TORQUE, *derived, UNRELATED],
        row_height=1.2,
    )


def trace_figure(trials: Sequence[Trial]) -> Figure:
    """Draw the signals of trials over time, side by side; each must have at least one segment."""
    names = trials[0].segments[0].joint_names
    charts = []
    for one in trials:
        first = one.segments[0]
        rows = rows_of(one.segments, one.window.start_ns)
        stop = min(round(_SECONDS * first.rate), rows[0].values.shape[1])
        charts.append(trace_chart(rows, first, 0, stop, stop))
    titles = [f"{_tex(names[one.segments[0].perturbed_joint])} perturbed" for one in trials]
    return matrix_figure([charts], [titles], joint_strokes(names), row_height=0.8)


def write_figures(directory: Path, result: Result) -> None:
    """Write every figure for which a result has the data, replacing existing ones.

    The figures are ``impedance``, ``coherence`` and ``traces`` in a directory, as PNG and PDF.

    Raises
    ------
    DataError
        If a figure cannot be written.
    """
    if result.curves:
        save_figure(impedance_figure(result), directory / "impedance")
        save_figure(coherence_figure(result), directory / "coherence")
    trials = [one for one in result.trials if one.segments]
    if trials and len(trials) <= result.summary.joints:
        save_figure(trace_figure(trials), directory / "traces")


@rc_context(fname=_STYLE)
def save_figure(figure: Figure, path: Path) -> list[Path]:
    """Write a figure as PNG and PDF, and return their paths; equal figures give equal files.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
    path : path of the files without a suffix

    Raises
    ------
    DataError
        If a file cannot be written.
    """
    written = []
    # With the time of day, no two files would be equal.
    for suffix, metadata in ((".png", {"Software": None}), (".pdf", {"CreationDate": None})):
        written.append(path.with_name(path.name + suffix))
        # In memory first: matplotlib fails at more than the disk when that is full.
        figure.savefig(drawn := io.BytesIO(), format=suffix[1:], dpi=200, metadata=metadata)
        write = functools.partial(Path.write_bytes, data=drawn.getvalue())
        write_atomically(written[-1], write, anew=True)
    return written


def _drawn(stroke: Stroke) -> dict[str, Any]:
    """Options with which matplotlib draws a stroke."""
    style: dict[str, Any] = {"color": printed(stroke.colour)}
    if stroke.symbol:
        return style | {"linestyle": "none", "marker": MARKERS[stroke.symbol]}
    return style | {"linestyle": DASHES[stroke.dash], "linewidth": _THINNER * stroke.width}


def _draw(chart: Chart, panels: Sequence[Axes]) -> None:
    """Draw a chart into its panels, which are above each other."""
    for one in chart.lines:
        panel, (_, axis) = panels[one.row - 1], chart.rows[one.row - 1]
        style = _drawn(one.stroke)
        if (band := one.band(axis)) is not None:
            panel.fill_between(*band, color=style["color"], alpha=0.18, linewidth=0)
        if one.stroke.symbol:
            panel.errorbar(one.x, one.y, yerr=one.reach, elinewidth=0.9, **style)
        else:
            panel.plot(one.x, one.y, **style)
    for panel, (_, axis) in zip(panels, chart.rows, strict=True):
        _scale(panel, "x", chart.abscissa)
        _scale(panel, "y", axis)


def _scale(panel: Axes, letter: str, axis: Axis) -> None:
    """Give the ``x`` or the ``y`` axis of a panel the scale, ends and ticks of a chart's axis."""
    shown = getattr(panel, f"{letter}axis")
    if axis.log:
        panel.set(**{f"{letter}scale": "log"})
        if axis.ticks or axis.ends is None or axis.ends[1] > 10.0 * axis.ends[0]:
            # Minor ticks would cost time without being seen; on shorter axes some have labels.
            shown.set_minor_locator(NullLocator())
        shown.set_major_locator(LogLocator(numticks=20))
        shown.set_major_formatter("{x:g}")
    if axis.ends is not None:
        panel.set(**{f"{letter}lim": axis.ends})
    if axis.ticks:
        shown.set_ticks(axis.ticks, axis.labels or None)


def _tex(name: str) -> str:
    """Escape a text so that matplotlib does not take it for a formula."""
    return plain(name).replace("$", r"\$")
