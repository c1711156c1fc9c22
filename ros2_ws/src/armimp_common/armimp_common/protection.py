"""The driver's own safety: what it obeys, when it stops by itself, and its latch."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence

from pydantic import Field

from armimp_common.cdr import next_number
from armimp_common.errors import GraphError
from armimp_common.schema import Schema
from armimp_common.topics import PERIOD

WATCHDOG_PERIODS = 5
"""Periods without a command, or by which commands are behind, after which the torque is taken away.

A controller that works through old samples is none any more.
"""
RAMP_PERIODS = 10
"""Periods in which it then falls to zero: few, as the last command may be a peak of chatter."""
_SPAN = 5
_MOST_OWED = 10_000


def first_bad(values: Sequence[float]) -> int | None:
    """Index of the first value that is not finite; None if there is none."""
    if math.isfinite(sum(values)):  # as it is almost always
        return None
    return next((i for i, value in enumerate(values) if not math.isfinite(value)), None)


class CommandSequence:
    """Checks by their numbers that commands come from one publisher, each of them once.

    Two publishers can't go unnoticed if one of them numbers its commands: whichever number comes
    next, the other sends another. Of a controller that never numbers them nothing can be told.

    Attributes
    ----------
    numbered : whether the commands carry numbers; None before the first one
    """

    def __init__(self) -> None:
        self._last = 0
        self.numbered: bool | None = None

    def restart(self) -> None:
        """Let the next command have any number, or none."""
        self._last, self.numbered = 0, None

    def check(self, number: int) -> str:
        """Take the number of a command, 0 if it has none; return what is wrong with it, or ""."""
        last, self._last = self._last, number
        if self.numbered is None:
            self.numbered = number > 0
        elif number != (next_number(last) if self.numbered else 0):
            return f"{_named(number)} came after {_named(last)}"
        return ""


def _named(number: int) -> str:
    return f"command {number}" if number else "a command without a number"


class CommandWatch:
    """Sets commands against the samples that they answer, and watches over their absence.

    Commands carry no stamp, so each counts as the answer to the oldest sample that has none.
    Samples that nobody was there to answer are owed by nobody: those before the first command,
    once they are more than `heard`. Which of them it answers is then not known.

    Parameters
    ----------
    patience : periods without a command, or by which commands are behind, that are borne
    heard : samples that may wait for the first command, as of a controller that is slow to start

    Attributes
    ----------
    owed : times (ns) of the samples that have no answer
    answered_ns : time of the sample that the last command answered; None if there was none
    silent : periods that have ended since the last command
    """

    def __init__(self, patience: int = WATCHDOG_PERIODS, heard: int = 0) -> None:
        self._patience, self._heard = patience, heard
        self.owed: deque[int] = deque(maxlen=_MOST_OWED)
        self.restart()

    def restart(self, spare: int = 0) -> None:
        """Wait for a first command; so many more of them than samples are borne."""
        self.owed.clear()
        self._begun = self._in_step = False
        self.silent, self._spare = 0, spare
        self.answered_ns: int | None = None

    def reset(self) -> None:
        """Wait for a first command after a fault; answers may still be under way."""
        self.restart(self._patience)
        # Whoever commanded before the fault has to begin anew, too.
        self._heard = min(self._heard, self._patience)

    def sample(self, sent_ns: int = 0) -> None:
        """Take note of a sample that a command is to answer."""
        self.owed.append(sent_ns)

    def command(self, torque: Sequence[float]) -> str:
        """Take note of a command; return what is wrong with its number, or ""."""
        unheard = len(self.owed) - 1
        if not self._begun and unheard >= self._heard:
            newest = self.owed.pop()
            self.owed.clear()
            self.owed.append(newest)
            self._spare = max(self._spare, min(unheard, self._patience))
        self._begun, self.silent = True, 0
        self.answered_ns = self.owed.popleft() if self.owed else None
        if self.answered_ns is not None:
            self._in_step = self._in_step or not self.owed
        elif self._spare:
            self._spare -= 1
        elif any(torque):
            # One of zero torque more, as whoever stops sends it, does no harm.
            return "more commands than samples"
        return ""

    def period(self) -> str:
        """End a period, in real time; return why the torque has to be taken away, or ""."""
        self.silent += self._begun
        if self.silent > self._patience:
            return f"no command for {self._patience} periods"
        if self._in_step and len(self.owed) > self._patience:
            return f"commands are more than {self._patience} periods behind"
        return ""


class ProtectionLimits(Schema):
    """Limits of the driver itself, wider than those of the controller."""

    position: float = Field(default=2.0 * math.pi, gt=0.0)
    """Largest angle (rad)."""
    velocity: float = Field(default=20.0, gt=0.0)
    """Largest velocity over 5 periods (rad/s)."""
    torque: float = Field(default=100.0, gt=0.0)
    """Largest command (N·m)."""


class TorqueLatch:
    """The torque that drives apply, and the latch of the faults that take it away.

    Parameters
    ----------
    joints : how many

    Attributes
    ----------
    fault : why there is no torque any more; empty while all is well
    applied : what the drives are to apply now (n,), N·m
    """

    def __init__(self, joints: int) -> None:
        self._zero = self.applied = (0.0,) * joints
        self._fading = 0
        self._resting = True
        self.fault = ""

    def obey(self, torque: Sequence[float]) -> None:
        """Apply a command (n,), N·m, unless there is a fault."""
        self._resting = not any(torque)
        if not self.fault:
            self.applied = tuple(torque)

    def latch(self, reason: str) -> None:
        """Take torque away at once and until :meth:`reset`; the first reason stays."""
        self.fault = self.fault or reason
        self.applied, self._fading = self._zero, 0

    def fade(self, reason: str) -> None:
        """Take torque away in a straight line, until :meth:`reset`; after a fault nothing changes.

        After the last of :data:`RAMP_PERIODS` calls of :meth:`go_on_fading` there is none.
        """
        if not self.fault:
            self.fault, self._fading = reason, RAMP_PERIODS

    def go_on_fading(self) -> None:
        """End a period, in which a torque that fades becomes smaller."""
        if self._fading:
            share = (self._fading - 1) / self._fading
            self.applied = tuple(share * value for value in self.applied) if share else self._zero
            self._fading -= 1

    def rest(self) -> None:
        """Forget the last command, as whoever gave it is no longer obeyed."""
        self.applied, self._fading, self._resting = self._zero, 0, True

    def reset(self) -> None:
        """Obey again after a fault.

        Raises
        ------
        GraphError
            If the last command was not zero: torque would come back with a jerk.
        """
        if not self._resting:
            raise GraphError("the last command is not zero torque: stop the controller first")
        self.fault, self.applied, self._fading = "", self._zero, 0


class Protection(TorqueLatch):
    """Decides which torque the drives get.

    Parameters
    ----------
    joints : how many
    limits : ProtectionLimits
    """

    def __init__(self, joints: int, limits: ProtectionLimits) -> None:
        super().__init__(joints)
        self._limits = limits
        self._history: deque[tuple[float, ...]] = deque(maxlen=_SPAN + 1)
        self._watch = CommandWatch()

    def command(self, torque: Sequence[float]) -> None:
        """Take a command (n,), N·m; one that cannot be obeyed is a fault."""
        if reason := self._watch.command(torque):
            self.latch(reason)
        # Written so that NaN fails.
        if len(torque) != len(self._zero) or not all(
            abs(value) <= self._limits.torque for value in torque
        ):
            self.latch(f"command cannot be obeyed: {list(torque)}")
        self.obey(torque)

    def sample(self, angles: Sequence[float]) -> None:
        """Check the angles (n,), rad, of a sample that the next command is to answer."""
        self._watch.sample()
        self._history.append(tuple(angles))
        if not all(abs(angle) <= self._limits.position for angle in angles):
            self.latch(f"position beyond {self._limits.position:g} rad: {list(angles)}")
        first, periods = self._history[0], len(self._history) - 1
        bound = self._limits.velocity * PERIOD * periods
        if periods and not all(abs(b - a) <= bound for a, b in zip(first, angles, strict=True)):
            self.latch(f"velocity beyond {self._limits.velocity:g} rad/s")

    def period(self) -> bool:
        """End a period, in real time only; return whether no command came in it."""
        if reason := self._watch.period():
            self.fade(reason)
        self.go_on_fading()
        return self._watch.silent > 1

    def rest(self) -> None:
        """Forget the last command, and the samples before it."""
        super().rest()
        self._watch.restart()
        self._history.clear()

    def reset(self) -> None:
        """Obey again after a fault, as :meth:`TorqueLatch.reset`."""
        super().reset()
        self._watch.reset()
        self._history.clear()
