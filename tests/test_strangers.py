"""What somebody else in the same domain can do to an experiment: end it, never spoil its result."""

from __future__ import annotations

from itertools import cycle
from pathlib import Path
from typing import Any

import pytest
import yaml
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient

from armimp_bringup import orchestrator
from armimp_bringup.config import ExperimentConfig
from armimp_bringup.orchestrator import PARAMETERS_FILE, run_experiment
from armimp_common import topics
from armimp_common.lifecycle import LifecycleManager
from armimp_estimation.problems import ProblemCode
from support.graph import PATIENCE
from support.strangers import ACTS, BASE, MOMENTS, disturbed

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("environment")]


@pytest.mark.parametrize(
    ("kind", "processes", "who"),
    [
        ("zero command", "composed", "/stranger"),
        ("zero command, leaves", "composed", "/imbic_controller"),
        ("wrong numbers", "separate", "/stranger"),
    ],
)
def test_one_command_of_somebody_else_is_a_fault_with_who_and_when(
    tmp_path: Path, kind: str, processes: str, who: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    if who == "/stranger":
        # Its name may be long on its way where the machine is busy.
        monkeypatch.setattr("armimp_common.driver_base._NAMES_PATIENCE", PATIENCE)
    summary = disturbed(kind, tmp_path / "out", processes=processes)
    assert not summary.valid
    faults = [one.values for one in summary.problems if one.code is ProblemCode.NODE_FAULT]
    (fault,) = [str(one["reason"]) for one in faults if one["source"] == "arm_sim: rig"]
    assert topics.COMMANDS in fault
    when, _, publishers = fault.partition("; published by ")
    assert when.endswith(" s")
    assert who in publishers.split(", ")


def test_a_status_that_ends_a_trial_early_is_refused_and_spoils_the_result(tmp_path: Path) -> None:
    summary = disturbed("shorter trial", tmp_path / "out")
    assert not summary.valid
    assert [trial.ticks for trial in summary.trials] == [2000, 2000]
    assert any(
        one.code is ProblemCode.MESSAGE_REFUSED and "ends after 1500 samples" in one.sentence
        for one in summary.problems
    )


def test_a_judgement_that_nobody_asked_for_ends_no_trial(tmp_path: Path) -> None:
    summary = disturbed("decision", tmp_path / "out")
    assert [trial.ticks for trial in summary.trials] == [2000, 2000]


def test_a_parameter_that_somebody_else_has_set_is_named_and_no_trial_begins(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    gain = Parameter("sensors.torque.gain", value=[1.3, 1.3])

    class Disturbed(LifecycleManager):
        def change(self, name: str, transition: Any) -> None:
            if (name, transition) == (topics.SIM_NODE, "configure"):
                client = AsyncParameterClient(self._node, name)
                assert self._spin_until(client.set_parameters([gain]), PATIENCE)
            super().change(name, transition)

    monkeypatch.setattr(orchestrator, "LifecycleManager", Disturbed)
    config, out = ExperimentConfig.model_validate(BASE), tmp_path / "out"
    summary = run_experiment(config, out).summary
    different = summary.problems[0]
    assert different.code is ProblemCode.PARAMETERS_DIFFER
    assert different.sentence.startswith("arm_sim: sensors.torque.gain is [1.3, 1.3], not ")
    assert not summary.trials
    active = yaml.safe_load((out / PARAMETERS_FILE).read_text(encoding="utf-8"))
    assert active["arm_sim"]["ros__parameters"]["sensors.torque.gain"] == [1.3, 1.3]


@pytest.mark.timeout(1800)
def test_whatever_a_stranger_does_a_valid_result_is_that_of_the_undisturbed_run(
    tmp_path: Path,
) -> None:
    config = ExperimentConfig.model_validate(BASE)
    reference = run_experiment(config, tmp_path / "reference").summary
    assert reference.valid
    valid = 0
    for kind, moment in zip(ACTS, cycle(MOMENTS), strict=False):
        summary = disturbed(kind, tmp_path / kind.replace("/", " "), moment)
        valid += summary.valid
        if summary.valid:
            assert summary.estimators == reference.estimators, kind
        else:
            assert summary.faults, kind
    assert 0 < valid < len(ACTS)
