"""Identity of a process, by which others on the same machine can tell whether it still lives."""

import math
import os
import time
from contextlib import suppress
from functools import cache
from pathlib import Path


def identity() -> str:
    """Return machine, process namespace, number and start time of this process.

    Empty where there is no ``/proc``, that is, elsewhere than on Linux.
    """
    try:
        return f"{_place()} {os.getpid()} {_state('self')[1]}"
    except OSError:
        return ""


def lives(process: str) -> bool | None:
    """Tell whether the process with this `identity` lives; None if it can't be told from here.

    A stopped process lives. One that has ended and was not yet waited for does not.
    """
    state = _state_of(process)
    return None if state is None else state not in ("", "Z", "X")


def stopped(process: str) -> bool:
    """Tell whether the process with this `identity` is there but stopped, as by SIGSTOP."""
    return _state_of(process) in ("T", "t")


def _state_of(process: str) -> str | None:
    """One letter; empty if it is gone, None if it can't be told from here."""
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
    return state if started == start else ""


def age() -> float:
    """Return how long ago this process was started, s, to some 10 ms; NaN if it can't be told."""
    try:
        started = int(_state("self")[1]) / os.sysconf("SC_CLK_TCK")
        return time.clock_gettime(time.CLOCK_BOOTTIME) - started
    except (OSError, AttributeError):
        return math.nan


def waited_ns(process: str) -> int | None:
    """Return how long the threads of the process with this `identity` waited for a processor, ns.

    That is the time since their start in which they could have run and others did; see
    proc_pid_schedstat(5). None if it can't be told from here.
    """
    if not lives(process):
        return None
    number = process.rpartition("] ")[2].partition(" ")[0]
    total = 0
    try:
        for task in Path(f"/proc/{number}/task").iterdir():
            with suppress(FileNotFoundError, ProcessLookupError):  # a thread that ended just now
                total += int((task / "schedstat").read_text(encoding="ascii").split()[1])
    except (OSError, ValueError, IndexError):
        return None
    return total


@cache
def _place() -> str:
    boot = Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()
    # Ends with "]", like "pid:[4026531836]".
    return f"{boot} {Path('/proc/self/ns/pid').readlink()}"


def _state(process: str) -> tuple[str, str]:
    """State and start time; see proc_pid_stat(5). The name before them may contain anything."""
    fields = Path(f"/proc/{process}/stat").read_text(errors="replace").rpartition(")")[2].split()
    return fields[0], fields[19]
