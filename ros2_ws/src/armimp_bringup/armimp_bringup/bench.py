"""``armimp bench``: speed and jitter of the graph on this machine, and the runner of benchmarks."""

from __future__ import annotations

import json
import math
import os
import platform
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median
from typing import Any

from armimp_bringup.terminal import Display
from armimp_common.errors import ArmimpError, ConfigurationError, GraphError, InterruptionError
from armimp_common.process import stop_on_signals
from armimp_common.versions import software
from armimp_estimation.summary import Summary

DURATION = 10.0
"""Length of each trial, s."""
_PRIORITY = 50  # of SCHED_FIFO


@dataclass(frozen=True, kw_only=True)
class Measured:
    """One figure of a benchmark."""

    label: str
    """Its name, also in the record."""
    value: float
    """NaN misses every limit."""
    unit: str = ""
    """May be empty."""
    limit: float | None = None
    """What the value must not exceed, if there is a target."""

    @property
    def missed(self) -> bool:
        """Whether there is a target that is not met."""
        return self.limit is not None and not self.value <= self.limit


Tell = Callable[[str], None]
Benchmark = Callable[[Tell], list[Measured]]
"""Takes a function that is told what is being measured; returns the figures."""


def run_for_bench(tell: Tell, **options: Any) -> Summary:
    """Run an experiment with these options of its configuration, and keep no files.

    Raises
    ------
    GraphError
        If it gave no estimate, as on a machine that is much too slow.
    InterruptionError
        After SIGINT or SIGTERM.
    """
    from armimp_bringup.config import load_config
    from armimp_bringup.orchestrator import run_experiment

    config = load_config(None, {"duration": DURATION, **options})
    with tempfile.TemporaryDirectory() as folder, stop_on_signals() as stopped:
        summary = run_experiment(config, Path(folder) / "run", interrupted=stopped).summary
        if stopped():
            raise InterruptionError("interrupted")
    for problem in summary.faults:
        tell(str(problem))
    if not summary.trials:
        raise GraphError("; ".join(map(str, summary.faults)))
    return summary


def speed(tell: Tell) -> list[Measured]:
    """Measure how fast simulated experiments run in both arrangements of the nodes."""
    figures = []
    for processes in ("composed", "separate"):
        tell(f"2 trials of {DURATION:g} s, {processes}")
        trials = run_for_bench(tell, processes=processes).trials
        figures += [
            Measured(
                label=f"{processes}: speed",
                value=median(trial.rtf for trial in trials),
                unit="x real time",
            ),
            Measured(
                label=f"{processes}: lost samples",
                value=sum(trial.lost for trial in trials),
                limit=0,
            ),
        ]
    return figures


def jitter(tell: Tell) -> list[Measured]:
    """Measure the jitter of runs in real time, without and with real-time priority.

    Jitter has no target: the verdict of a run decides how much of it is acceptable.
    """
    figures: list[Measured] = []
    for label, priority in (("ordinary", 0), ("SCHED_FIFO", _PRIORITY)):
        tell(f"{DURATION:g} s in real time, {label}")
        try:
            timing = run_for_bench(tell, mode="realtime", joints=1, priority=priority).timing
        except ConfigurationError as error:  # no permission
            tell(str(error))
            continue
        except GraphError as error:  # far too slow
            tell(str(error))
            timing = None
        if timing is None:
            figures.append(Measured(label=f"{label}: aborted", value=1.0, limit=0.0))
            continue
        found = [
            ("late samples", 100.0 * timing.late / max(timing.ticks, 1), "%"),
            ("missed commands", 100.0 * timing.missed / max(timing.ticks, 1), "%"),
            ("period, median", 1e3 * timing.period_p50, "ms"),
            ("period, 99 %", 1e3 * timing.period_p99, "ms"),
            ("period, longest", 1e3 * timing.period_max, "ms"),
            ("sample to command, median", 1e3 * timing.latency_p50, "ms"),
            ("sample to command, 99 %", 1e3 * timing.latency_p99, "ms"),
            ("sample to command, longest", 1e3 * timing.latency_max, "ms"),
        ]
        figures += [
            Measured(label=f"{label}: {what}", value=value, unit=unit)
            for what, value, unit in found
            if not math.isnan(value)
        ]
    return figures


BENCHMARKS: Mapping[str, Benchmark] = {"speed": speed, "jitter": jitter}
"""Benchmarks for users; those for the development of the project are in ``benchmarks/``."""


def available_cores() -> int:
    """Return the number of processor cores that this process may use."""
    return len(os.sched_getaffinity(0))


def bench(
    names: Sequence[str], *, as_json: bool, known: Mapping[str, Benchmark] | None = None
) -> int:
    """Run benchmarks and print the figures; return 0 if all ran and met their targets, else 1.

    Parameters
    ----------
    names : of ``known``; none means all of them
    as_json : whether to print a record of everything instead of tables
    known : by default :data:`BENCHMARKS`

    Raises
    ------
    ConfigurationError
        If there is no such benchmark.
    """
    from rich.console import Console

    known = BENCHMARKS if known is None else known
    for name in names:
        if name not in known:
            raise ConfigurationError(f"there is no benchmark {name!r}, only {', '.join(known)}")
    errors = Console(stderr=True, soft_wrap=True, highlight=False)
    measured: dict[str, list[Measured]] = {}
    failed: dict[str, str] = {}
    began = time.monotonic()
    with Display(errors) as display:
        display.phase("measuring")
        for name in dict.fromkeys(names or known):
            try:
                measured[name] = known[name](errors.print)
            except InterruptionError:
                raise
            except ArmimpError as error:  # does not keep the others from running
                failed[name] = str(error)
    if as_json:
        print(json.dumps(_record(measured, failed)))
    else:
        _print(measured, time.monotonic() - began)
    missed = [one for group in measured.values() for one in group if one.missed]
    for one in missed:
        errors.print(f"armimp: {one.label} is {one.value:.3g} {one.unit}, target {one.limit:g}")
    for name, reason in failed.items():
        errors.print(f"armimp: {name}: {reason}")
    return 1 if missed or failed else 0


def _record(
    measured: Mapping[str, Sequence[Measured]], failed: Mapping[str, str]
) -> dict[str, Any]:
    return {
        "schema": 1,
        "machine": {"cores": available_cores(), "system": platform.platform()},
        **software(),
        "benchmarks": {
            name: [asdict(one) | {"met": not one.missed} for one in group]
            for name, group in measured.items()
        },
        "failed": failed,
    }


def _print(measured: Mapping[str, Sequence[Measured]], took: float) -> None:
    from rich.box import SIMPLE_HEAD
    from rich.console import Console
    from rich.table import Table

    console = Console(soft_wrap=True)
    for name, group in measured.items():
        table = Table(title=name, box=SIMPLE_HEAD, title_justify="left", show_header=False)
        for justify in ("left", "right", "left", "left"):
            table.add_column("", justify=justify)
        for one in group:
            mark = "[bold red]✗[/]" if one.missed else "[green]✓[/]"
            limit = "" if one.limit is None else f"≤ {one.limit:g} {one.unit} {mark}"
            table.add_row(one.label, f"{one.value:.3g}", one.unit, limit)
        console.print(table)
    console.print(f"{available_cores()} cores; measured in {took:.0f} s", highlight=False)
