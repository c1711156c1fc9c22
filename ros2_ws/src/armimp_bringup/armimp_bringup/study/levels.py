"""Scores by level of each factor, as Figures 3 and 4 of the paper show them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from armimp_bringup.study.table import FloatArray, Table

MOST_JOINTS: Final = 3
"""With more of them, elements are drawn by the row; there would be too many marks."""


@dataclass(frozen=True, kw_only=True)
class LevelScore:
    """A score of Figure 3 or 4: its field of the results, name, unit, and quantity with targets."""

    field: str
    name: str
    unit: str = ""
    quantity: str = ""

    def subjects(self, table: Table) -> Mapping[tuple[str, str], FloatArray]:
        """Values, shape (n_conditions, n_elements), by symbol and 1-based indices of their marks.

        Parameters
        ----------
        table : ndarray, shape (n_conditions, n, n)
            Results of one estimator.
        """
        values, n = table[self.field], table.shape[-1]
        if self.field == "coherence_motion":
            return {("θ", f"{k + 1}"): values[:, 0, k, np.newaxis] for k in range(n)}
        if n > MOST_JOINTS:
            return {("Z", f"{i + 1}·"): values[:, i] for i in range(n)}
        return {
            ("Z", f"{i + 1}{k + 1}"): values[:, i, k, np.newaxis]
            for i in range(n)
            for k in range(n)
        }


FIT_SCORES: Final = (
    LevelScore(field="vaf_percent", name="VAF", unit="%", quantity="VAF"),
    LevelScore(field="r2", name="R²", quantity="R²"),
)
"""Those of Figure 3."""
COHERENCE_SCORES: Final = (
    LevelScore(field="coherence_derived", name="derived coherence", quantity="derived coherence"),
    LevelScore(field="coherence_torque", name="coherence τΔ → τ"),
    LevelScore(field="coherence_motion", name="coherence τΔ → θ"),
)
"""Band means, those of Figure 4."""


@dataclass(frozen=True, kw_only=True, eq=False)
class LevelStatistics:
    """Mean, smallest and largest value at each level that is present; shapes (n_levels,)."""

    levels: NDArray[np.int64]
    mean: FloatArray
    low: FloatArray
    high: FloatArray


def statistics(table: Table, factor: str, values: FloatArray) -> LevelStatistics:
    """Mean and range by level of a factor of values of shape (n_conditions, n_elements)."""
    levels = table[factor][:, 0, 0]
    present = np.unique(levels)
    groups = [values[levels == level] for level in present]
    return LevelStatistics(
        levels=present,
        mean=np.array([np.mean(group) for group in groups]),
        low=np.array([np.min(group) for group in groups]),
        high=np.array([np.max(group) for group in groups]),
    )
