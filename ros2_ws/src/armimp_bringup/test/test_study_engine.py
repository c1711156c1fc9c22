"""Conditions of a study and their batches: the same results wherever they run."""

import itertools
import os
import sys
import threading
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from armimp_bringup.config import ExperimentConfig
from armimp_bringup.study import MOST_SEEDS, Condition, engine, parse_seeds, select_conditions
from armimp_bringup.study.engine import cluster, processes, run_batch, split_evenly
from armimp_bringup.study.study import run_study
from armimp_common.errors import ConfigurationError, DataError
from armimp_common.versions import software
from armimp_sim.dynamics import WIDTH
from support.graph import PATIENCE
from support.results import threads

BASE = ExperimentConfig(duration=4.0, estimators=("welch_siso", "lpm_full"))
ONE = (Condition(friction=3, resolution=3, perturbation=1, seed=5),)


def test_other_software_and_unknown_estimators_are_refused() -> None:
    other = {**software(), "versions": {"numpy": "0.1"}}
    with pytest.raises(DataError, match=rf"numpy {np.__version__}, the study is made with 0\.1"):
        run_batch(BASE, other, ONE)
    with pytest.raises(ConfigurationError, match="guess"):
        run_batch(BASE.model_copy(update={"estimators": ("guess",)}), software(), ONE)


@given(st.integers(0, 500), st.integers(1, 9))
def test_batches_keep_order_and_workers_busy(total: int, workers: int) -> None:
    conditions = [Condition(friction=0, resolution=0, perturbation=1, seed=s) for s in range(total)]
    batches = split_evenly(conditions, workers)
    assert [one for batch in batches for one in batch] == conditions
    sizes = [len(batch) for batch in batches]
    assert all(1 <= size <= WIDTH for size in sizes)
    assert not sizes or max(sizes) - min(sizes) <= 1
    # Every worker has the same number of batches, and no fewer would do.
    if total >= workers:
        assert len(batches) % workers == 0
        assert (len(batches) - workers) * WIDTH < total
    else:
        assert len(batches) == total


def test_the_first_error_of_a_task_is_raised_and_ends_the_others_but_for_those_at_work() -> None:
    begun, over = list[int](), threading.Event()

    def work(task: int) -> int:
        begun.append(task)
        if task == 1:
            raise DataError("this one failed")
        assert task == 0 or over.wait(PATIENCE)
        return task

    with pytest.raises(DataError, match="this one failed"):
        list(threads(1).run(work, range(9)))
    over.set()
    for thread in threading.enumerate():
        if thread.name.startswith("ThreadPoolExecutor"):
            thread.join(PATIENCE)
    # One more may have begun before the error was heard of.
    assert max(begun) <= 2


def test_processes_give_results_and_the_errors_of_their_tasks_and_tell_that_they_died() -> None:
    assert sorted(processes(2).run(abs, [-1, 2, -3])) == [1, 2, 3]
    unknown = BASE.model_copy(update={"estimators": ("guess",)})
    with pytest.raises(ConfigurationError, match="guess"):
        list(processes(1).run(partial(run_batch, unknown, software()), [ONE]))
    with pytest.raises(DataError, match="a worker died: "):
        list(processes(1).run(os._exit, [3]))


def test_a_backend_that_is_not_installed_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ConfigurationError, match="which is not installed: pip install distributed"):
        cluster("tcp://127.0.0.1:8786")


@pytest.fixture
def distributed() -> Any:
    return pytest.importorskip("distributed")


@pytest.mark.slow
@pytest.mark.filterwarnings("default")  # other packages warn while a cluster starts and ends
def test_cluster_gives_the_same_files_as_threads(distributed: Any, tmp_path: Path) -> None:
    conditions = select_conditions(["friction=0,resolution=0+3,perturbation=1"], "0")
    run_study(BASE, conditions, tmp_path / "threads", threads(1), figures=False)
    with distributed.LocalCluster(
        n_workers=1,
        threads_per_worker=2,
        processes=False,
        protocol="tcp",
        host="127.0.0.1",
        dashboard_address=None,
    ) as local:
        backend = cluster(local.scheduler_address)
        assert backend.workers == 2
        run_study(BASE, conditions, tmp_path / "cluster", backend, figures=False)
    for name in ("study.json", "results.csv", "verdict.json"):
        of_threads, of_cluster = (tmp_path / place / name for place in ("threads", "cluster"))
        assert of_cluster.read_bytes() == of_threads.read_bytes()


@pytest.mark.filterwarnings("default")
@pytest.mark.parametrize(
    ("address", "error", "complaint"),
    [
        ("tcp://127.0.0.1:9", DataError, "--scheduler tcp://127.0.0.1:9: "),
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
    monkeypatch.setattr(engine, "_CONNECT_TIMEOUT", 0.5)
    with pytest.raises(error) as caught:
        cluster(address)
    assert str(caught.value).startswith(complaint)
    assert len(str(caught.value).splitlines()) == 1


def test_without_a_selection_all_48_conditions_are_there_once_and_in_order() -> None:
    conditions = select_conditions([], "0:3")
    levels = [(one.friction, one.resolution, one.perturbation) for one in conditions[:48]]
    assert levels == list(itertools.product(range(4), range(4), range(1, 4)))
    assert len({one.name for one in conditions}) == len({str(one) for one in conditions}) == 144
    assert conditions[0].name == "friction0-resolution0-perturbation1-seed0"
    assert str(conditions[0]) == "friction 0, resolution 0, perturbation 1, seed 0"


@pytest.mark.parametrize(
    "text",
    [
        *("friction=4", "perturbation=0", "resolution=1+", "friction=²", "noise=1", "friction", ""),
        "friction=1,friction=2",
    ],
)
def test_selection_that_makes_no_sense_is_refused_with_its_text(text: str) -> None:
    with pytest.raises(ConfigurationError) as caught:
        select_conditions([text], "0")
    assert str(caught.value).startswith(
        f"--only {text!r}: {text.rsplit(',', maxsplit=1)[-1]!r} is not one of"
    )


def test_numbers_and_ranges_of_seeds_may_be_joined() -> None:
    assert parse_seeds("5, 0:3,10 : 12 ") == (5, 0, 1, 2, 10, 11)
    assert parse_seeds(str(2**63 - 1)) == (2**63 - 1,)


@pytest.mark.parametrize(
    "text",
    [
        *("", "-1", "0:10:2", "0:", "3:3", str(2**63), "9" * 20, "0:9223372036854775807"),
        f"{MOST_SEEDS},0:{MOST_SEEDS}",
    ],
)
def test_seeds_that_make_no_sense_are_refused_with_their_text(text: str) -> None:
    with pytest.raises(ConfigurationError) as caught:
        parse_seeds(text)
    part = text.rsplit(",", maxsplit=1)[-1]
    assert str(caught.value).startswith(f"--seeds {text!r}: {part!r} is neither a seed nor a range")
