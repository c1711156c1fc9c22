"""Standard input, output and error, and lines on the last."""

import os
import sys
from contextlib import suppress
from typing import Final

_LONGEST: Final = 1200
"""Letters of a line: files of unknown origin may hold names of any length."""


def repair_streams() -> None:
    """Make standard input, output and error usable, whatever the environment gave the process.

    One that is closed leads to the null device, so that no other file takes its place. Letters that
    the encoding of standard output does not have become question marks.
    """
    for number, name, mode in ((0, "stdin", "r"), (1, "stdout", "w"), (2, "stderr", "w")):
        try:
            os.fstat(number)
        except OSError:
            null = os.open(os.devnull, os.O_RDWR)
            os.dup2(null, number)  # which child processes inherit
            if null != number:
                os.close(null)
        if getattr(sys, name) is None:
            setattr(sys, name, open(number, mode, encoding="utf-8", closefd=False))  # noqa: SIM115
    with suppress(AttributeError):  # not a file of this interpreter's own
        sys.stdout.reconfigure(errors="replace")  # type: ignore[union-attr]


def say(line: str) -> None:
    """Print a line, which stays one whatever is in the names and values that it quotes."""
    shown = "".join(
        letter if letter.isprintable() else letter.encode("unicode_escape").decode()
        for letter in line
    )
    if len(shown) > _LONGEST:
        shown = f"{shown[: _LONGEST // 2]} ... {shown[-_LONGEST // 2 :]}"
    print(shown, file=sys.stderr)
