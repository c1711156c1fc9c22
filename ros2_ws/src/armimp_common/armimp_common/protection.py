"""The driver's own safety: which commands it obeys, when it stops by itself, its fault latch."""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Sequence

from pydantic import Field

from armimp_common.cdr import next_number
from armimp_common.errors import GraphError
from armimp_common.schema import Schema
from armimp_common.topics import PERIOD

WATCHDOG_PERIODS = 5
"""Periods without a command, or by which commands lag behind, after which torque is taken away.

A controller that is still working through old samples no longer controls.
"""
RAMP_PERIODS = 10
"""Periods in which torque then falls to zero: few, as the last command may be a peak of chatter."""
_SPAN = 5
_MOST_OWED = 10_000
"""Periods over which a velocity is taken, and most unanswered samples that are remembered."""


def first_bad(values: Sequence[float]) -> int | None:
    """Return the index of the first value that is not finite; None if there is none."""
    if math.isfinite(sum(values)):  # as it is almost always
        return None
    return next((i for i, value in enumerate(values) if not math.isfinite(value)), None)


class CommandSequence:
    """Checks by their numbers that commands come from one publisher, each of them once.

    Two publishers can't go unnoticed if one of them numbers its commands: should the other happen
    to send the next number, the command after it has a wrong one. Of commands that are never
    numbered nothing can be told.

    Attributes
    ----------
    numbered : whether the commands carry numbers; None before the first one
    """

    def __init__(self) -> None:
        self._last = 0
        self.numbered: bool | None = None

    def restart(self) -> None:
        """Accept any number, or none, for the next command."""
        self._last, self.numbered = 0, None

    def check(self, number: int) -> str:
        """Check the number of a command, 0 if it has none; return what is wrong with it, or ""."""
        last, self._last = self._last, number
        if self.numbered is None:
            self.numbered = number > 0
        elif number != (next_number(last) if self.numbered else 0):
            return f"{_named(number)} came after {_named(last)}"
        return ""


def _named(number: int) -> str:
    return f"command {number}" if number else "a command without a number"


class CommandWatch:
    """Matches commands to the samples that they answer, and detects their absence.

    Commands carry no stamp, so each counts as the answer to the oldest unanswered sample. If more
    than `heard` samples precede the first command, all but the newest are dropped, as nobody was
    there to answer them. Which sample that command answers is then not known.

    Parameters
    ----------
    patience : periods without a command, or by which commands lag behind, that are tolerated
    heard : samples that may wait for the first command, for a controller that is slow to start

    Attributes
    ----------
    owed : times (ns) of the unanswered samples
    answered_ns : time of the sample that the last command answered; None if it answered none
    silent : periods that have ended since the last command
    """

    def __init__(self, patience: int = WATCHDOG_PERIODS, heard: int = 0) -> None:
        self._patience, self._heard = patience, heard
        self.owed: deque[int] = deque(maxlen=_MOST_OWED)
        self.restart()

    def restart(self, spare: int = 0) -> None:
        """Wait for a first command; up to `spare` commands more than samples are tolerated."""
        self.owed.clear()
        self._begun = self._in_step = False
        self.silent, self._spare, self._most_unheard = 0, spare, self._heard
        self.answered_ns: int | None = None

    def reset(self) -> None:
        """Wait for a first command after a fault; answers may still be under way."""
        self.restart(self._patience)
        # A controller that commanded before the fault has to begin anew, too.
        self._most_unheard = min(self._heard, self._patience)

    def sample(self, sent_ns: int = 0) -> None:
        """Note a sample that a command is to answer."""
        self.owed.append(sent_ns)

    def command(self, torque: Sequence[float]) -> str:
        """Note a command; return what is wrong if no sample is left for it to answer, or ""."""
        unheard = len(self.owed) - 1
        if not self._begun and unheard >= self._most_unheard:
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
            # A surplus command of zero torque, as a stopping controller sends it, does no harm.
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
    joints : number of joints n
    watch : matches commands to samples

    Attributes
    ----------
    watch : as given; it begins anew with :meth:`rest` and :meth:`reset`
    lock : to be held by whoever uses it while several threads do; can be taken again by its holder
    fault : why torque was taken away; empty while there is no fault
    applied : what the drives are to apply now (n,), N·m
    """

    def __init__(self, joints: int, watch: CommandWatch) -> None:
        self.watch = watch
        self.lock = threading.RLock()
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
        """Take torque away at once, until :meth:`reset`; the first reason is kept."""
        self.fault = self.fault or reason
        self.applied, self._fading = self._zero, 0

    def fade(self, reason: str) -> None:
        """Latch a fault and ramp torque down linearly; without effect after an earlier fault.

        It is zero after :data:`RAMP_PERIODS` calls of :meth:`go_on_fading`, until :meth:`reset`.
        """
        if not self.fault:
            self.fault, self._fading = reason, RAMP_PERIODS

    def go_on_fading(self) -> None:
        """End a period: a torque that is being ramped down becomes smaller."""
        if self._fading:
            share = (self._fading - 1) / self._fading
            self.applied = tuple(share * value for value in self.applied) if share else self._zero
            self._fading -= 1

    def rest(self) -> None:
        """Forget the last command and the samples before it, as its sender is no longer obeyed."""
        self.applied, self._fading, self._resting = self._zero, 0, True
        self.watch.restart()

    def reset(self) -> None:
        """Obey again after a fault.

        Raises
        ------
        GraphError
            If the last command was not zero: torque would come back with a jump.
        """
        if not self._resting:
            raise GraphError("the last command is not zero torque: stop the controller first")
        self.fault, self.applied, self._fading = "", self._zero, 0
        self.watch.reset()


class Protection(TorqueLatch):
    """Decides which torque the drives get.

    Parameters
    ----------
    joints : number of joints n
    limits : ProtectionLimits
    """

    def __init__(self, joints: int, limits: ProtectionLimits) -> None:
        super().__init__(joints, CommandWatch())
        self._limits = limits
        self._history: deque[tuple[float, ...]] = deque(maxlen=_SPAN + 1)

    def command(self, torque: Sequence[float]) -> None:
        """Take a command (n,), N·m; one that cannot be obeyed is a fault."""
        if reason := self.watch.command(torque):
            self.latch(reason)
        # Written so that NaN fails.
        if len(torque) != len(self._zero) or not all(
            abs(value) <= self._limits.torque for value in torque
        ):
            self.latch(f"command cannot be obeyed: {list(torque)}")
        self.obey(torque)

    def sample(self, angles: Sequence[float], sent_ns: int = 0) -> None:
        """Check the angles (n,), rad, of a sample sent at `sent_ns` that a command will answer."""
        self.watch.sample(sent_ns)
        self._history.append(tuple(angles))
        if not all(abs(angle) <= self._limits.position for angle in angles):
            self.latch(f"position beyond {self._limits.position:g} rad: {list(angles)}")
        first, periods = self._history[0], len(self._history) - 1
        bound = self._limits.velocity * PERIOD * periods
        if periods and not all(abs(b - a) <= bound for a, b in zip(first, angles, strict=True)):
            self.latch(f"velocity beyond {self._limits.velocity:g} rad/s")

    def period(self) -> bool:
        """End a period, in real time only; return whether no command came in it."""
        if reason := self.watch.period():
            self.fade(reason)
        self.go_on_fading()
        return self.watch.silent > 1

    def rest(self) -> None:
        """See :meth:`TorqueLatch.rest`."""
        super().rest()
        self._history.clear()

    def reset(self) -> None:
        """See :meth:`TorqueLatch.reset`."""
        super().reset()
        self._history.clear()
