"""A process that ends in order when the one that started it is gone, for whatever reason.

The parent keeps the writing end of a pipe, on which nothing is ever written, and the child waits
at the other end. The kernel closes the pipe with the parent, even after SIGKILL. (The parent-death
signal of Linux would come at the end of the thread that started the child, not of the process.)
"""

import os
import signal
import threading
import time
from typing import Final

_VARIABLE: Final = "ARMIMP_LIFELINE"
_PATIENCE: Final = 60.0
"""Seconds that an orphan has to end in order, which may include an estimate."""


class ParentWatchdog:
    """The end of the pipe that the parent keeps.

    Attributes
    ----------
    child_end : int
        File descriptor to be inherited by children, by ``pass_fds`` of `subprocess.Popen`.
    """

    def __init__(self) -> None:
        self.child_end, self._own_end = os.pipe()

    def environment(self) -> dict[str, str]:
        """Return the environment for children, which tells them of the pipe."""
        return {**os.environ, _VARIABLE: str(self.child_end)}

    def close(self) -> None:
        """Let go of the children, which then end; to be called once."""
        for end in (self._own_end, self.child_end):
            os.close(end)


def follow_lifeline() -> None:
    """End this process like SIGTERM when its parent, which gave it a `ParentWatchdog`, is gone.

    A process that then does not end within a minute is killed, whatever holds it up.
    """
    text = os.environ.pop(_VARIABLE, "")
    if text.isdecimal():
        threading.Thread(target=_watch, args=(int(text),), name="lifeline", daemon=True).start()


def _watch(pipe: int) -> None:
    try:
        while os.read(pipe, 1):
            pass
    except OSError:  # no such pipe: the variable came from elsewhere
        return
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(_PATIENCE)
    os.kill(os.getpid(), signal.SIGKILL)
