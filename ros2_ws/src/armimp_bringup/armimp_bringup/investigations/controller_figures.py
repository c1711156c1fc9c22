"""Figure of the investigation of the controller."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

from armimp_bringup.investigations.controller_outcomes import Cell
from armimp_bringup.investigations.writing import COLOURS, MARKERS, WIDTH

_LINES: Final[tuple[Any, ...]] = ("-", "--", ":", "-.")
_ROWS: Final[tuple[tuple[str, Callable[[Cell], float]], ...]] = (
    ("rms error of M (%)", lambda cell: 100.0 * float(cell.rms[0])),
    ("rms error of B (%)", lambda cell: 100.0 * float(cell.rms[1])),
    ("bias by the lock (%)", lambda cell: 100.0 * cell.lock_bias),
)


def controller_figure(
    cells: Sequence[Cell], defaults: Mapping[str, float], names: Mapping[str, str]
) -> Any:
    """Errors, and the bias that motion of locked joints may cause, over each of the parameters.

    Parameters
    ----------
    cells : all of the investigation
    defaults : value of every parameter where it is not varied
    names : of the parameters, for people
    """
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

    varied = [
        name for name in names if any(cell.setting.parameter == name for cell in cells)
    ] or list(names)
    places = list(dict.fromkeys(cell.place for cell in cells))
    estimators = list(dict.fromkeys(cell.estimator for cell in cells))
    figure = Figure(figsize=(WIDTH, 4.3), layout="constrained")
    axes = figure.subplots(len(_ROWS), len(varied), sharey="row", sharex="col", squeeze=False)
    for column, name in enumerate(varied):
        for row, (label, value) in enumerate(_ROWS):
            panel = axes[row, column]
            for number, place in enumerate(places):
                for estimator, line in zip(estimators, _LINES, strict=False):
                    points = sorted(
                        (
                            defaults[name]
                            if cell.setting.parameter is None
                            else cell.setting.value,
                            value(cell),
                        )
                        for cell in cells
                        if (cell.place, cell.estimator) == (place, estimator)
                        and cell.setting.parameter in {None, name}
                    )
                    panel.plot(
                        *zip(*points, strict=True),
                        linestyle=line,
                        color=COLOURS[number % len(COLOURS)],
                        marker=MARKERS[number % len(MARKERS)],
                    )
            panel.axvline(defaults[name], color="0.7", linewidth=0.6, zorder=0)
            panel.set_yscale("log")
            panel.yaxis.set_major_formatter(lambda number, _: f"{number:g}")
            if not column:
                panel.set_ylabel(label)
        axes[-1, column].set_xlabel(names[name])
    handles = [
        Line2D(
            [],
            [],
            color=COLOURS[number % len(COLOURS)],
            marker=MARKERS[number % len(MARKERS)],
            label=f"level {place.perturbation}, {place.voluntary:g} N·m rms",
        )
        for number, place in enumerate(places)
    ]
    handles += [
        Line2D([], [], color="0.4", linestyle=line, label=estimator)
        for estimator, line in zip(estimators, _LINES, strict=False)
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=3, frameon=False)
    return figure
