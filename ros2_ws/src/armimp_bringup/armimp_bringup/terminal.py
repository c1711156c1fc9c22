"""Output for users while they wait: error messages, named phases, progress, running results.

All of it goes to standard error. One :class:`Display` is open at a time; code that has something
to show gets it from :func:`display`.
"""

from __future__ import annotations

import math
import os
import shutil
import sys
import textwrap
import time
from contextlib import suppress

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from armimp_common.status import Progress as Snapshot
from armimp_common.topics import RATE
from armimp_estimation.mbk import UNITS

_REFRESHES = 1.0
"""Refreshes per second; each takes some milliseconds from the nodes in this process."""
_BAR_WIDTH = 16
_LONGEST = 1200
"""Longest line, characters: files of unknown origin may hold names of any length."""


def repair_streams() -> None:
    """Make standard input, output and error usable, whatever the environment gave the process.

    A closed stream is connected to the null device, so that no other file takes its number.
    Characters that the encoding of standard output lacks become question marks.
    """
    for number, name, mode in ((0, "stdin", "r"), (1, "stdout", "w"), (2, "stderr", "w")):
        try:
            os.fstat(number)
        except OSError:
            null = os.open(os.devnull, os.O_RDWR)
            os.dup2(null, number)  # which child processes inherit
            if null != number:
                os.close(null)
        if getattr(sys, name) is None:
            setattr(sys, name, open(number, mode, encoding="utf-8", closefd=False))  # noqa: SIM115
    with suppress(AttributeError):  # somebody has replaced it by an object without this method
        sys.stdout.reconfigure(errors="replace")  # type: ignore[union-attr]


def say(line: str) -> None:
    """Print one line on standard error, with unprintable characters of quoted values escaped.

    A very long line is shortened in its middle; a narrow terminal gets it wrapped between words.
    """
    shown = "".join(
        letter if letter.isprintable() else letter.encode("unicode_escape").decode()
        for letter in line
    )
    if len(shown) > _LONGEST:
        shown = f"{shown[: _LONGEST // 2]} ... {shown[-_LONGEST // 2 :]}"
    if sys.stderr.isatty():
        width = shutil.get_terminal_size().columns
        shown = textwrap.fill(shown, width, break_long_words=False, break_on_hyphens=False)
    print(shown, file=sys.stderr)


class Display:
    """A bar, a named phase and running results at the bottom of the terminal.

    Closing it removes it from the terminal without a trace, so that nothing is drawn over what is
    printed afterwards. If standard error is no terminal, only progress is printed, line by line.
    """

    present: Display | None = None
    """The display that is open, if any."""

    def __init__(self, console: Console | None = None) -> None:
        self._console = console if console is not None else Console(stderr=True)
        # The thread that refreshes reads these; each is replaced as a whole.
        self._phase: tuple[str, float] | None = None
        self._bar: tuple[str, int, int, str] | None = None
        self._lines: list[str] = []
        self._progress_began = 0.0
        self._announced: int | None = None
        self._live = Live(
            console=self._console,
            get_renderable=self._content,
            refresh_per_second=_REFRESHES,
            transient=True,
            redirect_stdout=False,
            redirect_stderr=False,
        )

    def phase(self, text: str) -> None:
        """Name the current activity, below the bar if there is one."""
        self._phase = (text, time.monotonic()) if text else None
        self._refresh()

    def progress(self, done: int, total: int, *, things: str) -> None:
        """Show how many things are done, and how long the others will take.

        Parameters
        ----------
        done, total : things that are done, and all of them
        things : what they are, in the plural
        """
        if self._bar is None:
            self._progress_began = time.monotonic()
        text = describe(done, total, time.monotonic() - self._progress_began, things=things)
        self._bar, self._phase = ("", done, total, text), None
        if not self._console.is_terminal:
            self._console.print(text, highlight=False)
        self._refresh()

    def show(self, snapshot: Snapshot) -> None:
        """Show where an experiment stands."""
        if not snapshot.samples:
            return
        label = f"trial {snapshot.trial}/{snapshot.trials}  joint {snapshot.joint}"
        text = describe_trial(snapshot)
        # The planned number falls when a trial is to end early.
        self._bar = label, snapshot.samples, snapshot.planned, text
        self._lines, self._phase = describe_estimates(snapshot), None
        if not self._console.is_terminal and self._announced != snapshot.trial:
            self._announced = snapshot.trial
            self._console.print(f"{label}: {text}", highlight=False)

    def complete(self, text: str) -> None:
        """Fill the bar, and name the activity that follows."""
        if self._bar is not None:
            label, _, total, _ = self._bar
            self._bar = label, total, total, f"{total / RATE:.1f} s"
        self.phase(text)

    def close(self) -> None:
        """Remove the display from the terminal, so that results can be printed."""
        self._live.stop()
        if Display.present is self:
            Display.present = None

    def _refresh(self) -> None:
        if self._live.is_started:
            self._live.refresh()

    def _content(self) -> RenderableType:
        parts: list[RenderableType] = []
        bar, phase = self._bar, self._phase
        if bar is not None:
            label, done, total, text = bar
            row = Table.grid(padding=(0, 1))
            if label:
                row.add_column(no_wrap=True)
            row.add_column(width=_BAR_WIDTH)
            row.add_column(no_wrap=True)
            filled = ProgressBar(total=max(total, 1), completed=done, width=_BAR_WIDTH)
            row.add_row(*([label] if label else []), filled, text)
            parts.append(row)
        parts += [Text(line, no_wrap=True, overflow="ellipsis") for line in self._lines]
        if phase is not None:
            name, began = phase
            parts.append(Text(f"{name}, {time.monotonic() - began:.0f} s", no_wrap=True))
        return Group(*parts)

    def __enter__(self) -> Display:
        Display.present = self
        if self._console.is_terminal:
            self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def display() -> Display:
    """Return the open display, or one that shows nothing if none is open."""
    return Display.present or Display(Console(quiet=True))


def describe(done: int, total: int, seconds: float, *, things: str) -> str:
    """Describe progress in words; the time left follows from the seconds taken so far."""
    parts = [f"{done} of {total} {things}"]
    if done == total:
        parts.append(f"took {duration(seconds)}")
    elif done:
        parts.append(f"{duration(seconds * (total - done) / done)} left")
    return ", ".join(parts)


def duration(seconds: float) -> str:
    """Write a time for people: ``12 s``, ``3 min 20 s``, ``2 h 5 min``."""
    whole = max(1, round(seconds))
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60} s"
    return f"{whole // 3600} h {whole % 3600 // 60} min"


def describe_trial(snapshot: Snapshot) -> str:
    """Describe how far a trial is, how fast it runs, and the time left for all trials."""
    parts = [
        f"{snapshot.samples / RATE:.1f}/{snapshot.planned / RATE:.1f} s",
        f"{snapshot.rate / RATE:.1f}x",
    ]
    if snapshot.rate > 0.0:
        waiting = snapshot.trials - snapshot.trial
        left = snapshot.planned * (1 + waiting) - snapshot.samples
        parts.append(f"{duration(left / snapshot.rate)} left")
    return "  ".join(parts)


def describe_estimates(snapshot: Snapshot) -> list[str]:
    """Describe coherences, and M, B and K of the measured column so far, in as many lines.

    Standard errors are shown only if the estimates account for the motion of the locked joints.
    """
    lines, motion, torque = [], snapshot.coherence_motion, snapshot.coherence_torque
    if motion is not None and torque is not None:
        lines.append(f"coherence θ {motion:.3f}  τ {torque:.3f}")
    for (letter, unit), (values, errors) in zip(UNITS.items(), snapshot.column, strict=True):
        elements = [
            f"{letter}{row}{snapshot.joint} "
            f"{_with_digits(value, error, stated=not snapshot.preliminary)}"
            for row, (value, error) in enumerate(zip(values, errors, strict=True), 1)
        ]
        if elements:
            lines.append(f"{'   '.join(elements)} {unit}")
    if snapshot.largest_error is not None:
        kind = "preliminary; random errors" if snapshot.preliminary else "standard errors"
        lines.append(f"{kind} up to {100.0 * snapshot.largest_error:.2g} %")
    return lines


def _with_digits(value: float, error: float, *, stated: bool) -> str:
    """Return value and error to two digits of the error; the value to one if not `stated`."""
    digits = 3
    if 0.0 < error < math.inf:
        digits = min(max(1 - math.floor(math.log10(error)), 0), 9)
    return (
        f"{value:.{digits}f} ± {error:.{digits}f}" if stated else f"{value:.{max(digits - 1, 0)}f}"
    )
