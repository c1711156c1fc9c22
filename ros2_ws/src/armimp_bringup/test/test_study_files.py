"""A study in its directory: complete, resumed after interruptions, and never mixed with another."""

from __future__ import annotations

import io
import json
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from armimp_bringup.config import ExperimentConfig
from armimp_bringup.study.conditions import Condition, select_conditions
from armimp_bringup.study.engine import Batch, Threads, run_batch, software
from armimp_bringup.study.scores import StudyVerdict
from armimp_bringup.study.store import ConditionResult, open_study, read_study
from armimp_bringup.study.study import run_study
from armimp_bringup.terminal import Display
from armimp_common.errors import ConfigurationError, DataError

BASE = ExperimentConfig(duration=4.0, estimators=("welch_siso", "lpm_full"))
CONDITIONS = select_conditions(["friction=0+3,resolution=0+3,perturbation=2"], "1")
TABLES = ("study.json", "results.csv", "verdict.json", "report.html")


class Recorded(Threads):
    """Threads that take results from elsewhere, and may be interrupted."""

    def __init__(self, results: Sequence[ConditionResult], stop_after: int | None = None) -> None:
        super().__init__(2)
        self._results = {result.entry.condition: result for result in results}
        self._stop_after = stop_after
        self.asked: list[Condition] = []

    def run(self, batches: Sequence[Batch]) -> Iterator[list[ConditionResult]]:
        for number, batch in enumerate(batches):
            if number == self._stop_after:
                raise KeyboardInterrupt
            self.asked += batch.conditions
            yield [self._results[condition] for condition in batch.conditions]


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
    assert found == {*TABLES, "config.json", "conditions", ".lock"}
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


def test_interrupted_study_does_only_what_is_missing(
    study: tuple[Path, StudyVerdict], results: list[ConditionResult], tmp_path: Path
) -> None:
    first = Recorded(results, stop_after=1)
    with pytest.raises(KeyboardInterrupt):
        run_study(BASE, CONDITIONS, tmp_path, first, figures=False)
    assert 0 < len(first.asked) < len(CONDITIONS)
    assert not (tmp_path / "study.json").exists()

    second = Recorded(results)
    told = io.StringIO()
    with Display(Console(file=told)):
        run_study(BASE, CONDITIONS, tmp_path, second, figures=False)
    assert sorted(first.asked + second.asked) == list(CONDITIONS)
    lines = told.getvalue().splitlines()
    assert lines[0] == "2 of 4 conditions, 2 of them from before"
    assert lines[-1].startswith("4 of 4 conditions, 2 of them from before, took ")
    assert _bytes(tmp_path) == _bytes(study[0])

    third = Recorded(results)
    run_study(BASE, CONDITIONS, tmp_path, third, figures=False)
    assert third.asked == []


def test_selection_may_grow_and_files_are_of_the_present_one(
    study: tuple[Path, StudyVerdict], results: list[ConditionResult], tmp_path: Path
) -> None:
    run_study(BASE, CONDITIONS[:1], tmp_path, Recorded(results), figures=False)
    assert len(read_study(tmp_path / "study.json")) == 1
    backend = Recorded(results)
    run_study(BASE, CONDITIONS, tmp_path, backend, figures=False)
    assert backend.asked == list(CONDITIONS[1:])
    assert _bytes(tmp_path) == _bytes(study[0])


def test_curves_without_a_result_are_made_again(
    results: list[ConditionResult], tmp_path: Path
) -> None:
    run_study(BASE, CONDITIONS, tmp_path, Recorded(results), figures=False)
    stored = tmp_path / "conditions" / CONDITIONS[1].name
    stored.with_name(f"{stored.name}.json").unlink()
    stored.with_name(f"{stored.name}.npz").write_bytes(b"half of")
    (tmp_path / "conditions" / ".0123456789abcdef.json").write_text("left over")
    (tmp_path / "conditions" / ".notes.json").write_text("of somebody else")
    backend = Recorded(results)
    run_study(BASE, CONDITIONS, tmp_path, backend, figures=False)
    assert backend.asked == [CONDITIONS[1]]
    assert [path.name for path in (tmp_path / "conditions").glob(".*")] == [".notes.json"]
    with open_study(tmp_path, BASE, software()) as store:
        curve = store.curves(CONDITIONS[1])["lpm_full"]
    np.testing.assert_array_equal(curve.Z, results[1].results["lpm_full"].estimate.Z)


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"duration": 20.0}, "experiment.duration is 4.0, not 20.0"),
        (
            {"arm_sim": {"voluntary": {"rms": 0.1}}},
            'experiment.arm_sim.voluntary is null, not {"rms": 0.1}',
        ),
    ],
)
def test_directory_of_another_configuration_is_refused_in_one_line(
    study: tuple[Path, StudyVerdict], changes: dict[str, object], complaint: str
) -> None:
    directory, _ = study
    before = _bytes(directory)
    with pytest.raises(ConfigurationError) as caught:
        run_study(BASE.model_copy(update=changes), CONDITIONS, directory, Recorded([]))
    assert str(caught.value) == (
        f"{directory}: holds a study of another configuration, where {complaint}"
    )
    assert _bytes(directory) == before


def test_levels_and_seed_of_the_configuration_do_not_count(
    study: tuple[Path, StudyVerdict],
) -> None:
    directory, verdict = study
    other = BASE.model_copy(update={"friction": 1, "seed": 9, "processes": "separate"})
    assert run_study(other, CONDITIONS, directory, Recorded([]), figures=False) == verdict


def _open(directory: Path, here: Mapping[str, Any]) -> None:
    with open_study(directory, BASE, here):
        pass


def test_directory_of_other_software_is_refused(tmp_path: Path) -> None:
    _open(tmp_path, software())
    other = {**software(), "versions": {**software()["versions"], "numpy": "9.9"}}
    with pytest.raises(ConfigurationError, match=r"versions\.numpy is .*, not \"9\.9\""):
        _open(tmp_path, other)


def test_two_processes_do_not_work_in_one_directory(tmp_path: Path) -> None:
    holder = (
        "import fcntl, sys\n"
        "file = open(sys.argv[1], 'w')\n"
        "fcntl.flock(file, fcntl.LOCK_EX)\n"
        "print('held', flush=True)\n"
        "sys.stdin.read()\n"
    )
    with subprocess.Popen(
        [sys.executable, "-c", holder, str(tmp_path / ".lock")],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as other:
        assert other.stdout is not None
        assert other.stdin is not None
        other.stdout.readline()
        with pytest.raises(DataError, match="another process is at work on it"):
            _open(tmp_path, software())
        other.stdin.close()
    _open(tmp_path, software())
