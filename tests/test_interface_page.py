"""The tables of docs/interfaces.md which are written by hand say what the code does."""

import json
import re
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rclpy.qos import HistoryPolicy

from armimp_bringup.config import ExperimentConfig
from armimp_bringup.parameters import bag_metadata, node_parameters
from armimp_common import qos
from armimp_common.status import values_of
from armimp_common.topics import TOPICS
from armimp_estimation.bags.reader import read_bag
from armimp_estimation.estimators.registry import ESTIMATORS
from armimp_estimation.metadata import READING_KEYS
from armimp_estimation.node import column_message, result_message
from armimp_estimation.result import Result, load_result
from armimp_estimation.summary import write_frf
from support.pages import markdown_tables
from support.places import ROOT
from support.results import make_result

DOCS = ROOT / "docs"
PAGE = (DOCS / "interfaces.md").read_text(encoding="utf-8")

TABLES = markdown_tables(PAGE)


def _table(heading: str, column: str, place: int = 0) -> dict[str, dict[str, str]]:
    """Rows of one table under a heading, by their first cell without backticks."""
    rows = TABLES[heading][place]
    names = [row[column].strip("`") for row in rows]
    assert len(set(names)) == len(names), f"{heading}: named twice"
    return dict(zip(names, rows, strict=True))


def _keys(heading: str, place: int = 0) -> set[str]:
    return set(_table(heading, "key", place))


def test_the_topics_of_the_page_are_those_of_the_contract() -> None:
    assert set(_table("Topics", "topic")) == set(TOPICS) == set(qos.PROFILES)
    assert {profile.history for profile in qos.PROFILES.values()} == {HistoryPolicy.KEEP_LAST}


@pytest.fixture(scope="module")
def directory(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A result of every estimator."""
    return make_result(tmp_path_factory.mktemp("result"), estimators=[*ESTIMATORS])


@pytest.fixture(scope="module")
def result(directory: Path) -> Result:
    return load_result(directory)


def _general(keys: Iterable[str]) -> set[str]:
    """Keys as the page writes them: for any estimator and any element."""
    for name in ESTIMATORS:
        keys = [re.sub(rf"(^|_){name}(\.|$)", r"\1ESTIMATOR\2", key) for key in keys]
    return {re.sub(r"_[12][12]\.", "_IK.", key) for key in keys}


def test_the_keys_of_column_and_conclusion_are_those_of_the_code(
    directory: Path, result: Result
) -> None:
    (trial, _) = read_bag(directory / "bags" / "session").trials
    column, conclusion = column_message(trial), result_message(result)
    assert _keys("Column") == _general(values_of(column))
    assert _keys("Conclusion") == _general(values_of(conclusion))
    assert column.name.replace("1", "K") in PAGE
    assert f"`{conclusion.name}`" in PAGE


def test_the_metadata_keys_of_the_page_are_those_that_a_run_stores() -> None:
    torque = {"sensors.torque.delay": 0.0002, "sensors.torque.cutoff": 900.0}
    config = ExperimentConfig.model_validate({"rig": "realistic", "arm_sim": torque})
    parameters = node_parameters(config, None)
    stored = bag_metadata(config, parameters.simulator, parameters.controller)
    rows = _table("Bags", "key")
    assert set(rows) | _keys("Bags", 1) == set(stored)
    assert all(f"`{part}`" in rows["config"]["value"] for part in json.loads(stored["config"]))
    assert _keys("Bags", 1) == set(READING_KEYS) - {"torque_timing", "torque_uncertainty"}


def test_the_arrays_of_frf_npz_are_those_that_are_written(result: Result, tmp_path: Path) -> None:
    *others, last = result.curves.values()
    other = replace(last, f=last.f + 1.0)
    write_frf(tmp_path / "frf.npz", {one.name: one for one in (*others, other)})
    with np.load(tmp_path / "frf.npz") as file:
        assert set(_table("frf.npz", "array")) == _general(file.files)
