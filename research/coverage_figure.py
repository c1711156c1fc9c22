"""Figure of the investigation of coverage."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from research.cells import LETTERS
from research.coverage_statistics import NOMINAL, TARGET, Cell
from research.decomposition_figures import LOOKS
from research.writing import COLOURS, MARKERS, WIDTH


def coverage_figure(cells: Sequence[Cell]) -> Any:
    """Draw the shares of all estimators, and stated over true errors of the first one.

    Parameters
    ----------
    cells : all of the investigation
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(WIDTH, 3.1), layout="constrained")
    shares, ratios = figure.subplots(1, 2)
    names = list(dict.fromkeys(cell.estimator for cell in cells))
    shares.axhspan(
        100.0 * TARGET[0], 100.0 * TARGET[1], color="0.88", zorder=0, label="target, pooled"
    )
    shares.axhline(100.0 * NOMINAL, color="0.5", linewidth=0.6)
    for number, name in enumerate(names):
        look = LOOKS.get(name, {})
        of_name = [cell for cell in cells if cell.estimator == name]
        places = [place + 0.24 * (number - 0.5 * (len(names) - 1)) for place in range(len(of_name))]
        pooled = [cell.pooled for cell in of_name]
        for place, cell in zip(places, of_name, strict=True):  # beneath the pooled shares
            elements = [100.0 * share.value for share in cell.by_element.values()]
            shares.plot(
                [place] * len(elements),
                elements,
                linestyle="none",
                marker="_",
                markersize=4,
                color=look.get("color"),
                alpha=0.45,
            )
        shares.errorbar(
            places,
            [100.0 * share.value for share in pooled],
            yerr=[
                [100.0 * (share.value - share.lower) for share in pooled],
                [100.0 * (share.upper - share.value) for share in pooled],
            ],
            linestyle="none",
            capsize=2,
            label=name,
            **look,
        )
    shares.set_ylabel("intervals that hold the truth (%)")
    shares.set_ylim(-3.0, 103.0)
    shares.plot([], [], linestyle="none", marker="_", color="0.5", label="single elements")
    shares.legend(loc="lower left")
    first = [cell for cell in cells if cell.estimator == names[0]]
    for number, letter in enumerate(LETTERS):
        ratios.plot(
            range(len(first)),
            [cell.honesty[number] for cell in first],
            linestyle="none",
            color=COLOURS[(0, 2, 4)[number]],
            marker=MARKERS[number],
            label=letter,
        )
    ratios.axhline(1.0, color="0.5", linewidth=0.6)
    ratios.set_ylabel(f"{names[0]}: stated over true rms error")
    ratios.set_ylim(bottom=0.0)
    ratios.legend(loc="upper right")
    labels = [
        "{} {} {}\n{}".format(*c.levels, f"{c.voluntary:g} N·m" if c.voluntary else "relaxed")
        for c in first
    ]
    for panel in (shares, ratios):
        panel.set_xticks(range(len(first)), labels, fontsize=6)
        panel.set_xlabel("friction, resolution, perturbation; voluntary torque")
    return figure
