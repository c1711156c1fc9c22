"""Output of the investigation of limits on the terminal."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from research.limits_statistics import Cell
from research.writing import print_table


def in_words(cells: Sequence[Cell]) -> list[str]:
    """Return one sentence for each estimator and voluntary torque: smallest and largest ratio."""
    sentences = []
    for name, torque in dict.fromkeys((cell.estimator, cell.voluntary) for cell in cells):
        limited = [
            cell
            for cell in cells
            if (cell.estimator, cell.voluntary) == (name, torque) and cell.bound.any()
        ]
        where = f"with {torque:g} N·m rms" if torque else "relaxed"
        if not limited:
            sentences.append(f"{name}, {where}: no noise, so there is no bound.")
            continue
        smallest = min(float(np.min(cell.ratio)) for cell in limited)
        worst = max(limited, key=lambda cell: cell.worst[1])
        element, largest = worst.worst
        error = 100.0 * float(worst.rms.flat[worst.elements.index(element)])
        sentences.append(
            f"{name}, {where}: rms errors are {smallest:.2f} to {_times(largest)} times the bound;"
            f" the largest is that of {element} at levels {'{} {} {}'.format(*worst.levels)},"
            f" an error of {error:.2g} %."
        )
    return sentences


def print_cells(cells: Sequence[Cell]) -> None:
    """Print the bounds of all conditions, then ratios of all estimators, element by element."""
    elements = cells[0].elements
    first = [cell for cell in cells if cell.estimator == cells[0].estimator]
    print_table(
        f"Cramér-Rao bounds, % of sqrt(|X_ii X_jj|), rms over {cells[0].runs} seeds",
        ("N·m rms", "levels", *elements),
        [
            (
                f"{cell.voluntary:g}",
                "{} {} {}".format(*cell.levels),
                *(f"{100.0 * value:.3g}" for value in cell.bound.flat),
            )
            for cell in first
        ],
        "levels: friction, resolution, perturbation",
    )
    print_table(
        "rms error over the bound",
        ("estimator", "N·m rms", "levels", *elements, "worst"),
        [
            (
                cell.estimator,
                f"{cell.voluntary:g}",
                "{} {} {}".format(*cell.levels),
                *(_times(value) for value in cell.ratio.flat),
                f"{cell.worst[0]} {_times(cell.worst[1])}",
            )
            for cell in cells
        ],
        "Monte Carlo standard errors are in limits.csv",
    )


def _times(ratio: float) -> str:
    if not np.isfinite(ratio):
        return "–"
    return f"{ratio:.2f}" if ratio < 10.0 else f"{ratio:.0f}"
