"""Runs batches of conditions in processes or on a cluster; those of a batch run side by side."""

from __future__ import annotations

import importlib
import itertools
import signal
import threading
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from concurrent.futures import CancelledError, Executor, Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from multiprocessing import active_children, get_context, parent_process
from typing import Any, TypeAlias, TypeVar

from armimp_bringup.bench import available_cores
from armimp_bringup.config import ExperimentConfig
from armimp_bringup.offline import SimulatedExperiment, simulate
from armimp_bringup.study import Condition, StudyEntry
from armimp_common.errors import ArmimpError, ConfigurationError, DataError
from armimp_common.process import end_with
from armimp_common.versions import software
from armimp_estimation.summary import ImpedanceCurve, TrialSummary
from armimp_sim.dynamics import WIDTH
from armimp_sim.plant import IntegrationError

Task = TypeVar("Task")
Done = TypeVar("Done")
Result: TypeAlias = tuple[StudyEntry, dict[str, ImpedanceCurve]]
"""Result of one condition, with its curves by name of the estimator."""
_CONNECT_TIMEOUT = 10.0  # s


def split_evenly(conditions: Sequence[Condition], workers: int) -> list[tuple[Condition, ...]]:
    """Split conditions into batches that keep all workers equally busy.

    A block of `armimp_sim.dynamics.WIDTH` lanes takes the same time however many of them are in
    use. So batches hold that many at most, and their number is a multiple of the workers' unless
    there are too few conditions.

    Parameters
    ----------
    conditions : those that are to be run
    workers : number of batches that run at the same time
    """
    total = len(conditions)
    batches = min(total, workers * -(-total // (workers * WIDTH)))
    bounds = [total * number // batches for number in range(batches + 1)] if total else []
    return [tuple(conditions[first:last]) for first, last in itertools.pairwise(bounds)]


def run_batch(
    base: ExperimentConfig, made_with: Mapping[str, Any], conditions: Sequence[Condition]
) -> list[Result]:
    """Simulate conditions side by side, and identify the impedance in each.

    Parameters
    ----------
    base : everything but levels and seed
    made_with : `software` of the process that runs the study, usually not this one
    conditions : one for each lane

    Raises
    ------
    ConfigurationError
        If the configuration does not make an experiment, or an estimator does not exist.
    DataError
        If a condition cannot be simulated or estimated, or the software here differs.
    """
    here = software()["versions"]
    for name, version in made_with["versions"].items():
        if here.get(name) != version:
            raise DataError(
                f"a worker has {name} {here.get(name)}, the study is made with {version}"
            )
    try:
        experiments = simulate([condition_config(base, one) for one in conditions])
    except IntegrationError as error:
        ends = dict.fromkeys(map(str, (conditions[0], conditions[-1])))
        raise DataError(f"{' to '.join(ends)}: {error}") from None
    return [
        estimate_condition(made_with, condition, one)
        for condition, one in zip(conditions, experiments, strict=True)
    ]


def condition_config(base: ExperimentConfig, condition: Condition) -> ExperimentConfig:
    """Return the configuration of one condition: that of the study with its levels and seed."""
    return base.model_copy(update={**condition.levels, "seed": condition.seed})


def estimate_condition(
    made_with: Mapping[str, Any], condition: Condition, experiment: SimulatedExperiment
) -> Result:
    """Identify the impedance in one condition, from its trials.

    Raises
    ------
    ConfigurationError
        If an estimator does not exist.
    DataError
        If the trials can't be estimated.
    """
    try:
        identification = experiment.identify(experiment.config.estimators)
    except ConfigurationError:
        raise
    except ArmimpError as error:
        raise DataError(f"{condition}: {error}") from None
    entry = StudyEntry.of(
        identification,
        truth=experiment.truth,
        # The software that the study as a whole is made with, wherever this runs.
        config=experiment.known.config | dict(made_with),
        seed=condition.seed,
        problems=list(identification.problems),
        trials=[
            TrialSummary(ticks=record.samples, **dict(scores))
            for record, scores in zip(experiment.records, identification.trials, strict=True)
        ],
        friction=condition.friction,
        resolution=condition.resolution,
        perturbation=condition.perturbation,
    )
    found = identification.estimators
    return entry, {name: ImpedanceCurve.of(one) for name, one in found.items()}


@dataclass(frozen=True)
class Backend:
    """Where a study runs: an executor, and the number of tasks that it runs at the same time."""

    pool: Executor
    workers: int
    lost: tuple[type[Exception], ...] = ()
    """Errors that mean the death of a worker."""
    end: Callable[[], None] | None = None
    """Ends the pool and what belongs to it; by default, tasks that have begun run to their end."""

    def run(self, work: Callable[[Task], Done], tasks: Iterable[Task]) -> Generator[Done]:
        """Yield the results of all tasks, in the order in which they are ready.

        The first error of a task is raised; tasks that have not begun by then are cancelled.
        """
        lost: tuple[type[Exception], ...] = (CancelledError, *self.lost)
        futures: list[Future[Done]] = []
        try:
            # A worker that is only half started would complain.
            before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})
            try:
                futures += (self.pool.submit(work, task) for task in tasks)
            finally:
                signal.pthread_sigmask(signal.SIG_SETMASK, before)
            for future in as_completed(futures):
                yield future.result()
        except lost as error:
            raise DataError(f"a worker died: {error}") from None
        finally:
            if self.end is None:
                self.pool.shutdown(wait=False, cancel_futures=True)
            else:
                self.end()  # a pool without its workers ends the futures itself


def processes(workers: int | None = None) -> Backend:
    """Return a backend of processes on this machine; in threads, estimates delay one another.

    Parameters
    ----------
    workers : number of processes; by default one for each core
    """
    workers = workers or available_cores()
    others = active_children()
    pool = ProcessPoolExecutor(workers, mp_context=get_context("spawn"), initializer=_follow_parent)

    def end() -> None:
        for child in {*active_children()}.difference(others):
            child.kill()
        # A pool that still clears up while this process exits would leave semaphores behind.
        pool.shutdown()

    return Backend(pool, workers, (BrokenProcessPool,), end)


def _follow_parent() -> None:
    # SIGINT stays blocked as it was at the start: Ctrl-C reaches workers, too, and they end anyway.
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGTERM})
    if (parent := parent_process()) is not None:
        threading.Thread(target=end_with, args=(parent.sentinel,), daemon=True).start()


def cluster(address: str) -> Backend:
    """Return a backend of the workers of a running dask cluster.

    Parameters
    ----------
    address : address of the scheduler, such as ``tcp://host:8786``

    Raises
    ------
    ConfigurationError
        If dask.distributed is not installed here, or the address makes no sense.
    DataError
        If nothing answers there, or the cluster has no workers.
    """
    try:
        distributed: Any = importlib.import_module("distributed")
    except ImportError:
        raise ConfigurationError(
            "--scheduler needs the package distributed, which is not installed: "
            "pip install distributed"
        ) from None
    try:
        client = distributed.Client(address, timeout=_CONNECT_TIMEOUT)
    except (ValueError, OSError) as error:
        kind = ConfigurationError if isinstance(error, ValueError) else DataError
        raise kind(f"--scheduler {address}: {' '.join(str(error).split())}") from None
    workers = sum(client.nthreads().values())
    if not workers:
        client.close()
        raise DataError(f"--scheduler {address}: the cluster has no workers")
    pool = client.get_executor(pure=False)

    def end() -> None:
        pool.shutdown(wait=False)
        client.close()

    return Backend(pool, workers, (distributed.KilledWorker,), end)
