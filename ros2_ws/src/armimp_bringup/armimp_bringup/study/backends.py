"""Where the batches run: threads of this process, or the workers of a dask cluster."""

from __future__ import annotations

import functools
import importlib
import queue
import threading
from collections.abc import Callable, Iterator, Sequence
from typing import Any, TypeAlias, TypeVar

from armimp_bringup.study.engine import Batch, run_batch
from armimp_bringup.study.store import ConditionResult
from armimp_common.errors import ConfigurationError, DataError

Results = list[ConditionResult]
Task = TypeVar("Task")
Done = TypeVar("Done")
_CONNECT_TIMEOUT = 10.0  # s


def as_ready(work: Callable[[Task], Done], tasks: Sequence[Task], workers: int) -> Iterator[Done]:
    """Results of the tasks from threads of this process, in the order in which they are ready.

    The threads are daemons, so that nothing waits for a task that nobody wants any more. The first
    error of a task is raised, and ends the others.
    """
    waiting: queue.SimpleQueue[Task] = queue.SimpleQueue()
    done: queue.SimpleQueue[tuple[Done] | BaseException] = queue.SimpleQueue()
    for task in tasks:
        waiting.put(task)
    stop = threading.Event()

    def work_off() -> None:
        while not stop.is_set():
            try:
                task = waiting.get_nowait()
            except queue.Empty:
                return
            try:
                done.put((work(task),))
            except BaseException as error:  # noqa: BLE001 (raised again by the other thread)
                done.put(error)
                return

    for _ in range(min(workers, len(tasks))):
        threading.Thread(target=work_off, daemon=True).start()
    try:
        for _ in tasks:
            result = done.get()
            if isinstance(result, BaseException):
                raise result
            yield result[0]
    finally:
        stop.set()


class Threads:
    """Threads of this process; most of the time they are in compiled code, without the GIL.

    Parameters
    ----------
    workers : int
        Number of threads.
    work : callable
        What to do with a batch.
    """

    def __init__(self, workers: int, work: Callable[[Batch], Results] = run_batch) -> None:
        if workers < 1:
            raise ConfigurationError(f"--workers must be at least 1, got {workers}")
        self.workers = workers
        self._work = work

    def run(self, batches: Sequence[Batch]) -> Iterator[Results]:
        """Yield the results of the batches, in the order in which they are ready.

        The first error of a batch is raised, and ends the others.
        """
        return as_ready(self._work, batches, self.workers)


class Dask:
    """The workers of a running dask cluster, which is connected to when it is needed.

    Parameters
    ----------
    address : str
        Of the scheduler, such as ``tcp://host:8786``.

    Raises
    ------
    ConfigurationError
        If dask.distributed is not installed here.
    """

    def __init__(self, address: str) -> None:
        try:
            self._distributed: Any = importlib.import_module("distributed")
        except ImportError:
            raise ConfigurationError(
                "--scheduler needs the package distributed, which is not installed: "
                "pip install distributed"
            ) from None
        self._address = address

    @property
    def workers(self) -> int:
        """Number of threads of all workers.

        Raises
        ------
        ConfigurationError
            If the address makes no sense.
        DataError
            If nothing answers there, or the cluster has no workers.
        """
        threads = sum(self._client.nthreads().values())
        if not threads:
            self._client.close()
            raise DataError(f"--scheduler {self._address}: the cluster has no workers")
        return int(threads)

    def run(self, batches: Sequence[Batch]) -> Iterator[Results]:
        """As `Threads.run`."""
        futures = [self._client.submit(run_batch, batch, pure=False) for batch in batches]
        try:
            for future in self._distributed.as_completed(futures):
                try:
                    yield future.result()
                except (self._distributed.KilledWorker, self._distributed.CancelledError) as error:
                    raise DataError(f"a worker of the cluster died: {_line(error)}") from None
        finally:
            self._client.cancel(futures)
            self._client.close()

    @functools.cached_property
    def _client(self) -> Any:
        try:
            return self._distributed.Client(self._address, timeout=_CONNECT_TIMEOUT)
        except ValueError as error:
            raise ConfigurationError(f"--scheduler {self._address}: {_line(error)}") from None
        except OSError as error:
            raise DataError(f"--scheduler {self._address}: no answer: {_line(error)}") from None


Backend: TypeAlias = Threads | Dask


def _line(error: Exception) -> str:
    return " ".join(str(error).split())
