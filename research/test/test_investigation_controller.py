"""`make research ARGS=controller`: what it varies, and what it finds."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from armimp_bringup.config import ExperimentConfig
from armimp_bringup.parameters import node_parameters
from armimp_common.errors import ConfigurationError
from research.controller import (
    GAMMA,
    LOCK,
    REFERENCE,
    WALK,
    ControllerPlan,
    changed,
    investigate,
    settings,
    worst,
)
from research.options import InvestigationOptions

pytestmark = pytest.mark.slow

# Shorter trials, larger steps and fewer seeds than anyone should draw conclusions from.
BASE = ExperimentConfig(internal_model="observer", duration=16.4, arm_sim={"substeps": 10})
PLAN = ControllerPlan(
    base=BASE,
    seeds="0:1",
    levels=((3, 3, 3),),
    values={WALK: (0.1, 1.0), GAMMA: (100.0, 5000.0), LOCK: (50.0,)},
)


def test_each_setting_changes_its_parameter_and_no_other() -> None:
    default = node_parameters(BASE, None).controller
    for name, value in settings(PLAN)[1:]:
        found = (
            node_parameters(changed(BASE, (name, value)), None).controller
            if value < 5000.0
            else None
        )
        if found is None:
            continue
        factor = value if name == WALK else 1.0
        assert found.law.perturbed_walk == pytest.approx(
            np.multiply(factor, default.law.perturbed_walk)
        )
        assert found.law.gamma == (value if name == GAMMA else default.law.gamma)
        expected = value if name == LOCK else default.target.lock_frequency
        assert found.target.lock_frequency == expected
    assert changed(BASE, settings(PLAN)[0]).internal_model == "tde"
    with pytest.raises(ConfigurationError, match="cannot vary 'speed', only walk, gamma, lock"):
        changed(BASE, ("speed", 1.0))


def test_the_worst_of_seeds_is_the_least_score_and_the_largest_of_all_else() -> None:
    rows = [{"a_vaf": 99.0, "a_B": 1.0, "step": 3.0}, {"a_vaf": 98.0, "a_B": 2.0, "step": 1.0}]
    assert worst(rows) == {"a_vaf": 98.0, "a_B": 2.0, "step": 3.0}


def test_what_is_found_is_written_drawn_and_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert investigate(InvestigationOptions(out=tmp_path), PLAN) == 0
    printed = capsys.readouterr().out
    assert "refused: gamma 5000: " in printed
    rows = json.loads((tmp_path / "controller.json").read_text(encoding="utf-8"))["rows"]
    found = {(row["parameter"], row["value"]): row for row in rows}
    assert list(found) == settings(PLAN)
    reference, default = found[REFERENCE, 0.0], found[GAMMA, 100.0]
    assert reference["command_step"] > 15.0 * default["command_step"]
    assert reference["torque_step"] > 15.0 * default["torque_step"]
    # Defaults are what they are, whichever parameter is set to them.
    same = {
        name: value
        for name, value in found[WALK, 1.0].items()
        if name not in {"parameter", "value"}
    }
    assert same.items() <= default.items()
    assert found[WALK, 0.1]["command_step"] < default["command_step"]
    assert found[WALK, 0.1]["bias_bound"] > default["bias_bound"]
    assert found[LOCK, 50.0]["bias_bound"] > default["bias_bound"]
    with (tmp_path / "controller.csv").open(encoding="utf-8", newline="") as file:
        assert len(list(csv.DictReader(file))) == len(rows) - 1
    assert (tmp_path / "controller.png").stat().st_size > 10_000
