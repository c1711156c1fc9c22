"""`armimp bench`: figures that are positive and consistent, targets, and the file."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path

import pytest

from armimp_bringup import benchmarks
from armimp_bringup.benchmarks import Measured, available_cores, benchmark_names
from armimp_bringup.cli import main
from armimp_bringup.study import bench
from armimp_common.errors import GraphError


@pytest.fixture
def brief(monkeypatch: pytest.MonkeyPatch) -> None:
    """Measurements as short as they can be."""
    for name, value in (("TRIAL", 10.0), ("_SCALAR", 0.02), ("_BATCH", 0.02), ("_REPEATS", 1)):
        monkeypatch.setattr(bench, name, value)


def _instead(monkeypatch: pytest.MonkeyPatch, **found: list[Measured]) -> None:
    """Benchmarks that have these figures without measuring anything."""

    def made(figures: list[Measured]) -> Callable[[object], list[Measured]]:
        return lambda tell: figures

    registry = {name: made(figures) for name, figures in found.items()}
    monkeypatch.setattr(benchmarks, "_BENCHMARKS", registry)


def _figure(value: float, limit: float | None = None) -> Measured:
    return Measured(key="one", label="a figure", value=value, unit="s", limit=limit)


@pytest.mark.usefixtures("brief")
def test_study_is_timed_in_one_lane_in_many_and_as_a_whole(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    status = main(["bench", "study", "--out", str(tmp_path / "out"), "--json"])
    told = capsys.readouterr()
    record = json.loads(told.out)
    assert record == json.loads((tmp_path / "out" / "bench.json").read_text())
    assert record["schema"] == 1
    assert record["machine"]["cores"] == available_cores() >= 1
    assert "numpy" in record["versions"]
    figures = record["benchmarks"]["study"]
    values = {key: one["value"] for key, one in figures.items()}
    assert set(values) == {
        "scalar_trial", "batch_trial", "speed_up", "loaded_trial", "estimate", "study",
    }  # fmt: skip
    assert all(value > 0.0 for value in values.values())
    assert values["speed_up"] == pytest.approx(values["scalar_trial"] / values["batch_trial"])
    # 96 trials in blocks, some lanes of which may be idle, and 48 conditions to estimate.
    shared = 96 * values["loaded_trial"] + 48 * values["estimate"]
    assert values["study"] >= 0.99 * shared / available_cores()
    assert figures["study"]["limit"] == 60.0
    assert status == (0 if values["study"] <= 60.0 else 1)
    assert "compiling" in told.err


def test_figures_are_shown_with_units_targets_and_the_machine(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    _instead(monkeypatch, first=[_figure(1.5, 2.0)], second=[_figure(7.25)])
    assert main(["bench", "--out", str(tmp_path)]) == 0
    told = capsys.readouterr().out
    assert "first" in told
    assert "≤ 2 s ✓" in told
    assert "7.25" in told
    assert f"{available_cores()} cores" in told
    assert str(tmp_path / "bench.json") in told


@pytest.mark.parametrize("value", [2.1, math.nan])
def test_missed_target_exits_with_1_and_is_named(
    value: float,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    _instead(monkeypatch, first=[_figure(value, 2.0), _figure(1.0, 2.0)])
    assert main(["bench", "--out", str(tmp_path)]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert line == f"armimp: a figure is {value:.3g} s, target 2"


def test_only_the_named_benchmarks_run(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    _instead(monkeypatch, first=[_figure(1.0)], second=[_figure(1.0)])
    assert main(["bench", "second", "second", "--out", str(tmp_path)]) == 0
    record = json.loads((tmp_path / "bench.json").read_text())
    assert list(record["benchmarks"]) == ["second"]


def test_when_one_fails_expect_it_named_and_the_figures_of_the_others(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def fails(tell: object) -> list[Measured]:
        raise GraphError("no graph today")

    _instead(monkeypatch, first=[], last=[_figure(2.0)])
    monkeypatch.setitem(benchmarks._BENCHMARKS, "first", fails)
    assert main(["bench", "--out", str(tmp_path)]) == 1
    assert capsys.readouterr().err == "armimp: first: no graph today\n"
    record = json.loads((tmp_path / "bench.json").read_text())
    assert list(record["benchmarks"]) == ["last"]
    assert record["failed"] == {"first": "no graph today"}


def test_unknown_benchmark_is_wrong_usage(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["bench", "guess", "--out", str(tmp_path / "out")]) == 2
    told = capsys.readouterr().err
    assert told == f"armimp: there is no benchmark 'guess', only {', '.join(benchmark_names())}\n"
    assert not (tmp_path / "out").exists()


def test_earlier_figures_are_not_overwritten(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "bench.json").write_text("{}")
    _instead(monkeypatch, first=[_figure(1.0)])
    assert main(["bench", "--out", str(tmp_path)]) == 1
    assert capsys.readouterr().err == f"armimp: {tmp_path / 'bench.json'}: exists already\n"
    assert (tmp_path / "bench.json").read_text() == "{}"
