"""Statistics of timing: quantiles, counts, and the verdict."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from armimp_common.diagnostics import format_value
from armimp_common.errors import ConfigurationError, MalformedMessageError
from armimp_common.jitter import (
    LATE_NS,
    Spread,
    TimingFigures,
    TimingLedger,
    TimingLimits,
    judge_timing,
)

MS = 1_000_000
GOOD = TimingFigures(
    ticks=1000,
    late=10,
    missed=10,
    period_p50=1e-3,
    period_p99=1.2e-3,
    period_max=2e-3,
    latency_p50=2e-4,
    latency_p99=1e-3,
    latency_max=2e-3,
)


def spread(durations: list[int]) -> Spread:
    made = Spread()
    for duration in durations:
        made.add(duration)
    return made


@given(st.lists(st.integers(0, 10**11), min_size=1, max_size=200), st.floats(0.0, 1.0))
def test_quantiles_are_those_of_the_durations_rounded_up_by_two_per_cent_at_most(
    durations: list[int], share: float
) -> None:
    exact = sorted(durations)[max(math.ceil(share * len(durations)), 1) - 1]
    found = spread(durations).quantile(share) * 1e9
    assert found >= exact * (1.0 - 1e-9)
    assert found <= max(exact * 1.0201, 1000.0)


def test_the_longest_duration_is_exact_however_long() -> None:
    made = spread([5, 10**15 + 1, 7])
    assert made.longest == (10**15 + 1) / 1e9
    assert made.quantile(1.0) == made.longest
    assert made.count == 3


def test_without_durations_there_is_no_quantile() -> None:
    assert math.isnan(Spread().quantile(0.5))
    assert math.isnan(Spread().longest)


def test_quantiles_of_many_durations_agree_with_numpy() -> None:
    durations = np.random.default_rng(1).gamma(3.0, 3e5, 20_000).astype(int)
    made = spread(durations.tolist())
    for share in (0.5, 0.99):
        assert made.quantile(share) * 1e9 == pytest.approx(np.quantile(durations, share), rel=0.021)


def test_ledger_counts_samples_late_ones_and_missed_commands() -> None:
    ledger = TimingLedger()
    for tick, lateness in enumerate((0, LATE_NS, LATE_NS + 1, 5 * MS, 10)):
        ledger.sent(tick * MS, tick * MS + lateness)
    ledger.missed()
    figures = ledger.figures()
    assert (figures.ticks, figures.late, figures.missed) == (5, 2, 1)


def test_ledger_measures_from_sample_to_sample_and_from_sample_to_command() -> None:
    ledger = TimingLedger()
    for sent in (0, 1 * MS, 2 * MS, 3 * MS, 7 * MS):
        ledger.sent(sent, sent)
    for latency in (200_000, 300_000, 1_500_000):
        ledger.answered(latency)
    figures = ledger.figures()
    assert figures.period_p50 == pytest.approx(1e-3, rel=0.021)
    assert figures.period_max == 4e-3
    assert figures.latency_p50 == pytest.approx(3e-4, rel=0.021)
    assert figures.latency_max == 1.5e-3


def test_new_ledger_has_measured_nothing() -> None:
    figures = TimingLedger().figures()
    assert (figures.ticks, figures.late_share, figures.missed_share) == (0, 0.0, 0.0)
    assert math.isnan(figures.period_p50)


def test_figures_survive_the_way_through_a_status() -> None:
    values = {key: format_value(value) for key, value in GOOD.to_values().items()}
    assert TimingFigures.from_values({**values, "more": "x"}) == GOOD
    empty = {
        key: format_value(value) for key, value in TimingLedger().figures().to_values().items()
    }
    assert math.isnan(TimingFigures.from_values(empty).latency_max)


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"late": "many"}, "invalid literal"),
        ({"late": "-1"}, "late must lie between 0"),
        ({"missed": "1001"}, "missed must lie between 0 and the number of samples, 1000, got 1001"),
        ({"period_max": "long"}, "could not convert"),
    ],
)
def test_figures_that_make_no_sense_are_refused(change: dict[str, str], complaint: str) -> None:
    values = {key: format_value(value) for key, value in GOOD.to_values().items()}
    with pytest.raises(MalformedMessageError, match=complaint):
        TimingFigures.from_values({**values, **change})


@pytest.mark.parametrize("key", GOOD.to_values())
def test_figures_that_are_missing_are_named(key: str) -> None:
    values = {name: format_value(v) for name, v in GOOD.to_values().items() if name != key}
    with pytest.raises(MalformedMessageError, match=f"timing: {key} is missing"):
        TimingFigures.from_values(values)


def test_more_late_samples_than_samples_are_refused() -> None:
    with pytest.raises(ConfigurationError, match="late must lie between 0"):
        TimingFigures(ticks=1, late=2, missed=0)


def test_a_run_at_its_limits_has_no_problem() -> None:
    assert judge_timing(GOOD, TimingLimits()) == []


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (
            {"late": 11},
            "real time: 11 of 1000 samples were sent more than 0.25 ms late, 1.1 % (limit 1 %)",
        ),
        (
            {"missed": 11},
            "real time: 11 of 1000 commands did not come in time, 1.1 % (limit 1 %)",
        ),
        (
            {"latency_p99": 1.2e-3},
            "real time: the 99 % quantile of the time from a sample to its command is 1.2 ms "
            "(limit 1 ms)",
        ),
    ],
)
def test_what_is_beyond_a_limit_is_said_with_value_and_limit(
    change: dict[str, float], sentence: str
) -> None:
    changed = replace(GOOD, **change)  # type: ignore[arg-type]
    assert judge_timing(changed, TimingLimits()) == [sentence]


def test_a_latency_that_was_never_measured_is_a_problem() -> None:
    assert len(judge_timing(replace(GOOD, latency_p99=math.nan), TimingLimits())) == 1
