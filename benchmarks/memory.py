"""How much memory the processes of a run take."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path

from armimp_bringup.bench import Measured
from armimp_bringup.nodes import MODULES
from benchmarks.command_run import COMMAND, MB, run_command

DURATION = 50.0
"""Length of each trial, s."""
_LABELS = {
    COMMAND: "command",
    **{arguments[0]: name for name, arguments in MODULES.items()},
}


def measure_memory(tell: Callable[[str], None]) -> list[Measured]:
    """Measure the largest resident size of each process; takes about a minute.

    Libraries that processes share count in each of them.

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
    for processes in ("separate", "composed"):
        tell(f"{processes}, trials of {DURATION:g} s")
        with tempfile.TemporaryDirectory() as folder:
            options = ("--duration", str(DURATION), "--processes", processes)
            peaks = run_command(Path(folder) / "out", *options, watch_memory=True).peaks
        figures += [
            Measured(
                label=f"{processes}: {label}, largest resident size",
                value=peaks[module] / MB,
                unit="MB",
            )
            for module, label in _LABELS.items()
            if module in peaks
        ]
    return figures
