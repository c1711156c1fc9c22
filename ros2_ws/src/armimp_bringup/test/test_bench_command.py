"""`armimp bench`: figures that are positive and consistent, targets, and the file."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path

import pytest

from armimp_bringup import benchmarks
from armimp_bringup.benchmarks import BENCHMARKS, Measured, available_cores
from armimp_bringup.cli import main
from armimp_common.errors import GraphError


def _instead(monkeypatch: pytest.MonkeyPatch, **found: list[Measured]) -> None:
    """Benchmarks that have these figures without measuring anything."""

    def made(figures: list[Measured]) -> Callable[[object], list[Measured]]:
        return lambda tell: figures

    registry = {name: made(figures) for name, figures in found.items()}
    monkeypatch.setattr(benchmarks, "BENCHMARKS", registry)


def _figure(value: float, limit: float | None = None) -> Measured:
    return Measured(key="one", label="a figure", value=value, unit="s", limit=limit)


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
    monkeypatch.setattr(benchmarks, "BENCHMARKS", {**benchmarks.BENCHMARKS, "first": fails})
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
    assert told == f"armimp: there is no benchmark 'guess', only {', '.join(BENCHMARKS)}\n"
    assert not (tmp_path / "out").exists()


def test_earlier_figures_are_not_overwritten(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "bench.json").write_text("{}")
    _instead(monkeypatch, first=[_figure(1.0)])
    assert main(["bench", "--out", str(tmp_path)]) == 1
    assert capsys.readouterr().err == f"armimp: {tmp_path / 'bench.json'}: exists already\n"
    assert (tmp_path / "bench.json").read_text() == "{}"
