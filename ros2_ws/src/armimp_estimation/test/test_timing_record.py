"""Timing of a run in real time: through bags and summaries into the verdict and the report."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import pytest

from armimp_common.errors import DataError
from armimp_common.realtime import TimingLimits, judge_timing
from armimp_common.status import TimingFigures
from armimp_estimation.conclusion import conclude
from armimp_estimation.parameters import EstimatorParameters
from armimp_estimation.realtime_timing import RECORD_KEY, TimingRecord, latest_metadata
from armimp_estimation.report import load_result, report_page
from support.results import METADATA, make_result

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
BAD = replace(GOOD, missed=100)


def record(figures: TimingFigures = GOOD) -> TimingRecord:
    return TimingRecord(figures=figures, limits=TimingLimits())


def test_a_record_survives_the_metadata_of_a_bag() -> None:
    assert TimingRecord.from_json(record().to_json()) == record()


def test_figures_that_were_never_measured_are_null_there() -> None:
    empty = record(TimingFigures(ticks=0, late=0, missed=0))
    assert json.loads(empty.to_json())["latency_p99"] is None
    assert math.isnan(TimingRecord.from_json(empty.to_json()).figures.latency_p99)


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("{", "metadata: timing: not JSON"),
        ("3", "metadata: timing: content: "),
        (json.dumps({"ticks": 3}), "metadata: timing: late: Field required"),
        (record().to_json().replace('"late":3', '"late":3000'), "late must lie between 0"),
    ],
)
def test_a_record_that_makes_no_sense_is_refused_in_one_line(text: str, complaint: str) -> None:
    with pytest.raises(DataError, match=complaint) as caught:
        TimingRecord.from_json(text)
    assert "\n" not in str(caught.value)


def test_of_several_bags_the_one_that_knows_most_of_the_run_tells_its_timing() -> None:
    later = record(replace(GOOD, ticks=5000))
    told = [{"seed": "1", RECORD_KEY: record().to_json()}, {RECORD_KEY: later.to_json()}]
    assert latest_metadata(told) == {"seed": "1", RECORD_KEY: later.to_json()}
    assert latest_metadata([{"seed": "1"}, {}]) == {"seed": "1"}


@pytest.mark.parametrize(
    "bad",
    [
        replace(BAD, missed=900),
        replace(BAD, late=900),
        replace(BAD, missed=100, period_max=0.2),
        replace(BAD, missed=100, latency_max=0.2),
    ],
)
def test_when_a_bag_is_of_another_run_expect_the_worse_run_to_count(bad: TimingFigures) -> None:
    longer = record(replace(GOOD, ticks=20_000, late=150, missed=120))
    told = [{RECORD_KEY: record(bad).to_json()}, {RECORD_KEY: longer.to_json()}]
    assert record(bad).problems
    assert not longer.problems

    for order in (told, told[::-1]):
        assert latest_metadata(order) == {RECORD_KEY: record(bad).to_json()}


def test_what_was_not_measured_yet_at_first_is_of_the_same_run() -> None:
    first = record(TimingFigures(ticks=10, late=0, missed=0))
    told = [{RECORD_KEY: one.to_json()} for one in (first, record())]
    assert latest_metadata(told) == {RECORD_KEY: record().to_json()}


@pytest.mark.parametrize("figures", [GOOD, BAD])
def test_the_verdict_is_not_valid_if_and_only_if_a_limit_is_exceeded(
    tmp_path: Path, figures: TimingFigures
) -> None:
    told = record(figures)
    directory = make_result(tmp_path / "result", metadata={**METADATA, RECORD_KEY: told.to_json()})

    summary = load_result(directory).summary

    assert summary.timing == told.summary
    expected = judge_timing(figures, TimingLimits())
    assert [one for one in summary.problems if one.startswith("real time: ")] == expected
    assert summary.valid is (not expected)


def test_timing_is_told_even_where_nothing_could_be_estimated() -> None:
    metadata = {RECORD_KEY: record(BAD).to_json()}
    summary = conclude(
        [], metadata=metadata, joint_names=("shoulder", "elbow"), estimators=("welch_siso",)
    ).summary
    assert summary.timing == record(BAD).summary
    assert summary.problems[0] == record(BAD).problems[0]


def test_limits_come_from_the_parameters_of_the_estimator() -> None:
    assert EstimatorParameters().realtime.limits() == TimingLimits()


def test_the_report_has_a_timing_part_for_a_run_in_real_time_only(tmp_path: Path) -> None:
    paced = make_result(tmp_path / "a", metadata={**METADATA, RECORD_KEY: record(BAD).to_json()})
    plain = make_result(tmp_path / "b")

    page = report_page(load_result(paced))

    assert 'id="timing"' in page
    assert 'id="timing"' not in report_page(load_result(plain))
    part = page[page.index('id="timing"') :]
    part = part[: part.index("</section>")]
    for shown in ("1.000", "1.100", "2.500", "0.200", "0.400", "1.500", "0.150", "5.000", "2000"):
        assert shown in part
    assert (part.count("✓"), part.count("✗")) == (2, 1)
    assert "The computer was not quick or regular enough" in page
