"""How long a run takes outside of its trials: imports, discovery, lifecycle, result, figures."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from statistics import median

from armimp_bringup.bench import Measured
from benchmarks.command_run import CommandRun, run_command

RUNS: Mapping[str, int] = {"cold": 5, "composed": 5, "separate": 3}
"""Runs of each kind; a cold one is composed and finds no compiled code."""
LIMITS: Mapping[str, Mapping[str, float]] = {
    "cold": {"before": 8.0},
    "composed": {"before": 2.0, "result": 1.0, "after": 5.0},
    "separate": {},
}
"""Longest times, s."""
DURATION = 10.0
"""Length of each trial, s."""


def time_start(tell: Callable[[str], None]) -> list[Measured]:
    """Measure `armimp run` without and with cached machine code; takes two to three minutes.

    Parameters
    ----------
    tell : callable
        Told what is being measured.

    Raises
    ------
    GraphError
        If a run has no result.
    """
    figures: list[Measured] = []
    with tempfile.TemporaryDirectory() as folder:
        tell("a run to warm up")
        _run(Path(folder) / "first", "composed")
        for kind, count in RUNS.items():
            runs = []
            for number in range(count):
                tell(f"{kind}, {number + 1} of {count}")
                runs.append(_run(Path(folder) / f"{kind}{number}", kind))
            figures += _figures(kind, runs)
    return figures


def _run(directory: Path, kind: str) -> CommandRun:
    options = ("--duration", str(DURATION))
    if kind == "cold":
        cache = directory.with_suffix(".cache")
        return run_command(directory, *options, environment={"NUMBA_CACHE_DIR": str(cache)})
    return run_command(directory, *options, "--processes", kind)


def _figures(kind: str, runs: Sequence[CommandRun]) -> list[Measured]:
    walls = [run.summary.wall for run in runs if run.summary.wall is not None]
    labels = {
        "before": "process to first sample",
        "trials": f"{len(runs[0].summary.trials)} trials",
        "result": "last sample to M, B, K on the screen",
        "after": "last sample to report and figures",
    }
    return [
        Measured(
            label=f"{kind}: {label} (median)",
            value=median(getattr(wall, key) for wall in walls),
            unit="s",
            limit=LIMITS[kind].get(key),
        )
        for key, label in labels.items()
    ]
