"""`armimp bench`: figures, targets, and what cannot be measured."""

import json
import math
import os
import signal
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest

from armimp_bringup import bench, orchestrator
from armimp_bringup.bench import Measured, available_cores
from armimp_bringup.config import ExperimentConfig
from armimp_common.errors import ConfigurationError, GraphError
from armimp_common.realtime import TimingLimits
from armimp_common.status import TimingFigures
from armimp_estimation.metadata import Timing
from support.command import call

Benchmarks = dict[str, Callable[[object], list[Measured]]]


def _figure(value: float, limit: float | None = None) -> Measured:
    return Measured(label="a figure", value=value, unit="s", limit=limit)


def test_figures_are_shown_with_units_targets_and_the_machine(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    measured: Benchmarks = {
        "first": lambda _: [_figure(1.5, 2.0)],
        "second": lambda _: [_figure(7.25)],
    }
    monkeypatch.setattr(bench, "BENCHMARKS", measured)
    told = call("bench")
    assert told.status == 0
    for words in ("first", "≤ 2 s ✓", "7.25", f"{available_cores()} cores"):
        assert words in told.out


@pytest.mark.parametrize("value", [2.1, math.nan])
def test_what_misses_its_target_or_fails_is_named_beside_the_figures_of_the_others(
    value: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(_: object) -> list[Measured]:
        raise GraphError("no graph today")

    figures = [_figure(value, 2.0), _figure(1.0, 2.0)]
    measured: Benchmarks = {"first": fails, "last": lambda _: figures, "other": lambda _: []}
    monkeypatch.setattr(bench, "BENCHMARKS", measured)
    assert call("bench", "last").status == call("bench", "first").status == 1
    told = call("bench", "first", "last", "last", "--json")
    assert told.status == 1
    missed = f"armimp: a figure is {value:.3g} s, target 2\n"
    assert told.err == f"{missed}armimp: first: no graph today\n"
    record = json.loads(told.out)
    assert list(record["benchmarks"]) == ["last"]
    assert record["failed"] == {"first": "no graph today"}


def test_jitter_is_that_of_runs_in_real_time_whose_priority_is_permitted(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    figures = TimingFigures(ticks=200, late=1, missed=4, period_p50=1e-3, latency_max=3e-3)
    timing = Timing(**dict(figures), **dict(TimingLimits()))

    def run_experiment(config: ExperimentConfig, _: Path, **__: object) -> SimpleNamespace:
        assert (config.mode, config.joints) == ("realtime", 1)
        if config.priority:
            raise ConfigurationError("priority = 50: not permitted")
        summary = SimpleNamespace(faults=["no use"], trials=["one"], timing=timing)
        return SimpleNamespace(summary=summary)

    monkeypatch.setattr(orchestrator, "run_experiment", run_experiment)
    told: list[str] = []
    found = {one.label: one.value for one in bench.jitter(told.append)}
    assert found == {
        "ordinary: late samples": pytest.approx(0.5),
        "ordinary: missed commands": pytest.approx(2.0),
        "ordinary: period, median": pytest.approx(1.0),
        "ordinary: sample to command, longest": pytest.approx(3.0),
    }
    assert "no use" in told
    assert "priority = 50: not permitted" in told


def test_a_run_in_real_time_that_was_aborted_is_a_figure_that_misses_its_target(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    summary = SimpleNamespace(faults=["too slow"], trials=[], timing=None)
    monkeypatch.setattr(
        orchestrator, "run_experiment", lambda *_, **__: SimpleNamespace(summary=summary)
    )
    found = bench.jitter(lambda _: None)
    assert [one.label for one in found if one.missed] == [
        "ordinary: aborted",
        "SCHED_FIFO: aborted",
    ]


def test_when_interrupted_expect_no_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    def run_experiment(*_: object, **__: object) -> SimpleNamespace:
        os.kill(os.getpid(), signal.SIGINT)
        return SimpleNamespace(summary=None)

    monkeypatch.setattr(orchestrator, "run_experiment", run_experiment)
    told = call("bench")
    last = told.err.splitlines()[-1]
    assert (told.status, told.out, last) == (130, "", "armimp: interrupted")
