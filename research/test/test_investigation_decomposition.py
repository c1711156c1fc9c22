"""`make research ARGS=decomposition`: its statistics, its coupled inputs, and what it finds."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from armimp_bringup.config import ExperimentConfig
from armimp_bringup.offline import simulate
from armimp_common.errors import ConfigurationError
from armimp_estimation.estimators.estimate import ImpedanceEstimate
from armimp_estimation.mbk import MBK
from research.decomposition import (
    DecompositionPlan,
    investigate,
    run_decomposition,
)
from research.decomposition_outcomes import Cell
from research.decomposition_statistics import (
    OCTAVES,
    Mean,
    octave_errors,
)
from research.decomposition_trials import (
    all_at_once,
    input_mixing,
    scales,
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


@pytest.mark.parametrize("correlation", [-0.1, 1.0, float("nan")])
def test_impossible_correlation_is_refused(correlation: float) -> None:
    with pytest.raises(ConfigurationError, match="correlation"):
        input_mixing((3.0, 1.8), correlation)


def test_mixing_keeps_the_power_and_gives_the_correlation() -> None:
    peak = np.array((9.0, 5.4, 1.0))
    mixing = input_mixing(tuple(peak), 0.6)
    covariance = mixing @ np.diag(peak**2) @ mixing.T
    expected = np.outer(peak, peak) * (0.4 * np.eye(3) + 0.6)
    np.testing.assert_allclose(covariance, expected, rtol=1e-12)


def test_all_at_once_has_as_many_trials_each_with_signals_of_its_own() -> None:
    config = BASE.model_copy(update={"duration": 10.0})
    (alone,), (together,) = simulate([config]), all_at_once([config])
    assert [record.samples for record in alone.records] == [10_000, 10_000]
    assert [record.samples for record in together.records] == [10_000, 10_000]
    signals = [row for record in together.records for row in record.perturbation]
    for i, one in enumerate(signals):
        assert np.any(one)
        assert not any(np.array_equal(one, other) for other in signals[i + 1 :])
    # Joint by joint only one is perturbed.
    assert not alone.records[0].perturbation[1].any()


def test_mean_tells_a_bias_from_chance() -> None:
    random = np.random.default_rng(5)
    noise = random.standard_normal((40, 3, 4))
    assert not Mean.of(noise).significant
    noise[:, 1, 2] += 1.0
    found = Mean.of(noise)
    assert found.significant
    assert int(np.argmax(np.abs(found.z))) == 1 * 4 + 2
    assert found.z[1, 2] == pytest.approx(found.bias[1, 2] / found.spread[1, 2] * np.sqrt(40.0))


def test_chance_alone_is_significant_as_often_as_stated() -> None:
    random = np.random.default_rng(6)
    many = [Mean.of(random.standard_normal((12, 8))).significant for _ in range(2000)]
    # 5 % by Bonferroni; four standard errors are 2 %.
    assert 0.03 < np.mean(many) < 0.07


def test_octave_errors_are_means_relative_to_the_truth() -> None:
    truth = MBK(M=np.diag([0.2, 0.1]), B=np.ones((2, 2)), K=np.full((2, 2), 5.0))
    f = np.arange(1, 123) * 1000.0 / 8192
    true = truth.impedance(f)
    estimate = ImpedanceEstimate(
        name="made", f=f, Z=true + (0.1 + 0.2j) * np.abs(true), variance=np.ones(true.shape),
        bin_correlation=np.ones((1, f.size)), averages=10.0, T=true, R=true,
    )  # fmt: skip
    errors = octave_errors(estimate, truth)
    assert errors.shape == (2, 2, len(OCTAVES) - 1)
    np.testing.assert_allclose(errors, 0.1 + 0.2j)


def test_scales_are_geometric_means_of_the_diagonal() -> None:
    np.testing.assert_allclose(
        scales(np.array([[4.0, 1.0], [2.0, -9.0]])), [[4.0, 6.0], [6.0, 9.0]]
    )
