"""`make research ARGS=growth`: what it counts, and what it finds for two and three joints."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from armimp_bringup.config import ExperimentConfig
from research.growth import GrowthPlan, investigate, run_growth
from research.growth_outcomes import Cell, Outcome
from research.options import InvestigationOptions

pytestmark = pytest.mark.slow

BASE = ExperimentConfig(duration=16.4, arm_sim={"substeps": 10})
PLAN = GrowthPlan(base=BASE, joints=(2, 3), seeds="0:4", voluntary=(0.0, 0.05))
Cells = dict[tuple[int, float, str], Cell]


@pytest.fixture(scope="module")
def cells() -> Cells:
    found = run_growth(PLAN, workers=2)
    return {(cell.joints, cell.voluntary, cell.estimator): cell for cell in found}


def test_responses_at_once_are_linear_joint_by_joint_and_quadratic_all_at_once(
    cells: Cells,
) -> None:
    assert [cells[n, 0.0, "lpm_full"].responses for n in (2, 3)] == [4, 6]
    assert [cells[n, 0.0, "mimo"].responses for n in (2, 3)] == [8, 18]


@pytest.mark.parametrize("joints", [2, 3])
def test_local_polynomials_have_the_least_bias(cells: Cells, joints: int) -> None:
    best = cells[joints, 0.0, "lpm_full"]
    assert best.worst_vaf > 99.9
    for name in ("welch_siso", "mimo"):
        assert (best.bias < cells[joints, 0.0, name].bias).all()


def _outcomes(errors: Sequence[float], samples: int) -> list[Outcome]:
    return [
        Outcome(
            joints=1,
            voluntary=0.0,
            estimator="made",
            samples=samples,
            errors=np.full((3, 1, 1), error),
            relative=np.full((3, 1, 1), 2.0 * error),
            vaf=np.array([[99.0 + error]]),
            seconds=abs(error),
        )
        for error in errors
    ]


def test_cell_tells_bias_spread_exponent_and_the_record_that_is_needed() -> None:
    # Spread of 0.02 about 0.03, and 0.04 in the first halves.
    whole, half = _outcomes((0.01, 0.03, 0.05), 50_000), _outcomes((-0.01, 0.03, 0.07), 25_000)
    cell = Cell.of(whole, half, target=0.01)
    np.testing.assert_allclose(cell.bias, 0.03)
    np.testing.assert_allclose(cell.spread, 0.02)
    np.testing.assert_allclose(cell.exponent, 1.0)
    np.testing.assert_allclose(cell.worst, 0.05)
    np.testing.assert_allclose(cell.worst_relative, 0.1)
    assert cell.duration == pytest.approx(50.0)
    assert cell.needed == pytest.approx(200.0)
    assert cell.seconds == pytest.approx(0.03)
    assert cell.worst_vaf == pytest.approx(99.01)


def test_investigation_leaves_tables_and_a_figure(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plan = GrowthPlan(base=BASE, joints=(2,), voluntary=(0.0,))
    assert investigate(InvestigationOptions(out=tmp_path, seeds="0:2"), plan) == 0
    assert "mimo" in capsys.readouterr().out
    result = json.loads((tmp_path / "growth.json").read_text(encoding="utf-8"))
    assert [cell["estimator"] for cell in result["cells"]] == ["welch_siso", "lpm_full", "mimo"]
    assert result["seeds"] == "0:2"
    assert len((tmp_path / "growth.csv").read_text(encoding="utf-8").splitlines()) == 4
    assert (tmp_path / "growth.png").stat().st_size > 10_000
    assert (tmp_path / "growth.pdf").stat().st_size > 5_000
