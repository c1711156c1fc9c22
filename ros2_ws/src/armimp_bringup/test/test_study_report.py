"""The files of a study, its report and its figures."""

import html
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from armimp_bringup.config import ExperimentConfig
from armimp_bringup.study import StudyEntry, select_conditions
from armimp_bringup.study.figures import impedance_figure, levels_figure
from armimp_bringup.study.scores import (
    COHERENCE_SCORES,
    FIT_SCORES,
    StudyVerdict,
    judge,
    results_table,
)
from armimp_bringup.study.study import run_study
from armimp_common.errors import ConfigurationError
from armimp_estimation.summary import read_frf
from support.places import contents
from support.results import read_study, threads

BASE = ExperimentConfig(duration=4.0, estimators=("welch_siso", "lpm_full"))
CONDITIONS = select_conditions(["friction=0+3,resolution=3,perturbation=1"], "1:3")

TABLES = ("study.json", "results.csv", "verdict.json", "report.html")


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp("study") / "new" / "folder"
    run_study(BASE, CONDITIONS, directory, threads(1), figures=False)
    return directory


@pytest.fixture(scope="module")
def entries(study: Path) -> list[StudyEntry]:
    return read_study(study / "study.json")


def test_study_leaves_all_its_files_and_no_others(study: Path) -> None:
    found = {path.name for path in study.iterdir()}
    assert found == {*TABLES, "conditions"}
    assert {path.name for path in (study / "conditions").iterdir()} == {
        f"{one.name}.{suffix}" for one in CONDITIONS for suffix in ("json", "npz")
    }


def test_number_of_workers_makes_no_difference(study: Path, tmp_path: Path) -> None:
    verdict = run_study(BASE, CONDITIONS, tmp_path / "out", threads(3), figures=False)
    stored = StudyVerdict.model_validate_json((study / "verdict.json").read_bytes())
    assert stored == verdict
    assert contents(tmp_path / "out") == contents(study)


def test_a_directory_that_holds_something_is_refused_and_left_alone(study: Path) -> None:
    before = contents(study)
    with pytest.raises(ConfigurationError, match="is not empty, nothing is overwritten"):
        run_study(BASE, CONDITIONS, study, threads(1), figures=False)
    assert contents(study) == before


def test_report_is_written_without_figures_and_says_how_far_each_missed_target_is(
    study: Path, entries: Sequence[StudyEntry]
) -> None:
    page = (study / "report.html").read_text(encoding="utf-8")
    assert len(page) < 8_000_000
    assert not list(study.glob("*.png"))
    assert not re.findall("(?:src|href)=[\"']?https?:", page.split("<script", 1)[0])
    text = page.split("<main", 1)[1].split("<script>", 1)[0]
    words = re.sub(r"\s+", " ", html.unescape(re.sub("<[^>]*>", " ", text)))
    for part in ("Worst value in each condition", "1, 2"):
        assert part in words
    missed = [one for one in judge(entries, results_table(entries)).worst if one.met is False]
    assert missed  # four seconds are too short
    assert f"{len(missed)} of 10 targets missed" in words
    for one in missed:
        assert str(one) in words


def test_figure_2_shows_each_element_beside_the_truth_with_a_phase_that_does_not_jump(
    study: Path, entries: Sequence[StudyEntry]
) -> None:
    curves = [read_frf(study / "conditions" / f"{one.name}.npz") for one in CONDITIONS]
    truth = entries[0].truth
    assert truth is not None
    shown = {
        condition: found["welch_siso"]
        for condition, found in zip(CONDITIONS[:2], curves[:2], strict=True)
    }
    axes = impedance_figure(shown, truth).axes
    assert [len(one.lines) for one in axes[:3]] == [3, 3, 2]  # two conditions, and the truth
    curve = curves[1]["welch_siso"]
    np.testing.assert_array_equal(axes[6].lines[1].get_ydata(), np.abs(curve.Z[1, 0]))
    true = truth.impedance(curve.f)[1, 0]
    np.testing.assert_array_equal(axes[6].lines[-1].get_ydata(), np.abs(true))
    for phase in axes[1::3]:
        for line in phase.lines:
            assert -90.0 < np.min(line.get_ydata()) <= np.max(line.get_ydata()) < 270.0


def test_figures_3_and_4_group_by_every_factor_and_reach_from_worst_to_best(
    entries: Sequence[StudyEntry],
) -> None:
    table = results_table(entries)
    for scores in (FIT_SCORES, COHERENCE_SCORES):
        figure = levels_figure(table[:, 0], scores)
        assert len(figure.axes) == len(scores)
        ticks = [one.get_text() for one in figure.axes[-1].get_xticklabels()]
        assert ticks == ["F0", "F3", "R3", "P1"]
    # At R3, the only level of resolution.
    container: Any = levels_figure(table[:, 0], FIT_SCORES).axes[0].containers[1]
    values = table["vaf_percent"][:, 0, 0, 1]
    np.testing.assert_allclose(container.lines[0].get_ydata()[2], np.mean(values))
    segment = container.lines[2][0].get_segments()[2]
    np.testing.assert_allclose(segment[:, 1], [values.min(), values.max()])


HARDEST = ["friction=0+3,resolution=0+3,perturbation=1", "friction=1,resolution=2,perturbation=2"]
"""The weakest perturbation with most friction, coarsest sensors, both or none; and the middle."""

COARSEST = "friction=3,resolution=3,perturbation=3"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("base", "only", "seeds"),
    [
        ({}, HARDEST, "0"),
        ({"joints": 3}, [COARSEST], "0"),
        ({"perturbation_kind": "multisine"}, [COARSEST], "0:4"),
    ],
)
def test_every_target_is_met_by_both_estimators(
    base: dict[str, object], only: list[str], seeds: str, tmp_path: Path
) -> None:
    conditions = select_conditions(only, seeds)
    config = ExperimentConfig.model_validate(base)
    verdict = run_study(config, conditions, tmp_path / "study", threads(2), figures=False)
    assert verdict.failures() == []
