"""The report of a study: what it says about the numbers it is given."""

from __future__ import annotations

import html
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from armimp_bringup.config import ExperimentConfig
from armimp_bringup.study.accuracy import element_errors, inertia_vaf, resolvable
from armimp_bringup.study.backends import Threads
from armimp_bringup.study.conditions import select_conditions
from armimp_bringup.study.engine import Batch, Provenance, run_batch
from armimp_bringup.study.entry import StudyEntry, read_study
from armimp_bringup.study.levels import fit_scores, statistics
from armimp_bringup.study.report_accuracy import explanation
from armimp_bringup.study.report_verdict import verdict_content
from armimp_bringup.study.study import run_study
from armimp_bringup.study.verdict import COLUMNS, judge
from armimp_estimation.mbk import MBK

BASE = ExperimentConfig(duration=10.0, estimators=("welch_siso", "lpm_full"))
CONDITIONS = select_conditions(["friction=0+3,resolution=3,perturbation=1"], "1:3")


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp("study")
    run_study(BASE, CONDITIONS, directory, Threads(1), figures=False)
    return directory


@pytest.fixture(scope="module")
def entries(study: Path) -> list[StudyEntry]:
    return read_study(study / "study.json")


def _words(text: str) -> str:
    return re.sub(r"\s+", " ", html.unescape(re.sub("<[^>]*>", " ", text)))


def test_report_is_written_without_figures_and_holds_everything(study: Path) -> None:
    page = (study / "report.html").read_text(encoding="utf-8")
    assert len(page) < 8_000_000
    assert not list(study.glob("*.png"))
    assert not re.findall("(?:src|href)=[\"']?https?:", page.split("<script", 1)[0])
    words = _words(page.split("<main", 1)[1].split("<script>", 1)[0])
    for part in ("Worst value in each condition", "Spread over 2 seeds", "1 to 2", "assumption"):
        assert part in words


def test_report_is_the_same_after_interruptions_and_in_another_order(
    study: Path, tmp_path: Path
) -> None:
    for part in (CONDITIONS[2:], CONDITIONS[:1], CONDITIONS):
        run_study(BASE, part, tmp_path / "other", Threads(2), figures=False)
    again = (tmp_path / "other" / "report.html").read_bytes()
    assert again == (study / "report.html").read_bytes()


def test_verdict_says_how_far_each_missed_target_is(entries: Sequence[StudyEntry]) -> None:
    verdict = judge(entries)
    assert not verdict.met  # ten seconds are too short
    content = verdict_content(entries, verdict)
    words = " ".join([content["title"], *(text for _, text in content["sentences"])])
    for one in verdict.worst:
        if one.met is False:
            column = next(column for column in COLUMNS if column.quantity == one.quantity)
            assert one.limit is not None
            assert (
                f"{one.quantity} {column.format(one.worst)} where {column.format(one.limit)} "
                f"is asked for, in {one.place}"
            ) in words
    missed = sum(one.met is False for one in verdict.worst)
    assert f"{missed} of 10 targets missed" in words


def test_errors_of_elements_are_the_largest_of_all_conditions(
    entries: Sequence[StudyEntry],
) -> None:
    found = element_errors(entries, "lpm_full", "K")
    assert found is not None
    truth = entries[0].truth
    assert truth is not None
    true = np.array(truth.K)
    estimates = np.array([entry.estimators["lpm_full"].K for entry in entries])
    worst = np.max(np.abs(estimates - true), axis=0)
    np.testing.assert_allclose(found.relative, 100.0 * worst / np.abs(true))
    scale = np.sqrt(np.outer(np.diag(true), np.diag(true)))
    np.testing.assert_allclose(found.scaled, 100.0 * worst / scale)
    np.testing.assert_allclose(found.size, 100.0 * np.abs(true) / scale)


def test_vaf_of_inertia_alone_is_that_of_an_impedance_without_the_rest() -> None:
    one = np.ones((1, 1))
    assert inertia_vaf(MBK(M=one, B=0 * one, K=0 * one)) == pytest.approx(100.0)
    assert inertia_vaf(MBK(M=0 * one, B=one, K=one)) == pytest.approx(0.0)


def test_reasons_follow_from_the_numbers_of_the_study() -> None:
    base = ExperimentConfig(joints=3, duration=10.0, estimators=("lpm_full",))
    conditions = select_conditions(["friction=3,resolution=3,perturbation=1"], "1")
    batch = Batch(base=base, conditions=conditions, provenance=Provenance.here())
    entries = [result.entry for result in run_batch(batch)]
    errors = [element_errors(entries, "lpm_full", letter) for letter in "MBK"]
    known = [one for one in errors if one is not None]
    said = list(explanation(entries, "lpm_full", known))
    vaf = entries[0].estimators["lpm_full"].vaf
    assert vaf is not None
    assert said[0].startswith(f"VAF is at least {np.min(vaf):.3f} %")
    for one in known:
        told = f"{one.letter} is more than 2 % wrong in {int(one.beyond.sum())} of 9 elements"
        assert any(told in sentence for sentence in said) == bool(one.beyond.any())
    assert known[2].beyond.any()
    seen = resolvable(entries)
    assert seen is not None
    below = int((seen.stiffness_torque < 0.02).sum())
    assert any(f"{below} of 9 elements of K never make" in sentence for sentence in said)


def test_nothing_is_said_about_counts_where_torques_are_not_quantised(
    entries: Sequence[StudyEntry],
) -> None:
    unquantised = [
        entry.model_copy(
            update={"config": {**entry.config, "arm_sim": {"sensors.torque_resolution": 0.0}}}
        )
        for entry in entries
    ]
    assert resolvable(entries) is not None
    assert resolvable(unquantised) is None


def test_statistics_by_level_count_every_condition_once(entries: Sequence[StudyEntry]) -> None:
    score = fit_scores(entries, "lpm_full")[0]
    values = next(iter(score.values.values()))
    by_friction = statistics(entries, "friction", values)
    assert by_friction.levels.tolist() == [0, 3]
    of_3 = [v[0] for entry, v in zip(entries, values, strict=True) if entry.friction == 3]
    assert by_friction.mean[1] == pytest.approx(np.mean(of_3))
    assert (by_friction.low[1], by_friction.high[1]) == (min(of_3), max(of_3))
