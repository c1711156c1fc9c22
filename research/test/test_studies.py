"""The studies: what they find with few seeds, what they leave behind, and what they refuse."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from armimp_bringup.config import ExperimentConfig
from armimp_sim.voluntary import VoluntaryParameters, voluntary_torque
from research import controller, coverage, decomposition, efficiency, growth, limits
from research.__main__ import main
from research.coverage_statistics import QUANTILE, Share
from research.coverage_statistics import Cell as CoverageCell
from research.decomposition_outcomes import Cell as DecompositionCell
from research.decomposition_statistics import Mean
from research.limits_statistics import Cell as LimitsCell
from research.options import InvestigationOptions

pytestmark = pytest.mark.slow

# Shorter trials, larger steps and fewer seeds than anyone should draw conclusions from.
SHORT = ExperimentConfig(duration=16.4, arm_sim={"substeps": 10})
BASE = ExperimentConfig(arm_sim={"substeps": 20})
REALISTIC = ((3, 3, 3),)


# --- The command --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "quoted"),
    [
        (["nothing"], "'nothing'"),
        (["coverage", "--workers", "0"], "got 0"),
        (["coverage", "--seeds", "0:5:0"], "'0:5:0'"),
    ],
)
def test_wrong_usage_is_named_and_leaves_no_directory(
    arguments: list[str], quoted: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*arguments, "--out", str(tmp_path / "new")]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert quoted in line
    assert not list(tmp_path.iterdir())


def test_nothing_is_overwritten(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "thesis.tex").write_text("ten years of work")
    assert main(["limits", "--out", str(tmp_path)]) == 2
    assert "is not empty" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]


def rows_of(directory: Path, study: str) -> list[dict[str, str]]:
    with (directory / f"{study}.csv").open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


@pytest.mark.parametrize(
    ("name", "investigate", "plan", "rows"),
    [
        (
            "coverage",
            coverage.investigate,
            coverage.CoveragePlan(base=SHORT, levels=REALISTIC, voluntary=(0.3, 0.0)),
            4 * 12,
        ),
        ("limits", limits.investigate, limits.LimitsPlan(base=SHORT, levels=REALISTIC), 4 * 12),
        ("growth", growth.investigate, growth.GrowthPlan(base=SHORT, joints=(2,)), 3),
        (
            "decomposition",
            decomposition.investigate,
            decomposition.DecompositionPlan(
                base=SHORT, voluntary=(0.0, 0.3), correlations=(0.0, 0.5)
            ),
            11 * 12,
        ),
    ],
)
def test_a_study_leaves_tables_and_a_figure_and_prints_json(
    name: str,
    investigate: Callable[..., int],
    plan: Any,
    rows: int,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    options = InvestigationOptions(out=tmp_path, seeds="0:3", workers=2, json=True)
    assert investigate(options, plan) == 0
    result = json.loads((tmp_path / f"{name}.json").read_text(encoding="utf-8"))
    assert result["seeds"] == "0:3"
    assert json.loads(capsys.readouterr().out) == result
    assert len(rows_of(tmp_path, name)) >= rows
    for figure in tmp_path.glob("*.p[nd][gf]"):
        assert figure.stat().st_size > 5_000
    assert {path.suffix for path in tmp_path.iterdir()} == {".json", ".csv", ".png", ".pdf"}


# --- Coverage: whether standard errors are honest -----------------------------------------------


@pytest.fixture(scope="module")
def covered() -> CoverageCell:
    plan = coverage.CoveragePlan(base=BASE, levels=REALISTIC, seeds="0:48", voluntary=(0.3,))
    cells = coverage.run_coverage(plan, workers=2)
    return next(cell for cell in cells if cell.estimator == "lpm_full")


def test_intervals_of_local_polynomials_hold_the_truth_as_often_as_they_say(
    covered: CoverageCell,
) -> None:
    """48 experiments of 12 parameters, against 92 to 98 % by the 95 % interval of the share."""
    assert covered.pooled.verdict in {"within", "below, within chance", "above, within chance"}
    assert replace(covered, stated=0.67 * covered.stated).pooled.verdict == "below"


def test_pooled_intervals_hold_the_share_in_95_of_100_experiments() -> None:
    """With errors that are correlated within a run; 400 repetitions, 4 standard deviations."""
    random = np.random.default_rng(5)
    held = []
    for _ in range(400):
        common, own = random.standard_normal((200, 1)), random.standard_normal((200, 12))
        share = Share.of(np.abs(np.sqrt(0.4) * common + np.sqrt(0.6) * own) < QUANTILE)
        held.append(share.lower <= 0.95 <= share.upper)
    assert np.mean(held) == pytest.approx(0.95, abs=4.0 * np.sqrt(0.95 * 0.05 / 400))


# --- Limits: how far estimators are from the accuracy that noise allows -------------------------


def test_no_estimator_beats_the_bound_and_local_polynomials_come_close_to_it() -> None:
    """24 runs, 48 ratios: below 0.5 by chance is beyond one in 10⁵ for each."""
    plan = limits.LimitsPlan(
        base=BASE, levels=REALISTIC, seeds="0:24", estimators=("lpm_full", "welch_siso")
    )
    cells: dict[tuple[str, float], LimitsCell] = {
        (cell.estimator, cell.voluntary): cell for cell in limits.run_limits(plan, workers=2)
    }
    for cell in cells.values():
        assert (cell.spread_ratio > 0.5).all()
        assert float(np.sqrt(np.mean(cell.spread_ratio**2))) > 1.0
    assert float(np.sqrt(np.mean(cells["lpm_full", 0.3].ratio ** 2))) < 1.5
    assert cells["lpm_full", 0.3].worst[1] < 2.0


def test_power_of_voluntary_torque_is_that_of_a_long_stream() -> None:
    config, samples = VoluntaryParameters(rms=0.3, cutoff=2.0), 400_000
    torque = voluntary_torque(config, joints=2, seed=4).take(samples)
    periodogram = np.mean(np.abs(np.fft.rfft(torque, axis=0)) ** 2, axis=1) / samples
    f = np.arange(samples // 2 + 1, dtype=np.float64) / (samples * 1e-3)
    for low, high in ((0.1, 1.0), (1.0, 2.0), (2.0, 4.0), (4.0, 8.0)):
        band = (f >= low) & (f < high)
        # Chi squared with two degrees of freedom for each bin and joint; 4 standard deviations.
        tolerance = 4.0 / np.sqrt(2.0 * np.count_nonzero(band))
        expected = np.mean(limits.power_spectrum(config, f[band]))
        assert np.mean(periodogram[band]) == pytest.approx(expected, rel=tolerance)


# --- Decomposition: what it buys ----------------------------------------------------------------


Decomposed = dict[tuple[str, float, float | None], DecompositionCell]


@pytest.fixture(scope="module")
def decomposed() -> Decomposed:
    plan = decomposition.DecompositionPlan(
        base=SHORT, seeds="0:8", voluntary=(0.0, 0.3), correlations=(0.0, 0.9), coupled_at=0.3
    )
    found = decomposition.run_decomposition(plan, workers=2)
    return {(cell.estimator, cell.voluntary, cell.correlation): cell for cell in found}


@pytest.mark.parametrize(
    ("name", "biased"), [("direct", True), ("welch_full", False), ("lpm_full", False)]
)
def test_voluntary_torque_biases_the_direct_estimate_and_none_from_the_perturbation(
    decomposed: Decomposed, name: str, biased: bool
) -> None:
    shift = decomposed[name, 0.3, None].octaves_shift
    assert shift is not None
    assert bool(shift.significant) is biased
    if biased:
        assert np.max(np.abs(shift.z)) > 1.3 * shift.critical
    else:
        assert not decomposed[name, 0.3, None].biased


def test_independent_inputs_make_mimo_less_uncertain_and_coupled_ones_more(
    decomposed: Decomposed,
) -> None:
    alone, independent, coupled = (
        float(np.sqrt(np.mean(decomposed[key].octaves.spread[..., :3] ** 2)))
        for key in (("welch_full", 0.3, None), ("mimo", 0.3, 0.0), ("mimo", 0.3, 0.9))
    )
    # With all joints at once each is perturbed twice as long.
    assert independent < 0.95 * alone
    assert coupled > 1.3 * independent


def test_chance_alone_is_significant_as_often_as_stated() -> None:
    random = np.random.default_rng(6)
    many = [Mean.of(random.standard_normal((12, 8))).significant for _ in range(2000)]
    # 5 % by Bonferroni; four standard errors are 2 %.
    assert 0.03 < np.mean(many) < 0.07


# --- Efficiency: the time of a person -----------------------------------------------------------


def test_errors_are_near_the_bound_and_longer_trials_have_smaller_ones(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    found = []
    for times in ((60.0, 60.0), (15.0, 15.0)):
        monkeypatch.setattr(efficiency, "TIMES", times)
        found.append(efficiency.measure(efficiency.Case(kind="noise", voluntary=0.3), range(8), 1))
    long, short = found
    assert 0.5 < long["K1_over_bound"] < 2.0
    assert long["K1_60s"] < short["K1_15s"]
    assert long["angle_1"] > 20.0


# --- Controller: its parameters and accuracy ----------------------------------------------------


def test_what_the_parameters_of_the_controller_do_is_written_drawn_and_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    walk, gamma, lock = controller.WALK, controller.GAMMA, controller.LOCK
    plan = controller.ControllerPlan(
        base=SHORT.model_copy(update={"internal_model": "observer"}),
        seeds="0:1",
        levels=REALISTIC,
        values={walk: (0.1, 1.0), gamma: (100.0, 5000.0), lock: (50.0,)},
    )
    assert controller.investigate(InvestigationOptions(out=tmp_path), plan) == 0
    assert "refused: gamma 5000: " in capsys.readouterr().out
    rows = json.loads((tmp_path / "controller.json").read_text(encoding="utf-8"))["rows"]
    found = {(row.pop("parameter"), row.pop("value")): row for row in rows}
    assert list(found) == controller.settings(plan)
    reference, default = found[controller.REFERENCE, 0.0], found[gamma, 100.0]
    assert reference["command_step"] > 15.0 * default["command_step"]
    assert reference["torque_step"] > 15.0 * default["torque_step"]
    # Defaults are what they are, whichever parameter is set to them.
    assert found[walk, 1.0].items() <= default.items()
    assert found[walk, 0.1]["command_step"] < default["command_step"]
    assert found[walk, 0.1]["bias_bound"] > default["bias_bound"]
    assert found[lock, 50.0]["bias_bound"] > default["bias_bound"]
    assert len(rows_of(tmp_path, "controller")) == len(rows) - 1
    assert (tmp_path / "controller.png").stat().st_size > 10_000
