"""Draws the figures of a result in another process, which gets ready while there is none yet.

matplotlib takes half a second to import and as much again for its first figure. A process that
starts together with an experiment has done all that when the last trial ends.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import IO

from armimp_common.errors import DataError

WORKER = "armimp_estimation.figure_worker"
_PATIENCE = 1.0
"""Time that the process has to end by itself, s; that of its forks."""


class FigureProcess:
    """At most one process that draws the figures of one result.

    It ends with this one, even if that is killed, or on leaving the context. If it cannot be
    started, dies or finds no result, nothing is drawn, and `finished` says so.
    """

    def __init__(self) -> None:
        self._process: subprocess.Popen[str] | None = None
        self._asked = False

    @property
    def number(self) -> int | None:
        """Number of the process; None without one."""
        return None if self._process is None else self._process.pid

    def start(self) -> None:
        """Start the process, so that it gets ready; not needed before `draw`."""
        if self._process is not None:
            return
        # The user's SIGINT is meant for this process, which ends the other one if need be. A mask
        # is inherited, and a signal that comes meanwhile is not lost.
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            self._process = subprocess.Popen(
                [sys.executable, "-m", WORKER],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
                # It forks, which takes a process without further threads.
                env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
            )
        except OSError:
            pass
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)

    def draw(
        self, directory: Path, bags: Sequence[Path] | None = None, *, namespace: str | None = None
    ) -> None:
        """Begin to draw every figure of a result, see `armimp_estimation.figures.write_figures`.

        The first call counts.

        Parameters
        ----------
        directory, bags, namespace
            As in `armimp_estimation.report.load_result`.
        """
        self.start()
        if self._asked or self._process is None or self._process.stdin is None:
            return
        self._asked = True
        request = {
            "directory": str(directory),
            "bags": None if bags is None else [str(bag) for bag in bags],
            "namespace": namespace,
        }
        with suppress(BrokenPipeError):
            print(json.dumps(request), file=self._process.stdin, flush=True)

    def finished(self) -> bool:
        """Wait until everything that `draw` has begun is drawn; tell whether it is.

        Raises
        ------
        DataError
            If a figure cannot be written.
        """
        if self._process is None or self._process.stdout is None:
            return False
        answer = self._process.stdout.readline()
        if not answer:
            return False
        error = json.loads(answer)["error"]
        if error:
            raise DataError(error)
        return True

    def close(self) -> None:
        """End the process, whatever it does."""
        if self._process is None:
            return
        process, self._process = self._process, None
        _shut(process.stdin)
        try:
            process.wait(_PATIENCE)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        _shut(process.stdout)

    def __enter__(self) -> FigureProcess:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


def _shut(stream: IO[str] | None) -> None:
    if stream is not None:
        with suppress(BrokenPipeError):
            stream.close()
