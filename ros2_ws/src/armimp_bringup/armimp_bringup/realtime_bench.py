"""How regular a run in real time is on this machine: a short experiment and its jitter."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable
from pathlib import Path

from armimp_bringup.benchmarks import Measured
from armimp_bringup.config import ExperimentConfig
from armimp_bringup.orchestrator import run_experiment
from armimp_common.errors import ConfigurationError

SECONDS = 10.0
"""Length of the only trial, s."""
_PRIORITY = 50


def time_realtime(tell: Callable[[str], None]) -> list[Measured]:
    """Measure the jitter of runs in real time with one joint; takes about half a minute.

    One run has ordinary scheduling, another one precedence over all other programs, where the
    system permits that. Nothing here is a target: what a machine must not exceed is a matter of the
    verdict of a run. NaN stands for what was not measured, as the run ended too early.

    Parameters
    ----------
    tell : callable
        Told what is being measured, and what went wrong.
    """
    figures: list[Measured] = []
    for key, label, priority in (
        ("ordinary", "ordinary scheduling", 0),
        ("fifo", f"SCHED_FIFO {_PRIORITY}", _PRIORITY),
    ):
        tell(f"{SECONDS:g} s in real time, {label}")
        figures += _jitter(key, label, priority, tell)
    return figures


def _jitter(key: str, label: str, priority: int, tell: Callable[[str], None]) -> list[Measured]:
    config = ExperimentConfig(mode="realtime", joints=1, duration=SECONDS, priority=priority)
    with tempfile.TemporaryDirectory() as temporary:
        try:
            summary = run_experiment(config, Path(temporary) / "run")
        except ConfigurationError as error:
            tell(str(error))
            return []
    for problem in summary.problems:
        tell(f"{label}: {problem}")
    timing = summary.timing
    found: dict[str, tuple[str, float, str]] = {"ticks": ("samples", 0.0, "")}
    if timing is not None:
        ticks = max(timing.ticks, 1)
        found["ticks"] = ("samples", timing.ticks, "")
        found["late"] = ("late samples", 100.0 * timing.late / ticks, "%")
        found["missed"] = ("missed commands", 100.0 * timing.missed / ticks, "%")
        for name, what in (("period", "period"), ("latency", "sample to command")):
            for part, words in (("p50", "median"), ("p99", "99 %"), ("max", "longest")):
                value = 1e3 * float(getattr(timing, f"{name}_{part}"))
                found[f"{name}_{part}"] = (f"{what}, {words}", value, "ms")
    return [
        Measured(key=f"{key}_{name}", label=f"{text}, {label}", value=value, unit=unit)
        for name, (text, value, unit) in found.items()
        if not math.isnan(value)
    ]
