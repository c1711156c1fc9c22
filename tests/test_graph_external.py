"""Experiments with nodes that others have started, as in containers or by ``ros2 run``."""

import os
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from armimp_bringup.config import ExperimentConfig
from armimp_bringup.graph import external_domain
from armimp_bringup.nodes import NODES
from armimp_bringup.orchestrator import run_experiment
from armimp_common.errors import ConfigurationError
from armimp_common.status import Progress
from armimp_common.topics import CONTROLLER_NODE, ESTIMATOR_NODE, SIM_NODE
from support.runs import FinishedRun

pytestmark = pytest.mark.usefixtures("environment")
Processes = dict[str, subprocess.Popen[bytes]]


@pytest.fixture
def started(start_node: Callable[[str], subprocess.Popen[bytes]]) -> Processes:
    return {name: start_node(name) for name in NODES}


def config(**options: Any) -> ExperimentConfig:
    return ExperimentConfig.model_validate({"duration": 2.0, "processes": "external", **options})


def test_nodes_of_others_run_an_experiment_with_the_usual_result(
    started: Processes, driver_domain: int, tmp_path: Path, composed: FinishedRun
) -> None:
    summary = run_experiment(config(), tmp_path / "out").summary

    assert summary.problems == composed.summary.problems
    assert [trial.lost for trial in summary.trials] == [0, 0]
    FinishedRun(directory=tmp_path / "out", summary=summary).assert_same_streams(composed)
    assert all(process.poll() is None for process in started.values())
    assert os.environ["ROS_DOMAIN_ID"] == str(driver_domain)


@pytest.mark.slow
def test_the_next_experiment_may_have_other_joints(started: Processes, tmp_path: Path) -> None:
    numbers = (2, 1, 3)
    runs = [run_experiment(config(joints=one), tmp_path / f"{one}").summary for one in numbers]
    assert [one.joints for one in runs] == list(numbers)
    assert [trial.lost for one in runs for trial in one.trials] == [0] * 6


@pytest.mark.slow
def test_when_a_node_of_others_is_killed_expect_it_named_and_the_others_left_alone(
    started: Processes, tmp_path: Path
) -> None:
    def kill(progress: Progress) -> None:
        if progress.samples > 1000:
            started[CONTROLLER_NODE].kill()

    summary = run_experiment(config(), tmp_path / "out", on_progress=kill).summary

    assert not summary.valid
    assert summary.problems[0].sentence == f"node {CONTROLLER_NODE} is dead"
    assert started[SIM_NODE].poll() is None
    assert started[ESTIMATOR_NODE].poll() is None


def test_the_domain_of_external_nodes_is_the_given_one_or_that_of_the_environment(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", "7")
    assert (external_domain(3), external_domain(None)) == (3, 7)
    monkeypatch.delenv("ROS_DOMAIN_ID")
    assert external_domain(None) == 0
    monkeypatch.setenv("ROS_DOMAIN_ID", "seven")
    with pytest.raises(ConfigurationError, match="'seven'"):
        external_domain(None)
