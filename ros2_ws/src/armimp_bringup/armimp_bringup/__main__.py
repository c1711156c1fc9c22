"""Entry point of the command ``armimp``; an interrupt during the imports is handled, too."""

from __future__ import annotations

import _thread
import os
import signal
import sys
import threading
from types import FrameType
from typing import NoReturn


def program() -> NoReturn:
    """Import the command line, which takes most of a second, and run it."""
    came: list[int] = []

    def interrupt(number: int, frame: FrameType | None) -> NoReturn:
        came.append(number)
        raise KeyboardInterrupt

    def ignored(error: sys.UnraisableHookArgs) -> None:
        if came:  # in a callback of a library: once more when that is over
            threading.Timer(0.1, _thread.interrupt_main).start()
        else:
            sys.__unraisablehook__(error)

    sys.unraisablehook = ignored
    for number in (signal.SIGINT, signal.SIGTERM):
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, interrupt)
    try:
        from armimp_bringup import cli

        cli.program()
    except BaseException:  # some libraries make another error of a KeyboardInterrupt
        if not came:
            raise
        os.write(2, b"armimp: interrupted\n")
        os._exit(130)


if __name__ == "__main__":
    program()
