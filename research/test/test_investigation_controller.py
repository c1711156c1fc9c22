"""`make research ARGS=controller`: what it varies, what it keeps of the runs, and what it finds."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from armimp_bringup.config import ExperimentConfig
from armimp_bringup.parameters import node_parameters
from armimp_common.errors import ConfigurationError
from research.controller import (
    DITHER,
    GAMMA,
    LOCK,
    MODEL,
    ControllerPlan,
    Findings,
    default_values,
    investigate,
    overrides,
    run_controller,
    settings,
)
from research.controller_outcomes import Cell, Outcome, Place, Setting
from research.options import InvestigationOptions

pytestmark = pytest.mark.slow

# Shorter trials, larger steps and fewer seeds than anyone should draw conclusions from.
BASE = ExperimentConfig(duration=16.4, arm_sim={"substeps": 10})
WEAK = Place(perturbation=1, voluntary=0.0)
RELAXED = Place(perturbation=3, voluntary=0.0)
TENSE = Place(perturbation=3, voluntary=0.3)
PLAN = ControllerPlan(
    base=BASE,
    seeds="0:3",
    places=(RELAXED, TENSE),
    values={MODEL: (0.6, 4.0), LOCK: (50.0, 200.0), DITHER: (0.0,)},
)
DEFAULTS = {MODEL: 0.6, GAMMA: 100.0, LOCK: 100.0, DITHER: 0.7}


@pytest.fixture(scope="module")
def findings() -> Findings:
    return run_controller(PLAN, workers=2)


def _by_setting(findings: Findings, place: Place, estimator: str) -> dict[str, Cell]:
    return {
        str(cell.setting): cell
        for cell in findings.cells
        if (cell.place, cell.estimator) == (place, estimator)
    }


def test_defaults_are_those_of_the_controller_in_its_own_units() -> None:
    assert default_values(node_parameters(ExperimentConfig(), None)) == pytest.approx(DEFAULTS)


def test_default_setting_comes_first_and_once() -> None:
    assert settings(PLAN, DEFAULTS) == [
        Setting(),
        Setting(parameter=MODEL, value=4.0),
        Setting(parameter=LOCK, value=50.0),
        Setting(parameter=LOCK, value=200.0),
        Setting(parameter=DITHER, value=0.0),
    ]


@pytest.mark.parametrize("name", [MODEL, GAMMA, LOCK, DITHER])
def test_setting_changes_its_parameter_and_no_other(name: str) -> None:
    preset = node_parameters(BASE, None)
    changed = overrides(Setting(parameter=name, value=0.5 * DEFAULTS[name]), preset)
    varied = node_parameters(BASE.model_copy(update={"imbic_controller": changed}), None)
    expected = {**DEFAULTS, name: 0.5 * DEFAULTS[name]}
    assert default_values(varied) == pytest.approx(expected)
    # All elements of the matrix, not just the first one.
    ratio = np.array(varied.controller.law.model_inertia) / preset.controller.known.robot_inertia
    assert ratio == pytest.approx(np.full(4, expected[MODEL]))


def test_default_setting_overrides_nothing() -> None:
    assert overrides(Setting(), node_parameters(BASE, None)) == {}


def test_parameter_that_is_not_varied_here_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="cannot vary 'speed', only model_factor, gamma"):
        overrides(Setting(parameter="speed", value=1.0), node_parameters(BASE, None))


def test_when_encoders_are_not_quantised_expect_counts_of_dither_to_be_refused() -> None:
    plan = replace(PLAN, base=BASE.model_copy(update={"resolution": 0}))
    with pytest.raises(ConfigurationError, match="needs a resolution level above 0"):
        run_controller(plan, workers=1)


def test_every_setting_has_every_place_and_estimator(findings: Findings) -> None:
    accepted = ("defaults", "lock_frequency 50", "lock_frequency 200", "lock_dither 0")
    assert [(str(cell.setting), cell.place, cell.estimator) for cell in findings.cells] == [
        (setting, place, estimator)
        for setting in accepted
        for place in (RELAXED, TENSE)
        for estimator in ("welch_siso", "lpm_full")
    ]
    assert {(cell.runs, cell.lost) for cell in findings.cells} == {(3, 0)}


def test_setting_that_is_not_stable_is_refused_with_the_reason(findings: Findings) -> None:
    assert list(findings.refused) == [Setting(parameter=MODEL, value=4.0)]
    assert "stab" in findings.refused[Setting(parameter=MODEL, value=4.0)]


@pytest.mark.parametrize("place", [RELAXED, TENSE])
def test_stiffer_lock_leaves_less_bias_by_its_motion(findings: Findings, place: Place) -> None:
    cells = _by_setting(findings, place, "welch_siso")
    assert cells["lock_frequency 50"].lock_bias > 1.5 * cells["defaults"].lock_bias
    assert cells["defaults"].lock_bias > 1.5 * cells["lock_frequency 200"].lock_bias


@pytest.mark.parametrize("place", [RELAXED, TENSE])
def test_dither_does_not_count_as_motion_of_locked_joints(findings: Findings, place: Place) -> None:
    cells = _by_setting(findings, place, "welch_siso")
    assert cells["defaults"].lock_ratio < 1.5 * cells["lock_dither 0"].lock_ratio


def test_without_dither_m_of_the_relaxed_arm_is_worse(findings: Findings) -> None:
    cells = _by_setting(findings, RELAXED, "lpm_full")
    assert cells["lock_dither 0"].rms[0] > 1.5 * cells["defaults"].rms[0]


def test_outcomes_of_a_block_with_a_stopped_run_are_those_of_the_others_alone() -> None:
    """Level 3 exceeds this speed, level 1 does not."""
    base = BASE.model_copy(update={"imbic_controller": {"safety.velocity_limit": [0.8]}})
    plan = replace(PLAN, base=base, values={})
    both = run_controller(replace(plan, places=(WEAK, RELAXED)), workers=1).cells
    alone = run_controller(replace(plan, places=(WEAK,)), workers=1).cells
    assert [(cell.place.perturbation, cell.runs, cell.lost) for cell in both] == [
        *[(1, 3, 0)] * 2,
        *[(3, 0, 3)] * 2,
    ]
    for one, other in zip(both[:2], alone, strict=True):
        assert one.described() == other.described()
    assert np.isnan(both[2].rms).all()


def _outcome(errors: tuple[float, float], vaf: float, command: float, clipped: int) -> Outcome:
    """Of a joint pair whose M, B, K all have these errors in their first and second column."""
    return Outcome(
        estimator="made",
        errors=np.broadcast_to(np.array(errors), (3, 2, 2)),
        vaf=vaf,
        coherence=vaf / 100.0,
        lock_ratio=command / 1000.0,
        lock_bias=command / 100.0,
        command_step=command,
        largest_command=10.0 * command,
        clipped=clipped,
    )


def test_cell_tells_bias_of_the_worst_element_and_errors_of_all() -> None:
    outcomes = [
        _outcome((0.01, -0.02), vaf=99.0, command=3.0, clipped=1),
        _outcome((0.01, -0.06), vaf=98.0, command=4.0, clipped=2),
    ]
    cell = Cell.of(Setting(), RELAXED, "made", outcomes, lost=1)
    assert (cell.runs, cell.lost, cell.clipped) == (2, 1, 3)
    assert cell.bias == pytest.approx([-0.04] * 3)
    assert cell.uncertainty == pytest.approx([0.02] * 3)  # 0.04/√2 over √2
    assert cell.rms == pytest.approx([np.sqrt((2 * 0.01**2 + 0.02**2 + 0.06**2) / 4)] * 3)
    assert cell.worst == pytest.approx([0.06] * 3)
    assert (cell.vaf, cell.coherence) == (98.0, 0.98)
    assert (cell.lock_ratio, cell.lock_bias) == (0.004, 0.04)
    assert cell.command_step == pytest.approx(np.sqrt((3.0**2 + 4.0**2) / 2))
    assert cell.largest_command == 40.0


def test_investigation_leaves_tables_and_a_figure(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plan = replace(PLAN, places=(RELAXED,), values={MODEL: (0.4, 4.0)})
    assert investigate(InvestigationOptions(out=tmp_path, seeds="0:2"), plan) == 0
    printed = capsys.readouterr().out
    assert "M̄ / M_r = 0.4" in printed
    assert "refused: M̄ / M_r = 4: " in printed
    result = json.loads((tmp_path / "controller.json").read_text(encoding="utf-8"))
    assert result["seeds"] == "0:2"
    assert result["defaults"] == pytest.approx(DEFAULTS)
    assert [(one["parameter"], one["value"]) for one in result["refused"]] == [(MODEL, 4.0)]
    named = [("defaults", None)] * 2 + [(MODEL, 0.4)] * 2
    assert [(cell["parameter"], cell["value"]) for cell in result["cells"]] == named
    with (tmp_path / "controller.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [float(row["rms_B"]) for row in rows] == [cell["rms_B"] for cell in result["cells"]]
    assert (tmp_path / "controller.png").stat().st_size > 10_000
    assert (tmp_path / "controller.pdf").stat().st_size > 5_000
