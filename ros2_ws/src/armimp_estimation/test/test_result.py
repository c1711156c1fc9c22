"""Results: one path for live and recorded trials, whatever is wrong as data, and the files."""

import functools
import json
import math
from collections.abc import Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest

from armimp_common.errors import DataError
from armimp_common.realtime import TimingLimits
from armimp_common.status import TimingFigures
from armimp_common.topics import CONTROLLER_NODE, JOINT_STATES, PERIOD_NS
from armimp_estimation.alignment.assemble import Trial
from armimp_estimation.atomic_write import write_atomically
from armimp_estimation.fit import Calibration
from armimp_estimation.identify import Identification, identify
from armimp_estimation.metadata import RECORD_KEY, Metadata, Timing, latest_metadata
from armimp_estimation.problems import Problem, ProblemCode, Severity, problem
from armimp_estimation.report.run import report_page
from armimp_estimation.result import Result, conclude
from armimp_estimation.spectra import segment_averages
from armimp_estimation.summary import (
    ImpedanceCurve,
    read_frf,
    read_summary,
    write_frf,
    write_summary,
)
from armimp_estimation.trial import TrialData
from support import known
from support.places import contents
from support.problems import codes
from support.results import METADATA as SHOWN
from support.streams import changed, trials_of
from support.synthetic_bags import recorded_arm
from support.synthetic_trials import (
    SEGMENT,
    TWO_JOINT_ARM,
    SyntheticConfig,
    part_of,
    synthetic_trials,
)

RECORDING = recorded_arm()
NAMES = RECORDING.records[0].joint_names
ESTIMATORS = ("welch_siso", "lpm_full")
METADATA = {**SHOWN, "joint_names": json.dumps(NAMES)}
NOISE = problem(ProblemCode.STALLED, seconds=30.0)


LIVE = trials_of(RECORDING.by_topic(), joint_names=NAMES)
LOST = {RECORDING.records[1].start_ns + tick * PERIOD_NS for tick in range(4000, 4037)}
KEPT = tuple(one for one in RECORDING.messages if one[0] != JOINT_STATES or one[1] not in LOST)

result_of = functools.partial(
    conclude, known=Metadata.of(METADATA), joint_names=("shoulder", "elbow"), estimators=ESTIMATORS
)


def bits(result: Result) -> list[bytes]:
    return [part.tobytes() for one in result.curves.values() for part in (one.Z, one.variance)]


def codes_of(trials: Sequence[Trial], **options: Any) -> list[ProblemCode]:
    return codes(result_of(trials, **options).summary.problems)


@functools.cache
def complete() -> Result:
    return result_of(LIVE)


@pytest.mark.parametrize("trials", [LIVE[:1], LIVE[1:], [], [LIVE[0], LIVE[0]]])
def test_when_there_is_not_one_trial_for_each_joint_expect_a_result_without_estimates(
    trials: list[Trial],
) -> None:
    result = result_of(trials)
    assert not result.summary.valid
    assert not result.curves
    assert not result.summary.estimators
    assert codes(result.summary.problems) == [ProblemCode.TRIALS_INCOMPLETE]
    assert len(result.summary.trials) == len(trials)
    assert result.summary.truth is not None


def test_a_trial_of_a_joint_that_there_is_not_is_told_and_has_no_place_in_the_report() -> None:
    unknown = problem(ProblemCode.JOINT_UNKNOWN, name="7", known="shoulder, elbow")
    window = replace(LIVE[1].window, joint=6)
    strange = replace(LIVE[1], segments=(), window=window, problems=(unknown,))
    result = result_of([LIVE[0], strange])
    assert not result.summary.valid
    assert [one.k for one in result.summary.trials] == [1]
    assert "Trial 1: shoulder perturbed" in report_page(result)


def test_known_problems_make_a_result_invalid_and_come_first() -> None:
    summary = result_of(LIVE, problems=[NOISE]).summary
    assert (summary.valid, summary.problems, summary.faults) == (False, [NOISE], [NOISE])
    assert tuple(summary.estimators) == ESTIMATORS
    assert codes_of([], problems=[NOISE]) == [NOISE.code, ProblemCode.TRIALS_INCOMPLETE]
    # No problem is listed twice.
    spoiled = replace(LIVE[0], problems=(NOISE,))
    assert result_of([spoiled, LIVE[1]], problems=[NOISE]).summary.problems == [NOISE]


def test_trials_of_another_rate_are_refused_where_the_controller_that_made_them_has_its_own() -> (
    None
):
    faster = [
        replace(one, segments=tuple(replace(part, rate=2000.0) for part in one.segments))
        for one in LIVE
    ]
    planned = Metadata(config={CONTROLLER_NODE: {}})
    assert ProblemCode.RATE_UNPLANNED not in codes_of(faster, known=Metadata())
    assert ProblemCode.RATE_UNPLANNED not in codes_of(LIVE, known=planned)
    assert codes_of(faster, known=planned).count(ProblemCode.RATE_UNPLANNED) == 2


def test_notes_and_problems_of_an_estimator_that_decides_nothing_leave_the_result_valid() -> None:
    note = Problem(code=ProblemCode.DELAY_CORRECTED, severity=Severity.NOTE)
    biased = Problem(code=ProblemCode.LOCK_RATIO, estimator="welch_siso")
    summary = complete().summary.with_problems([note, biased])
    assert summary.valid
    assert summary.faults == []
    again = summary.with_problems([note, NOISE])
    assert again.problems == [NOISE, note, biased]
    assert not again.verdict.impedance


HALF = '{"a": "\\ud800"}'
"""Half a surrogate pair."""
ONE = "[[1, 0], [0, 1]]"


@pytest.mark.parametrize(
    ("key", "text", "reason"),
    [
        ("config", "x", "config is not JSON: 'x'"),
        ("config", HALF, "config is not JSON"),
        ("config", "null", "config: Input should be a valid dictionary, got"),
        ("seed", "9" * 5000, "seed is not JSON"),
        ("seed", "[" * 100_000, "seed is not JSON"),
        ("truth", '{"M": [[1, 2], [3]], "B": 1, "K": 2}', "truth: not three matrices"),
        ("truth", f'{{"M": [[NaN, 0], [0, 1]], "B": {ONE}, "K": {ONE}}}', ".*M is not finite"),
        ("truth", f'{{"M": {ONE}, "B": [[1e300, 0], [0, 1]], "K": {ONE}}}', ".*element of 1e.300"),
        ("truth", '{"M": [[1]], "B": [[1]], "K": [[1]]}', "truth is of 1 joints, the data of 2"),
        ("torque_delay", "true", "torque_delay: Input should be a valid number, got True"),
        ("torque_delay", "-2", "torque_delay: Input should be greater than or equal to -1, got -2"),
        ("torque_order", "1.5", "torque_order: Input should be a valid integer, got 1.5"),
        ("torque_uncertainty", "-1", "torque_uncertainty: Input should be greater .*got -1"),
        ("torque_timing", '"later"', "torque_timing: Input should be 'unknown', 'before_update'"),
        ("robot_inertia", "[0.3]", "parameter 'robot_inertia' has 1 values for 2 joints"),
        (RECORD_KEY, "3", "timing: Input should be"),
        (RECORD_KEY, '{"ticks": 3}', "timing.*late: Field required"),
    ],
)
def test_metadata_that_make_no_sense_are_refused_in_one_line(
    key: str, text: str, reason: str
) -> None:
    with pytest.raises(DataError, match=f"^metadata: {reason}") as caught:
        Metadata.of({key: text}, 2)
    assert "\n" not in str(caught.value)


def test_trials_that_lost_samples_are_refused_or_estimated_from_their_intact_parts() -> None:
    trials = trials_of(replace(RECORDING, messages=KEPT).by_topic(), joint_names=NAMES)
    refused = result_of(trials)
    healed = result_of([replace(one, allow_gaps=True) for one in trials])
    for one in (refused, healed):
        assert codes(one.summary.problems) == [ProblemCode.SAMPLES_MISSING]
    assert not refused.curves
    assert all(math.isnan(value) for value in refused.summary.trials[0].lock_ratio)
    (note,) = healed.summary.problems
    assert (note.severity, note.trial) == (Severity.NOTE, 2)
    assert note.values == {"stream": JOINT_STATES, "count": 37, "first": 4.0, "last": 4.037}
    assert healed.summary.valid
    assert "Not usable" not in report_page(healed)
    first, second = healed.summary.trials
    assert (first.lost, first.excluded, first.stretches) == (0, 0, 1)
    assert (second.lost, second.excluded, second.stretches) == (37, 37, 2)
    for estimator in healed.summary.estimators.values():
        assert np.min(known(estimator.vaf)) > 99.0
    # Of records without gaps the result is the same.
    assert bits(result_of([replace(one, allow_gaps=True) for one in LIVE])) == bits(complete())


def test_segments_of_all_parts_are_averaged_and_none_spans_a_gap() -> None:
    complete = RECORDING.records[0]
    parts = [part_of(complete, *ends) for ends in ((0, 3000), (3100, 3600), (4000, 9000))]
    data = TrialData.of(*parts, segment=SEGMENT)
    alone = [TrialData.of(one, segment=SEGMENT).spectra for one in parts[::2]]
    counts = [8, 16]
    assert [one.segments for one in alone] == counts
    mean = sum(one.matrix * one.segments for one in alone) / sum(counts)
    np.testing.assert_allclose(data.spectra.matrix, mean, rtol=1e-12)
    assert data.spectra.segments == sum(counts)
    assert data.record is parts[2]
    # Of equal parts exactly; segments on either side of a gap have nothing in common.
    once, twice, joined = (segment_averages(8192, *runs) for runs in ((8,), (8, 8), (16,)))
    assert twice[0] == pytest.approx(2 * once[0])
    assert twice[0] > joined[0]
    np.testing.assert_allclose(twice[1], once[1])


GOOD = TimingFigures(
    ticks=2000,
    late=3,
    missed=1,
    period_p50=1e-3,
    period_p99=1.1e-3,
    period_max=2.5e-3,
    latency_p50=2e-4,
    latency_p99=4e-4,
    latency_max=1.5e-3,
)
BAD = changed(GOOD, missed=100)


def timing(figures: TimingFigures = GOOD, **changes: Any) -> Timing:
    return Timing(**{**dict(figures), **changes}, **dict(TimingLimits()))


def stored(*timings: Timing) -> list[dict[str, str]]:
    return [{RECORD_KEY: one.model_dump_json()} for one in timings]


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({}, []),
        ({"late": 21}, [ProblemCode.SAMPLES_LATE]),
        ({"missed": 21}, [ProblemCode.COMMANDS_LATE]),
        ({"latency_p99": 1.1e-3}, [ProblemCode.LATENCY]),
        ({"latency_p99": math.nan}, [ProblemCode.LATENCY]),
    ],
)
def test_each_limit_that_is_exceeded_is_a_problem(
    changes: dict[str, float], expected: list[ProblemCode]
) -> None:
    told = timing(GOOD, **changes)
    assert codes(told.problems) == expected
    # Without trials nothing is estimated.
    summary = result_of([], known=Metadata.of(METADATA | stored(told)[0])).summary
    assert codes(summary.faults) == [*expected, ProblemCode.TRIALS_INCOMPLETE]
    assert known(summary.timing).model_dump_json() == told.model_dump_json()


def test_of_several_bags_the_one_that_knows_most_of_the_run_tells_its_timing() -> None:
    empty = timing(TimingFigures(ticks=10, late=0, missed=0))
    assert json.loads(empty.model_dump_json())["latency_p99"] is None
    bags = stored(empty, timing(), timing(ticks=5000))
    assert latest_metadata([{"seed": "1", **bags[0]}, *bags[1:]]) == {"seed": "1", **bags[2]}
    assert latest_metadata([{"seed": "1"}, {}]) == {"seed": "1"}


@pytest.mark.parametrize(
    "changes", [{"missed": 900}, {"late": 900}, {"period_max": 0.2}, {"latency_max": 0.2}]
)
def test_when_a_bag_is_of_another_run_expect_the_worse_run_to_count(
    changes: dict[str, float],
) -> None:
    bad, longer = timing(BAD, **changes), timing(ticks=20_000, late=150, missed=120)
    assert bad.problems
    assert not longer.problems
    for order in ((bad, longer), (longer, bad)):
        assert latest_metadata(stored(*order)) == stored(bad)[0]


@pytest.fixture(scope="module")
def identification() -> Identification:
    data = synthetic_trials(SyntheticConfig(rate=125.0, samples=6144, torque_noise=0.02))
    told = Metadata(truth=TWO_JOINT_ARM, calibration=Calibration())
    return identify(data, ["welch_siso", "welch_full"], told)


def test_summary_has_the_keys_of_schema_1_and_comes_back_bit_by_bit(tmp_path: Path) -> None:
    summary = result_of(
        [replace(trial, bag="somewhere", rtf=2.5) for trial in LIVE], problems=[NOISE]
    ).summary
    path = tmp_path / "summary.json"
    write_summary(path, summary)
    content = json.loads(path.read_text())
    assert content["schema"] == 1
    assert (content["valid"], content["verdict"]["impedance"]) == (False, False)
    assert content["problems"][0] == {
        "code": "stalled",
        "concern": "impedance",
        "severity": "error",
        "trial": None,
        "estimator": "",
        "values": {"seconds": 30.0},
        "sentence": "nothing happened for 30 s",
    }
    assert [(one["bag"], one["rtf"]) for one in content["trials"]] == [("somewhere", 2.5)] * 2
    back = read_summary(path)
    assert back.model_dump_json() == summary.model_dump_json()
    np.testing.assert_array_equal(known(back.truth).B, TWO_JOINT_ARM.B)


def test_files_hold_the_result_and_are_never_overwritten(tmp_path: Path) -> None:
    complete().write(tmp_path)
    before = contents(tmp_path)
    assert read_summary(tmp_path / "summary.json") == complete().summary
    assert set(read_frf(tmp_path / "frf.npz")) == set(ESTIMATORS)
    with pytest.raises(DataError, match=r"frf.npz: exists already"):
        complete().write(tmp_path)
    with pytest.raises(DataError, match=r"summary.json: exists already"):
        write_summary(tmp_path / "summary.json", complete().summary)
    assert contents(tmp_path) == before
    (tmp_path / "bare").mkdir()
    result_of([]).write(tmp_path / "bare")
    assert [path.name for path in (tmp_path / "bare").iterdir()] == ["summary.json"]
    with pytest.raises(DataError, match=r"nowhere/summary.json: cannot be written: No such file"):
        write_summary(tmp_path / "nowhere" / "summary.json", complete().summary)


@pytest.mark.parametrize("links", [True, False])
def test_a_file_that_appears_while_another_is_written_stays_as_it_is(
    links: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "summary.json"
    if not links:  # as on FAT
        monkeypatch.setattr(Path, "hardlink_to", Mock(side_effect=PermissionError))

    with pytest.raises(DataError, match=r"summary.json: exists already"):
        write_atomically(path, lambda _: path.write_text("first"))
    assert path.read_text() == "first"
    path.unlink()
    write_atomically(path, lambda part: part.write_text("alone"))
    assert [(one.name, one.read_text()) for one in tmp_path.iterdir()] == [(path.name, "alone")]


def test_curves_come_back_bit_by_bit_each_with_its_own_frequencies(
    identification: Identification, tmp_path: Path
) -> None:
    curves = {name: ImpedanceCurve.of(one) for name, one in identification.estimators.items()}
    curves["fine"] = replace(curves["welch_siso"], name="fine", f=curves["welch_siso"].f + 1.0)
    for name in ("one", "two"):
        write_frf(tmp_path / f"{name}.npz", curves)
    assert (tmp_path / "one.npz").read_bytes() == (tmp_path / "two.npz").read_bytes()
    back = read_frf(tmp_path / "one.npz")
    assert list(back) == list(curves)
    for name, written in curves.items():
        for mine, other in ((written, back[name]), (written.coherence, back[name].coherence)):
            for one in fields(mine):
                if one.name != "coherence":
                    found, expected = getattr(other, one.name), getattr(mine, one.name)
                    np.testing.assert_array_equal(found, expected, strict=True)


def test_covariances_of_responses_and_parameters_contain_the_standard_errors(
    identification: Identification,
) -> None:
    for result in identification.estimators.values():
        estimate, fit = result.estimate, result.fit
        share = np.abs(known(estimate.inverse)) ** 2
        variance = np.einsum("kiif,kjf->ijf", known(estimate.disturbance), share).real
        np.testing.assert_allclose(variance, estimate.noise, rtol=1e-6)
        errors = fit.errors.ravel()
        correlation = fit.covariance / np.outer(errors, errors)
        assert np.linalg.eigvalsh(correlation).min() > 0.0
