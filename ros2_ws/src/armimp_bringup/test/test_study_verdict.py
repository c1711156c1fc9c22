"""The worst values of a study, found and compared with the targets."""

import csv
import io
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from armimp_bringup.study import StudyEntry
from armimp_bringup.study.scores import (
    SCORES,
    StudyVerdict,
    results_csv,
    results_table,
    torque_in_counts,
)
from armimp_bringup.study.scores import judge as judge_table
from armimp_bringup.study.study import print_verdict
from armimp_estimation.mbk import MBK
from armimp_estimation.problems import ProblemCode, problem
from armimp_estimation.summary import EstimatorSummary, TrialSummary
from support import known

TRUTH = MBK(
    M=np.array([[0.2, 0.1], [0.08, 0.06]]),
    B=np.array([[0.6, 0.2], [0.3, 0.4]]),
    K=np.array([[8.0, 3.0], [-2.0, 7.0]]),
)
GOOD = {"vaf": 99.95, "r2": 0.9995, "coherence_derived": 0.99}


def _square(value: float, joints: int) -> list[list[float]]:
    return [[value] * joints for _ in range(joints)]


def _truth(joints: int) -> MBK:
    if joints == 2:
        return TRUTH
    ones = np.ones((joints, joints))
    return MBK(M=ones, B=ones, K=ones)


def _estimator(joints: int = 2) -> EstimatorSummary:
    truth = _truth(joints)
    scores = {"lack_of_fit": 1.0, "coherence_torque": 0.98, **GOOD}
    matrices: dict[str, Any] = {name: _square(value, joints) for name, value in scores.items()}
    for letter in "MBK":
        matrices[letter] = getattr(truth, letter).tolist()
        matrices[f"{letter}_se"] = _square(0.0, joints)
        matrices[f"{letter}_ci"] = [[[0.0, 0.0]] * joints] * joints
    return EstimatorSummary(
        **matrices,
        covariance=[[0.0] * (3 * joints**2)] * (3 * joints**2),
        coherence_motion=[0.97] * joints,
    )


def _entry(*, joints: int = 2, **changes: Any) -> StudyEntry:
    values: dict[str, Any] = {
        "config": {},
        "joints": joints,
        "joint_names": [f"joint {k + 1}" for k in range(joints)],
        "seed": 0,
        "problems": [],
        "trials": [
            TrialSummary(
                k=k + 1,
                bag=None,
                ticks=10,
                lock_ratio=[0.001 * (i + 1) for i in range(joints)],
                bias_bound=[0.01] * joints,
            )
            for k in range(joints)
        ],
        "estimators": {name: _estimator(joints) for name in ("welch_siso", "lpm_full")},
        "truth": _truth(joints),
        "friction": 0,
        "resolution": 0,
        "perturbation": 1,
    }
    return StudyEntry(**{**values, **changes})


def _with(entry: StudyEntry, estimator: str, **scores: Any) -> StudyEntry:
    changed = entry.estimators[estimator].model_copy(update=scores)
    return entry.model_copy(update={"estimators": {**entry.estimators, estimator: changed}})


def judge(entries: Sequence[StudyEntry]) -> StudyVerdict:
    return judge_table(entries, results_table(entries))


def _rows(verdict: StudyVerdict) -> Mapping[tuple[str, str], Any]:
    return {(one.estimator, one.quantity): one for one in verdict.worst}


def targets(joints: int, estimator: str) -> dict[str, float]:
    found = {one.name: one.limit(joints, estimator) for one in SCORES}
    return {name: limit for name, limit in found.items() if limit is not None}


def test_targets_are_those_of_the_design() -> None:
    scores = {"VAF": 99.9, "R²": 0.999, "derived coherence": 0.985}
    assert targets(2, "lpm_full") == {**scores, "M, K error": 0.5, "B error": 0.5}
    assert targets(3, "lpm_full") == targets(7, "lpm_full") == scores
    scores = {"VAF": 99.5, "R²": 0.99, "derived coherence": 0.985}
    assert targets(2, "welch_siso") == {**scores, "M, K error": 3.0, "B error": 8.0}
    assert targets(3, "welch_siso") == scores
    assert targets(2, "welch_full") == {}


@pytest.mark.parametrize(
    ("score", "quantity", "limit", "step"),
    [
        ("vaf", "VAF", 99.5, 1e-9),
        ("r2", "R²", 0.99, 1e-12),
        ("coherence_derived", "derived coherence", 0.985, 1e-12),
    ],
)
def test_worst_score_is_the_smallest_and_may_reach_the_limit(
    score: str, quantity: str, limit: float, step: float
) -> None:
    good = GOOD[score]
    for value, met in ((limit, True), (limit - step, False), (math.nan, False)):
        bad = _with(
            _entry(friction=2, resolution=1, perturbation=3, seed=7),
            "welch_siso",
            **{score: [[good, good], [value, good]]},
        )
        verdict = judge([_entry(), bad, _entry(friction=3)])
        worst = _rows(verdict)["welch_siso", quantity]
        assert worst.met is met
        assert verdict.met is met
        assert worst.worst == pytest.approx(value, nan_ok=True)
        assert str(worst).endswith("in Z21 at friction 2, resolution 1, perturbation 3, seed 7")
        assert [one for one in verdict.worst if one.met is not True and one is not worst] == []


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(
    ("letter", "quantity", "limit"),
    [("M", "M, K error", 3.0), ("K", "M, K error", 3.0), ("B", "B error", 8.0)],
)
def test_worst_error_counts_in_both_directions_and_relative_to_the_element(
    letter: str, quantity: str, limit: float, sign: float
) -> None:
    for error, met in ((0.99 * limit, True), (1.01 * limit, False)):
        matrix = [list(row) for row in getattr(TRUTH, letter)]
        matrix[1][0] *= 1.0 + sign * 0.01 * error
        entry = _with(_entry(), "welch_siso", **{letter: matrix})
        found = results_table([entry])[f"{letter}_error_percent"][0, 0, 1, 0]
        true = getattr(TRUTH, letter)[1][0]
        assert found == pytest.approx(sign * math.copysign(error, true))
        worst = _rows(judge([_entry(), entry]))["welch_siso", quantity]
        assert worst.worst == pytest.approx(error)
        assert worst.element == f"{letter}21"
        assert worst.met is met


def test_with_more_joints_elements_that_transducers_cannot_resolve_are_not_judged() -> None:
    target = {
        f"target.{name}": [value] * 4
        for name, value in (("inertia", 1.0), ("damping", 0.0), ("stiffness", 1.0))
    }
    config = {
        "arm_sim": {"sensors.torque.resolution": 0.02},
        "imbic_controller": {"perturbation.peak": [3.0, 3.0, 3.0, 0.1], **target},
    }
    entry = _entry(joints=4, config=config)
    assert entry.truth is not None
    # One element is as large as the target: half of the torque goes into the arm.
    counts = known(torque_in_counts(entry, np.array([0.0])))
    np.testing.assert_allclose(counts[0], [75.0, 75.0, 75.0, 2.5])
    vaf = _square(99.95, 4)
    vaf[1][3] = 50.0
    verdict = judge([_with(entry, "lpm_full", vaf=vaf)])
    assert verdict.met
    assert verdict.unresolved == pytest.approx(0.25)
    assert "25.0 % of all elements not resolved" in "\n".join(_printed(verdict))
    plain = _with(_entry(joints=4), "lpm_full", vaf=vaf)
    assert _rows(judge([plain]))["lpm_full", "VAF"].element == "Z24"


def test_a_value_that_misses_its_target_by_little_is_shown_with_digits_that_tell() -> None:
    r2 = next(one for one in SCORES if one.name == "R²")
    shown = [r2.format(value, 0.999) for value in (0.9989954, 0.9990046, 0.9958, 0.999)]
    assert shown == ["0.998995", "0.99900", "0.99580", "0.99900"]


def test_condition_that_is_not_valid_fails_the_study_with_its_reason() -> None:
    faults = [problem(ProblemCode.NO_PERTURBATION), problem(ProblemCode.NOTHING_RECORDED)]
    broken = _entry(friction=1, problems=faults)
    verdict = judge([_entry(), broken])
    assert not verdict.met
    assert verdict.failures() == [
        "friction 1, resolution 0, perturbation 1, seed 0 is not valid: "
        "the perturbation is zero throughout"
    ]


def test_table_of_results_has_a_row_for_each_condition_element_and_estimator() -> None:
    entries = [
        _with(
            _entry(friction=f),
            "lpm_full",
            vaf=[[99.1, 99.2], [99.3, 0.1 + 0.2]],
            M_se=[[0.25, 1.0], [2.0, math.nan]],
        )
        for f in (0, 3)
    ]
    rows = list(csv.DictReader(io.StringIO(results_csv(results_table(entries)))))
    assert len(rows) == 2 * 2 * 4
    last = rows[-1]
    assert [last[key] for key in ("friction", "estimator", "row", "column")] == [
        *("3", "lpm_full", "2", "2")
    ]
    assert float(last["vaf_percent"]) == 0.1 + 0.2
    assert float(last["M"]) == TRUTH.M[1][1]
    assert float(last["M_error_percent"]) == 0.0
    assert last["M_se"] == ""  # not known
    assert float(last["lock_ratio"]) == 0.002
    assert {r["valid"] for r in rows} == {"True"}


def _printed(verdict: StudyVerdict) -> list[str]:
    file = io.StringIO()
    print_verdict(verdict, Console(file=file, width=80))
    return [line.rstrip() for line in file.getvalue().splitlines()]


def test_printed_table_fits_into_80_characters() -> None:
    bad = _with(_entry(friction=3, seed=10), "welch_siso", vaf=_square(98.7654, 2))
    lines = _printed(judge([bad]))
    assert max(map(len, lines)) <= 80
    assert " welch_siso  VAF                98.765 %  ≥ 99.5 %  ✗  Z11  F3 R0 P1 seed 10" in lines
    assert sum("✓" in line for line in lines) == 9
