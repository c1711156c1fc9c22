"""`make research ARGS=growth`: what it counts, and what it finds for two and three joints."""

from __future__ import annotations

import pytest

from armimp_bringup.config import ExperimentConfig
from research.growth import GrowthPlan, run_growth
from research.growth_outcomes import Cell

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
