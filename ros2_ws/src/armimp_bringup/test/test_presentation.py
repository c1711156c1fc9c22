"""What becomes of a result on the command line, whatever goes wrong with its figures."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest

from armimp_bringup import presentation
from armimp_bringup.presentation import Stopwatch, complaints, present
from armimp_common.status import Phase
from armimp_estimation.problems import Problem, ProblemCode, Severity, problem
from armimp_estimation.result import Result, load_result
from armimp_estimation.summary import read_summary
from support.results import make_result


@pytest.fixture
def directory(tmp_path: Path) -> Path:
    return make_result(tmp_path / "result")


def names(directory: Path) -> set[str]:
    return {path.name for path in directory.iterdir() if path.is_file()}


@pytest.mark.slow
def test_when_figures_cannot_be_drawn_expect_one_line_and_everything_else(
    directory: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (directory / "coherence.png").mkdir()
    assert present(load_result(directory), directory, as_json=True) == 1
    told = capsys.readouterr()
    (line,) = told.err.splitlines()
    assert line.startswith(f"armimp: {directory / 'coherence.png'}: cannot be written: ")
    assert json.loads(told.out)["valid"] is True
    assert "report.html" in names(directory)


def test_wall_times_and_origin_become_part_of_the_summary_and_change_nothing_else(
    directory: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(presentation, "_draw", lambda *_: None)
    stopwatch = Stopwatch()
    for phase in (Phase.SETTLE, Phase.PERTURB, Phase.REST, Phase.DONE):
        stopwatch.note(phase)
    before = read_summary(directory / "summary.json")
    assert present(Result(summary=before), directory, as_json=False, stopwatch=stopwatch) == 0
    after = read_summary(directory / "summary.json")
    assert after.wall is not None
    assert after.wall.before > 0.0
    assert after.wall.trials >= 0.0
    assert after.wall.after > 0.0
    assert after.origin is not None
    assert after.model_copy(update={"wall": None, "origin": None}) == before
    assert "until the first sample" in capsys.readouterr().out


def test_trials_last_from_the_first_sample_to_the_last_one_that_is_perturbed() -> None:
    stopwatch = Stopwatch()
    stopwatch.note(Phase.SETTLE)
    wall = stopwatch.stop()
    assert math.isnan(wall.before)
    assert math.isnan(wall.trials)
    stopwatch.note(Phase.PERTURB)
    first = stopwatch.stop()
    assert math.isnan(first.trials)
    for phase in (Phase.REST, Phase.SETTLE, Phase.PERTURB):
        stopwatch.note(phase)
    inside = stopwatch.stop()
    assert inside.before == first.before
    stopwatch.note(Phase.ABORTED)
    whole = stopwatch.stop()
    assert whole.before == first.before
    assert whole.trials > inside.trials >= 0.0


def test_problems_are_told_by_what_they_do_and_one_cause_takes_one_line(directory: Path) -> None:
    late: dict[str, Any] = {
        "count": 300,
        "ticks": 20_000,
        "late_ms": 0.25,
        "percent": 1.5,
        "limit": 1.0,
    }
    problems = [
        problem(ProblemCode.SAMPLES_LATE, **late),
        problem(ProblemCode.STALLED, seconds=30.0),
        problem(ProblemCode.LATENCY, ms=2.0, limit=1.0),
        Problem(
            code=ProblemCode.LOCK_RATIO,
            estimator="welch_siso",
            values={"name": "a", "perturbed": "b", "percent": 4.0, "limit": 2.0, "estimator": "x"},
        ),
        Problem(
            code=ProblemCode.DELAY_CORRECTED,
            severity=Severity.NOTE,
            values={"delay_ms": 1.0, "error_ms": 0.1},
        ),
    ]
    summary = read_summary(directory / "summary.json")
    deciding = {
        name: one.model_copy(update={"decides": name != "welch_siso"})
        for name, one in summary.estimators.items()
    }
    told = complaints(summary.model_copy(update={"problems": problems, "estimators": deciding}))
    kinds = [line.partition(": ")[0] for line in told]
    assert kinds == ["not valid", "not valid", "refused", "note"]
    assert told[0].startswith("not valid: the machine was too busy for real time: 300 of 20000 ")
    assert "real time: the" not in told[0]
    (alone,) = complaints(summary.model_copy(update={"problems": problems[:1]}))
    assert alone == f"not valid: {problems[0]}"
