"""The process behind `armimp_estimation.figure_process`: draws the figures of one result.

It gets everything ready while it waits: imports, fonts, one figure that nobody sees. Asked by a
line of JSON on its standard input, it draws every figure in every format at the same time as far as
there are processor cores, each in a fork of itself, and answers with another line. It ends when
that input does, that is, when whoever started it is gone.
"""

from __future__ import annotations

import gc
import io
import json
import logging
import os
import select
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from armimp_common.errors import DataError

# Without a home directory matplotlib keeps its cache elsewhere, and warns of that at length.
logging.getLogger("matplotlib").setLevel(logging.ERROR)

# Everything else is imported by the thread that gets things ready.

Job = Callable[[], None]


def jobs(request: dict[str, Any]) -> list[Job]:
    """What has to be done for a request.

    Parameters
    ----------
    request : dict
        ``directory`` of the result, and ``bags`` and ``namespace`` as `load_result` takes them.

    Raises
    ------
    DataError
        If there is no readable result.
    """
    from armimp_estimation.figures import FORMATS, drawings, save_figure
    from armimp_estimation.report.result import load_result

    directory = Path(request["directory"])
    bags = None if request["bags"] is None else [Path(bag) for bag in request["bags"]]
    result = load_result(directory, bags, namespace=request["namespace"])

    def job(draw: Callable[[], Any], path: Path) -> Job:
        return lambda: save_figure(draw(), path)

    # What takes longest comes first.
    return [
        job(draw, directory / f"{name}.{form}")
        for name, draw in drawings(result).items()
        for form in reversed(FORMATS)
    ]


def work_off(waiting: Sequence[Job], cores: int, owner: int) -> str:
    """Do jobs in forks of this process, which must have one thread only.

    Parameters
    ----------
    waiting : sequence of Job
        The jobs; each may raise a `DataError`.
    cores : int
        How many to do at a time.
    owner : int
        File descriptor of a pipe; if it is closed at the other end, the work is given up.

    Returns
    -------
    str
        The message of the first error; empty without one.

    Raises
    ------
    ChildProcessError
        If a fork failed in any other way, or the owner is gone.
    """
    left = iter(waiting)
    running: dict[int, int] = {}
    errors: list[str] = []
    try:
        _begin(left, running, cores)
        while running:
            ready, _, _ = select.select([owner, *running], [], [])
            if owner in ready:
                raise ChildProcessError("nobody waits for the figures any more")
            for pipe in ready:
                with os.fdopen(pipe, encoding="utf-8") as answer:
                    text = answer.read()
                if os.waitpid(running.pop(pipe), 0)[1] != 0:
                    raise ChildProcessError("a fork failed")
                errors += [text] if text else []
            _begin(left, running, cores)
    finally:
        for process in running.values():
            os.kill(process, signal.SIGKILL)
            os.waitpid(process, 0)
    return next(iter(errors), "")


def _begin(left: Iterator[Job], running: dict[int, int], cores: int) -> None:
    """Begin jobs until there are as many as cores, or none is left."""
    while len(running) < cores and (job := next(left, None)) is not None:
        reading, writing = os.pipe()
        process = os.fork()
        if process:
            os.close(writing)
            running[reading] = process
            continue
        status = 1
        try:
            try:
                job()
            except DataError as error:
                os.write(writing, str(error).encode(errors="backslashreplace"))
            status = 0
        finally:
            os._exit(status)


def warm_up() -> None:
    """Draw something, so that the next figures take less time."""
    import numpy as np

    from armimp_estimation.figures import FORMATS, coherence_figure
    from armimp_estimation.report.curves import CoherenceCurves
    from armimp_estimation.report.result import load_result  # noqa: F401 (imports the rest)

    f = np.linspace(0.1, 15.0, 50)
    curves = CoherenceCurves(f=f, motion=0.99 + 0.0 * f, torque=0.98 + 0.0 * f, derived={})
    figure = coherence_figure({(i, k): curves for i in range(2) for k in range(2)}, 2)
    for form in FORMATS:
        figure.savefig(io.BytesIO(), format=form)


def main() -> None:
    """Wait for one request, and answer it; does not return, as tidying up takes time."""
    gc.disable()  # everything here is short-lived
    warming = threading.Thread(target=warm_up, daemon=True)
    warming.start()
    line = sys.stdin.readline()
    if not line:
        os._exit(0)
    warming.join()
    try:
        error = work_off(jobs(json.loads(line)), len(os.sched_getaffinity(0)), sys.stdin.fileno())
    except (DataError, ChildProcessError):
        os._exit(1)
    print(json.dumps({"error": error}), flush=True)
    os._exit(0)


if __name__ == "__main__":
    main()
