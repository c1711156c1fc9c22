"""The directory of a study: its configuration, one result for each condition, and the products.

A result counts once its ``.json`` is there; it is moved into place when its curves are, so that a
study that was interrupted goes on where it was, and never takes a part of a result for the whole.
"""

from __future__ import annotations

import fcntl
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, TypeVar

from pydantic import TypeAdapter, ValidationError, model_validator

from armimp_bringup.config import ExperimentConfig
from armimp_bringup.study.conditions import LEVELS, Condition
from armimp_common.errors import ConfigurationError, DataError
from armimp_estimation.atomic_write import is_part, open_lock, read_bytes, read_text, write_text
from armimp_estimation.curves import ImpedanceCurve, read_frf, write_frf
from armimp_estimation.identify import EstimatorResult
from armimp_estimation.json_model import first_complaint
from armimp_estimation.summary import Summary, write_summary

CONFIG_FILE = "config.json"
RESULTS_DIRECTORY = "conditions"
_LOCK = ".lock"
_VARIED = {*LEVELS, "seed", "mode", "processes"}
"""What differs between the conditions of a study, and is not part of its configuration."""
_Content = TypeVar("_Content")


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


_ENTRY = TypeAdapter(StudyEntry)
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
    return _read(path, _ENTRIES, "a study")


def read_entry(path: Path) -> StudyEntry:
    """Read the result of one condition.

    Raises
    ------
    DataError
        If it can't be read, or is something else.
    """
    return _read(path, _ENTRY, "the result of a condition")


def _read(path: Path, adapter: TypeAdapter[_Content], what: str) -> _Content:
    try:
        return adapter.validate_json(read_bytes(path))
    except OSError as error:
        raise DataError(f"{path}: {error.strerror}") from None
    except ValidationError as error:
        raise DataError(f"{path}: not {what}: {first_complaint(error)}") from None


class StudyStore:
    """The directory of a study, which `open_study` gives to one process at a time."""

    def __init__(self, directory: Path, estimators: Iterable[str]) -> None:
        self._results = directory / RESULTS_DIRECTORY
        self._estimators = set(estimators)

    def missing(self, conditions: Iterable[Condition]) -> list[Condition]:
        """Conditions without a result."""
        return [one for one in conditions if not self._path(one, "json").exists()]

    def save(self, result: ConditionResult) -> None:
        """Store a result.

        Raises
        ------
        DataError
            If it can't be written.
        """
        curves = self._path(result.entry.condition, "npz")
        # Curves without a result were left by an interruption between the two.
        curves.unlink(missing_ok=True)
        write_frf(curves, {n: ImpedanceCurve.of(one) for n, one in result.results.items()})
        write_summary(self._path(result.entry.condition, "json"), result.entry)

    def entries(self, conditions: Sequence[Condition]) -> list[StudyEntry]:
        """Results of conditions, in their order.

        Raises
        ------
        DataError
            If one is missing or damaged.
        """
        found: list[StudyEntry] = []
        for condition in conditions:
            path = self._path(condition, "json")
            entry = read_entry(path)
            if entry.condition != condition:
                raise DataError(f"{path}: is of {entry.condition}, not {condition}")
            if set(entry.estimators) != self._estimators:
                raise DataError(
                    f"{path}: has the estimators {', '.join(sorted(entry.estimators))}, "
                    f"not {', '.join(sorted(self._estimators))}"
                )
            if found and entry.joints != found[0].joints:
                raise DataError(f"{path}: has {entry.joints} joints, not {found[0].joints}")
            found.append(entry)
        return found

    def curves(self, condition: Condition) -> dict[str, ImpedanceCurve]:
        """Curves of one condition by name of the estimator.

        Raises
        ------
        DataError
            If they are missing or damaged.
        """
        return read_frf(self._path(condition, "npz"))

    def _path(self, condition: Condition, suffix: str) -> Path:
        return self._results / f"{condition.name}.{suffix}"


@contextmanager
def open_study(
    directory: Path, base: ExperimentConfig, software: Mapping[str, Any]
) -> Iterator[StudyStore]:
    """Reserve the directory of a study for this process while the context lasts.

    Parameters
    ----------
    directory : Path
        New, empty, or that of a study with the same configuration.
    base : ExperimentConfig
        Configuration; levels and seed in it do not count.
    software : mapping
        Counts as part of the configuration.

    Raises
    ------
    ConfigurationError
        If the directory holds something else, or a study of another configuration.
    DataError
        If it can't be made or written to, or another process works in it.
    """
    try:
        directory.mkdir(parents=True, exist_ok=True)
        known = (directory / CONFIG_FILE).exists()
        if not known and any(path.name != _LOCK for path in directory.iterdir()):
            raise ConfigurationError(
                f"{directory}: is not empty and holds no study, nothing is overwritten"
            )
        lock = _locked(directory)
    except OSError as error:
        raise DataError(f"{directory}: cannot be used: {error.strerror}") from None
    with lock:
        described = json.loads(base.model_dump_json(exclude=_VARIED))
        _begin(directory, {"schema": 1, "experiment": described, **software})
        yield StudyStore(directory, base.estimators)


def _locked(directory: Path) -> BinaryIO:
    lock = open_lock(directory / _LOCK)
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        lock.close()
        raise DataError(f"{directory}: another process is at work on it") from None
    return lock


def _begin(directory: Path, described: Mapping[str, Any]) -> None:
    """Write the configuration of a new study, or compare with that of an older one."""
    path, results = directory / CONFIG_FILE, directory / RESULTS_DIRECTORY
    if not path.exists():
        write_text(path, json.dumps(described, indent=1) + "\n")
    try:
        results.mkdir(exist_ok=True)
        for left_over in filter(is_part, results.glob(".*")):
            left_over.unlink()
        stored = json.loads(read_text(path))
    except OSError as error:
        raise DataError(f"{directory}: cannot be used: {error.strerror}") from None
    except (ValueError, RecursionError) as error:
        raise DataError(f"{path}: not the configuration of a study: {error}") from None
    different = next(iter(sorted(_differences(stored, described))), None)
    if different is not None:
        raise ConfigurationError(
            f"{directory}: holds a study of another configuration, where {different}"
        )


def _differences(one: object, other: object, where: str = "") -> Iterable[str]:
    """Places where two JSON values differ, with the values, as in ``joints is 2, not 3``."""
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        for key in one.keys() | other.keys():
            inside = f"{where}.{key}" if where else str(key)
            yield from _differences(one.get(key), other.get(key), inside)
    elif one != other:
        shown, wanted = (json.dumps(value) for value in (one, other))
        shown, wanted = (t if len(t) <= 200 else f"{t[:197]}..." for t in (shown, wanted))
        yield f"{where or 'content'} is {shown}, not {wanted}"
