"""What the command line shows of a running trial and of a result."""

import io
import json
import math
import sys
from itertools import count
from pathlib import Path
from types import SimpleNamespace

import pytest
from rich.console import Console

from armimp_bringup import presentation
from armimp_bringup.presentation import Stopwatch, complaints, present
from armimp_bringup.terminal import Display, say
from armimp_common.status import Phase, Progress
from armimp_common.topics import COMMANDS
from armimp_estimation.problems import Problem, ProblemCode, Severity, problem
from armimp_estimation.result import Result, load_result
from armimp_estimation.summary import read_summary
from support import known
from support.results import make_result
from support.streams import changed
from support.synthetic_bags import recorded_arm


@pytest.fixture
def directory(tmp_path: Path) -> Path:
    return make_result(tmp_path / "result")


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
    assert (directory / "report.html").is_file()


def test_wall_times_and_origin_become_part_of_the_summary_and_change_nothing_else(
    directory: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(presentation, "_draw", lambda *_: None)
    monkeypatch.setattr(presentation, "time", SimpleNamespace(monotonic=count().__next__))
    stopwatch = Stopwatch()
    for phase in (Phase.SETTLE, Phase.PERTURB, Phase.REST, Phase.DONE):
        stopwatch.note(phase)
    before = read_summary(directory / "summary.json")
    assert present(Result(summary=before), directory, as_json=False, stopwatch=stopwatch) == 0
    after = read_summary(directory / "summary.json")
    wall = known(after.wall)
    assert wall.before > 1.0
    assert (wall.trials, wall.result, wall.after) == (1.0, 1.0, 2.0)
    assert after.origin is not None
    assert after.model_copy(update={"wall": None, "origin": None}) == before
    assert "until the first sample" in capsys.readouterr().out


def test_trials_last_from_the_first_sample_to_the_last_one_that_is_perturbed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(presentation, "time", SimpleNamespace(monotonic=count().__next__))
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
    assert (inside.trials, whole.trials) == (2.0, 4.0)


def test_problems_are_listed_by_their_effect_and_one_cause_takes_one_line(directory: Path) -> None:
    problems = [
        problem(
            ProblemCode.SAMPLES_LATE, count=300, ticks=20_000, late_ms=0.25, percent=1.5, limit=1.0
        ),
        problem(ProblemCode.STALLED, seconds=30.0),
        problem(ProblemCode.LATENCY, ms=2.0, limit=1.0),
        Problem(
            code=ProblemCode.LOCK_RATIO,
            estimator="welch_siso",
            values={"name": "a", "perturbed": "b", "percent": 4.0, "limit": 2.0, "estimator": "x"},
        ),
        problem(ProblemCode.DELAY_CORRECTED, severity=Severity.NOTE, delay_ms=1.0, error_ms=0.1),
    ]
    summary = read_summary(directory / "summary.json")
    deciding = {
        name: changed(one, decides=name != "welch_siso") for name, one in summary.estimators.items()
    }
    told = complaints(summary.model_copy(update={"problems": problems, "estimators": deciding}))
    kinds = [line.partition(": ")[0] for line in told]
    assert kinds == ["not valid", "not valid", "refused", "note"]
    assert told[0].startswith("not valid: the machine was too busy for real time: 300 of 20000 ")
    assert "real time: the" not in told[0]
    (alone,) = complaints(summary.model_copy(update={"problems": problems[:1]}))
    assert alone == f"not valid: {problems[0]}"


def test_after_refusals_the_verdict_names_the_deciding_estimator(
    directory: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    summary = read_summary(directory / "summary.json")
    presentation.print_result(summary)
    assert capsys.readouterr().out.endswith("\nvalid\n")
    siso = changed(summary.estimators["welch_siso"], decides=False)
    refusal = problem(ProblemCode.NO_RESPONSE, estimator="welch_siso")
    estimators = {**summary.estimators, "welch_siso": siso}
    presentation.print_result(
        summary.model_copy(update={"problems": [refusal], "estimators": estimators})
    )
    assert capsys.readouterr().out.endswith("\nvalid, by welch_full\n")


def test_on_a_terminal_messages_break_between_words(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    line = "armimp: " + "perturbed half-open " * 9 + "x" * 90
    say(line)
    assert capsys.readouterr().err == f"{line}\n"
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    say(line)
    shown = capsys.readouterr().err.splitlines()
    assert " ".join(shown) == line
    assert len(shown) > 2
    assert all(len(one) <= 80 for one in shown[:-1])


def test_commands_that_were_not_recorded_are_shown_as_such_and_not_as_lost(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    messages = [one for one in recorded_arm().messages if one[0] != COMMANDS]
    summary = read_summary(make_result(tmp_path / "silent", messages=messages) / "summary.json")
    presentation.print_result(summary)
    table = capsys.readouterr().out.partition("trials\n")[2]
    rows = [line.split()[:4] for line in table.splitlines() if "commands" in line]
    assert rows == [["1", "10000", "0", "commands"], ["2", "10000", "0", "commands"]]


# --- The live display: what is measured so far, with its uncertainty, and how far the trial is --

SNAPSHOT = Progress(
    trial=1,
    trials=2,
    joint=2,
    phase=Phase.PERTURB,
    samples=10_000,
    planned=50_000,
    rate=5000.0,
    coherence_motion=0.9876,
    coherence_torque=0.99,
    M=(0.0837, 0.0598),
    M_se=(0.00021, 0.0001),
    B=(0.2358, 0.4051),
    B_se=(0.0017, 0.012),
    K=(3.1082, 6.8538),
    K_se=(0.033, 1.5),
    largest_error=0.0107,
)


@pytest.mark.parametrize(
    ("preliminary", "column"),
    [
        (
            False,
            [
                "M12 0.08370 ± 0.00021   M22 0.05980 ± 0.00010 kg·m²",
                "B12 0.2358 ± 0.0017   B22 0.405 ± 0.012 N·m·s/rad",
                "K12 3.108 ± 0.033   K22 6.9 ± 1.5 N·m/rad",
                "standard errors up to 1.1 %",
            ],
        ),
        (
            True,
            [
                "M12 0.0837   M22 0.0598 kg·m²",
                "B12 0.236   B22 0.41 N·m·s/rad",
                "K12 3.11   K22 7 N·m/rad",
                "preliminary; random errors up to 1.1 %",
            ],
        ),
    ],
)
def test_a_terminal_shows_time_left_coherence_and_column_and_follows_an_earlier_end(
    preliminary: bool, column: list[str]
) -> None:
    output = io.StringIO()
    console = Console(file=output, force_terminal=True, width=120, height=20)
    snapshot = changed(SNAPSHOT, preliminary=preliminary)
    with Display(console) as display:
        display.show(snapshot)
        display.phase("")
        display.show(changed(snapshot, samples=20_000, planned=20_000))
        display.complete("estimating")
    text = output.getvalue()
    told = ("trial 1/2", "10.0/50.0 s  5.0x  18 s left", "coherence θ 0.988", *column)
    assert [part for part in told if part not in text] == []
    assert "20.0 s" in text
    assert "estimating" in text


def test_without_a_terminal_only_the_beginning_of_each_trial_is_printed() -> None:
    output = io.StringIO()
    with Display(Console(file=output, width=120)) as display:
        for samples in (0, 10, 20_000):
            display.show(changed(SNAPSHOT, samples=samples))
    assert output.getvalue().count("trial 1/2") == 1
