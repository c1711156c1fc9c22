"""Batches of conditions: the same results whatever stands beside a condition."""

from __future__ import annotations

import json
import pickle
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from armimp_bringup.config import ExperimentConfig
from armimp_bringup.study import engine
from armimp_bringup.study.conditions import Condition, select_conditions
from armimp_bringup.study.engine import (
    Batch,
    ConditionResult,
    Provenance,
    condition_config,
    run_batch,
    split_evenly,
)
from armimp_bringup.study.errors import StudyError
from armimp_common.errors import ConfigurationError
from armimp_sim.dynamics import WIDTH
from armimp_sim.plant import IntegrationError

BASE = ExperimentConfig(duration=10.0, estimators=("welch_siso", "lpm_full"))
CONDITIONS = (
    *select_conditions(["friction=0,resolution=0+3,perturbation=3"], "4"),
    Condition(friction=3, resolution=3, perturbation=1, seed=5),
)


def _run(conditions: Sequence[Condition], base: ExperimentConfig = BASE) -> list[ConditionResult]:
    return run_batch(Batch(base=base, conditions=tuple(conditions), provenance=Provenance.here()))


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
    for number, condition in enumerate(CONDITIONS):
        (alone,) = _run([condition])
        _assert_same(alone, together[number])


@pytest.mark.slow
def test_order_in_the_batch_makes_no_difference(together: list[ConditionResult]) -> None:
    for one, other in zip(_run(CONDITIONS[::-1]), together[::-1], strict=True):
        _assert_same(one, other)


def test_results_know_their_condition_and_differ(together: list[ConditionResult]) -> None:
    assert tuple(result.condition for result in together) == CONDITIONS
    found = {json.dumps(r.entry.estimators["welch_siso"].model_dump()["M"]) for r in together}
    assert len(found) == len(CONDITIONS)


def test_entry_says_what_it_was_made_of(together: list[ConditionResult]) -> None:
    for condition, result in zip(CONDITIONS, together, strict=True):
        entry = result.entry
        config = json.loads(json.dumps(entry.config))
        assert config["experiment"] == json.loads(
            condition_config(BASE, condition).model_dump_json()
        )
        for level in ("friction", "resolution", "perturbation", "seed"):
            assert config["experiment"][level] == getattr(condition, level)
        assert config["versions"]["numpy"] == np.__version__
        assert [trial.k for trial in entry.trials] == [1, 2]
        assert {trial.ticks for trial in entry.trials} == {10_000}
        assert list(entry.estimators) == list(BASE.estimators)
        assert entry.truth is not None


def test_result_survives_the_way_to_another_process(together: list[ConditionResult]) -> None:
    _assert_same(pickle.loads(pickle.dumps(together[0])), together[0])


def test_overrides_of_the_configuration_reach_every_condition() -> None:
    base = BASE.model_copy(update={"arm_sim": {"voluntary": {"rms": 0.3}}})
    (result,) = _run(CONDITIONS[:1], base)
    (plain,) = _run(CONDITIONS[:1])
    assert json.loads(json.dumps(result.entry.config))["arm_sim"]["voluntary.rms"] == 0.3
    assert result.entry.estimators["welch_siso"].M != plain.entry.estimators["welch_siso"].M


def test_software_other_than_that_of_the_study_is_refused() -> None:
    here = Provenance.here()
    other = replace(here, versions={**here.versions, "numpy": "0.1"})
    batch = Batch(base=BASE, conditions=CONDITIONS, provenance=other)
    with pytest.raises(StudyError, match=rf"numpy {np.__version__}, the study is made with 0\.1"):
        run_batch(batch)


def test_unknown_estimator_is_a_wrong_configuration() -> None:
    with pytest.raises(ConfigurationError, match="guess"):
        _run(CONDITIONS[:1], BASE.model_copy(update={"estimators": ("guess",)}))


def test_simulation_that_breaks_down_is_told_with_its_conditions(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def broken(rigs: Sequence[object]) -> None:
        raise IntegrationError("plant: the state is not finite any more")

    monkeypatch.setattr(engine, "run_offline", broken)
    with pytest.raises(StudyError, match=f"{CONDITIONS[0]} to {CONDITIONS[-1]}: plant: the state"):
        _run(CONDITIONS)
    with pytest.raises(StudyError, match=f"^{CONDITIONS[0]}: plant: the state"):
        _run(CONDITIONS[:1])


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
