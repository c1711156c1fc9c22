"""Conditions of a study and their batches: the same results wherever they run."""

from __future__ import annotations

import itertools
import json
import pickle
import sys
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from armimp_bringup.config import ExperimentConfig
from armimp_bringup.study import (
    MOST_SEEDS,
    Condition,
    ConditionResult,
    engine,
    parse_seeds,
    select_conditions,
)
from armimp_bringup.study.engine import (
    Batch,
    cluster,
    condition_config,
    run_batch,
    software,
    split_evenly,
    threads,
)
from armimp_bringup.study.study import run_study
from armimp_common.errors import ConfigurationError, DataError
from armimp_sim.dynamics import WIDTH
from support.graph import PATIENCE

BASE = ExperimentConfig(duration=4.0, estimators=("welch_siso", "lpm_full"))
CONDITIONS = (
    *select_conditions(["friction=0,resolution=0+3,perturbation=3"], "4"),
    Condition(friction=3, resolution=3, perturbation=1, seed=5),
)


def _run(conditions: Sequence[Condition], base: ExperimentConfig = BASE) -> list[ConditionResult]:
    return run_batch(Batch(base=base, conditions=tuple(conditions)))


@pytest.fixture(scope="module")
def together() -> list[ConditionResult]:
    return _run(CONDITIONS)


def _assert_same(one: ConditionResult, other: ConditionResult) -> None:
    assert one.entry.model_dump_json() == other.entry.model_dump_json()
    for name, estimate in ((n, r.estimate) for n, r in one.results.items()):
        for attribute in ("f", "Z", "variance"):
            values = getattr(estimate, attribute)
            np.testing.assert_array_equal(values, getattr(other.results[name].estimate, attribute))


def test_condition_gives_the_same_bits_alone_and_beside_others(
    together: list[ConditionResult],
) -> None:
    for condition, result in zip(CONDITIONS[1:], together[1:], strict=True):
        (alone,) = _run([condition])
        _assert_same(alone, result)


def test_entry_says_what_it_was_made_of_and_survives_the_way_to_another_process(
    together: list[ConditionResult],
) -> None:
    for condition, result in zip(CONDITIONS, together, strict=True):
        entry = result.entry
        assert entry.condition == condition
        config = json.loads(json.dumps(entry.config))
        assert config["experiment"] == json.loads(
            condition_config(BASE, condition).model_dump_json()
        )
        assert config["versions"]["numpy"] == np.__version__
        assert [trial.k for trial in entry.trials] == [1, 2]
        assert {trial.ticks for trial in entry.trials} == {4_000}
        assert list(entry.estimators) == list(BASE.estimators)
        assert entry.truth is not None
    _assert_same(pickle.loads(pickle.dumps(together[0])), together[0])


def test_other_software_and_unknown_estimators_are_refused() -> None:
    other = {**software(), "versions": {"numpy": "0.1"}}
    with pytest.raises(DataError, match=rf"numpy {np.__version__}, the study is made with 0\.1"):
        run_batch(Batch(base=BASE, conditions=CONDITIONS, software=other))
    with pytest.raises(ConfigurationError, match="guess"):
        _run(CONDITIONS[:1], BASE.model_copy(update={"estimators": ("guess",)}))


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


# --- where batches run -------------------------------------------------------------------------


def _batches(number: int) -> list[Batch]:
    cells = [Condition(friction=0, resolution=0, perturbation=1, seed=s) for s in range(number)]
    return [Batch(base=BASE, conditions=(one,), software={}) for one in cells]


def _seed(batch: Batch) -> int:
    return batch.conditions[0].seed


def _await_threads() -> None:
    """Return when no pool of threads is at work any more."""
    for thread in threading.enumerate():
        if thread.name.startswith("ThreadPoolExecutor"):
            thread.join(PATIENCE)


def test_error_in_a_batch_is_raised_and_the_others_are_not_begun() -> None:
    begun, over = [], threading.Event()

    def work(batch: Batch) -> list[ConditionResult]:
        begun.append(_seed(batch))
        if _seed(batch) == 1:
            raise DataError("this one failed")
        assert _seed(batch) == 0 or over.wait(PATIENCE)
        return []

    with pytest.raises(DataError, match="this one failed"):
        list(threads(1).run(work, _batches(50)))
    over.set()
    _await_threads()
    # One more may have begun before the error was heard of.
    assert begun in ([0, 1], [0, 1, 2])


def test_wrong_backends_are_told_in_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ConfigurationError, match="--workers must be at least 1, got 0"):
        threads(0)
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ConfigurationError, match="which is not installed: pip install distributed"):
        cluster("tcp://127.0.0.1:8786")


@pytest.fixture
def distributed() -> Any:
    return pytest.importorskip("distributed")


@pytest.mark.slow
@pytest.mark.filterwarnings("default")  # of what other packages do while a cluster starts and ends
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


# --- Selections of conditions on the command line: what they mean, and what is refused how ------


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
