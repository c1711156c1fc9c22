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
        self._silent = self._owed = self._spare = self._seen = 0
        self._begun = False

    def command(self, torque: Sequence[float]) -> None:
        """Take a command (n,), N·m; one that cannot be obeyed is a fault."""
        if not self._begun:
            # Which of the last samples it answers is not known.
            self._spare = min(self._seen, WATCHDOG_PERIODS)
        self._begun, self._silent = True, 0
        if self._owed:
            self._owed -= 1
        elif self._spare:
            self._spare -= 1
        elif any(torque):
            # One of zero torque more, as whoever stops sends it, does no harm.
            self.latch("more commands than samples")
        # Written so that NaN fails.
        if len(torque) != len(self._zero) or not all(
            abs(value) <= self._limits.torque for value in torque
        ):
            self.latch(f"command cannot be obeyed: {list(torque)}")
        self.obey(torque)

    def sample(self, angles: Sequence[float]) -> None:
        """Check the angles (n,), rad, of a sample that the next command is to answer."""
        self._seen += 1
        self._owed += self._begun
        self._history.append(tuple(angles))
        if not all(abs(angle) <= self._limits.position for angle in angles):
            self.latch(f"position beyond {self._limits.position:g} rad: {list(angles)}")
        first, periods = self._history[0], len(self._history) - 1
        bound = self._limits.velocity * PERIOD * periods
        if periods and not all(abs(b - a) <= bound for a, b in zip(first, angles, strict=True)):
            self.latch(f"velocity beyond {self._limits.velocity:g} rad/s")

    def period(self) -> bool:
        """End a period, in real time only; return whether no command came in it."""
        self._silent += self._begun
        if self._silent > WATCHDOG_PERIODS:
            self.fade(f"no command for {WATCHDOG_PERIODS} periods")
        elif self._owed > WATCHDOG_PERIODS:
            self.fade(f"commands are more than {WATCHDOG_PERIODS} periods behind")
        self.go_on_fading()
        return self._silent > 1

    def rest(self) -> None:
        """Forget the last command, and the samples before it."""
        super().rest()
        self._begun = False
        self._silent = self._owed = self._seen = 0
        self._history.clear()

    def reset(self) -> None:
        """Obey again after a fault, as :meth:`TorqueLatch.reset`."""
        super().reset()
        self._begun = False
        self._silent = self._owed = 0
        self._history.clear()
