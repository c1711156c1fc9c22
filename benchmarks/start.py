"""How long a run takes outside of its trials: imports, discovery, lifecycle, result, figures."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from statistics import median

from armimp_bringup.bench import Measured
from armimp_estimation.summary import WallSummary
from benchmarks.command_run import CommandRun, run_command

LIMITS: Mapping[str, float | None] = {"composed": 3.0, "separate": None}
"""Longest time outside of the trials, s."""
RUNS: Mapping[str, int] = {"composed": 5, "separate": 3}
DURATION = 10.0
"""Length of each trial, s."""


def time_start(tell: Callable[[str], None]) -> list[Measured]:
    """Measure `armimp run` with a warm cache of compiled code; takes one to two minutes.

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
        for processes, limit in LIMITS.items():
            runs = []
            for number in range(RUNS[processes]):
                tell(f"{processes}, {number + 1} of {RUNS[processes]}")
                runs.append(_run(Path(folder) / f"{processes}{number}", processes))
            figures += _figures(processes, runs, limit)
    return figures


def _run(directory: Path, processes: str) -> CommandRun:
    return run_command(directory, "--duration", str(DURATION), "--processes", processes)


def _figures(processes: str, runs: Sequence[CommandRun], limit: float | None) -> list[Measured]:
    def seconds(key: str, what: str, values: Sequence[float]) -> Measured:
        return Measured(
            key=f"{processes}_{key}",
            label=f"{processes}: {what} (median)",
            value=median(values),
            unit="s",
            limit=limit if key == "outside" else None,
        )

    walls = [run.summary.wall for run in runs if run.summary.wall is not None]
    return [
        seconds("before", "process to first sample", [wall.before for wall in walls]),
        seconds("trials", f"{len(runs[0].summary.trials)} trials", [wall.trials for wall in walls]),
        seconds("after", "last sample to report and figures", [wall.after for wall in walls]),
        seconds("exit", "start and end of the process itself", _rests(runs, walls)),
        seconds("outside", "all but the trials", [run.outside for run in runs]),
    ]


def _rests(runs: Sequence[CommandRun], walls: Sequence[WallSummary]) -> list[float]:
    parts = [wall.before + wall.trials + wall.after for wall in walls]
    return [run.took - part for run, part in zip(runs, parts, strict=True)]
