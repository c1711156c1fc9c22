"""`make research ARGS=coverage`: its statistics, and honest standard errors of a fixed set."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from armimp_bringup.config import ExperimentConfig
from research.coverage import CoveragePlan, run_coverage
from research.coverage_statistics import QUANTILE, Cell, Share

pytestmark = pytest.mark.slow

BASE = ExperimentConfig(arm_sim={"substeps": 20})
PLAN = CoveragePlan(base=BASE, levels=((3, 3, 3),), seeds="0:48", voluntary=(0.3, 0.0))
Cells = dict[tuple[str, float], Cell]


@pytest.fixture(scope="module")
def cells() -> Cells:
    return {(cell.estimator, cell.voluntary): cell for cell in run_coverage(PLAN, workers=2)}


def test_intervals_of_local_polynomials_hold_the_truth_as_often_as_they_say(cells: Cells) -> None:
    """48 experiments of 12 parameters, against 92 to 98 % by the 95 % interval of the share."""
    cell = cells["lpm_full", 0.3]
    assert cell.pooled.verdict in {"within", "below, within chance", "above, within chance"}


def test_standard_errors_that_are_a_third_too_small_are_noticed(cells: Cells) -> None:
    cell = cells["lpm_full", 0.3]
    assert replace(cell, stated=0.67 * cell.stated).pooled.verdict == "below"


def test_shares_are_those_of_their_elements() -> None:
    errors = np.zeros((4, 3, 2, 2))
    errors[:3, 1, 0, 1] = -1.01 * QUANTILE
    cell = Cell(
        levels=(3, 3, 3),
        voluntary=0.3,
        estimator="made",
        errors=errors,
        stated=np.ones(errors.shape),
    )
    assert cell.by_element["B12"].value == pytest.approx(0.25)
    assert cell.by_element["B21"].value == 1.0
    assert [share.value for share in cell.by_letter] == [1.0, pytest.approx(13 / 16), 1.0]
    assert cell.pooled.value == pytest.approx(45 / 48)


def test_pooled_intervals_hold_the_share_in_95_of_100_experiments() -> None:
    """With errors that are correlated within a run; 400 repetitions, 4 standard deviations."""
    random = np.random.default_rng(5)
    held = []
    for _ in range(400):
        common, own = random.standard_normal((200, 1)), random.standard_normal((200, 12))
        share = Share.of(np.abs(np.sqrt(0.4) * common + np.sqrt(0.6) * own) < QUANTILE)
        held.append(share.lower <= 0.95 <= share.upper)
    assert np.mean(held) == pytest.approx(0.95, abs=4.0 * np.sqrt(0.95 * 0.05 / 400))
