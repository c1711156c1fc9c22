"""`make research ARGS=limits`: its ratios, its bounds, and estimators against them."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from armimp_bringup.config import ExperimentConfig
from research.limits import LimitsPlan, investigate, run_limits
from research.limits_statistics import Cell
from research.options import InvestigationOptions

pytestmark = pytest.mark.slow

BASE = ExperimentConfig(arm_sim={"substeps": 20})
PLAN = LimitsPlan(
    base=BASE, levels=((3, 3, 3),), seeds="0:24", estimators=("lpm_full", "welch_siso")
)
SHORT = ExperimentConfig(duration=16.4, arm_sim={"substeps": 10})
Cells = dict[tuple[str, float], Cell]


@pytest.fixture(scope="module")
def cells() -> Cells:
    return {(cell.estimator, cell.voluntary): cell for cell in run_limits(PLAN, workers=2)}


def test_no_estimator_has_a_spread_below_the_bound_by_more_than_chance(cells: Cells) -> None:
    """24 runs, 48 ratios: below 0.5 by chance is beyond one in 10⁵ for each."""
    for cell in cells.values():
        assert (cell.spread_ratio > 0.5).all()
        assert float(np.sqrt(np.mean(cell.spread_ratio**2))) > 1.0


def test_local_polynomials_come_close_to_the_bound_with_voluntary_torque(cells: Cells) -> None:
    assert float(np.sqrt(np.mean(cells["lpm_full", 0.3].ratio ** 2))) < 1.5
    assert cells["lpm_full", 0.3].worst[1] < 2.0


def test_investigation_leaves_tables_and_a_figure(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plan = replace(PLAN, base=SHORT, levels=((3, 3, 3), (0, 0, 3)))
    assert investigate(InvestigationOptions(out=tmp_path, seeds="0:3", workers=2), plan) == 0
    assert "Cramér-Rao" in capsys.readouterr().out
    result = json.loads((tmp_path / "limits.json").read_text(encoding="utf-8"))
    assert [
        (cell["estimator"], cell["voluntary_rms"], cell["friction"]) for cell in result["cells"]
    ] == [
        (name, torque, friction)
        for name in ("lpm_full", "welch_siso")
        for torque in (0.3, 0.0)
        for friction in (3, 0)
    ]
    assert result["cells"][3]["rms_over_bound"] == [[[None, None], [None, None]]] * 3
    with (tmp_path / "limits.csv").open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == 8 * 12
    assert float(rows[0]["rms_over_bound"]) == pytest.approx(
        float(rows[0]["rms_error_percent"]) / float(rows[0]["bound_percent"])
    )
    assert (tmp_path / "limits.png").stat().st_size > 10_000
    assert (tmp_path / "limits.pdf").stat().st_size > 5_000
