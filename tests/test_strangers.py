"""What somebody else in the same domain can do to an experiment: end it, never spoil its result."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

from armimp_bringup.config import ExperimentConfig
from armimp_bringup.orchestrator import PARAMETERS_FILE, run_experiment
from armimp_common import topics
from armimp_estimation.problems import ProblemCode
from armimp_estimation.summary import Summary
from support.graph import PATIENCE
from support.strangers import BASE, Case, cases, disturbed, judged

SEED = 1
pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("environment")]


def after(kind: str, directory: Path, moment: str = "during", **options: Any) -> Summary:
    """Run an experiment in which a stranger has done this."""
    summary, delivered = disturbed(Case(kind, moment, 1, tuple(options.items())), directory)
    assert delivered
    return summary


@pytest.mark.parametrize(
    ("kind", "processes", "who"),
    [
        ("zero command", "composed", "/stranger"),
        ("zero command", "separate", "/stranger"),
        ("zero command, leaves", "composed", "/imbic_controller"),
        ("wrong numbers", "composed", "/stranger"),
        ("wrong numbers", "separate", "/stranger"),
    ],
)
def test_one_command_of_somebody_else_is_a_fault_with_who_and_when(
    tmp_path: Path, kind: str, processes: str, who: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    if who == "/stranger":
        # Its name may be long on its way where the machine is busy.
        monkeypatch.setattr("armimp_common.driver_base._NAMES_PATIENCE", PATIENCE)
    summary = after(kind, tmp_path / "out", processes=processes)
    assert not summary.valid
    faults = [one.values for one in summary.problems if one.code is ProblemCode.NODE_FAULT]
    (fault,) = [str(one["reason"]) for one in faults if one["source"] == "arm_sim: rig"]
    assert topics.COMMANDS in fault
    when, _, publishers = fault.partition("; published by ")
    assert when.endswith(" s")
    assert who in publishers.split(", ")


def test_a_status_that_ends_a_trial_early_is_refused_and_spoils_the_result(tmp_path: Path) -> None:
    summary = after("shorter trial", tmp_path / "out")
    assert not summary.valid
    assert [trial.ticks for trial in summary.trials] == [2000, 2000]
    assert any(
        one.code is ProblemCode.MESSAGE_REFUSED and "ends after 1500 samples" in one.sentence
        for one in summary.problems
    )


def test_a_judgement_that_nobody_asked_for_ends_no_trial(tmp_path: Path) -> None:
    summary = after("decision", tmp_path / "out")
    assert [trial.ticks for trial in summary.trials] == [2000, 2000]


def test_a_parameter_that_somebody_else_has_set_is_named_and_no_trial_begins(
    tmp_path: Path,
) -> None:
    out = tmp_path / "out"
    summary = after("torque gain", out, "configure")
    different = summary.problems[0]
    assert different.code is ProblemCode.PARAMETERS_DIFFER
    assert different.sentence.startswith("arm_sim: sensors.torque.gain is [1.3, 1.3], not ")
    assert not summary.trials
    active = yaml.safe_load((out / PARAMETERS_FILE).read_text(encoding="utf-8"))
    assert active["arm_sim"]["ros__parameters"]["sensors.torque.gain"] == [1.3, 1.3]


@pytest.mark.timeout(1800)
@pytest.mark.parametrize("options", [{}, {"processes": "separate"}], ids=["composed", "separate"])
def test_whatever_a_stranger_does_a_valid_result_is_that_of_the_undisturbed_run(
    tmp_path: Path, options: dict[str, str]
) -> None:
    reference = run_experiment(
        ExperimentConfig.model_validate(BASE), tmp_path / "reference"
    ).summary
    assert reference.valid
    given = tuple(options.items())
    found = [
        judged(Case(one.kind, one.moment, one.seed, given), reference, tmp_path / f"{number}")
        for number, one in enumerate(cases(SEED))
    ]
    assert {one.verdict for one in found} <= {"same", "refused", "not delivered"}, [
        one for one in found if one.verdict in ("wrong", "silent", "traceback")
    ]
    assert max(one.seconds for one in found) < 60.0
    assert {one.verdict for one in found} >= {"same", "refused"}
