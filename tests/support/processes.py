"""Run processes, find them by their command line, wait for them, and ask for priority."""

import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from psutil import Process, process_iter

from armimp_common.errors import ConfigurationError
from armimp_common.realtime import require_precedence

PRIORITY = 30


def run_program(*command: str, **options: Any) -> str:
    """Run a program, which must succeed, and return what it printed."""
    done = subprocess.run(command, capture_output=True, text=True, check=False, **options)
    assert done.returncode == 0, done.stdout + done.stderr
    return str(done.stdout)


run_python = partial(run_program, sys.executable)
"""Run Python in a process of its own."""


def wait_until(condition: Callable[[], bool], what: str, patience: float = 120.0) -> None:
    """Wait for a condition that another process or thread brings about."""
    deadline = time.monotonic() + patience
    while not condition():
        assert time.monotonic() < deadline, f"did not happen within {patience} s: {what}"
        time.sleep(0.005)


def processes_of(*words: str | Path) -> list[int]:
    """Ids of the other processes whose command line contains all these words."""
    commands = {one: " ".join(one.info["cmdline"] or ()) for one in process_iter(["cmdline"])}
    del commands[Process()]
    return [one.pid for one, told in commands.items() if all(str(word) in told for word in words)]


def permitted_priority() -> int:
    """Return a SCHED_FIFO priority if this user may have one, else 0."""
    try:
        require_precedence(PRIORITY)
    except ConfigurationError:
        return 0
    return PRIORITY
