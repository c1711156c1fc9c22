"""`make research ARGS=decomposition`: its statistics, its coupled inputs, and what it finds."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from armimp_bringup.config import ExperimentConfig
from research.decomposition import (
    DecompositionPlan,
    investigate,
    run_decomposition,
)
from research.decomposition_outcomes import Cell
from research.decomposition_statistics import (
    Mean,
)
from research.options import InvestigationOptions

pytestmark = pytest.mark.slow

# Shorter trials, larger steps and fewer seeds than anyone should draw conclusions from.
BASE = ExperimentConfig(duration=16.4, arm_sim={"substeps": 10})
PLAN = DecompositionPlan(
    base=BASE, seeds="0:8", voluntary=(0.0, 0.3), correlations=(0.0, 0.9), coupled_at=0.3
)
Cells = dict[tuple[str, float, float | None], Cell]


@pytest.fixture(scope="module")
def cells() -> Cells:
    found = run_decomposition(PLAN, workers=2)
    return {(cell.estimator, cell.voluntary, cell.correlation): cell for cell in found}


def test_voluntary_torque_biases_the_direct_estimate_of_z(cells: Cells) -> None:
    shift = cells["direct", 0.3, None].octaves_shift
    assert shift is not None
    assert shift.significant
    assert np.max(np.abs(shift.z)) > 1.3 * shift.critical


@pytest.mark.parametrize("name", ["welch_full", "lpm_full"])
def test_voluntary_torque_does_not_bias_estimates_from_the_perturbation(
    cells: Cells, name: str
) -> None:
    shift = cells[name, 0.3, None].octaves_shift
    assert shift is not None
    assert not shift.significant
    assert not cells[name, 0.3, None].biased


def test_independent_inputs_make_mimo_less_uncertain_and_coupled_ones_more(cells: Cells) -> None:
    def low_frequency_spread(cell: Cell) -> float:
        return float(np.sqrt(np.mean(cell.octaves.spread[..., :3] ** 2)))

    alone = low_frequency_spread(cells["welch_full", 0.3, None])
    independent = low_frequency_spread(cells["mimo", 0.3, 0.0])
    coupled = low_frequency_spread(cells["mimo", 0.3, 0.9])
    # With all joints at once each is perturbed twice as long.
    assert independent < 0.95 * alone
    assert coupled > 1.3 * independent


def test_investigation_leaves_tables_and_figures_and_prints_json(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plan = DecompositionPlan(
        base=BASE.model_copy(update={"duration": 10.0}),
        voluntary=(0.0, 0.3),
        correlations=(0.0, 0.5),
    )
    assert investigate(InvestigationOptions(out=tmp_path, seeds="3:5", json=True), plan) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed == json.loads((tmp_path / "decomposition.json").read_text(encoding="utf-8"))
    assert printed["seeds"] == "3:5"
    assert len(printed["cells"]) == 11
    with (tmp_path / "decomposition.csv").open(encoding="utf-8") as file:
        assert len(list(csv.DictReader(file))) == 11 * 12
    for name in ("decomposition", "decomposition_coupling"):
        assert (tmp_path / f"{name}.png").stat().st_size > 10_000
        assert (tmp_path / f"{name}.pdf").stat().st_size > 5_000


def test_chance_alone_is_significant_as_often_as_stated() -> None:
    random = np.random.default_rng(6)
    many = [Mean.of(random.standard_normal((12, 8))).significant for _ in range(2000)]
    # 5 % by Bonferroni; four standard errors are 2 %.
    assert 0.03 < np.mean(many) < 0.07
