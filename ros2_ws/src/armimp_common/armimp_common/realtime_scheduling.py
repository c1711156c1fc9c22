"""Precedence of a process over others on the same machine, as far as the system permits it."""

from __future__ import annotations

import ctypes
import gc
import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from pydantic import Field

from armimp_common.errors import ConfigurationError, GraphError
from armimp_common.schema import Schema

_SWITCH_INTERVAL = 2e-4
"""How long a thread may keep another one of Python waiting (s); the default is five periods."""
_REFUSAL = "the system does not permit SCHED_FIFO to this user, see docs/realtime.md"
_NEW_OBJECTS = 50_000
"""How many there may be before the collector looks at them; the default is 700."""
_PR_SET_TIMERSLACK = 29
_SLACK_NS = 1000


class UrgencyParameters(Schema):
    """What a process asks of the system while it works in real time."""

    priority: int = Field(
        default=0,
        ge=0,
        le=99,
        description="SCHED_FIFO priority of the process in realtime; 0: ordinary scheduling",
    )
    cpu: int = Field(
        default=-1, ge=-1, le=1023, description="processor core to stay on in realtime; -1: any"
    )


class RealtimeScheduling:
    """Takes precedence for the whole process, until it is given back.

    Python's garbage collector rests meanwhile: a collection in the wrong moment takes milliseconds.
    All threads count, those of the middleware too, since each of them carries a message on.

    Parameters
    ----------
    parameters : UrgencyParameters

    Raises
    ------
    GraphError
        If the system does not permit what is asked.
    """

    def __init__(self, parameters: UrgencyParameters) -> None:
        self._collecting = gc.isenabled()
        self._interval = sys.getswitchinterval()
        self._before: dict[int, tuple[int, os.sched_param, set[int]]] = {}
        for thread in _threads():
            with suppress(ProcessLookupError):  # ended just now
                self._raise(thread, parameters)
        gc.collect()
        gc.freeze()
        gc.disable()
        sys.setswitchinterval(_SWITCH_INTERVAL)

    def _raise(self, thread: int, parameters: UrgencyParameters) -> None:
        policy, param = os.sched_getscheduler(thread), os.sched_getparam(thread)
        self._before[thread] = policy, param, os.sched_getaffinity(thread)
        try:
            if parameters.cpu >= 0:
                os.sched_setaffinity(thread, {parameters.cpu})
        except OSError as error:
            self._restore()
            raise GraphError(
                f"parameter 'realtime.cpu' = {parameters.cpu}: {error.strerror}"
            ) from None
        try:
            if parameters.priority:
                os.sched_setscheduler(thread, os.SCHED_FIFO, os.sched_param(parameters.priority))
        except PermissionError:
            self._restore()
            raise GraphError(
                f"parameter 'realtime.priority' = {parameters.priority}: {_REFUSAL}"
            ) from None

    def give_back(self) -> None:
        """Let the process be as it was."""
        self._restore()
        sys.setswitchinterval(self._interval)
        if self._collecting:
            gc.unfreeze()
            gc.enable()

    def _restore(self) -> None:
        for thread, (policy, param, cores) in self._before.items():
            with suppress(OSError):
                os.sched_setscheduler(thread, policy, param)
                os.sched_setaffinity(thread, cores)
        self._before.clear()


def require_precedence(priority: int) -> None:
    """Find out beforehand whether the system permits a SCHED_FIFO priority; 0 always is.

    Raises
    ------
    ConfigurationError
        If it does not.
    """
    if priority == 0:
        return
    refused: list[OSError] = []

    def attempt() -> None:
        try:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
        except OSError as error:
            refused.append(error)

    # The scheduling of a thread ends with it.
    thread = threading.Thread(target=attempt)
    thread.start()
    thread.join()
    if refused:
        raise ConfigurationError(f"priority = {priority}: {_REFUSAL}")


@contextmanager
def seldom_collecting() -> Iterator[None]:
    """Have Python's garbage collector look at what is new only, and that seldom.

    Of what is there already it would find nothing, but look at all of it again and again.
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


def _threads() -> list[int]:
    try:
        return [int(entry.name) for entry in Path("/proc/self/task").iterdir()]
    except OSError:
        return [0]
