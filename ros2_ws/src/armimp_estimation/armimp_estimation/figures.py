"""Figures of a result, fit for a paper: one or two columns wide, as PNG and PDF."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from armimp_common.errors import DataError
from armimp_estimation.alignment.assemble import AssembledTrial
from armimp_estimation.lean_fonts import lean_fonts
from armimp_estimation.report.curves import (
    BodeCurve,
    CoherenceCurves,
    coherence_curves,
    coherence_floor,
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
    Look,
    joint_colour,
    looks,
)
from armimp_estimation.report.result import Result
from armimp_estimation.report.traces import PERIOD, rows_of
from armimp_estimation.results import ImpedanceCurve, Summary

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.gridspec import GridSpec

FORMATS = ("png", "pdf")
ONE_COLUMN = 3.5
"""Width of a column, inches."""
TWO_COLUMNS = 7.16
# The types of matplotlib for these differ from version to version.
_STYLE: Any = {
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
    # Letters in the PDF stay letters, as publishers ask for.
    "pdf.fonttype": 42,
}
_DASHES: dict[str, Any] = {
    "solid": "solid",
    "dash": (0, (4, 1.5)),
    "dashdot": (0, (5, 1.5, 1, 1.5)),
    "longdash": (0, (8, 2)),
    "longdashdot": (0, (8, 2, 1, 2)),
    "dot": (0, (1, 1.2)),
}
_TICKS = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0)
_RIGHT, _TOP = 0.1, 0.22
"""Margins, inches."""
_BUCKETS = 1000
"""More than the dots of a printed column."""
_LEGEND_ROW = 0.17
_AXIS_LABEL = 0.42
"""Height of tick labels and title of an abscissa, inches."""


def impedance_figure(
    summary: Summary, curves: Mapping[str, ImpedanceCurve], *, width: float = TWO_COLUMNS
) -> Figure:
    """Bode plot of every element of Z_h, with 95 % confidence bands and, if known, the truth.

    Parameters
    ----------
    summary : Summary
        Of the result.
    curves : mapping of str to ImpedanceCurve
        By name of the estimator; at least one.
    width : float
        Of the figure, inches.

    Returns
    -------
    matplotlib.figure.Figure
        Magnitude (N·m/rad) above phase (degrees), one pair for each element.
    """
    from matplotlib import rc_context
    from matplotlib.patches import Patch
    from matplotlib.ticker import LogLocator, MultipleLocator, NullLocator

    n = summary.joints
    names = looks(curves)
    with rc_context(_STYLE):
        keys = [_line_key(look.label, look.colour, look.dash) for look in names.values()]
        keys.append(Patch(color="#c9cdd2", label="95 % confidence"))
        if summary.truth is not None:
            keys.append(_line_key("truth (simulation)", TRUTH_COLOUR, "dot"))
        height = 1.4 + 0.6 * width / TWO_COLUMNS
        figure, cells = _matrix(n, width, cell_height=height, rows=(3, 2), entries=len(keys))
        for (i, k), (magnitude, phase) in cells.items():
            shown = {name: element_curve(curve, i, k) for name, curve in curves.items()}
            for name, look in names.items():
                _draw_bode(shown[name], look, magnitude, phase)
            every = list(shown.values())
            if summary.truth is not None:
                finest = max((curve.f for curve in curves.values()), key=len)
                true = true_curve(summary.truth.mbk(), finest, i, k)
                style: dict[str, Any] = {
                    "color": TRUTH_COLOUR,
                    "linestyle": _DASHES["dot"],
                    "linewidth": 1.0,
                }
                magnitude.plot(true.f, true.magnitude, **style)
                phase.plot(true.f, true.phase, **style)
                every.append(true)
            magnitude.set_yscale("log")
            low, high = magnitude_range(every)
            magnitude.set_ylim(low, high)
            if high > 10.0 * low:
                # Else some of the minor ticks have labels; but now they are only made, not seen.
                magnitude.yaxis.set_minor_locator(NullLocator())
            ends = phase_range(every)
            phase.set_ylim(ends)
            phase.yaxis.set_major_locator(MultipleLocator(phase_step(ends, most=3)))
            magnitude.yaxis.set_major_locator(LogLocator(numticks=20))
            magnitude.yaxis.set_major_formatter("{x:g}")
            _title(magnitude, f"$Z_{{{i + 1}{k + 1}}}$")
            if k == 0:
                magnitude.set_ylabel("magnitude (N·m/rad)" if width > ONE_COLUMN else "N·m/rad")
                phase.set_ylabel("phase (°)")
            _frequency_axis(phase, [curve.f for curve in curves.values()], last=i == n - 1)
        _legend(figure, keys)
    return figure


def coherence_figure(
    curves: Mapping[tuple[int, int], CoherenceCurves],
    joints: int,
    *,
    width: float = TWO_COLUMNS,
) -> Figure:
    """Coherences behind every element of Z_h.

    Parameters
    ----------
    curves : mapping of (int, int) to CoherenceCurves
        By element, 0-based.
    joints : int
        Number of joints n.
    width : float
        Of the figure, inches.
    """
    from matplotlib import rc_context

    floor = coherence_floor(curves.values())
    names = looks(dict.fromkeys(name for one in curves.values() for name in one.derived))
    with rc_context(_STYLE):
        keys = [
            _line_key("perturbation to angle", MOTION_COLOUR),
            _line_key("perturbation to torque", TORQUE_COLOUR),
        ]
        keys += [_line_key(f"derived, {o.label}", o.colour, o.dash) for o in names.values()]
        height = 0.8 + 0.4 * width / TWO_COLUMNS
        figure, cells = _matrix(joints, width, cell_height=height, rows=(1,), entries=len(keys))
        for (i, k), (axes,) in cells.items():
            _title(axes, f"$Z_{{{i + 1}{k + 1}}}$")
            axes.set_ylim(floor, 1.01)
            if k == 0:
                axes.set_ylabel("coherence $\\gamma^2$")
            if (i, k) in curves:
                one = curves[i, k]
                axes.plot(one.f, one.motion, color=MOTION_COLOUR)
                axes.plot(one.f, one.torque, color=TORQUE_COLOUR)
                for name, values in one.derived.items():
                    look = names[name]
                    axes.plot(one.f, values, color=look.colour, linestyle=_DASHES[look.dash])
                _frequency_axis(axes, [one.f], last=i == joints - 1)
        _legend(figure, keys)
    return figure


def trace_figure(
    trials: Sequence[AssembledTrial], *, seconds: float = 5.0, width: float = TWO_COLUMNS
) -> Figure:
    """Signals of the trials over time: one column for each trial.

    Parameters
    ----------
    trials : sequence of TrialEvidence
        At least one, each with a segment.
    seconds : float
        From the beginning of the perturbation.
    width : float
        Of the figure, inches.
    """
    from matplotlib import rc_context

    stop = max(round(seconds / PERIOD), 2)
    shown = [rows_of(one.segments, one.window.start_ns) for one in trials]
    names = trials[0].segments[0].joint_names
    count = max(len(rows) for rows in shown)
    with rc_context(_STYLE):
        figure, grid = _Frame(
            columns=len(trials),
            rows=count,
            width=width,
            cell_height=0.72,
            left=0.82,
            gap=(0.5, 0.12),
            legend_rows=math.ceil(len(names) / _legend_columns(width)),
        ).make()
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
                    _title(axes, f"{_tex(names[one.window.joint])} perturbed")
                if number == len(rows) - 1:
                    axes.set_xlabel("time (s)")
        figure.align_ylabels(labelled)
        _legend(figure, [_line_key(name, joint_colour(j)) for j, name in enumerate(names)])
    return figure


def drawings(result: Result) -> dict[str, Callable[[], Figure]]:
    """What draws each figure that a result gives, by its name.

    Parameters
    ----------
    result : Result
        The result; figures for which it lacks the data are left out.
    """
    n, curves = result.summary.joints, result.curves
    found: dict[str, Callable[[], Figure]] = {}
    if curves:
        found["impedance"] = lambda: impedance_figure(result.summary, curves)
        elements = coherence_curves(curves, n)
        found["coherence"] = lambda: coherence_figure(elements, n)
    trials = [one for one in result.trials if one.segments]
    if trials and len(trials) <= n:
        found["traces"] = lambda: trace_figure(trials)
    return found


def write_figures(directory: Path, result: Result) -> None:
    """Write every figure that a result gives, as PNG and PDF, in place of those that are there.

    Parameters
    ----------
    directory : Path
        Where ``impedance``, ``coherence`` and ``traces`` go.
    result : Result
        See `drawings`.

    Raises
    ------
    DataError
        If one cannot be written.
    """
    for name, draw in drawings(result).items():
        figure = draw()
        for form in FORMATS:
            save_figure(figure, directory / f"{name}.{form}")


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure in the format that its path names; equal figures give equal files.

    Raises
    ------
    DataError
        If it cannot be written.
    """
    from matplotlib import rc_context

    metadata = {"CreationDate": None} if path.suffix == ".pdf" else {"Software": None}
    try:
        with rc_context(_STYLE), lean_fonts():
            figure.savefig(path, dpi=200, metadata=metadata)
    except OSError as error:
        raise DataError(f"{path}: cannot be written: {error.strerror}") from None


@dataclass(frozen=True, kw_only=True)
class _Frame:
    """Measures of a figure of several axes, in inches: what is between them stays as it is."""

    columns: int
    rows: int
    width: float
    cell_height: float
    left: float
    gap: tuple[float, float]
    legend_rows: int = 1

    def make(self) -> tuple[Figure, GridSpec]:
        from matplotlib.figure import Figure

        across, down = self.gap
        inner = self.width - self.left - _RIGHT
        cell = (inner - across * (self.columns - 1)) / self.columns
        bottom = _AXIS_LABEL + _LEGEND_ROW * self.legend_rows + 0.06
        height = self.rows * self.cell_height + (self.rows - 1) * down + _TOP + bottom
        figure = Figure(figsize=(self.width, height))
        grid = figure.add_gridspec(
            self.rows,
            self.columns,
            left=self.left / self.width,
            right=1.0 - _RIGHT / self.width,
            top=1.0 - _TOP / height,
            bottom=bottom / height,
            wspace=across / cell,
            hspace=down / self.cell_height,
        )
        return figure, grid


def _matrix(
    n: int, width: float, *, cell_height: float, rows: Sequence[int], entries: int
) -> tuple[Figure, dict[tuple[int, int], list[Axes]]]:
    """Axes in the arrangement of the impedance matrix, some above each other in each place."""
    figure, grid = _Frame(
        columns=n,
        rows=n,
        width=width,
        cell_height=cell_height,
        left=0.58,
        gap=(0.42, 0.42),
        legend_rows=math.ceil(entries / _legend_columns(width)),
    ).make()
    cells = {}
    for i in range(n):
        for k in range(n):
            inner = grid[i, k].subgridspec(len(rows), 1, height_ratios=rows, hspace=0.1)
            first = figure.add_subplot(inner[0])
            others = [figure.add_subplot(inner[r], sharex=first) for r in range(1, len(rows))]
            for axes in [first, *others][:-1]:
                axes.tick_params(labelbottom=False)
            cells[i, k] = [first, *others]
    return figure, cells


def _draw_bode(curve: BodeCurve, look: Look, magnitude: Axes, phase: Axes) -> None:
    line: dict[str, Any] = {"color": look.colour, "linestyle": _DASHES[look.dash]}
    fill: dict[str, Any] = {"color": look.colour, "alpha": 0.18, "linewidth": 0}
    magnitude.plot(curve.f, curve.magnitude, **line)
    phase.plot(curve.f, curve.phase, **line)
    magnitude.fill_between(curve.f, *curve.magnitude_band, **fill)
    phase.fill_between(curve.f, *curve.phase_band, **fill)


def _frequency_axis(axes: Axes, grids: Sequence[Any], *, last: bool) -> None:
    low, high = min(f[0] for f in grids), max(f[-1] for f in grids)
    axes.set_xscale("log")
    axes.set_xlim(low, high)
    axes.set_xticks([tick for tick in _TICKS if low <= tick <= high])
    axes.xaxis.set_major_formatter("{x:g}")
    axes.minorticks_off()
    if last:
        axes.set_xlabel("frequency (Hz)")


def _title(axes: Axes, text: str) -> None:
    # With y given, no time is spent on finding out whether anything is in the way.
    axes.set_title(text, pad=3, y=1.0)


def _legend_columns(width: float) -> int:
    return 4 if width > ONE_COLUMN else 2


def _legend(figure: Figure, handles: Sequence[Any]) -> None:
    columns = min(len(handles), _legend_columns(figure.get_figwidth()))
    figure.legend(handles=handles, loc="lower center", ncols=columns, frameon=False)


def _line_key(label: str, colour: str, dash: str = "solid") -> Any:
    from matplotlib.lines import Line2D

    return Line2D([], [], color=colour, linestyle=_DASHES[dash], label=_tex(label))


def _tex(name: str) -> str:
    """Text that matplotlib does not take for a formula."""
    return plain(name).replace("$", r"\$")
