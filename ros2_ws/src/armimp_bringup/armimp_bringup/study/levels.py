"""Scores by level of each factor, as Figures 3 and 4 of the paper show them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from armimp_bringup.study.entry import StudyEntry
from armimp_bringup.study.verdict import targets

FloatArray = NDArray[np.float64]

MOST_JOINTS: Final = 3
"""With more of them, elements are drawn by the row; there would be too many marks."""
MOTION_SYMBOL: Final = "θ"


@dataclass(frozen=True, kw_only=True, order=True)
class Subject:
    """What a mark stands for: a symbol with indices; a column of None is the whole row."""

    symbol: str
    row: int
    column: int | None = None

    @property
    def indices(self) -> str:
        """Indices, 1-based; a dot for a whole row."""
        if self.symbol == MOTION_SYMBOL:
            return f"{self.row + 1}"
        return f"{self.row + 1}{'·' if self.column is None else self.column + 1}"


@dataclass(frozen=True, kw_only=True, eq=False)
class LevelScore:
    """A score by level.

    Parameters
    ----------
    name, unit : str
        For people; the unit may be empty.
    values : mapping of Subject to ndarray, shape (n_entries, n_elements)
        Of each entry.
    limit : float or None
        Target.
    """

    name: str
    unit: str
    values: Mapping[Subject, FloatArray]
    limit: float | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class LevelStatistics:
    """Mean, smallest and largest value at each level that is present; shapes (n_levels,)."""

    levels: NDArray[np.int64]
    mean: FloatArray
    low: FloatArray
    high: FloatArray


def fit_scores(entries: Sequence[StudyEntry], estimator: str) -> tuple[LevelScore, ...]:
    """VAF and R², those of Fig. 3."""
    limits = targets(entries[0].joints).get(estimator, {})
    return (
        LevelScore(
            name="VAF",
            unit="%",
            values=_elements(entries, estimator, "vaf"),
            limit=limits.get("VAF"),
        ),
        LevelScore(
            name="R²", unit="", values=_elements(entries, estimator, "r2"), limit=limits.get("R²")
        ),
    )


def coherence_scores(entries: Sequence[StudyEntry], estimator: str) -> tuple[LevelScore, ...]:
    """Band means of derived coherence and of those with the perturbation, those of Fig. 4."""
    motion = {
        Subject(symbol=MOTION_SYMBOL, row=k): np.array(
            [[entry.estimators[estimator].coherence_motion[k]] for entry in entries]
        )
        for k in range(entries[0].joints)
    }
    return (
        LevelScore(
            name="derived coherence",
            unit="",
            values=_elements(entries, estimator, "coherence_derived"),
            limit=targets(entries[0].joints).get(estimator, {}).get("derived coherence"),
        ),
        LevelScore(
            name="coherence τΔ → τ",
            unit="",
            values=_elements(entries, estimator, "coherence_torque"),
        ),
        LevelScore(name="coherence τΔ → θ", unit="", values=motion),
    )


def statistics(entries: Sequence[StudyEntry], factor: str, values: FloatArray) -> LevelStatistics:
    """Mean and range of values by level of a factor.

    Parameters
    ----------
    entries : sequence of StudyEntry
        Results.
    factor : str
        Such as ``friction``.
    values : ndarray, shape (n_entries, n_elements)
        Of the entries.
    """
    levels = np.array([getattr(entry, factor) for entry in entries])
    present = np.unique(levels)
    groups = [values[levels == level] for level in present]
    return LevelStatistics(
        levels=present,
        mean=np.array([np.mean(group) for group in groups]),
        low=np.array([np.min(group) for group in groups]),
        high=np.array([np.max(group) for group in groups]),
    )


def _elements(
    entries: Sequence[StudyEntry], estimator: str, score: str
) -> dict[Subject, FloatArray]:
    n = entries[0].joints
    matrices = np.array(
        [getattr(entry.estimators[estimator], score) for entry in entries], dtype=np.float64
    )
    if n > MOST_JOINTS:
        return {Subject(symbol="Z", row=i): matrices[:, i, :] for i in range(n)}
    return {
        Subject(symbol="Z", row=i, column=k): matrices[:, i, k, np.newaxis]
        for i in range(n)
        for k in range(n)
    }
