"""The numbers of a study: the table of results, the scores in it, their targets, the verdict."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from armimp_bringup.study import LEVELS, Condition, StudyEntry
from armimp_common.arrays import BoolArray, FloatArray
from armimp_estimation.json_model import JsonModel, Number
from armimp_estimation.mbk import MBK, UNITS
from armimp_estimation.problems import ProblemCode
from armimp_estimation.report.formats import NONE, setting

Table: TypeAlias = NDArray[np.void]

FREQUENCIES: Final = np.linspace(0.122, 15.0, 200)
"""The band of the study, Hz."""
LEAST_COUNTS: Final = 5.0
"""Torque, counts, that an element must exceed to be judged if there are more than three joints."""
MOST_JOINTS: Final = 3
"""With more joints, figures draw the elements of a row together, to limit the number of marks."""
_LEVELS: Final = (*LEVELS, "seed")
_SCORES: Final = ("r2", "coherence_derived", "coherence_torque", "coherence_motion")
_ERRORS: Final = ("", "_se", "_error_percent")
_SUBSCRIPTS: Final = str.maketrans("0123456789·", "₀₁₂₃₄₅₆₇₈₉.")
_TYPE: Final = np.dtype(
    [
        *((name, np.int64) for name in _LEVELS),
        ("valid", np.bool_),
        ("estimator", np.object_),
        ("row", np.int64),
        ("column", np.int64),
        ("resolved", np.bool_),
        *((name, np.float64) for name in ("vaf_percent", *_SCORES, "lock_ratio", "bias_bound")),
        *((letter + suffix, np.float64) for letter in UNITS for suffix in _ERRORS),
    ]
)


# --- the table ---------------------------------------------------------------------------------


def results_table(entries: Sequence[StudyEntry]) -> Table:
    """Return the results of a study as a table.

    Errors are those of an element of M, B or K relative to its true value.

    Parameters
    ----------
    entries : results with the same estimators and number of joints, at least one

    Returns
    -------
    ndarray, shape (n_conditions, n_estimators, n, n)
        Structured; rows and columns of the elements are 1-based, errors in %.
    """
    n, names = entries[0].joints, list(entries[0].estimators)
    table = np.zeros((len(entries), len(names), n, n), dtype=_TYPE)
    table["row"] = np.arange(1, n + 1)[:, np.newaxis]
    table["column"] = np.arange(1, n + 1)
    for entry, of_entry in zip(entries, table, strict=True):
        for name in (*_LEVELS, "valid"):
            of_entry[name] = getattr(entry, name)
        of_entry["resolved"] = resolved(entry)
        for trial in entry.trials:
            of_entry["lock_ratio"][..., trial.k - 1] = trial.lock_ratio
            of_entry["bias_bound"][..., trial.k - 1] = trial.bias_bound
        for name, rows in zip(names, of_entry, strict=True):
            result = entry.estimators[name]
            rows["estimator"] = name
            rows["vaf_percent"] = result.vaf
            for score in _SCORES:
                rows[score] = getattr(result, score)
            for letter in UNITS:
                rows[letter] = getattr(result, letter)
                rows[f"{letter}_se"] = getattr(result, f"{letter}_se")
                true = getattr(entry.arm, letter)
                off, error = 100.0 * (rows[letter] - true), rows[f"{letter}_error_percent"]
                error[:] = np.nan  # where the true value is zero
                np.divide(off, np.abs(true), out=error, where=true != 0.0)
    return table


def torque_in_counts(entry: StudyEntry, f: FloatArray) -> FloatArray | None:
    """Return the torque that each element makes in one condition, in counts of the transducers.

    It is ``peak_k / count`` times the rms of ``|Z_ik / (M_rd s² + B_rd s + K_rd + Z_kk)|`` over the
    frequencies: the torque due to a perturbation at its peak if its spectrum were flat there.

    Parameters
    ----------
    entry : result with its configuration
    f : frequencies, Hz; zero alone gives the largest static torque of the stiffness

    Returns
    -------
    ndarray, shape (n, n)
        Counts; None if torques are not quantised, or the configuration lacks what is needed.
    """
    count = setting(entry.config, "arm_sim", "sensors.torque.resolution")
    names = ("perturbation.peak", "target.inertia", "target.damping", "target.stiffness")
    found = [setting(entry.config, "imbic_controller", name) for name in names]
    known = all(isinstance(values, list) and len(values) == entry.joints for values in found)
    if not isinstance(count, float) or count <= 0.0 or not known:
        return None
    peak, inertia, damping, stiffness = (np.array(values, dtype=np.float64) for values in found)
    z = entry.arm.impedance(f)
    target = MBK(M=np.diag(inertia), B=np.diag(damping), K=np.diag(stiffness)).impedance(f)
    yielding = np.einsum("kkf->kf", z + target)
    gain = np.sqrt(np.mean(np.abs(z / yielding) ** 2, axis=2))
    return np.asarray(gain * peak / count)


def resolved(entry: StudyEntry) -> BoolArray:
    """Return which elements are judged: with more than three joints, those above five counts."""
    counts = torque_in_counts(entry, FREQUENCIES) if entry.joints > 3 else None
    if counts is None:
        return np.ones((entry.joints, entry.joints), dtype=np.bool_)
    return np.asarray(counts > LEAST_COUNTS)


def results_csv(table: Table) -> str:
    """Return the table as CSV.

    Numbers have as many digits as it takes to read them back exactly; NaN becomes an empty cell.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(_TYPE.names or ())
    for row in table.ravel():
        writer.writerow(
            "" if isinstance(value, float) and math.isnan(value) else value for value in row.item()
        )
    return text.getvalue()


# --- the scores --------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Score:
    """A quantity that results are judged by or shown with."""

    name: str
    """Name for people."""
    fields: tuple[str, ...] = ()
    """Fields of the table that hold its values."""
    unit: str = ""
    """Unit of values and limits, with a space before it; may be empty."""
    floor: bool = True
    """Whether values have to stay above the limit, not below."""
    digits: int = 4
    """Digits after the point, where people read it."""
    limits: Mapping[str, float] = field(default_factory=dict)
    """Targets by estimator."""

    def format(self, value: float, limit: float | None = None) -> str:
        """Value with unit, in as many digits as show that it misses a limit; a dash for NaN."""
        if math.isnan(value):
            return NONE
        digits = self.digits
        if limit is not None and not self.meets(value, limit):
            while f"{value:.{digits}f}" == f"{limit:.{digits}f}":
                digits += 1
        return f"{value:.{digits}f}{self.unit}"

    def limit(self, joints: int, estimator: str) -> float | None:
        """Target of an estimator, if there is one; with more than two joints errors have none."""
        return self.limits.get(estimator) if self.floor or joints <= 2 else None

    def meets(self, value: float, limit: float) -> bool:
        """Whether a value is good enough; NaN never is."""
        return value >= limit if self.floor else value <= limit

    def worst(self, table: Table, *, judged: bool) -> tuple[float, int, str]:
        """The worst value of one estimator, the index of its condition, and its element.

        Errors are compared as magnitudes, and NaN is worse than any number; elements are such as
        ``Z12`` or ``M12``.

        Parameters
        ----------
        table : (n_conditions, n, n), results of the estimator
        judged : whether only resolved elements count
        """
        values = np.stack([table[field] for field in self.fields], axis=1)
        if not self.floor:
            values = np.abs(values)
        badness = np.where(np.isnan(values), np.inf, -values if self.floor else values)
        if judged:
            badness = np.where(table["resolved"][:, np.newaxis], badness, -np.inf)
        place, field, i, k = map(int, np.unravel_index(badness.argmax(), badness.shape))
        letter = "Z" if self.floor else self.fields[field][0]
        return float(values[place, field, i, k]), place, f"{letter}{i + 1}{k + 1}"

    def subjects(self, table: Table) -> Mapping[str, FloatArray]:
        """Values, shape (n_conditions, n_elements), by the symbols of their marks, such as ``Z₁₂``.

        Parameters
        ----------
        table : (n_conditions, n, n), results of one estimator
        """
        values, n = table[self.fields[0]], table.shape[-1]
        if self.fields == ("coherence_motion",):
            found = {f"θ{k + 1}": values[:, 0, k, np.newaxis] for k in range(n)}
        elif n > MOST_JOINTS:
            found = {f"Z{i + 1}·": values[:, i] for i in range(n)}
        else:
            places = np.ndindex(n, n)
            found = {f"Z{i + 1}{k + 1}": values[:, i, k, np.newaxis] for i, k in places}
        return {name.translate(_SUBSCRIPTS): of_mark for name, of_mark in found.items()}


def _error(name: str, letters: str, **limits: float) -> Score:
    fields = tuple(f"{letter}_error_percent" for letter in letters)
    return Score(name=name, fields=fields, unit=" %", floor=False, digits=2, limits=limits)


_VAF: Final = Score(
    name="VAF",
    fields=("vaf_percent",),
    unit=" %",
    digits=3,
    limits={"welch_siso": 99.5, "lpm_full": 99.9},
)
_R2: Final = Score(
    name="R²", fields=("r2",), digits=5, limits={"welch_siso": 0.99, "lpm_full": 0.999}
)
_DERIVED: Final = Score(
    name="derived coherence",
    fields=("coherence_derived",),
    limits={"welch_siso": 0.985, "lpm_full": 0.985},
)
SCORES: Final = (
    _VAF,
    _R2,
    _DERIVED,
    _error("M, K error", "MK", welch_siso=3.0, lpm_full=0.5),
    _error("B error", "B", welch_siso=8.0, lpm_full=0.5),
)
"""Scores on which the verdict is based."""
FIT_SCORES: Final = (_VAF, _R2)
"""Those of Figure 3 of the paper."""
COHERENCE_SCORES: Final = (
    _DERIVED,
    Score(name="coherence τΔ → τ", fields=("coherence_torque",)),
    Score(name="coherence τΔ → θ", fields=("coherence_motion",)),
)
"""Those of Figure 4, means over the band."""


# --- the verdict -------------------------------------------------------------------------------


class WorstValue(JsonModel):
    """The worst value of a quantity among the elements of all conditions that are judged.

    ``element`` is such as ``Z12``, ``M12`` or ``K21``. Where there is no target, limit and met
    are null.
    """

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
    def condition(self) -> Condition:
        """Where the value was found."""
        return Condition(**self.model_dump(include={*_LEVELS}))

    @property
    def score(self) -> Score:
        """The score of this quantity."""
        return next(one for one in SCORES if one.name == self.quantity)

    @property
    def target(self) -> str:
        """The target, as in ``≥ 99.5 %``; a dash if there is none."""
        sign = "≥" if self.score.floor else "≤"
        return "–" if self.limit is None else f"{sign} {self.limit:g}{self.score.unit}"

    def __str__(self) -> str:
        """How far the value is from the target, and where that is."""
        sign = "<" if self.score.floor else ">"
        limit = math.nan if self.limit is None else self.limit
        return (
            f"{self.estimator}: {self.quantity} {self.score.format(self.worst, limit)} "
            f"{sign} {self.score.format(limit)} in {self.element} at {self.condition}"
        )


class StudyVerdict(JsonModel):
    """Content of ``verdict.json``: what a study reached, and whether that meets its targets.

    ``unresolved`` is the share of elements, over all conditions, that make too little torque to be
    judged.
    """

    schema_version: Literal[1] = Field(default=1, alias="schema")
    met: bool
    joints: int
    conditions: int
    unresolved: float
    worst: list[WorstValue]
    problems: list[tuple[ProblemCode, str]]

    def failures(self) -> list[str]:
        """Missed targets and conditions that are not valid, one line each."""
        return [
            *(str(one) for one in self.worst if one.met is False),
            *(sentence for _, sentence in self.problems),
        ]


def judge(entries: Sequence[StudyEntry], table: Table) -> StudyVerdict:
    """Find the worst values, and compare them with the targets.

    Parameters
    ----------
    entries : results with the same estimators and number of joints, at least one
    table : their numbers
    """
    worst = [
        _worst(of_estimator, score) for of_estimator in np.moveaxis(table, 1, 0) for score in SCORES
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


def _worst(table: Table, score: Score) -> WorstValue:
    """Return the worst value of a score of one estimator."""
    estimator = str(table["estimator"].flat[0])
    limit = score.limit(table.shape[-1], estimator) if table["resolved"].any() else None
    value, place, element = score.worst(table, judged=limit is not None)
    return WorstValue(
        estimator=estimator,
        quantity=score.name,
        worst=value,
        limit=limit,
        met=None if limit is None else score.meets(value, limit),
        element=element,
        **{name: int(table[name][place, 0, 0]) for name in _LEVELS},
    )
