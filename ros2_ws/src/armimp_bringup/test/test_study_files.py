"""A study in its directory: complete, and never mixed with another."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from armimp_bringup.config import ExperimentConfig
from armimp_bringup.study.conditions import select_conditions
from armimp_bringup.study.engine import Batch, Threads, run_batch
from armimp_bringup.study.scores import StudyVerdict
from armimp_bringup.study.store import ConditionResult
from armimp_bringup.study.study import run_study
from armimp_common.errors import ConfigurationError

BASE = ExperimentConfig(duration=4.0, estimators=("welch_siso", "lpm_full"))
CONDITIONS = select_conditions(["friction=0+3,resolution=0+3,perturbation=2"], "1")
TABLES = ("study.json", "results.csv", "verdict.json", "report.html")


@pytest.fixture(scope="module")
def results() -> list[ConditionResult]:
    return run_batch(Batch(base=BASE, conditions=CONDITIONS))


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, StudyVerdict]:
    """A small study on two threads."""
    directory = tmp_path_factory.mktemp("study") / "new" / "folder"
    return directory, run_study(BASE, CONDITIONS, directory, Threads(2), figures=False)


def _bytes(directory: Path) -> dict[str, bytes]:
    return {name: (directory / name).read_bytes() for name in TABLES}


def test_study_leaves_all_its_files_and_no_others(study: tuple[Path, StudyVerdict]) -> None:
    directory, _ = study
    found = {path.name for path in directory.iterdir()}
    assert found == {*TABLES, "config.json", "conditions"}
    assert {path.name for path in (directory / "conditions").iterdir()} == {
        f"{one.name}.{suffix}" for one in CONDITIONS for suffix in ("json", "npz")
    }


def test_study_file_is_a_list_of_results_with_their_levels(
    study: tuple[Path, StudyVerdict], results: list[ConditionResult]
) -> None:
    directory, _ = study
    content = json.loads((directory / "study.json").read_text())
    assert [
        (one["friction"], one["resolution"], one["perturbation"], one["seed"]) for one in content
    ] == [(c.friction, c.resolution, c.perturbation, c.seed) for c in CONDITIONS]
    for one, result in zip(content, results, strict=True):
        assert one == json.loads(result.entry.model_dump_json(by_alias=True))
        assert one["schema"] == 1
        assert set(one["estimators"]) == set(BASE.estimators)


def test_number_of_workers_makes_no_difference(
    study: tuple[Path, StudyVerdict], tmp_path: Path
) -> None:
    directory, verdict = study
    again = run_study(BASE, CONDITIONS, tmp_path / "out", Threads(3), figures=False)
    assert again == verdict
    stored = StudyVerdict.model_validate_json((directory / "verdict.json").read_bytes())
    assert stored == verdict
    assert _bytes(tmp_path / "out") == _bytes(directory)


def test_a_directory_that_holds_something_is_refused_and_left_alone(
    study: tuple[Path, StudyVerdict],
) -> None:
    directory, _ = study
    before = _bytes(directory)
    with pytest.raises(ConfigurationError, match="is not empty, nothing is overwritten"):
        run_study(BASE, CONDITIONS, directory, Threads(1), figures=False)
    assert _bytes(directory) == before
