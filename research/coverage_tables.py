"""Output of the investigation of coverage on the terminal."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from research.cells import LETTERS
from research.coverage_statistics import (
    NOMINAL,
    TARGET,
    Cell,
    Share,
)
from research.writing import print_table


def in_words(cells: Sequence[Cell]) -> list[str]:
    """Return one sentence for each estimator: which conditions lie outside the target."""
    lower, upper = (100.0 * limit for limit in TARGET)
    sentences = []
    for name in dict.fromkeys(cell.estimator for cell in cells):
        of_name = [cell for cell in cells if cell.estimator == name]
        outside = [cell for cell in of_name if cell.pooled.verdict != "within"]
        listed = "; ".join(
            f"{where(cell)}: {100.0 * cell.pooled.value:.1f} % ({cell.pooled.verdict})"
            for cell in outside
        )
        sentences.append(
            f"{name}: {len(of_name) - len(outside)} of {len(of_name)} conditions have pooled shares"
            f" of {lower:g} to {upper:g} %" + (f"; outside are {listed}." if outside else ".")
        )
    return sentences


def where(cell: Cell) -> str:
    """Name the levels and the voluntary torque of a cell."""
    friction, resolution, perturbation = cell.levels
    torque = f"{cell.voluntary:g} N·m rms" if cell.voluntary else "relaxed"
    return f"friction {friction}, resolution {resolution}, perturbation {perturbation}, {torque}"


def print_cells(cells: Sequence[Cell]) -> None:
    """Print pooled shares with bias, spread and standard errors; then shares of all elements."""
    common = ("estimator", "N·m rms", "levels")
    nominal = f"{100.0 * NOMINAL:g} %"
    print_table(
        f"{cells[0].runs} seeds; share of runs (%) whose {nominal} interval holds the truth",
        (*common, "pooled", *LETTERS, "bias M B K", "spread M B K", "stated M B K", "verdict"),
        [(*_key(cell), *_summary(cell), cell.pooled.verdict) for cell in cells],
        f"levels: friction, resolution, perturbation; in brackets: {nominal} interval of it;\n"
        "bias, spread and stated standard errors: rms over the elements, % of "
        "sqrt(|X_ii X_jj|)",
    )
    print_table(
        "shares of the elements (%)",
        (*common, *cells[0].by_element),
        [(*_key(cell), *(_percent(share) for share in cell.by_element.values())) for cell in cells],
        "their intervals are in coverage.csv",
    )


def _key(cell: Cell) -> tuple[str, str, str]:
    return cell.estimator, f"{cell.voluntary:g}", "{} {} {}".format(*cell.levels)


def _percent(share: Share) -> str:
    return f"{100.0 * share.value:.1f}"


def _summary(cell: Cell) -> list[str]:
    pooled = cell.pooled
    shown = [f"{_percent(pooled)} [{100.0 * pooled.lower:.1f}, {100.0 * pooled.upper:.1f}]"]
    shown += [_percent(share) for share in cell.by_letter]
    for one in (cell.bias, cell.spread, cell.claimed):
        values = 100.0 * np.sqrt(np.mean(one**2, axis=(1, 2)))
        shown.append(" ".join(f"{value:.2f}" for value in values))
    return shown
