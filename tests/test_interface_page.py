"""The tables of docs/interfaces.md which are written by hand say what the code does."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rclpy.qos import HistoryPolicy

from armimp_bringup.config import ExperimentConfig
from armimp_bringup.parameters import bag_metadata, node_parameters
from armimp_common import qos
from armimp_common.status import (
    values_of,
)
from armimp_common.topics import (
    MESSAGE_TYPES,
)
from armimp_estimation.alignment.assemble import Trial
from armimp_estimation.alignment.stream_statistics import StreamStatistics
from armimp_estimation.alignment.trial_windows import TrialWindow
from armimp_estimation.estimators.registry import estimator_names
from armimp_estimation.identify import identify
from armimp_estimation.metadata import READING_KEYS
from armimp_estimation.node import column_message, result_message
from armimp_estimation.result import Result
from armimp_estimation.summary import ImpedanceCurve, Summary, write_frf
from armimp_estimation.torque_timing import TorqueReading
from armimp_estimation.trial import TrialData
from support.pages import markdown_tables
from support.synthetic_trials import TWO_JOINT_ARM, SyntheticConfig, synthetic_trial

DOCS = Path(__file__).resolve().parents[1] / "docs"
PAGE = (DOCS / "interfaces.md").read_text(encoding="utf-8")


TABLES = markdown_tables(PAGE)


def _table(heading: str, column: str, place: int = 0) -> dict[str, dict[str, str]]:
    """One table under a heading by what its first column names, without backticks."""
    rows = TABLES[heading][place]
    names = [row[column].strip("`") for row in rows]
    assert len(set(names)) == len(names), f"{heading}: named twice"
    return dict(zip(names, rows, strict=True))


def _keys(heading: str, place: int = 0) -> set[str]:
    return set(_table(heading, "key", place))


# --- nodes and topics --------------------------------------------------------------------------


def test_the_topics_of_the_page_are_those_of_the_contract() -> None:
    assert set(_table("Topics", "topic")) == set(MESSAGE_TYPES) == set(qos.PROFILES)
    assert {profile.history for profile in qos.PROFILES.values()} == {HistoryPolicy.KEEP_LAST}


# --- keys of messages and files ----------------------------------------------------------------


@pytest.fixture(scope="module")
def trials() -> list[TrialData]:
    config = SyntheticConfig(samples=40_000)
    return [TrialData.of(synthetic_trial(TWO_JOINT_ARM, joint, config, 1)) for joint in (0, 1)]


@pytest.fixture(scope="module")
def result(trials: list[TrialData]) -> Result:
    found = identify(trials, estimator_names(), TWO_JOINT_ARM)
    rest: dict[str, Any] = {"config": {}, "seed": 1, "problems": [], "trials": []}
    summary = Summary.of(found, joint_names=found.joint_names, truth=None, **rest)
    curves = {name: ImpedanceCurve.of(one) for name, one in found.estimators.items()}
    return Result(summary=summary, curves=curves)


def _general(keys: Iterable[str]) -> set[str]:
    """Keys as the page writes them: for any estimator and any element."""
    for name in estimator_names():
        keys = [re.sub(rf"(^|_){name}(\.|$)", r"\1ESTIMATOR\2", key) for key in keys]
    return {re.sub(r"_[12][12]\.", "_IK.", key) for key in keys}


def test_the_keys_of_column_and_conclusion_are_those_of_the_code(
    trials: list[TrialData], result: Result
) -> None:
    record = trials[0].record
    window = TrialWindow(
        trial=1, joint=0, joint_name="", start_ns=0, ticks=record.samples, seed=1, ended=True
    )
    trial = Trial(window=window, segments=(record,), statistics=StreamStatistics())
    column, conclusion = column_message(trial, TorqueReading()), result_message(result)
    assert _keys("Column") == _general(values_of(column))
    assert _keys("Conclusion") == _general(values_of(conclusion))
    assert column.name.replace("1", "K") in PAGE
    assert f"`{conclusion.name}`" in PAGE


def test_the_metadata_keys_of_the_page_are_those_that_a_run_stores() -> None:
    config = ExperimentConfig(rig="realistic")
    parameters = node_parameters(config, None)
    stored = bag_metadata(config, parameters.simulator, parameters.controller)
    rows = _table("Bags", "key")
    assert set(rows) == set(stored)
    assert all(f"`{part}`" in rows["config"]["value"] for part in json.loads(stored["config"]))
    assert _keys("Bags", 1) == set(READING_KEYS)


def test_the_arrays_of_frf_npz_are_those_that_are_written(result: Result, tmp_path: Path) -> None:
    *others, last = result.curves.values()
    other = replace(last, f=last.f + 1.0)
    write_frf(tmp_path / "frf.npz", {one.name: one for one in (*others, other)})
    with np.load(tmp_path / "frf.npz") as file:
        assert set(_table("frf.npz", "array")) == _general(file.files)
