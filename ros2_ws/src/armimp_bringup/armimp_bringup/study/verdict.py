"""How a study stands against the targets of accuracy: the worst value of everything."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from armimp_bringup.study.store import StudyEntry
from armimp_bringup.study.table import Table
from armimp_estimation.json_model import Number
from armimp_estimation.problems import ProblemCode

FloatArray = NDArray[np.float64]


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

    def badness(self, values: FloatArray) -> FloatArray:
        """Increases towards the worst value, which NaN is."""
        return np.where(np.isnan(values), np.inf, -values if self.floor else values)


@dataclass(frozen=True, kw_only=True)
class Quantity(Scale):
    """A row of the table of targets: a quantity, and the fields of the results that it is in."""

    name: str
    fields: tuple[str, ...]

    def values(self, table: Table) -> FloatArray:
        """Values of the rows of one estimator, without signs of errors; (n_conditions, F, n, n)."""
        found = np.stack([table[field] for field in self.fields], axis=-3)
        return found if self.floor else np.abs(found)

    def element(self, field: int, i: int, k: int) -> str:
        """Name of an element (0-based), such as ``Z12`` or ``M12``."""
        return f"{'Z' if self.floor else self.fields[field][0]}{i + 1}{k + 1}"


def _errors(letters: str, kind: str) -> tuple[str, ...]:
    return tuple(f"{letter}_{kind}_percent" for letter in letters)


QUANTITIES: Final = (
    Quantity(name="VAF", fields=("vaf_percent",), unit=" %", floor=True, digits=3),
    Quantity(name="R²", fields=("r2",), unit="", floor=True, digits=5),
    Quantity(
        name="derived coherence", fields=("coherence_derived",), unit="", floor=True, digits=4
    ),
    Quantity(name="M, K error", fields=_errors("MK", "error"), unit=" %", floor=False, digits=2),
    Quantity(name="B error", fields=_errors("B", "error"), unit=" %", floor=False, digits=2),
    Quantity(
        name="M, K scaled", fields=_errors("MK", "scaled_error"), unit=" %", floor=False, digits=2
    ),
    Quantity(
        name="B scaled", fields=_errors("B", "scaled_error"), unit=" %", floor=False, digits=2
    ),
)
"""What is looked at. Scaled errors have no targets."""
_TARGETS: Final[Mapping[str, Mapping[str, float]]] = {
    "welch_siso": {
        "VAF": 99.5,
        "R²": 0.99,
        "derived coherence": 0.985,
        "M, K error": 3.0,
        "B error": 8.0,
    },
    "lpm_full": {
        "VAF": 99.9,
        "R²": 0.999,
        "derived coherence": 0.985,
        "M, K error": 0.5,
        "B error": 0.5,
    },
}


def targets(joints: int, estimator: str) -> Mapping[str, float]:
    """Limits of the quantities of an estimator that have one; with three joints of scores only."""
    limits = _TARGETS.get(estimator, {})
    if joints <= 2:
        return limits
    return {name: limit for name, limit in limits.items() if "error" not in name}


class WorstValue(BaseModel):
    """The worst value of a quantity among the elements of all conditions that are judged.

    ``element`` is such as ``Z12``, ``M12`` or ``K21``. Where there is no target, limit and met
    are null.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    estimator: str
    quantity: str
    worst: Number
    limit: float | None
    met: bool | None
    element: str
    friction: int
    resolution: int
    perturbation: int
    seed: int

    @property
    def of(self) -> Quantity:
        """Its quantity."""
        return next(one for one in QUANTITIES if one.name == self.quantity)

    @property
    def place(self) -> str:
        """Element and condition in words."""
        return (
            f"{self.element} at friction {self.friction}, resolution {self.resolution}, "
            f"perturbation {self.perturbation}, seed {self.seed}"
        )


class StudyVerdict(BaseModel):
    """Content of ``verdict.json``: judgement of what a study contains.

    ``unresolved`` is the share of elements, over all conditions, that make too little torque to be
    judged.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True)

    schema_version: Literal[1] = Field(default=1, alias="schema")
    met: bool
    joints: int
    conditions: int
    unresolved: float
    worst: list[WorstValue]
    problems: list[tuple[ProblemCode, str]]

    def failures(self) -> list[str]:
        """What is not as it should be, one line each."""
        return [
            *(_missed(one) for one in self.worst if one.met is False),
            *(sentence for _, sentence in self.problems),
        ]


def judge(entries: Sequence[StudyEntry], table: Table) -> StudyVerdict:
    """Find the worst values, and compare them with the targets.

    Parameters
    ----------
    entries : sequence of StudyEntry
        Results with the same estimators and number of joints, at least one.
    table : ndarray
        Their numbers.
    """
    worst = [
        _worst(of_estimator, quantity)
        for of_estimator in np.moveaxis(table, 1, 0)
        for quantity in QUANTITIES
    ]
    problems = [
        (fault.code, f"{entry.condition} is not valid: {fault}")
        for entry in entries
        for fault in entry.faults[:1]
    ]
    return StudyVerdict(
        met=all(one.met is not False for one in worst) and all(entry.valid for entry in entries),
        joints=entries[0].joints,
        conditions=len(entries),
        unresolved=float(1.0 - np.mean(table["resolved"])),
        worst=worst,
        problems=problems,
    )


def _worst(table: Table, quantity: Quantity) -> WorstValue:
    """Worst value of a quantity of one estimator."""
    estimator, joints = str(table["estimator"].flat[0]), table.shape[-1]
    judged = table["resolved"].any()
    limit = targets(joints, estimator).get(quantity.name) if judged else None
    values = quantity.values(table)
    badness = quantity.badness(values)
    if limit is not None:
        badness = np.where(table["resolved"][:, np.newaxis], badness, -np.inf)
    place, field, i, k = np.unravel_index(int(np.argmax(badness)), badness.shape)
    value, row = float(values[place, field, i, k]), table[place, i, k]
    return WorstValue(
        estimator=estimator,
        quantity=quantity.name,
        worst=value,
        limit=limit,
        met=None if limit is None else quantity.meets(value, limit),
        element=quantity.element(int(field), int(i), int(k)),
        **{name: int(row[name]) for name in ("friction", "resolution", "perturbation", "seed")},
    )


def _missed(one: WorstValue) -> str:
    limit = math.nan if one.limit is None else one.limit
    sign = "<" if one.of.floor else ">"
    worst, limited = one.of.format(one.worst), one.of.format(limit)
    return f"{one.estimator}: {one.quantity} {worst} {sign} {limited} in {one.place}"
