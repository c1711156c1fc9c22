"""The directory of a study: its configuration, one result for each condition, and the products.

A result counts once its ``.json`` is there; it is moved into place when its curves are, so that a
study that was interrupted goes on where it was, and never takes a part of a result for the whole.
"""

from __future__ import annotations

import fcntl
import json
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO

from armimp_bringup.config import ExperimentConfig
from armimp_bringup.study.conditions import Condition
from armimp_bringup.study.engine import ConditionResult, Provenance
from armimp_bringup.study.entry import StudyEntry, differences, read_entry
from armimp_bringup.study.errors import StudyError
from armimp_common.errors import ConfigurationError
from armimp_estimation.atomic_write import is_part, open_lock, read_text, write_whole
from armimp_estimation.results import ImpedanceCurve, read_frf, write_frf, write_summary

CONFIG_FILE = "config.json"
RESULTS_DIRECTORY = "conditions"
_LOCK = ".lock"
# What differs between the conditions of a study, and is not part of its configuration.
_VARIED = {"friction", "resolution", "perturbation", "seed", "mode", "processes"}


class StudyStore:
    """An open directory of a study, for one process at a time.

    Parameters
    ----------
    directory : Path
        New, empty, or that of a study with the same configuration.
    base : ExperimentConfig
        Configuration; levels and seed in it do not count.
    provenance : Provenance
        Software, which counts as part of the configuration.

    Raises
    ------
    ConfigurationError
        If the directory holds something else, or a study of another configuration.
    StudyError
        If it can't be made or written to, or another process works in it.
    """

    def __init__(self, directory: Path, base: ExperimentConfig, provenance: Provenance) -> None:
        self.directory = directory
        self._estimators = set(base.estimators)
        described = _description(base, provenance)
        try:
            directory.mkdir(parents=True, exist_ok=True)
            self._refuse_foreign()
            self._lock = self._locked()
        except OSError as error:
            raise StudyError(f"{directory}: cannot be used: {error.strerror}") from None
        try:
            self._begin(described)
            self._check(described)
        except BaseException:
            self._lock.close()
            raise

    def __enter__(self) -> StudyStore:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._lock.close()

    def missing(self, conditions: Iterable[Condition]) -> list[Condition]:
        """Conditions without a result."""
        return [one for one in conditions if not self._path(one, "json").exists()]

    def save(self, result: ConditionResult) -> None:
        """Store a result.

        Raises
        ------
        StudyError, DataError
            If it can't be written.
        """
        curves = self._path(result.condition, "npz")
        # Curves without a result were left by an interruption between the two.
        curves.unlink(missing_ok=True)
        write_frf(curves, result.results)
        write_summary(self._path(result.condition, "json"), result.entry)

    def entries(self, conditions: Sequence[Condition]) -> list[StudyEntry]:
        """Results of conditions, in their order.

        Raises
        ------
        StudyError, DataError
            If one is missing or damaged.
        """
        found: list[StudyEntry] = []
        for condition in conditions:
            path = self._path(condition, "json")
            entry = read_entry(path)
            if entry.condition != condition:
                raise StudyError(f"{path}: is of {entry.condition}, not {condition}")
            if set(entry.estimators) != self._estimators:
                raise StudyError(
                    f"{path}: has the estimators {', '.join(sorted(entry.estimators))}, "
                    f"not {', '.join(sorted(self._estimators))}"
                )
            if found and entry.joints != found[0].joints:
                raise StudyError(f"{path}: has {entry.joints} joints, not {found[0].joints}")
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

    def _refuse_foreign(self) -> None:
        if (self.directory / CONFIG_FILE).exists():
            return
        if any(path.name != _LOCK for path in self.directory.iterdir()):
            raise ConfigurationError(
                f"{self.directory}: is not empty and holds no study, nothing is overwritten"
            )

    def _begin(self, described: dict[str, Any]) -> None:
        path = self.directory / CONFIG_FILE
        if not path.exists():
            write_file(path, json.dumps(described, indent=1) + "\n")
        results = self.directory / RESULTS_DIRECTORY
        try:
            results.mkdir(exist_ok=True)
            for left_over in filter(is_part, results.glob(".*")):
                left_over.unlink()
        except OSError as error:
            raise StudyError(f"{results}: cannot be used: {error.strerror}") from None

    def _locked(self) -> BinaryIO:
        lock = open_lock(self.directory / _LOCK)
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            lock.close()
            raise StudyError(f"{self.directory}: another process is at work on it") from None
        return lock

    def _check(self, described: dict[str, Any]) -> None:
        path = self.directory / CONFIG_FILE
        try:
            stored = json.loads(read_text(path))
        except OSError as error:
            raise StudyError(f"{path}: {error.strerror}") from None
        except (ValueError, RecursionError) as error:
            raise StudyError(f"{path}: not the configuration of a study: {error}") from None
        different = next(iter(sorted(differences(stored, described))), None)
        if different is not None:
            raise ConfigurationError(
                f"{self.directory}: holds a study of another configuration, where {different}"
            )

    def _path(self, condition: Condition, suffix: str) -> Path:
        return self.directory / RESULTS_DIRECTORY / f"{condition.name}.{suffix}"


def write_file(path: Path, content: str) -> None:
    """Write or replace a text file, so that no part of it is ever seen.

    Raises
    ------
    StudyError
        If it can't be written.
    """
    replace_file(path, lambda part: part.write_text(content, encoding="utf-8"))


def replace_file(path: Path, write: Callable[[Path], object]) -> None:
    """Have a file written beside its place (with the same suffix), and move it there.

    Raises
    ------
    StudyError
        If it can't be written.
    """
    write_whole(path, write, anew=True, error=StudyError)


def _description(base: ExperimentConfig, provenance: Provenance) -> dict[str, Any]:
    described: dict[str, Any] = json.loads(base.model_dump_json(exclude=_VARIED))
    return {
        "schema": 1,
        "experiment": described,
        "versions": dict(provenance.versions),
        "git_revision": provenance.git_revision,
    }
