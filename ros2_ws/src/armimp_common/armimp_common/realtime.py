"""Real time on an ordinary host: deadlines, scheduling priority, and statistics of the timing."""

from __future__ import annotations

import ctypes
import gc
import inspect
import math
import os
import random
import sys
import time
from array import array
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Final

import numpy as np
from pydantic import Field

from armimp_common.errors import ConfigurationError, GraphError
from armimp_common.schema import Schema
from armimp_common.status import TimingFigures
from armimp_common.topics import NS_PER_S, PERIOD_NS

LATE_NS: Final = PERIOD_NS // 4
"""A sample is late if it is sent more than this after its deadline, ns."""

_KEPT = 4096
"""Size of the sample of durations from which quantiles are taken."""
_SWITCH_INTERVAL = 2e-4
"""Longest time for which a Python thread keeps another one waiting (s); Python's is 5 ms."""
_REFUSAL = "the system does not permit SCHED_FIFO to this user, see docs/realtime.md"
_NEW_OBJECTS = 50_000
"""Number of new objects at which the garbage collector looks at them; Python's default is 700."""
_PR_SET_TIMERSLACK = 29
_SLACK_NS = 1000
"""Option of prctl(2), and the slack of timers that is asked for with it (ns)."""


class Pacer:
    """Waits for the deadlines of samples, ``start + k · PERIOD_NS``, so that errors do not add up.

    Lateness does not move later deadlines: a thread that was held up for three periods finds three
    deadlines behind it and catches up, as time on a rig does not wait either.

    Parameters
    ----------
    now : returns the time on any monotonic clock, ns
    sleep : sleeps for a time, s
    """

    def __init__(
        self,
        *,
        now: Callable[[], int] = time.monotonic_ns,
        sleep: Callable[[float], object] = time.sleep,
    ) -> None:
        self._sleep = sleep
        self._start_ns = 0
        self.now = now

    def start(self) -> None:
        """Make the present time the deadline of tick 0."""
        self._start_ns = self.now()

    def deadline_ns(self, tick: int) -> int:
        """Return the deadline of a tick on the clock, ns."""
        return self._start_ns + tick * PERIOD_NS

    def wait(self, tick: int) -> None:
        """Return at the deadline of a tick, or at once if it has passed; never before it."""
        deadline_ns = self.deadline_ns(tick)
        while (left_ns := deadline_ns - self.now()) > 0:
            self._sleep(left_ns / NS_PER_S)


class Durations:
    """Distribution of durations, in memory that does not grow with their number.

    Quantiles are those of a random sample of them (algorithm R of Vitter, ACM Trans. Math. Softw.
    11(1), 1985); the maximum is exact.
    """

    def __init__(self) -> None:
        self._kept = array("q")
        self._random = random.Random(0).random
        self._count = self._longest_ns = 0

    def add(self, duration_ns: int) -> None:
        """Add a duration, ns."""
        self._longest_ns = max(self._longest_ns, duration_ns)
        self._count += 1
        if len(self._kept) < _KEPT:
            self._kept.append(duration_ns)
        elif (place := int(self._random() * self._count)) < _KEPT:
            self._kept[place] = duration_ns

    def quantiles(self) -> tuple[float, float, float]:
        """Return median, 99 % quantile and maximum, s; NaN if there are no durations."""
        if not self._kept:
            return math.nan, math.nan, math.nan
        p50, p99 = np.quantile(self._kept, (0.5, 0.99), method="inverted_cdf") / NS_PER_S
        return float(p50), float(p99), self._longest_ns / NS_PER_S


class TimingMeter:
    """Measures the timing of a rig from the times of samples sent and of commands received.

    Commands carry no stamp, so the caller decides which sample each of them answers.
    """

    def __init__(self) -> None:
        self._period, self._latency = Durations(), Durations()
        self._last_ns: int | None = None
        self._ticks = self._late = self._missed = 0

    def sent(self, deadline_ns: int, sent_ns: int) -> None:
        """Count a sample that was due at ``deadline_ns`` and sent at ``sent_ns``, ns."""
        self._ticks += 1
        self._late += sent_ns - deadline_ns > LATE_NS
        if self._last_ns is not None:
            self._period.add(sent_ns - self._last_ns)
        self._last_ns = sent_ns

    def answered(self, latency_ns: int) -> None:
        """Count a command that came this long after its sample, ns."""
        self._latency.add(latency_ns)

    def missed(self) -> None:
        """Count a period that began without the command meant for it."""
        self._missed += 1

    def figures(self) -> TimingFigures:
        """Return the figures so far."""
        period, latency = self._period.quantiles(), self._latency.quantiles()
        return TimingFigures(
            ticks=self._ticks,
            late=self._late,
            # A gap may span more periods than samples were sent so far.
            missed=min(self._missed, self._ticks),
            period_p50=period[0],
            period_p99=period[1],
            period_max=period[2],
            latency_p50=latency[0],
            latency_p99=latency[1],
            latency_max=latency[2],
        )


class TimingLimits(Schema):
    """Limits beyond which a run in real time is not valid."""

    max_late_share: float = Field(default=0.01, ge=0.0, le=1.0)
    """Largest share of samples sent late."""
    max_missed_share: float = Field(default=0.01, ge=0.0, le=1.0)
    """Largest share of periods whose command did not come in time."""
    max_latency: float = Field(default=0.001, gt=0.0)
    """Largest 99 % quantile of the time from sample to command (s)."""


class SchedulingParameters(Schema):
    """What a process asks of the system while it works in real time."""

    priority: int = Field(default=0, ge=0, le=99)
    """SCHED_FIFO priority of the process in mode realtime; 0: ordinary scheduling."""


@contextmanager
def realtime_scheduling(priority: int) -> Iterator[None]:
    """Give the whole process a SCHED_FIFO priority (none with 0); its threads switch sooner.

    Python's garbage collector is off meanwhile: a collection at a bad moment takes milliseconds.
    All threads are included, also those of the middleware, since each of them passes messages on.

    Raises
    ------
    GraphError
        If the system does not permit the priority.
    """
    with ExitStack() as undo:
        for task in Path("/proc/self/task").iterdir() if priority else ():
            thread = int(task.name)
            with suppress(ProcessLookupError):  # ended just now
                before = os.sched_getscheduler(thread), os.sched_getparam(thread)
                try:
                    os.sched_setscheduler(thread, os.SCHED_FIFO, os.sched_param(priority))
                except PermissionError:
                    text = f"parameter 'realtime.priority' = {priority}: {_REFUSAL}"
                    raise GraphError(text) from None
                undo.callback(_reschedule, thread, *before)
        # The first message that rclpy logs looks up the file of each module, which takes 0.1 s.
        inspect.getmodule(inspect.currentframe())
        gc.collect()
        gc.freeze()
        undo.callback(gc.unfreeze)
        if gc.isenabled():
            gc.disable()
            undo.callback(gc.enable)
        undo.callback(sys.setswitchinterval, sys.getswitchinterval())
        sys.setswitchinterval(_SWITCH_INTERVAL)
        yield


def _reschedule(thread: int, policy: int, param: os.sched_param) -> None:
    with suppress(OSError):
        os.sched_setscheduler(thread, policy, param)


def require_precedence(priority: int) -> None:
    """Check beforehand that the system permits a SCHED_FIFO priority; 0 is always permitted.

    Raises
    ------
    ConfigurationError
        If it does not.
    """
    try:
        with realtime_scheduling(priority):
            pass
    except GraphError:
        raise ConfigurationError(f"priority = {priority}: {_REFUSAL}") from None


@contextmanager
def seldom_collecting() -> Iterator[None]:
    """Let Python's garbage collector run seldom, and search new objects only.

    Objects that exist already hold no garbage; it would only search them again and again.
    """
    threshold = gc.get_threshold()
    gc.freeze()
    gc.set_threshold(_NEW_OBJECTS, *threshold[1:])
    try:
        yield
    finally:
        gc.set_threshold(*threshold)
        gc.unfreeze()


def wake_up_exactly() -> None:
    """Let the kernel wake this thread at the time it asked for, not up to 50 µs later."""
    with suppress(OSError, AttributeError):  # elsewhere than on Linux
        ctypes.CDLL(None).prctl(_PR_SET_TIMERSLACK, _SLACK_NS, 0, 0, 0)
