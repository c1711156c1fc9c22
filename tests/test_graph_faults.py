"""Experiments that never begin: interrupted, misconfigured, or without room for output."""

import re
from pathlib import Path
from typing import Any

import pytest

from armimp_bringup import orchestrator
from armimp_bringup.config import ExperimentConfig
from armimp_bringup.orchestrator import run_experiment
from armimp_common.errors import ConfigurationError
from armimp_common.lifecycle import LifecycleManager, TransitionName
from armimp_common.schema import to_params_yaml
from armimp_common.status import Phase
from armimp_common.topics import CONTROLLER_NODE, SIM_NODE
from armimp_estimation.problems import ProblemCode
from armimp_estimation.summary import read_summary

CONFIG = ExperimentConfig(duration=3.0)
pytestmark = pytest.mark.usefixtures("environment")


@pytest.mark.slow
@pytest.mark.parametrize("asked", [0, 3, 30])
def test_when_interrupted_before_the_rig_is_active_expect_no_trial_begun(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, asked: int
) -> None:
    active: list[str] = []
    questions: list[None] = []
    phases: list[Phase] = []
    change = LifecycleManager.change

    def noted(manager: LifecycleManager, name: str, transition: TransitionName) -> None:
        active.extend([name] if transition == "activate" else [])
        change(manager, name, transition)

    def interrupted() -> bool:
        questions.append(None)
        # At the latest when all but the rig, which is the last one, are active.
        return len(questions) > asked or CONTROLLER_NODE in active

    monkeypatch.setattr(LifecycleManager, "change", noted)
    summary = run_experiment(
        CONFIG, tmp_path / "out", interrupted=interrupted, on_phase=phases.append
    ).summary

    assert not summary.valid
    assert summary.problems[0].code is ProblemCode.INTERRUPTED
    assert read_summary(tmp_path / "out" / "summary.json") == summary
    assert summary.estimators == {}
    assert SIM_NODE not in active
    assert Phase.SETTLE not in phases


@pytest.mark.slow
def test_when_a_node_refuses_its_configuration_expect_it_named_and_no_trial(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # The orchestrator checks all parameters beforehand: spoil the file which it writes.
    def spoiled(models: Any) -> str:
        return re.sub(r"peak: .*", "peak: [1.0]", to_params_yaml(models))

    monkeypatch.setattr(orchestrator, "to_params_yaml", spoiled)

    summary = run_experiment(CONFIG, tmp_path / "out").summary

    assert not summary.valid
    assert summary.problems[0].code is ProblemCode.NODE_FAILED
    assert CONTROLLER_NODE in summary.problems[0].sentence
    assert summary.trials == []
    assert not (tmp_path / "out" / "bags").exists()


def test_when_the_output_is_not_empty_expect_a_refusal_before_anything_starts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(orchestrator, "GraphContext", None)
    (tmp_path / "precious").write_text("data")

    with pytest.raises(ConfigurationError, match="is not empty, nothing is overwritten"):
        run_experiment(CONFIG, tmp_path)

    assert [path.name for path in tmp_path.iterdir()] == ["precious"]
