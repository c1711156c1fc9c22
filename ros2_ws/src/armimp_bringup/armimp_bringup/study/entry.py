"""The result of one condition, as it stands in ``study.json``."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from pathlib import Path

from pydantic import TypeAdapter, ValidationError, model_validator

from armimp_bringup.study.conditions import Condition
from armimp_common.errors import DataError
from armimp_estimation.atomic_write import read_bytes
from armimp_estimation.json_model import first_complaint
from armimp_estimation.results import Summary


class StudyEntry(Summary):
    """A summary with the levels of its condition; its seed is part of any summary."""

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
        return Condition(
            seed=self.seed,
            friction=self.friction,
            resolution=self.resolution,
            perturbation=self.perturbation,
        )


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
    try:
        return _ENTRIES.validate_json(read_bytes(path))
    except OSError as error:
        raise DataError(f"{path}: {error.strerror}") from None
    except ValidationError as error:
        raise DataError(f"{path}: not a study: {first_complaint(error)}") from None


def read_entry(path: Path) -> StudyEntry:
    """Read the result of one condition.

    Raises
    ------
    DataError
        If it can't be read, or is something else.
    """
    try:
        return StudyEntry.model_validate_json(read_bytes(path))
    except OSError as error:
        raise DataError(f"{path}: {error.strerror}") from None
    except ValidationError as error:
        raise DataError(
            f"{path}: not the result of a condition: {first_complaint(error)}"
        ) from None


def differences(one: object, other: object, where: str = "") -> Iterable[str]:
    """Places where two JSON values differ, with the values, as in ``joints is 2, not 3``."""
    if isinstance(one, dict) and isinstance(other, dict):
        for key in one.keys() | other.keys():
            inside = f"{where}.{key}" if where else str(key)
            yield from differences(one.get(key), other.get(key), inside)
    elif one != other:
        yield f"{where or 'content'} is {_shown(one)}, not {_shown(other)}"


def _shown(value: object) -> str:
    text = json.dumps(value)
    return text if len(text) <= 200 else f"{text[:197]}..."
