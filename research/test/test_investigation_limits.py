"""`make research ARGS=limits`: its ratios, its bounds, and estimators against them."""

from __future__ import annotations

import numpy as np
import pytest

from armimp_bringup.config import ExperimentConfig
from research.limits import LimitsPlan, run_limits
from research.limits_statistics import Cell

pytestmark = pytest.mark.slow

BASE = ExperimentConfig(arm_sim={"substeps": 20})
PLAN = LimitsPlan(
    base=BASE, levels=((3, 3, 3),), seeds="0:24", estimators=("lpm_full", "welch_siso")
)
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
