"""Call the command line as a user does, and check what is promised about its error messages."""

import contextlib
import signal
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from tempfile import TemporaryFile
from typing import Any

from armimp_bringup.cli import main


@dataclass(frozen=True, kw_only=True)
class Told:
    """Exit status and output of a command."""

    status: int
    out: str
    err: str


_file = partial(TemporaryFile, "w+", encoding="utf-8", errors="backslashreplace", newline="")


def call(*arguments: str) -> Told:
    """Run a command in this process."""
    # Into real files: the executor of rclpy asks for their descriptors.
    with _file() as out, _file() as err:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            status = main(arguments)
        for file in (out, err):
            file.seek(0)
        return Told(status=status, out=out.read(), err=err.read())


def refused(*arguments: str) -> Told:
    """Run a command that must do nothing but print one line of complaint."""
    told = call(*arguments)
    assert told.status in (1, 2), told
    assert told.err.startswith("armimp: "), told
    assert told.err.count("\n") == 1, told
    assert len(told.err.splitlines()) == 1, told
    assert told.out == "", told
    return told


@contextlib.contextmanager
def program(
    *arguments: str, module: str = "armimp_bringup", **options: Any
) -> Iterator[subprocess.Popen[str]]:
    """Run a command in a process of its own, which is killed at the end."""
    command = [sys.executable, "-m", module, *arguments]
    given: dict[str, Any] = {"stderr": subprocess.PIPE, "text": True, **options}
    with subprocess.Popen(command, **given) as process:
        try:
            yield process
        finally:
            process.kill()


def interrupted(
    process: subprocess.Popen[str], status: int, number: signal.Signals = signal.SIGINT
) -> list[str]:
    """Send a signal, check the exit status, and return the rest of the error output."""
    process.send_signal(number)
    _, error = process.communicate(timeout=60.0)
    assert process.returncode == status, error
    assert "Traceback" not in error
    return error.splitlines()
