"""The study on the terminal: progress with the time left, and the table of the worst values."""

from __future__ import annotations

import time
from types import TracebackType

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.measure import Measurement
from rich.progress import BarColumn, Progress, TextColumn
from rich.table import Table

from armimp_bringup.study.verdict import COLUMNS, StudyVerdict


class StudyDisplay:
    """Conditions that are done and the time left, on one line of standard error.

    Where that is no terminal, a line tells of each batch.
    """

    def __init__(self, console: Console | None = None) -> None:
        self._console = console if console is not None else Console(stderr=True)
        self._progress = Progress(
            TextColumn("{task.description}"),
            BarColumn(bar_width=32),
            TextColumn("{task.fields[text]}"),
            console=self._console,
        )
        self._task = self._progress.add_task("study", total=None, text="preparing")
        self._began = time.monotonic()

    def tell(self, text: str) -> None:
        """Say what goes on besides the conditions."""
        if self._console.is_terminal:
            self._progress.update(self._task, text=text)
        else:
            self._console.print(text, highlight=False)

    def show(self, done: int, total: int, stored: int) -> None:
        """Show where the study stands.

        Parameters
        ----------
        done : int
            Conditions that have a result.
        total : int
            All conditions.
        stored : int
            Those that had a result when the study began, or began again.
        """
        text = describe(done, total, stored, time.monotonic() - self._began)
        self._progress.update(self._task, total=total, completed=done)
        self.tell(text)

    def __enter__(self) -> StudyDisplay:
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


def describe(done: int, total: int, stored: int, seconds: float) -> str:
    """Progress in words; the time left follows from what was done in these seconds."""
    parts = [f"{done} of {total} conditions"]
    if stored:
        parts.append(f"{stored} of them from before")
    if done > stored and done == total:
        parts.append(f"took {duration(seconds)}")
    elif done > stored:
        parts.append(f"{duration(seconds * (total - done) / (done - stored))} left")
    return ", ".join(parts)


def duration(seconds: float) -> str:
    """A time as people say it: ``12 s``, ``3 min 20 s``, ``2 h 5 min``."""
    whole = max(1, round(seconds))
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60} s"
    return f"{whole // 3600} h {whole % 3600 // 60} min"


def print_verdict(verdict: StudyVerdict, console: Console) -> None:
    """Print the table of the worst values, wider than the terminal rather than with gaps."""
    table = verdict_table(verdict)
    wide = Measurement.get(console, console.options.update(max_width=1000), table).maximum
    console.width = max(console.width, wide)
    console.print(table)


def verdict_table(verdict: StudyVerdict) -> Table:
    """The worst value of each quantity for each estimator, with the target and the place."""
    many = "s" if verdict.conditions > 1 else ""
    table = Table(
        title=f"worst values of {verdict.conditions} condition{many}, all elements",
        caption="F, R, P: levels of friction, resolution and perturbation",
        box=SIMPLE_HEAD,
        padding=(0, 1, 0, 0),  # fits into 80 characters
        title_justify="left",
        caption_justify="left",
    )
    table.add_column("estimator", no_wrap=True)
    table.add_column("quantity", no_wrap=True)
    for name in ("worst", "target"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("", no_wrap=True)
    table.add_column("in", no_wrap=True)
    table.add_column("condition", no_wrap=True)
    columns = {column.quantity: column for column in COLUMNS}
    for number, one in enumerate(verdict.worst):
        column = columns[one.quantity]
        sign = "≥" if column.floor else "≤"
        table.add_row(
            one.estimator if number % len(COLUMNS) == 0 else "",
            one.quantity,
            column.format(one.worst),
            "–" if one.limit is None else f"{sign} {one.limit:g}{column.unit}",
            {True: "[green]✓[/]", False: "[bold red]✗[/]", None: ""}[one.met],
            one.element,
            f"F{one.friction} R{one.resolution} P{one.perturbation} seed {one.seed}",
            end_section=number % len(COLUMNS) == len(COLUMNS) - 1,
        )
    return table
