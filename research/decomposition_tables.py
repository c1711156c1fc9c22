"""The investigation of decomposition in tables."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from armimp_common.arrays import FloatArray
from research.cells import LETTERS
from research.decomposition_outcomes import Cell
from research.decomposition_statistics import LEVEL, root_mean_square
from research.decomposition_trials import ESTIMATORS, MIMO
from research.writing import print_table


def cell_rows(cells: Sequence[Cell]) -> list[dict[str, Any]]:
    """Return a row for each element of M, B and K of each cell."""
    return [
        {
            "estimator": cell.estimator,
            "voluntary_rms": cell.voluntary,
            "correlation": cell.correlation,
            "element": f"{letter}{i + 1}{k + 1}",
            "bias_percent": 100.0 * cell.total.bias[number, i, k],
            "uncertainty_percent": 100.0 * cell.total.uncertainty[number, i, k],
            "spread_percent": 100.0 * cell.total.spread[number, i, k],
            "z": cell.total.z[number, i, k],
            "stated_error_percent": 100.0 * cell.stated[number, i, k],
            "shift_percent": None if cell.shift is None else 100.0 * cell.shift.bias[number, i, k],
            "shift_z": None if cell.shift is None else cell.shift.z[number, i, k],
            "reweighted_percent": None
            if cell.reweighted is None
            else 100.0 * cell.reweighted.bias[number, i, k],
        }
        for cell in cells
        for number, letter in enumerate(LETTERS)
        for i, k in np.ndindex(cell.total.bias.shape[1:])
    ]


def print_cells(cells: Sequence[Cell]) -> None:
    """Print bias and spread of all estimators, and the effect of coupled inputs on ``mimo``."""
    many = cells[0].total.runs
    rows = []
    for cell in cells:
        if cell.correlation in {None, 0.0}:
            verdict = ("–", "–", "–")
            if cell.shift is not None and cell.octaves_shift is not None:
                verdict = (
                    f"{np.max(np.abs(cell.octaves_shift.z)):.1f}",
                    f"{np.max(np.abs(cell.shift.z)):.1f}",
                    "yes" if cell.biased else "no",
                )
            rows.append(
                (
                    cell.estimator,
                    f"{cell.voluntary:g}",
                    *(f"{_largest(100.0 * cell.total.bias[i]):+.2f}" for i in range(3)),
                    *(f"{100.0 * root_mean_square(cell.total.spread[i]):.2f}" for i in range(3)),
                    *verdict,
                )
            )
    print_table(
        f"{many} seeds; errors of M, B and K in % of sqrt(|X_ii X_jj|)",
        (
            "estimator",
            "N·m rms",
            "bias M",
            "B",
            "K",
            "spread M",
            "B",
            "K",
            "z of Z",
            "z of MBK",
            "biased",
        ),
        sorted(rows, key=lambda row: (ESTIMATORS.index(row[0]), float(row[1]))),
        "bias: of the worst element; spread: rms over the elements; z: the largest shift that\n"
        "voluntary torque makes, in standard errors; biased: by more than chance, at "
        f"{100.0 * LEVEL:g} %\nfor all elements together",
    )
    coupled = [cell for cell in cells if cell.correlation is not None]
    at = coupled[-1].voluntary
    print_table(
        f"{MIMO} with correlated perturbations, voluntary torque of {at:g} N·m rms",
        (
            "correlation",
            "coherence",
            "inflation",
            "condition",
            "spread M",
            "B",
            "K",
            "bias K",
        ),
        [
            (
                f"{cell.correlation:g}",
                f"{cell.coherence:.3f}",
                f"{cell.inflation:.2f}",
                f"{cell.condition:.0f}",
                *(f"{100.0 * root_mean_square(cell.total.spread[i]):.2f}" for i in range(3)),
                f"{_largest(100.0 * cell.total.bias[2]):+.2f}",
            )
            for cell in coupled
            if cell.voluntary == at
        ],
        "coherence and inflation: band means; condition: the worst",
    )


def _largest(values: FloatArray) -> float:
    """Return the value that is farthest from 0."""
    flat = values.ravel()
    return float(flat[np.argmax(np.abs(flat))])
