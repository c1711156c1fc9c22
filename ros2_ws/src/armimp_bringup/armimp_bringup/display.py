"""The live display of a running experiment."""

from __future__ import annotations

import math
from types import TracebackType

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn

from armimp_bringup.supervisor import Progress as Snapshot
from armimp_common.contract import NS_PER_S, PERIOD_NS

_RATE = NS_PER_S / PERIOD_NS
_UNITS = ("kg·m²", "N·m·s/rad", "N·m/rad")


class LiveDisplay:
    """Trial, joint, speed against real time, running coherence, time left; running M, B and K.

    Written to standard error; where that is no terminal, only the beginning of each trial is told.
    """

    def __init__(self, console: Console | None = None) -> None:
        self._console = console if console is not None else Console(stderr=True)
        # Refreshed from the executor's thread only: a thread of its own would slow the nodes down.
        self._progress = Progress(
            TextColumn("{task.description}"),
            BarColumn(bar_width=24),
            TextColumn("{task.fields[text]}"),
            console=self._console,
            auto_refresh=False,
        )
        self._task: TaskID | None = None
        self._told: int | None = None

    def show(self, snapshot: Snapshot) -> None:
        """Show where the experiment stands."""
        text = describe(snapshot)
        if not self._console.is_terminal:
            if self._told != snapshot.trial and snapshot.samples:
                self._told = snapshot.trial
                self._console.print(f"trial {snapshot.trial} of {snapshot.trials}: {text}")
            return
        label = f"trial {snapshot.trial}/{snapshot.trials}  joint {snapshot.joint}"
        if self._task is None or self._told != snapshot.trial:
            self._task = self._progress.add_task(label, total=snapshot.planned, text=text)
            self._told = snapshot.trial
        self._progress.update(
            self._task,
            total=snapshot.planned,  # less than at first where a trial ends early
            completed=snapshot.samples,
            text="\n".join([text, *describe_column(snapshot)]),
        )
        self._progress.refresh()

    def __enter__(self) -> LiveDisplay:
        if self._console.is_terminal:
            self._progress.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._console.is_terminal:
            self._progress.stop()


def describe(snapshot: Snapshot) -> str:
    """The figures of a snapshot in one line."""
    parts = [
        f"{snapshot.samples / _RATE:5.1f} of {snapshot.planned / _RATE:.1f} s",
        f"{snapshot.rate / _RATE:4.1f}x real time",
    ]
    if snapshot.coherence_motion is not None and snapshot.coherence_torque is not None:
        parts.append(
            f"coherence θ {snapshot.coherence_motion:.3f} τ {snapshot.coherence_torque:.3f}"
        )
    if snapshot.rate > 0.0:
        waiting = snapshot.trials - snapshot.trial
        left = snapshot.planned * (1 + waiting) - snapshot.samples
        parts.append(f"{left / snapshot.rate:.0f} s left")
    return "  ".join(parts)


def describe_column(snapshot: Snapshot) -> list[str]:
    """Running M, B and K of the column that is measured, with standard errors, a line for each."""
    lines = []
    for letter, (values, errors), unit in zip("MBK", snapshot.column or (), _UNITS, strict=False):
        elements = [
            f"{letter}{row}{snapshot.joint} {_with_error(value, error)}"
            for row, (value, error) in enumerate(zip(values, errors, strict=True), 1)
        ]
        lines.append(f"{'   '.join(elements)} {unit}")
    if snapshot.largest_error is not None:
        lines.append(f"standard errors up to {100.0 * snapshot.largest_error:.2g} %")
    return lines


def _with_error(value: float, error: float) -> str:
    """A value with as many digits as two of its standard error take."""
    digits = 3
    if 0.0 < error < math.inf:
        digits = min(max(1 - math.floor(math.log10(error)), 0), 9)
    return f"{value:.{digits}f} ± {error:.{digits}f}"
