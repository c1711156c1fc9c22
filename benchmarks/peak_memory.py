"""Largest resident size of a process and of all that it has started."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from types import TracebackType

_PERIOD = 0.2
"""How often to look (s); what a process needs in its last moments may be missed."""


class PeakMemory:
    """Looks at a process and its descendants now and then, in a thread, within its context.

    Parameters
    ----------
    root : number of the process; None to look at nothing

    Attributes
    ----------
    peaks : largest resident size in bytes by module, for processes like ``python -m MODULE``; the
        largest one where several run the same module
    """

    def __init__(self, root: int | None) -> None:
        self._root = root
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)
        self.peaks: dict[str, int] = {}

    def _watch(self) -> None:
        while self._root is not None and not self._over.wait(_PERIOD):
            for process in descendants(self._root):
                # A process that has ended meanwhile has nothing to read.
                with suppress(OSError, ValueError, IndexError):
                    module = _module(process)
                    self.peaks[module] = max(self.peaks.get(module, 0), peak_of(process))

    def __enter__(self) -> PeakMemory:
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._over.set()
        self._thread.join()


def descendants(root: int) -> Iterator[int]:
    """Numbers of a process, its children, their children and so on."""
    children: dict[int, list[int]] = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdecimal():
            with suppress(OSError, ValueError, IndexError):
                fields = (entry / "stat").read_text(errors="replace")
                parent = int(fields.rpartition(")")[2].split()[1])
                children.setdefault(parent, []).append(int(entry.name))
    waiting = [root]
    while waiting:
        process = waiting.pop()
        yield process
        waiting += children.get(process, [])


def peak_of(process: int) -> int:
    """Largest resident size that a process has had, bytes; see proc_pid_status(5).

    Raises
    ------
    OSError, IndexError
        If there is no such process, or it has ended.
    """
    text = Path(f"/proc/{process}/status").read_text(errors="replace")
    return 1024 * int(text.partition("VmHWM:")[2].split()[0])


def _module(process: int) -> str:
    parts = Path(f"/proc/{process}/cmdline").read_bytes().split(b"\0")
    return parts[parts.index(b"-m") + 1].decode()
