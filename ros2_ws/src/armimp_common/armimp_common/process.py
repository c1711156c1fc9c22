"""Identity of a process, by which others on the same machine can tell whether it still lives."""

import math
import os
import time
from contextlib import suppress
from enum import Enum
from functools import cache
from pathlib import Path
from typing import Final

_STAT_BYTES: Final = 4096
"""More than ``/proc/<pid>/stat`` ever has."""


def identity() -> str:
    """Return machine, process namespace, number and start time of this process.

    Empty where there is no ``/proc``, that is, elsewhere than on Linux.
    """
    try:
        return f"{_place()} {os.getpid()} {_state('self')[1]}"
    except OSError:
        return ""


class Life(Enum):
    """What the system tells of a process."""

    RUNNING = "running"
    STOPPED = "stopped"
    """As by SIGSTOP."""
    ENDED = "ended"
    """Even if nobody has waited for it yet."""
    UNKNOWN = "unknown"
    """It can't be told from here."""

    @property
    def there(self) -> bool | None:
        """Whether the process lives; None if it can't be told from here."""
        return None if self is Life.UNKNOWN else self is not Life.ENDED


def life_of(process: str) -> Life:
    """Tell what has become of the process with this `identity`."""
    place, _, rest = process.rpartition("] ")
    number, _, start = rest.partition(" ")
    try:
        if not number.isdecimal() or f"{place}]" != _place():
            return Life.UNKNOWN
    except OSError:
        return Life.UNKNOWN
    try:
        state, started = _state(number)
    except OSError:
        return Life.ENDED
    if started != start or state in ("Z", "X"):
        return Life.ENDED
    return Life.STOPPED if state in ("T", "t") else Life.RUNNING


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
    if not life_of(process).there:
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
    # Without a file object: this is done many times a second.
    file = os.open(f"/proc/{process}/stat", os.O_RDONLY | os.O_CLOEXEC)
    try:
        fields = os.read(file, _STAT_BYTES).rpartition(b")")[2].split(None, 20)
    finally:
        os.close(file)
    return fields[0].decode("ascii"), fields[19].decode("ascii")
