"""Runs `armimp run` as a user does, and measures it from outside."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from armimp_common.errors import DataError, GraphError
from armimp_estimation.summary import SUMMARY_FILE, Summary, read_summary
from benchmarks.peak_memory import PeakMemory

COMMAND = "armimp_bringup"
"""Module behind the command ``armimp``."""
MB = 1e6
"""Bytes."""


@dataclass(frozen=True, kw_only=True)
class CommandRun:
    """A run that has ended."""

    took: float
    """From the start of the process to its end, s."""
    summary: Summary
    """What it found."""
    peaks: Mapping[str, int]
    """Largest resident size of each of its processes, by module, bytes."""

    @property
    def outside(self) -> float:
        """Time outside of the trials, s; see `armimp_bringup.presentation`."""
        return self.took - (0.0 if self.summary.wall is None else self.summary.wall.trials)


def run_command(
    directory: Path,
    *options: str,
    watch_memory: bool = False,
    environment: Mapping[str, str] | None = None,
) -> CommandRun:
    """Run an experiment by the command line.

    Parameters
    ----------
    directory : new directory for its result
    options : of ``armimp run``
    watch_memory : whether to look at memory, which takes some time
    environment : variables beside those of this process

    Raises
    ------
    GraphError
        If it ends without result, or loses samples. A result need not be valid.
    """
    command = [sys.executable, "-m", COMMAND, "run", "--out", str(directory), *options]
    with tempfile.TemporaryFile("w+") as said:
        began = time.monotonic()
        with (
            subprocess.Popen(
                command,
                stdout=subprocess.DEVNULL,
                stderr=said,
                env={**os.environ, **(environment or {})},
            ) as process,
            PeakMemory(process.pid if watch_memory else None) as memory,
        ):
            try:
                process.wait()
            except BaseException:
                process.terminate()
                raise
        took = time.monotonic() - began
        said.seek(0)
        lines = said.read().strip().splitlines()
    try:
        summary = read_summary(directory / SUMMARY_FILE)
    except DataError:
        reason = lines[-1] if lines else f"status {process.returncode}"
        raise GraphError(f"armimp run {' '.join(options)} ended without result: {reason}") from None
    if summary.wall is None or not summary.estimators or any(one.lost for one in summary.trials):
        raise GraphError(f"armimp run {' '.join(options)}: {'; '.join(map(str, summary.faults))}")
    return CommandRun(took=took, summary=summary, peaks=memory.peaks)
