"""Pacing by the wall clock: deadlines are counted from a start, so that errors don't add up."""

from __future__ import annotations

import time
from collections.abc import Callable

from armimp_common.contract import NS_PER_S


class Pacer:
    """Waits for the deadlines ``start + k · period``.

    What comes late does not move the deadlines after it: a thread that was held up for three
    periods finds three deadlines behind it and catches up, as time on a rig does not wait either.

    Parameters
    ----------
    period_ns : int
        Distance of two deadlines, ns.
    spin_ns : int
        The last part of each wait that is spent asking the clock over and over instead of asleep.
        It costs that share of a processor core, and saves the time that waking up takes.
    now : callable
        Tells the time, ns, on any monotonic clock.
    sleep : callable
        Sleeps for a time, s; 0 lets others run.
    """

    def __init__(
        self,
        period_ns: int,
        *,
        spin_ns: int = 0,
        now: Callable[[], int] = time.monotonic_ns,
        sleep: Callable[[float], object] = time.sleep,
    ) -> None:
        self._period_ns = period_ns
        self._spin_ns = spin_ns
        self._sleep = sleep
        self._start_ns = 0
        self.now = now

    def start(self) -> None:
        """Let the deadline of tick 0 be now."""
        self._start_ns = self.now()

    def deadline_ns(self, tick: int) -> int:
        """Deadline of a tick on the clock, ns."""
        return self._start_ns + tick * self._period_ns

    def wait(self, tick: int) -> None:
        """Return at the deadline of a tick, or at once if it has passed; never before it."""
        deadline_ns = self.deadline_ns(tick)
        while (left_ns := deadline_ns - self.now()) > 0:
            asleep_ns = left_ns - self._spin_ns
            self._sleep(asleep_ns / NS_PER_S if asleep_ns > 0 else 0.0)
