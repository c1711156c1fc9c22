"""How a study stands against the targets of accuracy: the worst value of everything."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal

from pydantic import BaseModel, ConfigDict, Field

from armimp_bringup.study.entry import StudyEntry
from armimp_estimation.json_model import Number

Quantity = Literal[
    "VAF", "R²", "derived coherence", "M, K error", "B error", "M, K scaled", "B scaled"
]


@dataclass(frozen=True, kw_only=True)
class Scale:
    """How values of one kind are written, and which of them are bad.

    Parameters
    ----------
    unit : str
        Of the values and of the limits, with a space before it; may be empty.
    floor : bool
        Whether values have to stay above the limit, not below.
    digits : int
        After the point, where people read it.
    """

    unit: str
    floor: bool
    digits: int

    def format(self, value: float) -> str:
        """Value with unit."""
        return f"{value:.{self.digits}f}{self.unit}"

    def meets(self, value: float, limit: float) -> bool:
        """Whether a value is good enough; NaN never is."""
        return value >= limit if self.floor else value <= limit

    def badness(self, value: float) -> float:
        """Increases towards the worst value, which NaN is."""
        if math.isnan(value):
            return math.inf
        return -value if self.floor else value


@dataclass(frozen=True, kw_only=True)
class Column(Scale):
    """A column of the table of targets: a quantity and its scale."""

    quantity: Quantity


COLUMNS: Final = (
    Column(quantity="VAF", unit=" %", floor=True, digits=3),
    Column(quantity="R²", unit="", floor=True, digits=5),
    Column(quantity="derived coherence", unit="", floor=True, digits=4),
    Column(quantity="M, K error", unit=" %", floor=False, digits=2),
    Column(quantity="B error", unit=" %", floor=False, digits=2),
    Column(quantity="M, K scaled", unit=" %", floor=False, digits=2),
    Column(quantity="B scaled", unit=" %", floor=False, digits=2),
)
"""What is looked at. Scaled errors have no targets: see :func:`scaled_error`."""

_TWO_JOINTS: Final[dict[str, dict[Quantity, float]]] = {
    "welch_siso": {
        "VAF": 99.5,
        "R²": 0.99,
        "derived coherence": 0.985,
        "M, K error": 3.0,
        "B error": 8.0,
    },
    "lpm_full": {
        "VAF": 99.7,
        "R²": 0.997,
        "derived coherence": 0.985,
        "M, K error": 2.0,
        "B error": 2.0,
    },
}
_OTHER_JOINTS: Final[dict[str, dict[Quantity, float]]] = {"lpm_full": {"VAF": 99.7}}


def targets(joints: int) -> Mapping[str, Mapping[Quantity, float]]:
    """Limits by estimator and quantity, for 50 s trials; not every estimator has any."""
    return _TWO_JOINTS if joints == 2 else _OTHER_JOINTS


class WorstValue(BaseModel):
    """The worst value of a quantity over all conditions and elements, and where it is.

    ``element`` is such as ``Z12``, ``M12`` or ``K21``. Where there is no target, limit and met
    are null.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    estimator: str
    quantity: Quantity
    worst: Number
    limit: float | None
    met: bool | None
    element: str
    friction: int
    resolution: int
    perturbation: int
    seed: int

    @property
    def place(self) -> str:
        """Element and condition in words."""
        return (
            f"{self.element} at friction {self.friction}, resolution {self.resolution}, "
            f"perturbation {self.perturbation}, seed {self.seed}"
        )


class StudyVerdict(BaseModel):
    """Content of ``verdict.json``: judgement of what a study contains."""

    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True)

    schema_version: Literal[1] = Field(default=1, alias="schema")
    met: bool
    joints: int
    conditions: int
    worst: list[WorstValue]
    problems: list[str]

    def failures(self) -> list[str]:
        """What is not as it should be, one line each."""
        return [*(_missed(one) for one in self.worst if one.met is False), *self.problems]


def judge(entries: Sequence[StudyEntry]) -> StudyVerdict:
    """Find the worst values, and compare them with the targets.

    Parameters
    ----------
    entries : sequence of StudyEntry
        Results with the same estimators and number of joints, at least one.
    """
    joints = entries[0].joints
    limits = targets(joints)
    worst = [
        _worst(entries, estimator, column, limits.get(estimator, {}).get(column.quantity))
        for estimator in entries[0].estimators
        for column in COLUMNS
    ]
    problems = [
        f"{entry.condition} is not valid: {problem}"
        for entry in entries
        if not entry.valid
        for problem in entry.problems[:1]
    ]
    return StudyVerdict(
        met=all(one.met is not False for one in worst) and all(entry.valid for entry in entries),
        joints=joints,
        conditions=len(entries),
        worst=worst,
        problems=problems,
    )


def values(
    entry: StudyEntry, estimator: str, quantity: Quantity
) -> Iterator[tuple[str, int, int, float]]:
    """Values of a quantity in one condition: name of the element, its row and column, value."""
    result = entry.estimators[estimator]
    letters, _, kind = quantity.rpartition(" ")
    if kind in {"error", "scaled"}:
        error = relative_error if kind == "error" else scaled_error
        for letter in letters.split(", "):
            for i in range(entry.joints):
                for k in range(entry.joints):
                    found = error(entry, estimator, letter, i, k)
                    yield f"{letter}{i + 1}{k + 1}", i, k, abs(found)
        return
    matrix = {
        "VAF": result.vaf,
        "R²": result.r2,
        "derived coherence": result.coherence_derived,
    }[quantity]
    for i in range(entry.joints):
        for k in range(entry.joints):
            yield f"Z{i + 1}{k + 1}", i, k, math.nan if matrix is None else matrix[i][k]


def relative_error(entry: StudyEntry, estimator: str, letter: str, i: int, k: int) -> float:
    """Error of an element of M, B or K against the truth, %; NaN without a truth."""
    if entry.truth is None:
        return math.nan
    true = getattr(entry.truth, letter)[i][k]
    found = getattr(entry.estimators[estimator], letter)[i][k]
    return float(100.0 * (found - true) / abs(true)) if true else math.nan


def scaled_error(entry: StudyEntry, estimator: str, letter: str, i: int, k: int) -> float:
    """Error of an element ``X_ik`` relative to ``sqrt(|X_ii X_kk|)`` of the truth, %.

    On the diagonal it is the relative error. Elsewhere it says what an error does to the arm as a
    whole: an element that is tiny beside its diagonal may be wrong by far more than its own size,
    and still not matter. NaN without a truth.
    """
    if entry.truth is None:
        return math.nan
    true = getattr(entry.truth, letter)
    scale = math.sqrt(abs(true[i][i] * true[k][k]))
    found = getattr(entry.estimators[estimator], letter)[i][k]
    return float(100.0 * (found - true[i][k]) / scale) if scale else math.nan


def _worst(
    entries: Sequence[StudyEntry], estimator: str, column: Column, limit: float | None
) -> WorstValue:
    entry, element, value = max(
        (
            (entry, element, value)
            for entry in entries
            for element, _, _, value in values(entry, estimator, column.quantity)
        ),
        key=lambda found: column.badness(found[2]),
    )
    return WorstValue(
        estimator=estimator,
        quantity=column.quantity,
        worst=value,
        limit=limit,
        met=None if limit is None else column.meets(value, limit),
        element=element,
        friction=entry.friction,
        resolution=entry.resolution,
        perturbation=entry.perturbation,
        seed=entry.seed,
    )


def _missed(one: WorstValue) -> str:
    column = next(column for column in COLUMNS if column.quantity == one.quantity)
    limit = "" if one.limit is None else column.format(one.limit)
    sign = "<" if column.floor else ">"
    return (
        f"{one.estimator}: {one.quantity} {column.format(one.worst)} {sign} {limit} in {one.place}"
    )
