"""The studies: what they find with few seeds, and what they leave behind."""

import csv
import json
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from armimp_bringup.config import ExperimentConfig
from armimp_estimation.estimators.lpm import LpmFull
from armimp_estimation.fit import fit_mbk
from armimp_estimation.trial import TrialData
from research import controller, coverage, decomposition, growth, limits
from research.__main__ import main
from research.controller import GAMMA
from research.coverage_statistics import QUANTILE, Share
from research.cramer_rao import SensorNoise, cramer_rao_bound, error_covariance, motion_in_band
from research.decomposition_statistics import Mean
from research.decomposition_trials import matrices
from research.options import InvestigationOptions
from support.synthetic_trials import TWO_JOINT_ARM, SyntheticConfig, synthetic_trial

pytestmark = pytest.mark.slow

# Shorter trials, larger steps and fewer seeds than anyone should draw conclusions from.
SHORT = ExperimentConfig(duration=16.4, arm_sim={"substeps": 10})
BASE = ExperimentConfig(arm_sim={"substeps": 20})
REALISTIC = ((3, 3, 3),)


@pytest.mark.parametrize(
    ("study", "plan", "rows"),
    [
        (
            coverage,
            coverage.CoveragePlan(base=SHORT, levels=REALISTIC, voluntary=(0.3, 0.0)),
            4 * 12,
        ),
        (limits, limits.LimitsPlan(base=SHORT, levels=REALISTIC), 4 * 12),
        (growth, growth.GrowthPlan(base=SHORT, joints=(2,)), 3),
        (
            decomposition,
            decomposition.DecompositionPlan(
                base=SHORT, voluntary=(0.0, 0.3), correlations=(0.0, 0.5)
            ),
            11 * 12,
        ),
        (
            controller,
            controller.ControllerPlan(base=SHORT, levels=REALISTIC, values={GAMMA: (100.0,)}),
            2,
        ),
    ],
)
def test_a_study_leaves_tables_and_a_figure_and_prints_json(
    study: ModuleType, plan: Any, rows: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    name = study.__name__.rpartition(".")[2]
    options = InvestigationOptions(out=tmp_path, seeds="0:3", workers=2, json=True)
    assert study.investigate(options, plan) == 0
    result = json.loads((tmp_path / f"{name}.json").read_text(encoding="utf-8"))
    assert result["seeds"] == "0:3"
    assert json.loads(capsys.readouterr().out) == result
    with (tmp_path / f"{name}.csv").open(encoding="utf-8", newline="") as stream:
        assert len(list(csv.DictReader(stream))) >= rows
    for figure in tmp_path.glob("*.p[nd][gf]"):
        assert figure.stat().st_size > 5_000
    assert {path.suffix for path in tmp_path.iterdir()} == {".json", ".csv", ".png", ".pdf"}


@pytest.mark.parametrize("use", [("limits", "--only", "x"), ("ideal", "--json")])
def test_an_option_that_a_study_does_not_have_is_refused(
    use: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(use) == 2
    assert capsys.readouterr().err.startswith(f"armimp: {use[1]}: {use[0]} ")


def test_intervals_of_local_polynomials_hold_the_truth_as_often_as_they_say() -> None:
    """48 experiments of 12 parameters, against 92 to 98 % by the 95 % interval of the share."""
    plan = coverage.CoveragePlan(base=BASE, levels=REALISTIC, seeds="0:48", voluntary=(0.3,))
    cells = coverage.run_coverage(plan, workers=2)
    covered = next(cell for cell in cells if cell.estimator == "lpm_full")
    assert covered.pooled.verdict in {"within", "below, within chance", "above, within chance"}
    assert replace(covered, stated=0.6 * np.std(covered.errors, axis=0)).pooled.verdict == "below"


def test_pooled_intervals_hold_the_share_in_95_of_100_experiments() -> None:
    """With errors that are correlated within a run; 400 repetitions, 4 standard deviations."""
    random = np.random.default_rng(5)
    held = []
    for _ in range(400):
        common, own = random.standard_normal((200, 1)), random.standard_normal((200, 12))
        share = Share.of(np.abs(np.sqrt(0.4) * common + np.sqrt(0.6) * own) < QUANTILE)
        held.append(share.lower <= 0.95 <= share.upper)
    assert np.mean(held) == pytest.approx(0.95, abs=4.0 * np.sqrt(0.95 * 0.05 / 400))


def test_chance_alone_is_significant_as_often_as_stated() -> None:
    random = np.random.default_rng(6)
    many = [Mean.of(random.standard_normal((12, 8))).significant for _ in range(2000)]
    # 5 % by Bonferroni; four standard errors are 2 %.
    assert 0.03 < np.mean(many) < 0.07


def test_errors_by_white_noise_of_torques_are_close_to_the_bound() -> None:
    noise, config = SensorNoise(angle=0.0, torque=0.2), SyntheticConfig(torque_noise=0.2)
    over = []
    for seed in range(24):
        records = [synthetic_trial(TWO_JOINT_ARM, k, config, 2 * seed + k) for k in range(2)]
        f, motion = motion_in_band(records)
        covariance = error_covariance(TWO_JOINT_ARM, f, config.samples, noise)
        fit = fit_mbk(LpmFull().estimate([TrialData.of(one) for one in records]))
        error = matrices(fit.mbk) - matrices(TWO_JOINT_ARM)
        over.append(error / cramer_rao_bound(f, motion, covariance))
    assert 0.95 < np.sqrt(np.mean(np.square(over))) < 1.2
