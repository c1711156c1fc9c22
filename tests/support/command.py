"""Calling the command line as a user does, and what is promised about its complaints, for tests."""

from __future__ import annotations

import contextlib
import io
from dataclasses import dataclass

from armimp_bringup.cli import main

_NOTES = ("note: ", "armimp: note: ", "armimp: refused: ", "trial ")


@dataclass(frozen=True, kw_only=True)
class Told:
    """What a command left on the screen."""

    status: int
    out: str
    err: str

    @property
    def complaints(self) -> list[str]:
        """Lines of standard error, without progress and notes, which are no complaints."""
        lines = self.err.split("\n")[:-1]
        return [line for line in lines if not line.startswith(_NOTES)]


def call(*arguments: str) -> Told:
    """Run a command in this process."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        status = main(arguments)
    return Told(status=status, out=out.getvalue(), err=err.getvalue())


def refused(*arguments: str) -> Told:
    """Run a command that must not do anything but complain, in one line."""
    told = call(*arguments)
    assert told.status in (1, 2), told
    assert told.err.startswith("armimp: "), told
    assert told.err.count("\n") == 1, told
    assert len(told.err.splitlines()) == 1, told
    assert told.out == "", told
    return told


def behaved(*arguments: str) -> Told:
    """Run a command on data that may be bad: each of its complaints must be one line of its own."""
    told = call(*arguments)
    assert told.status in (0, 1, 2), told
    assert bool(told.complaints) == (told.status != 0), told
    assert all(line.startswith("armimp: ") for line in told.complaints), told
    return told
