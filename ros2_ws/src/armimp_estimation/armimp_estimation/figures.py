"""Figures of a result, fit for a paper: one or two columns wide, as PNG and PDF."""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import LogLocator, MultipleLocator, NullLocator

from armimp_estimation.alignment.assemble import Trial
from armimp_estimation.atomic_write import write_atomically
from armimp_estimation.curves import ImpedanceCurve
from armimp_estimation.report.curves import (
    distances,
    element_curve,
    envelope,
    magnitude_range,
    phase_range,
    phase_step,
    true_curve,
)
from armimp_estimation.report.formats import plain
from armimp_estimation.report.look import (
    MOTION_COLOUR,
    TORQUE_COLOUR,
    TRUTH_COLOUR,
    joint_colour,
    looks,
)
from armimp_estimation.report.result_plots import PERIOD, rows_of
from armimp_estimation.result import Result
from armimp_estimation.summary import Summary

TWO_COLUMNS = 7.16
"""Width of a figure of two columns, inches."""
STYLE: Any = {
    "font.size": 8,
    "axes.titlesize": 8,
    "axes.labelsize": 8,
    "xtick.labelsize": 7,
    "ytick.labelsize": 7,
    "legend.fontsize": 7.5,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#dcdfe3",
    "grid.linewidth": 0.4,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "xtick.minor.size": 0,
    "ytick.minor.size": 0,
    "lines.linewidth": 1.1,
    "lines.markersize": 3.5,
    # Letters in the PDF stay letters, as publishers ask for.
    "pdf.fonttype": 42,
}
"""Settings of matplotlib for all figures."""
DASHES: dict[str, Any] = {
    "solid": "solid",
    "dash": (0, (4, 1.5)),
    "dashdot": (0, (5, 1.5, 1, 1.5)),
    "longdash": (0, (8, 2)),
    "longdashdot": (0, (8, 2, 1, 2)),
    "dot": (0, (1, 1.2)),
}
"""Dashes of matplotlib by the names that the report has for them."""
_TICKS = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0)
_BUCKETS = 1000
"""More than the dots of a printed column."""
_TRUE: dict[str, Any] = {"color": TRUTH_COLOUR, "linestyle": DASHES["dot"], "linewidth": 1.0}


@rc_context(STYLE)
def impedance_figure(summary: Summary, curves: Mapping[str, ImpedanceCurve]) -> Figure:
    """Bode plot of every element of Z_h with 95 % confidence bands, and how far the curves part.

    Parameters
    ----------
    summary : Summary
        Of the result.
    curves : mapping of str to ImpedanceCurve
        By name of the estimator; at least one.

    Returns
    -------
    matplotlib.figure.Figure
        For each element magnitude (N·m/rad), phase (degrees), and the distance from the truth or
        else from the reference estimator (%).
    """
    n, names = summary.joints, looks(curves)
    truth = None if summary.truth is None else summary.truth.mbk()
    keys: list[Any] = [line_key(look.name, look.colour, look.dash) for look in names.values()]
    keys.append(Patch(color="#c9cdd2", label="95 % confidence"))
    if truth is not None:
        keys.append(line_key("truth (simulation)", TRUTH_COLOUR, "dot"))
    figure, cells = element_matrix(n, TWO_COLUMNS, cell_height=2.7, rows=(3, 2, 2), keys=keys)
    grids = [curve.f for curve in curves.values()]
    for (i, k), (magnitude, phase, distance) in cells.items():
        every = []
        for name, look in names.items():
            one = element_curve(curves[name], i, k)
            style = {"color": look.colour, "linestyle": DASHES[look.dash]}
            magnitude.plot(one.f, one.magnitude, **style)
            phase.plot(one.f, one.phase, **style)
            _band(magnitude, one.f, one.magnitude_band, look.colour)
            _band(phase, one.f, one.phase_band, look.colour)
            every.append(one)
        if truth is not None:
            true = true_curve(truth, max(grids, key=len), i, k)
            magnitude.plot(true.f, true.magnitude, **_TRUE)
            phase.plot(true.f, true.phase, **_TRUE)
            every.append(true)
        parted = distances(curves, truth, i, k)
        for name, (f, off, radius) in parted.lines.items():
            look = names[name]
            _band(distance, f, (np.full(f.size, 1e-6), radius), look.colour)
            if off is not None:
                style = {"color": look.colour, "linestyle": DASHES[look.dash], "linewidth": 0.7}
                distance.plot(f, off, **style)
        log_axis(magnitude, magnitude_range(every))
        log_axis(distance, parted.ends)
        ends = phase_range(every)
        phase.set_ylim(ends)
        phase.yaxis.set_major_locator(MultipleLocator(phase_step(ends, most=3)))
        title(magnitude, f"$Z_{{{i + 1}{k + 1}}}$")
        if k == 0:
            magnitude.set_ylabel("magnitude (N·m/rad)")
            phase.set_ylabel("phase (°)")
            distance.set_ylabel("distance (%)")
        frequency_axis(distance, grids, last=i == n - 1)
    return figure


@rc_context(STYLE)
def coherence_figure(curves: Mapping[str, ImpedanceCurve]) -> Figure:
    """Coherences behind every element of Z_h.

    Parameters
    ----------
    curves : mapping of str to ImpedanceCurve
        By name of the estimator; at least one.
    """
    names, common = looks(curves), next(iter(curves.values())).coherence
    keys = [
        line_key("perturbation to angle", MOTION_COLOUR),
        line_key("perturbation to torque", TORQUE_COLOUR),
        *(line_key(f"derived, {one.name}", one.colour, one.dash) for one in names.values()),
    ]
    lowest = min(np.nanmin(one.coherence.derived) for one in curves.values())
    lowest = min(lowest, np.nanmin(common.motion), np.nanmin(common.torque))
    # One axis for all, so that they can be compared.
    floor = next((floor for floor in (0.8, 0.5) if lowest >= floor), 0.0)
    n = len(common.motion)
    figure, cells = element_matrix(n, TWO_COLUMNS, cell_height=1.2, rows=(1,), keys=keys)
    for (i, k), (axes,) in cells.items():
        axes.plot(common.f, common.motion[k], color=MOTION_COLOUR)
        axes.plot(common.f, common.torque[i, k], color=TORQUE_COLOUR)
        for name, look in names.items():
            one = curves[name].coherence
            axes.plot(one.f, one.derived[i, k], color=look.colour, linestyle=DASHES[look.dash])
        title(axes, f"$Z_{{{i + 1}{k + 1}}}$")
        axes.set_ylim(floor, 1.01)
        if k == 0:
            axes.set_ylabel("coherence $\\gamma^2$")
        frequency_axis(axes, [common.f], last=i == n - 1)
    return figure


@rc_context(STYLE)
def trace_figure(trials: Sequence[Trial], *, seconds: float = 5.0) -> Figure:
    """Signals of the trials over time: one column for each trial.

    Parameters
    ----------
    trials : sequence of Trial
        At least one, each with a segment.
    seconds : float
        From the beginning of the perturbation.
    """
    stop = max(round(seconds / PERIOD), 2)
    shown = [rows_of(one.segments, one.window.start_ns) for one in trials]
    names = trials[0].segments[0].joint_names
    keys = [line_key(name, joint_colour(joint)) for joint, name in enumerate(names)]
    count = max(len(rows) for rows in shown)
    figure, grid = _frame(
        (count, len(trials)), TWO_COLUMNS, cell_height=0.72, left=0.82, gap=(0.5, 0.12), keys=keys
    )
    labelled: list[Axes] = []
    for column, (one, rows) in enumerate(zip(trials, shown, strict=True)):
        for number, row in enumerate(rows):
            axes = figure.add_subplot(grid[number, column])
            for joint, values in zip(row.joints, row.values[:, :stop], strict=True):
                thinned, step = envelope(values, _BUCKETS)
                time = PERIOD * step * np.arange(thinned.size)
                axes.plot(time, thinned, color=joint_colour(joint), linewidth=0.5)
            axes.set_xlim(0.0, PERIOD * min(stop, row.values.shape[1]))
            axes.tick_params(labelbottom=number == len(rows) - 1)
            if column == 0:
                axes.set_ylabel(f"{row.title}\n({row.unit})", fontsize=7)
                labelled.append(axes)
            if number == 0:
                title(axes, f"{_tex(names[one.window.joint])} perturbed")
            if number == len(rows) - 1:
                axes.set_xlabel("time (s)")
    figure.align_ylabels(labelled)
    return figure


def write_figures(directory: Path, result: Result) -> None:
    """Write every figure for which a result has the data, in place of those that are there.

    Parameters
    ----------
    directory : Path
        Where ``impedance``, ``coherence`` and ``traces`` go, as PNG and PDF.
    result : Result
        The result.

    Raises
    ------
    DataError
        If one cannot be written.
    """
    if result.curves:
        save_figure(impedance_figure(result.summary, result.curves), directory / "impedance")
        save_figure(coherence_figure(result.curves), directory / "coherence")
    trials = [one for one in result.trials if one.segments]
    if trials and len(trials) <= result.summary.joints:
        save_figure(trace_figure(trials), directory / "traces")


@rc_context(STYLE)
def save_figure(figure: Figure, path: Path) -> list[Path]:
    """Write a figure as PNG and PDF; equal figures give equal files.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        The figure.
    path : Path
        Without a suffix.

    Returns
    -------
    list of Path
        The files.

    Raises
    ------
    DataError
        If one cannot be written.
    """
    if (layout := figure.get_layout_engine()) is not None:
        # Once is enough for both files.
        layout.execute(figure)
        figure.set_layout_engine("none")
    written = []
    # The time of day would make every file another one.
    for suffix, metadata in ((".png", {"Software": None}), (".pdf", {"CreationDate": None})):
        written.append(path.with_name(path.name + suffix))
        save = functools.partial(figure.savefig, dpi=200, metadata=metadata)
        write_atomically(written[-1], save, anew=True)
    return written


def line_key(label: str, colour: str, dash: str = "solid") -> Line2D:
    """Entry of a legend for a line."""
    return Line2D([], [], color=colour, linestyle=DASHES[dash], label=_tex(label))


def element_matrix(
    n: int, width: float, *, cell_height: float, rows: Sequence[int], keys: Sequence[Any]
) -> tuple[Figure, dict[tuple[int, int], list[Axes]]]:
    """Axes in the arrangement of the impedance matrix, some above each other in each place."""
    figure, grid = _frame(
        (n, n), width, cell_height=cell_height, left=0.58, gap=(0.42, 0.42), keys=keys
    )
    cells = {}
    for i, k in np.ndindex(n, n):
        inner = grid[i, k].subgridspec(len(rows), 1, height_ratios=rows, hspace=0.12)
        first = figure.add_subplot(inner[0])
        cells[i, k] = [
            first,
            *(figure.add_subplot(inner[row], sharex=first) for row in range(1, len(rows))),
        ]
        for axes in cells[i, k][:-1]:
            axes.tick_params(labelbottom=False)
    return figure, cells


def _frame(
    shape: tuple[int, int],
    width: float,
    *,
    cell_height: float,
    left: float,
    gap: tuple[float, float],
    keys: Sequence[Any],
) -> tuple[Figure, Any]:
    """Figure with a grid and a legend; all measures in inches, so that they hold for any grid."""
    rows, columns = shape
    right, top, tick_labels, legend_row = 0.1, 0.22, 0.42, 0.17
    entries = min(len(keys), 4)
    across, down = gap
    cell = (width - left - right - across * (columns - 1)) / columns
    bottom = tick_labels + legend_row * math.ceil(len(keys) / entries) + 0.06
    height = rows * cell_height + (rows - 1) * down + top + bottom
    figure = Figure(figsize=(width, height))
    grid = figure.add_gridspec(
        rows,
        columns,
        left=left / width,
        right=1.0 - right / width,
        top=1.0 - top / height,
        bottom=bottom / height,
        wspace=across / cell,
        hspace=down / cell_height,
    )
    figure.legend(handles=list(keys), loc="lower center", ncols=entries, frameon=False)
    return figure, grid


def _band(axes: Axes, f: Any, ends: tuple[Any, Any], colour: str) -> None:
    axes.fill_between(f, *ends, color=colour, alpha=0.18, linewidth=0)


def log_axis(axes: Axes, ends: tuple[float, float]) -> None:
    """Make an ordinate logarithmic, with a tick for each decade."""
    axes.set_yscale("log")
    axes.set_ylim(ends)
    if ends[1] > 10.0 * ends[0]:
        # Else some of the minor ticks have labels; but now they are only made, not seen.
        axes.yaxis.set_minor_locator(NullLocator())
    axes.yaxis.set_major_locator(LogLocator(numticks=20))
    axes.yaxis.set_major_formatter("{x:g}")


def frequency_axis(axes: Axes, grids: Sequence[Any], *, last: bool) -> None:
    """Make an abscissa logarithmic over all these frequencies (Hz); the last one has a title."""
    low, high = min(f[0] for f in grids), max(f[-1] for f in grids)
    axes.set_xscale("log")
    axes.set_xlim(low, high)
    axes.set_xticks([tick for tick in _TICKS if low <= tick <= high])
    axes.xaxis.set_major_formatter("{x:g}")
    axes.minorticks_off()
    if last:
        axes.set_xlabel("frequency (Hz)")


def title(axes: Axes, text: str) -> None:
    """Write a title above axes."""
    # With y given, no time is spent on finding out whether anything is in the way.
    axes.set_title(text, pad=3, y=1.0)


def _tex(name: str) -> str:
    """Text that matplotlib does not take for a formula."""
    return plain(name).replace("$", r"\$")
