"""Processes of this machine: which are alive, how children follow a parent."""

import math
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from types import FrameType
from typing import Any, Final

_STAT_BYTES: Final = 4096
"""Bytes to read of ``/proc/<pid>/stat``, more than it ever has."""
_VARIABLE: Final = "ARMIMP_PARENT_PIPE"
_IN_ORDER: Final = 5.0
"""Time that interrupted work usually takes to shut down (s)."""
_PATIENCE: Final = 60.0
"""Time that a process without its parent has to shut down, perhaps with an estimate (s)."""


STOPPED: Final = ("T", "t")
"""States of stopped processes, as after SIGSTOP."""


def identity() -> str:
    """Return boot id of the machine, PID namespace, PID and start time of this process.

    Other processes of the same machine can tell by it whether this one is still alive. Empty where
    there is no ``/proc``, that is, anywhere but on Linux.
    """
    try:
        return f"{_place()} {os.getpid()} {_state('self')[1]}"
    except OSError:
        return ""


def state_of(process: str) -> str | None:
    """Return the state of the process with this `identity`, a letter of proc_pid_stat(5).

    The state is empty if the process has ended, even if it is still a zombie, which its parent has
    not waited for; None if it cannot be known here, as for a process of another machine.
    """
    place, _, rest = process.rpartition("] ")
    number, _, start = rest.partition(" ")
    try:
        if not number.isdecimal() or f"{place}]" != _place():
            return None
    except OSError:
        return None
    try:
        state, started = _state(number)
    except OSError:
        return ""
    return "" if started != start or state in ("Z", "X") else state


def age() -> float:
    """Return the time since this process was started (s), to some 10 ms; NaN if not known."""
    try:
        started = int(_state("self")[1]) / os.sysconf("SC_CLK_TCK")
        return time.clock_gettime(time.CLOCK_BOOTTIME) - started
    except (OSError, AttributeError):
        return math.nan


@cache
def _place() -> str:
    boot = Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()
    # Ends with "]", like "pid:[4026531836]".
    return f"{boot} {Path('/proc/self/ns/pid').readlink()}"


def _state(process: str) -> tuple[str, str]:
    """Return state and start time, see proc_pid_stat(5); the name before them may hold anything."""
    # In a quarter of the time of psutil (19 instead of 74 µs): heartbeats are checked every 20 ms.
    file = os.open(f"/proc/{process}/stat", os.O_RDONLY | os.O_CLOEXEC)
    try:
        fields = os.read(file, _STAT_BYTES).rpartition(b")")[2].split(None, 20)
    finally:
        os.close(file)
    return fields[0].decode("ascii"), fields[19].decode("ascii")


class ParentWatchdog:
    """Lets child processes shut down when the process that started them is gone for any reason.

    The parent keeps the write end of a pipe, into which nothing is ever written, and the child
    waits at the read end. When the parent ends the kernel closes the pipe, even after SIGKILL. (The
    parent-death signal of Linux would come at the end of the thread that started the child.)

    Attributes
    ----------
    child_end : file descriptor to be inherited by children, by ``pass_fds`` of `subprocess.Popen`
    """

    def __init__(self) -> None:
        self.child_end, self._own_end = os.pipe()

    def environment(self) -> dict[str, str]:
        """Return the environment for children, which holds the descriptor of the pipe."""
        return {**os.environ, _VARIABLE: str(self.child_end)}

    def close(self) -> None:
        """Close the pipe, so that the children end; to be called once."""
        for end in (self._own_end, self.child_end):
            os.close(end)


def follow_parent() -> None:
    """Send this process SIGTERM when its parent, which gave it a `ParentWatchdog`, is gone.

    If it has not ended a minute later, it is killed, whatever holds it up.
    """
    text = os.environ.pop(_VARIABLE, "")
    if text.isdecimal():
        threading.Thread(target=end_with, args=(int(text),), name="parent", daemon=True).start()


def end_with(pipe: int) -> None:
    """Send this process SIGTERM when the other end of a pipe is closed, and kill it in the end."""
    try:
        while os.read(pipe, 1):
            pass
    except OSError:  # no such pipe: the variable came from elsewhere
        return
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(_PATIENCE)
    os.kill(os.getpid(), signal.SIGKILL)


@contextmanager
def stop_on_signals() -> Iterator[Callable[[], bool]]:
    """Turn SIGINT and SIGTERM into a stop condition; a SIGINT over 5 s after the first interrupts.

    An earlier repetition is ignored, as the work is still shutting down. To be used in the main
    thread, with rclpy's own handlers off.

    Yields
    ------
    callable
        Tells whether a signal has come.
    """
    received: dict[int, float] = {}

    def on_signal(number: int, frame: FrameType | None) -> None:
        first = received.setdefault(number, time.monotonic())
        if number == signal.SIGINT and time.monotonic() - first > _IN_ORDER:
            raise KeyboardInterrupt

    before: dict[int, Any] = {
        number: signal.signal(number, on_signal) for number in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        yield lambda: bool(received)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
