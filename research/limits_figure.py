"""Figure of the investigation of limits."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from research.cells import LETTERS
from research.decomposition_figures import LOOKS
from research.limits_statistics import Cell
from research.writing import WIDTH

_APART = 0.27


def limits_figure(cells: Sequence[Cell]) -> Any:
    """Draw errors over the bound for all elements, one panel for each voluntary torque.

    Parameters
    ----------
    cells : all of the investigation
    """
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D
    from matplotlib.ticker import LogLocator

    torques = list(dict.fromkeys(cell.voluntary for cell in cells))
    names = list(dict.fromkeys(cell.estimator for cell in cells))
    figure = Figure(figsize=(WIDTH, 3.4), layout="constrained")
    panels = figure.subplots(1, len(torques), squeeze=False)[0]
    for panel, torque in zip(panels, torques, strict=True):
        shown = [cell for cell in cells if cell.voluntary == torque]
        levels = list(dict.fromkeys(cell.levels for cell in shown))
        for cell in shown:
            middle, look = levels.index(cell.levels), LOOKS.get(cell.estimator, {})
            for number in range(len(LETTERS)):
                ratios = cell.ratio[number].ravel()
                place = middle + _APART * (number - 1)
                place += 0.08 * (names.index(cell.estimator) - 0.5 * (len(names) - 1))
                panel.plot(np.full(ratios.size, place), ratios, linestyle="none", alpha=0.8, **look)
        panel.axhline(1.0, color="0.2", linewidth=0.8)
        panel.set_yscale("log")
        lower, upper = panel.get_ylim()
        if upper < 200.0 * lower:  # powers of ten would be two labels or three
            panel.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        panel.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
        panel.set_title(f"{torque:g} N·m rms" if torque else "relaxed")
        panel.grid(visible=False, axis="x")
        panel.set_xticks(
            [place + _APART * (i - 1) for place in range(len(levels)) for i in range(3)],
            [
                f"{letter}\n{'{} {} {}'.format(*level)}" if letter == "B" else letter
                for level in levels
                for letter in LETTERS
            ],
            fontsize=6,
        )
        for place in range(1, len(levels)):
            panel.axvline(place - 0.5, color="0.85", linewidth=0.6)
        panel.set_xlabel("element; friction, resolution, perturbation")
    panels[0].set_ylabel("rms error over the Cramér-Rao bound")
    handles = [
        Line2D([], [], linestyle="none", label=name, **LOOKS.get(name, {})) for name in names
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), frameon=False)
    return figure
