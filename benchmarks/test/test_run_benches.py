"""`make bench ARGS=start`, `memory` and `growth`: structure and sanity of their figures."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from armimp_common.errors import GraphError
from armimp_estimation.results import Summary, WallSummary, read_summary
from benchmarks import command_run, growth, memory, start
from benchmarks.__main__ import main
from benchmarks.command_run import CommandRun, run_command
from benchmarks.peak_memory import PeakMemory, descendants, peak_of
from support.results import make_result

pytestmark = pytest.mark.slow

HUNGRY = """
import subprocess, sys, time
if len(sys.argv) == 1:
    subprocess.run([sys.executable, "-m", "hungry", "child"])
else:
    filled = bytes(range(256)) * (80 * 4096)
    print("full", flush=True)
    sys.stdin.readline()
"""


@pytest.fixture(scope="module")
def summary(tmp_path_factory: pytest.TempPathFactory) -> Summary:
    made = read_summary(make_result(tmp_path_factory.mktemp("bench") / "made") / "summary.json")
    wall = WallSummary(before=1.0, trials=4.0, after=0.5)
    return made.model_copy(
        update={
            "wall": wall,
            "trials": [one.model_copy(update={"rtf": 5.0}) for one in made.trials],
        }
    )


@pytest.fixture
def instead(summary: Summary, monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, ...]]:
    """Options of all runs that were asked for; none takes place."""
    asked: list[tuple[str, ...]] = []

    def run(directory: Path, *options: str, watch_memory: bool = False) -> CommandRun:
        asked.append(options)
        modules = [command_run.COMMAND, "armimp_estimation.figure_worker"]
        if "separate" in options:
            modules += ["armimp_sim.node", "armimp_control.node", "armimp_estimation.node"]
        make_result(directory)
        peaks = {module: 100_000_000 + i for i, module in enumerate(modules)}
        return CommandRun(took=5.75, summary=summary, peaks=peaks if watch_memory else {})

    monkeypatch.setattr(growth, "_compile", lambda joints: None)
    for bench in (start, memory, growth):
        monkeypatch.setattr(bench, "run_command", run)
    return asked


Measure = Callable[[str], tuple[int, dict[str, Any]]]


@pytest.fixture
def measure(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Measure:
    """Run a benchmark; gives its status and figures."""

    def run(name: str) -> tuple[int, dict[str, Any]]:
        status = main([name, "--out", str(tmp_path), "--json"])
        figures: dict[str, Any] = json.loads(capsys.readouterr().out)["benchmarks"][name]
        return status, figures

    return run


def test_start_tells_what_is_outside_of_the_trials_and_has_a_limit(
    instead: list[tuple[str, ...]], measure: Measure
) -> None:
    status, figures = measure("start")
    assert status == 0
    assert len(instead) == 1 + sum(start.RUNS.values())
    for processes in ("composed", "separate"):
        parts = {
            key: figures[f"{processes}_{key}"]["value"]
            for key in ("before", "trials", "after", "exit", "outside")
        }
        assert parts == {"before": 1.0, "trials": 4.0, "after": 0.5, "exit": 0.25, "outside": 1.75}
    assert figures["composed_outside"]["limit"] == 3.0
    assert figures["separate_outside"]["limit"] is None


@pytest.mark.usefixtures("instead")
def test_a_start_that_takes_too_long_makes_the_exit_status_1(
    measure: Measure, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(start, "LIMITS", {"composed": 1.7})
    status, figures = measure("start")
    assert status == 1
    assert figures["composed_outside"]["met"] is False


@pytest.mark.usefixtures("instead")
def test_memory_is_told_of_every_process_of_both_arrangements(measure: Measure) -> None:
    _, figures = measure("memory")
    assert set(figures) == {
        "separate_command",
        "separate_arm_sim",
        "separate_imbic_controller",
        "separate_impedance_estimator",
        "separate_figures",
        "composed_command",
        "composed_figures",
    }
    assert all(one["unit"] == "MB" for one in figures.values())
    assert figures["composed_command"]["value"] == pytest.approx(100.0)


def test_growth_is_told_for_every_number_of_joints_and_every_length(
    instead: list[tuple[str, ...]], measure: Measure
) -> None:
    _, figures = measure("growth")
    assert {option[1] for option in instead} == {"2", "3", "7"}
    assert {option[3] for option in instead} == {"10.0", "25.0", "50.0"}
    assert len(figures) == 5 * len(growth.CASES)
    case = {key: figures[f"7_joints_10_s_{key}"] for key in ("rate", "outside", "memory")}
    assert case["rate"]["value"] == pytest.approx(5000.0)
    assert case["outside"]["value"] == pytest.approx(1.75)
    assert case["memory"]["value"] == pytest.approx(100.0)
    for key in ("bag", "estimate"):
        assert figures[f"7_joints_10_s_{key}"]["value"] > 0.0


def test_a_real_run_is_measured(measure: Measure, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(growth, "CASES", ((1, 10.0),))
    _, figures = measure("growth")
    values = {key.removeprefix("1_joints_10_s_"): one["value"] for key, one in figures.items()}
    assert values["rate"] > 100.0
    assert values["outside"] > 0.1
    assert 50.0 < values["memory"] < 2000.0
    assert 0.1 < values["bag"] < 100.0
    assert values["estimate"] > 0.0


def test_when_a_run_has_no_result_expect_its_last_words(tmp_path: Path) -> None:
    with pytest.raises(GraphError, match=r"ended without result: armimp: .*'friction' = 9"):
        run_command(tmp_path / "out", "--friction", "9")


def test_peaks_are_those_of_all_descendants_by_module(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "hungry.py").write_text(HUNGRY)
    monkeypatch.chdir(tmp_path)
    with subprocess.Popen(
        [sys.executable, "-m", "hungry"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        assert process.stdout.readline() == "full\n"
        family = list(descendants(process.pid))
        assert len(family) == 2
        assert family[0] == process.pid
        assert peak_of(family[1]) > 80e6 > peak_of(family[0])
        with PeakMemory(process.pid) as peaks:
            while not peaks.peaks:
                pass
        process.stdin.write("\n")
        process.stdin.flush()
    assert set(peaks.peaks) == {"hungry"}
    assert peaks.peaks["hungry"] > 80e6
