"""Processes of this machine by their command line, for tests that stop or kill them."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path


def processes_of(*words: str | Path) -> list[int]:
    """Processes whose command line has all these words in it, but for this one."""
    found = []
    for entry in Path("/proc").iterdir():
        with suppress(OSError):
            if entry.name.isdigit() and int(entry.name) != os.getpid():
                command = (entry / "cmdline").read_bytes().decode(errors="replace")
                found += [int(entry.name)] if all(str(one) in command for one in words) else []
    return found
