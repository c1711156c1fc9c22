"""Where batches run: threads and dask clusters, and what happens when one of them fails."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Generator
from pathlib import Path
from typing import Any, cast

import pytest

from armimp_bringup.config import ExperimentConfig
from armimp_bringup.study import backends
from armimp_bringup.study.backends import Dask, Threads
from armimp_bringup.study.conditions import Condition, select_conditions
from armimp_bringup.study.engine import Batch, ConditionResult, Provenance
from armimp_bringup.study.errors import StudyError
from armimp_bringup.study.study import run_study
from armimp_common.errors import ConfigurationError

BASE = ExperimentConfig(duration=10.0, estimators=("welch_siso",))
PROVENANCE = Provenance.here()


def _batches(number: int) -> list[Batch]:
    return [
        Batch(
            base=BASE,
            conditions=(Condition(friction=0, resolution=0, perturbation=1, seed=seed),),
            provenance=PROVENANCE,
        )
        for seed in range(number)
    ]


def _seed(batch: Batch) -> int:
    return batch.conditions[0].seed


class Work:
    """Notes the batches it is given; the results are empty."""

    def __init__(self) -> None:
        self.seeds: list[int] = []
        self.threads: set[str] = set()
        self.at_once = self._now = 0
        self._lock = threading.Lock()

    def __call__(self, batch: Batch) -> list[ConditionResult]:
        with self._lock:
            self.seeds.append(_seed(batch))
            self.threads.add(threading.current_thread().name)
            self._now += 1
            self.at_once = max(self.at_once, self._now)
        time.sleep(0.01)
        with self._lock:
            self._now -= 1
        return []


@pytest.mark.parametrize("workers", [1, 2, 5])
def test_threads_do_every_batch_once_and_no_more_at_a_time_than_there_are(workers: int) -> None:
    work = Work()
    assert list(Threads(workers, work).run(_batches(12))) == [[]] * 12
    assert sorted(work.seeds) == list(range(12))
    assert work.at_once == workers == len(work.threads)


def test_threads_have_nothing_to_do_without_batches() -> None:
    assert list(Threads(2, Work()).run([])) == []


def test_results_come_as_soon_as_they_are_there() -> None:
    slow = threading.Event()

    def work(batch: Batch) -> list[ConditionResult]:
        if _seed(batch) == 0:
            assert slow.wait(10.0)
        return []

    running = Threads(2, work).run(_batches(3))
    assert next(running) == next(running) == []
    slow.set()
    assert list(running) == [[]]


def test_error_in_a_batch_is_raised_and_the_others_are_not_begun() -> None:
    begun = []

    def work(batch: Batch) -> list[ConditionResult]:
        begun.append(_seed(batch))
        if _seed(batch) == 1:
            raise StudyError("this one failed")
        return []

    with pytest.raises(StudyError, match="this one failed"):
        list(Threads(1, work).run(_batches(50)))
    assert begun == [0, 1]


def test_nothing_more_is_begun_once_nobody_wants_the_results() -> None:
    work = Work()
    running = Threads(1, work).run(_batches(50))
    next(running)
    cast("Generator[object, None, None]", running).close()
    time.sleep(0.1)
    assert len(work.seeds) <= 3


def test_batch_that_takes_for_ever_does_not_keep_the_process_alive() -> None:
    def work(batch: Batch) -> list[ConditionResult]:
        if _seed(batch) == 0:
            raise StudyError("failed")
        threading.Event().wait(20.0)
        return []

    with pytest.raises(StudyError):
        list(Threads(2, work).run(_batches(2)))
    alive = [thread for thread in threading.enumerate() if thread is not threading.main_thread()]
    assert all(thread.daemon for thread in alive)


@pytest.mark.parametrize("workers", [0, -1])
def test_number_of_threads_must_be_positive(workers: int) -> None:
    with pytest.raises(ConfigurationError, match=f"--workers must be at least 1, got {workers}"):
        Threads(workers)


def test_missing_dask_is_told_in_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ConfigurationError) as caught:
        Dask("tcp://127.0.0.1:8786")
    assert str(caught.value) == (
        "--scheduler needs the package distributed, which is not installed: pip install distributed"
    )


@pytest.fixture
def distributed() -> Any:
    return pytest.importorskip("distributed")


@pytest.mark.slow
@pytest.mark.filterwarnings("default")  # of what other packages do while a cluster starts and ends
def test_cluster_gives_the_same_files_as_threads(distributed: Any, tmp_path: Path) -> None:
    conditions = select_conditions(["friction=0,resolution=0+3,perturbation=1"], "0")
    run_study(BASE, conditions, tmp_path / "threads", Threads(1), figures=False)
    with distributed.LocalCluster(
        n_workers=1,
        threads_per_worker=2,
        processes=False,
        protocol="tcp",
        host="127.0.0.1",
        dashboard_address=None,
    ) as cluster:
        backend = Dask(cluster.scheduler_address)
        assert backend.workers == 2
        run_study(BASE, conditions, tmp_path / "cluster", backend, figures=False)
    for name in ("study.json", "results.csv", "verdict.json"):
        of_threads, of_cluster = (tmp_path / place / name for place in ("threads", "cluster"))
        assert of_cluster.read_bytes() == of_threads.read_bytes()


@pytest.mark.filterwarnings("default")
def test_error_on_a_cluster_arrives_as_it_is(distributed: Any) -> None:
    wrong = [
        Batch(
            base=BASE.model_copy(update={"estimators": ("guess",)}),
            conditions=batch.conditions,
            provenance=batch.provenance,
        )
        for batch in _batches(1)
    ]
    with (
        distributed.LocalCluster(
            n_workers=1, processes=False, protocol="tcp", host="127.0.0.1", dashboard_address=None
        ) as cluster,
        pytest.raises(ConfigurationError, match="guess"),
    ):
        list(Dask(cluster.scheduler_address).run(wrong))


@pytest.mark.filterwarnings("default")
def test_cluster_without_workers_is_refused(distributed: Any) -> None:
    with (
        distributed.LocalCluster(
            n_workers=0, processes=False, protocol="tcp", host="127.0.0.1", dashboard_address=None
        ) as cluster,
        pytest.raises(StudyError, match="the cluster has no workers"),
    ):
        _ = Dask(cluster.scheduler_address).workers


@pytest.mark.filterwarnings("default")
@pytest.mark.parametrize(
    ("address", "error", "complaint"),
    [
        ("tcp://127.0.0.1:9", StudyError, "--scheduler tcp://127.0.0.1:9: no answer: "),
        ("nonsense", ConfigurationError, "--scheduler nonsense: missing port number"),
    ],
)
def test_scheduler_that_is_not_there_is_named(
    distributed: Any,
    monkeypatch: pytest.MonkeyPatch,
    address: str,
    error: type[Exception],
    complaint: str,
) -> None:
    monkeypatch.setattr(backends, "_CONNECT_TIMEOUT", 0.5)
    with pytest.raises(error) as caught:
        _ = Dask(address).workers
    assert str(caught.value).startswith(complaint)
    assert len(str(caught.value).splitlines()) == 1
