"""The timing of a run in real time."""

from __future__ import annotations

from armimp_common.jitter import LATE_NS
from armimp_estimation.report.formats import number, percent
from armimp_estimation.report.html import Group, Html, element, section, table
from armimp_estimation.report.verdict_part import mark
from armimp_estimation.results import Summary


def timing_section(summary: Summary) -> Html | None:
    """How regular samples were, and how quickly commands came; None for a run in lockstep."""
    timing = summary.timing
    if timing is None:
        return None
    ticks = max(timing.ticks, 1)
    spreads: list[list[object]] = [
        [
            "time between samples",
            *map(_milliseconds, (timing.period_p50, timing.period_p99, timing.period_max)),
            "",
            "",
        ],
        [
            "from a sample to its command",
            *map(_milliseconds, (timing.latency_p50, timing.latency_p99, timing.latency_max)),
            f"99 % ≤ {_milliseconds(timing.max_latency)}",
            mark(timing.latency_p99 <= timing.max_latency),
        ],
    ]
    counts: list[list[object]] = [
        [what, count, percent(count / ticks, ".3f"), f"≤ {percent(limit)}", mark(met)]
        for what, count, limit, met in (
            (
                "samples sent late",
                timing.late,
                timing.max_late_share,
                timing.late / ticks <= timing.max_late_share,
            ),
            (
                "commands not in time",
                timing.missed,
                timing.max_missed_share,
                timing.missed / ticks <= timing.max_missed_share,
            ),
        )
    ]
    return section(
        "timing",
        "Timing",
        element(
            "p",
            f"The run was paced by the wall clock: {timing.ticks} samples, of all trials and of "
            "what lies between them. A sample is late if it was sent more than "
            f"{_milliseconds(LATE_NS / 1e9)} after its time. Where a command did not come within "
            "one period, the last one was held.",
        ),
        table(
            "Jitter",
            ["duration", "median", "99 %", "longest", "limit", "verdict"],
            [Group(rows=spreads)],
            words=(5,),
        ),
        table(
            "Late and missed",
            ["what", "count", "share", "limit", "verdict"],
            [Group(rows=counts)],
            words=(4,),
        ),
    )


def _milliseconds(seconds: float) -> str:
    return number(1e3 * seconds, ".3f", "ms")
