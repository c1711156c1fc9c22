"""Calling the command line as a user does, and what is promised about its complaints, for tests."""

from __future__ import annotations

import contextlib
import io
from dataclasses import dataclass

from armimp_bringup.cli import main


@dataclass(frozen=True, kw_only=True)
class Told:
    """What a command left on the screen."""

    status: int
    out: str
    err: str


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
