"""Figure of the investigation of the controller."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

from research.controller_outcomes import Cell, Place
from research.decomposition_figures import LOOKS
from research.writing import MARKERS, WIDTH

_LINES: Final[tuple[Any, ...]] = ("-", "--", ":", "-.")
_ERRORS: Final[tuple[tuple[str, int], ...]] = (("rms error of M (%)", 0), ("rms error of B (%)", 1))


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
    from matplotlib.ticker import LogLocator, NullLocator

    varied = [
        name for name in names if any(cell.setting.parameter == name for cell in cells)
    ] or list(names)
    estimators = list(dict.fromkeys(cell.estimator for cell in cells))
    figure = Figure(figsize=(WIDTH, 5.4), layout="constrained")
    axes = figure.subplots(3, len(varied), sharey="row", sharex="col", squeeze=False)
    for column, name in enumerate(varied):
        shown = [cell for cell in cells if cell.setting.parameter in {None, name}]
        for row, (label, number) in enumerate(_ERRORS):
            for estimator in estimators:
                of_estimator = [cell for cell in shown if cell.estimator == estimator]
                errors = [100.0 * float(cell.rms[number]) for cell in of_estimator]
                _plot(axes[row, column], of_estimator, errors, defaults[name], _colour(estimator))
            axes[row, 0].set_ylabel(label)
        # The motion of locked joints is that of the trials, whichever the estimator.
        locks = [cell for cell in shown if cell.estimator == estimators[0]]
        bias = [100.0 * cell.lock_bias for cell in locks]
        _plot(axes[-1, column], locks, bias, defaults[name], "0.3")
        for panel in axes[:, column]:
            panel.axvline(defaults[name], color="0.75", linewidth=2.0, zorder=0)
            panel.set_yscale("log")
            panel.yaxis.set_major_locator(LogLocator(subs=(1.0, 3.0)))
            panel.yaxis.set_major_formatter(lambda number, _: f"{number:g}")
            panel.yaxis.set_minor_locator(NullLocator())
        axes[-1, column].set_xlabel(names[name].replace("M_r", "$M_r$"))
    axes[-1, 0].set_ylabel("bias by the lock (%)")
    _legend(figure, estimators, list(dict.fromkeys(cell.place for cell in cells)))
    return figure


def _plot(
    panel: Any, cells: Sequence[Cell], values: Sequence[float], default: float, colour: str
) -> None:
    """A line for each place."""
    for number, place in enumerate(dict.fromkeys(cell.place for cell in cells)):
        points = sorted(
            (default if cell.setting.parameter is None else cell.setting.value, value)
            for cell, value in zip(cells, values, strict=True)
            if cell.place == place
        )
        panel.plot(*zip(*points, strict=True), color=colour, **_look(number))


def _colour(estimator: str) -> Any:
    return LOOKS.get(estimator, {"color": "0.6"})["color"]


def _look(place: int) -> dict[str, Any]:
    return {"linestyle": _LINES[place % len(_LINES)], "marker": MARKERS[place % len(MARKERS)]}


def _legend(figure: Any, estimators: Sequence[str], places: Sequence[Place]) -> None:
    from matplotlib.lines import Line2D

    handles = [
        Line2D([], [], color="0.3", **_look(number), label=_short(place))
        for number, place in enumerate(places)
    ]
    handles += [Line2D([], [], color=_colour(name), label=name) for name in estimators]
    figure.legend(handles=handles, loc="outside lower center", ncols=3, frameon=False)


def _short(place: Place) -> str:
    torque = f"{place.voluntary:g} N·m voluntary" if place.voluntary else "relaxed"
    return f"perturbation {place.perturbation}, {torque}"
