"""`make research ARGS=controller`: what it varies, and what it finds."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import pytest

from armimp_bringup.config import ExperimentConfig
from research.controller import (
    GAMMA,
    LOCK,
    REFERENCE,
    WALK,
    ControllerPlan,
    investigate,
    settings,
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
