"""Results of the conditions of a study, and their files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from pydantic import TypeAdapter, model_validator

from armimp_bringup.study.conditions import LEVELS, Condition
from armimp_estimation.curves import ImpedanceCurve, read_frf, write_frf
from armimp_estimation.identify import EstimatorResult
from armimp_estimation.json_model import read_json
from armimp_estimation.summary import Summary, write_summary


class StudyEntry(Summary):
    """The result of one condition: a summary with the levels; its seed is part of any summary."""

    seed: int
    friction: int
    resolution: int
    perturbation: int

    @model_validator(mode="after")
    def _check_complete(self) -> StudyEntry:
        """Whatever simulates a condition knows the truth, and perturbs each joint once."""
        if self.truth is None:
            raise ValueError("truth is missing")
        if not self.estimators:
            raise ValueError("estimators are missing")
        if any(estimator.vaf is None for estimator in self.estimators.values()):
            raise ValueError("a VAF is missing")
        perturbed = [trial.k for trial in self.trials]
        if sorted(perturbed) != list(range(1, self.joints + 1)):
            raise ValueError(f"trials perturb the joints {perturbed}, of {self.joints}")
        return self

    @property
    def condition(self) -> Condition:
        """What the result is of."""
        levels = {factor: getattr(self, factor) for factor in LEVELS}
        return Condition(seed=self.seed, **levels)


@dataclass(frozen=True, kw_only=True, eq=False)
class ConditionResult:
    """The result of one condition, and its curves by name of the estimator."""

    entry: StudyEntry
    results: dict[str, EstimatorResult]


_ENTRIES = TypeAdapter(list[StudyEntry])


def study_text(entries: Sequence[StudyEntry]) -> str:
    """Content of ``study.json``: a list of entries."""
    return _ENTRIES.dump_json(list(entries), indent=1, by_alias=True).decode() + "\n"


def read_study(path: Path) -> list[StudyEntry]:
    """Read ``study.json``.

    Raises
    ------
    DataError
        If it can't be read, or is something else.
    """
    return read_json(path, _ENTRIES.validate_json, "a study")


def save_result(directory: Path, result: ConditionResult) -> None:
    """Write result and curves of a condition.

    Raises
    ------
    DataError
        If they can't be written.
    """
    name = result.entry.condition.name
    write_frf(
        directory / f"{name}.npz", {n: ImpedanceCurve.of(one) for n, one in result.results.items()}
    )
    write_summary(directory / f"{name}.json", result.entry)


def saved_curves(directory: Path, condition: Condition) -> dict[str, ImpedanceCurve]:
    """Curves of one condition by name of the estimator.

    Raises
    ------
    DataError
        If they are missing or damaged.
    """
    return read_frf(directory / f"{condition.name}.npz")
