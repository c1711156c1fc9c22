"""`make research ARGS=limits`: its ratios, its bounds, and estimators against them."""

from __future__ import annotations

import csv
import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from armimp_bringup.config import ExperimentConfig
from research.limits import LimitsPlan, investigate, run_limits
from research.limits_statistics import Cell
from research.limits_tables import in_words
from research.options import InvestigationOptions

pytestmark = pytest.mark.slow

BASE = ExperimentConfig(arm_sim={"substeps": 20})
PLAN = LimitsPlan(
    base=BASE, levels=((3, 3, 3),), seeds="0:24", estimators=("lpm_full", "welch_siso")
)
SHORT = ExperimentConfig(duration=16.4, arm_sim={"substeps": 10})
BAND = (0.122, 15.0)
Cells = dict[tuple[str, float], Cell]


@pytest.fixture(scope="module")
def cells() -> Cells:
    return {(cell.estimator, cell.voluntary): cell for cell in run_limits(PLAN, workers=2)}


def made(errors: Sequence[float], limit: float) -> Cell:
    runs = np.ones((len(errors), 3, 2, 2))
    return Cell(
        levels=(0, 1, 3),
        voluntary=0.3,
        estimator="made",
        errors=np.array(errors)[:, None, None, None] * runs,
        bounds=limit * runs,
    )


def test_no_estimator_has_a_spread_below_the_bound_by_more_than_chance(cells: Cells) -> None:
    """24 runs, 48 ratios: below 0.5 by chance is beyond one in 10⁵ for each."""
    for cell in cells.values():
        assert (cell.spread_ratio > 0.5).all()
        assert float(np.sqrt(np.mean(cell.spread_ratio**2))) > 1.0


def test_local_polynomials_come_close_to_the_bound_with_voluntary_torque(cells: Cells) -> None:
    assert float(np.sqrt(np.mean(cells["lpm_full", 0.3].ratio ** 2))) < 1.5
    assert cells["lpm_full", 0.3].worst[1] < 2.0


def test_cell_tells_bound_rms_spread_and_their_ratios() -> None:
    cell = made((0.01, 0.03, 0.05), 0.01)
    np.testing.assert_allclose(cell.rms, np.sqrt(35.0 / 3.0) * 0.01)
    np.testing.assert_allclose(cell.ratio, np.sqrt(35.0 / 3.0))
    np.testing.assert_allclose(cell.bias, 0.03)
    np.testing.assert_allclose(cell.spread_ratio, 2.0)
    assert cell.elements[:3] == ["M11", "M12", "M21"]


def test_uncertainty_of_the_ratio_is_its_scatter_over_experiments() -> None:
    random = np.random.default_rng(1)
    cells = [made(list(errors), 0.5) for errors in random.standard_normal((300, 64))]
    scatter = np.std([cell.ratio[0, 0, 0] for cell in cells])
    stated = np.mean([cell.uncertainty[0, 0, 0] for cell in cells])
    assert stated == pytest.approx(float(scatter), rel=0.15)


def test_without_a_bound_there_is_no_ratio() -> None:
    cell = made((0.01, 0.02), 0.0)
    assert np.isnan(cell.ratio).all()
    assert in_words([cell]) == ["made, with 0.3 N·m rms: no noise, so there is no bound."]


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
