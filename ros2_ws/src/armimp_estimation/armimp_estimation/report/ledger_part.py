"""What became of every sample of every trial."""

from __future__ import annotations

from collections.abc import Iterator

from armimp_common import contract
from armimp_common.contract import PERIOD_NS
from armimp_estimation.report.formats import NONE, STREAMS, alarming, code, percent
from armimp_estimation.report.html import Group, Html, element, join, section, table
from armimp_estimation.report.result import Result, TrialEvidence
from armimp_estimation.report.trials_part import joint_label, trial_title


def ledger_section(result: Result) -> Html:
    """What became of every sample."""
    if not result.trials:
        rows = [
            [f"trial of {joint_label(result, trial.k)}", trial.ticks, trial.lost]
            for trial in result.summary.trials
        ]
        return section(
            "ledger",
            "Sample ledger",
            table("Samples", ["trial", "samples", "lost"], [Group(rows=rows)]),
            _note("The bags were not at hand; this is what the summary says."),
        )
    return section(
        "ledger",
        "Sample ledger",
        table(
            "Messages of each stream",
            [
                "stream",
                "expected",
                "received",
                "lost",
                "duplicated",
                "contradictory",
                "reordered",
                "late",
            ],
            [
                Group(title=trial_title(result, one), rows=list(_streams(one)))
                for one in result.trials
            ],
        ),
        _note(
            "Commands carry no time stamp: they are counted, but neither repetitions nor order "
            "show. Late samples are stamped over a quarter of a period after their time."
        ),
        _exclusions(result),
    )


def _streams(one: TrialEvidence) -> Iterator[list[object]]:
    for topic, count in one.assembled.ledger.streams.items():
        stamped = topic != contract.COMMANDS
        yield [
            join([STREAMS.get(topic, topic), element("span", " ", code(topic), class_="aside")]),
            count.expected,
            count.received,
            _noted(count.lost),
            *(
                _noted(number) if stamped else NONE
                for number in (count.duplicated, count.contradictory, count.reordered, count.late)
            ),
        ]


def _exclusions(result: Result) -> Html | None:
    """What no estimate uses, and why; nothing if all is used."""
    rows: list[list[object]] = []
    for one in result.trials:
        ledger = one.assembled.ledger
        if ledger.excluded or ledger.clipped:
            longest = max((part.samples for part in one.assembled.segments), default=0)
            rows.append(
                [
                    trial_title(result, one),
                    ledger.clipped,
                    _noted(ledger.excluded),
                    percent(ledger.excluded_share),
                    ledger.stretches,
                    f"{longest * PERIOD_NS / 1e9:.3f} s",
                    one.assembled.problem or "clipped commands",
                ]
            )
    if not rows:
        return None
    return join(
        [
            table(
                "Left out of all estimates",
                ["trial", "clipped", "samples", "share", "parts left", "longest", "why"],
                [Group(rows=rows)],
                words=(6,),
            ),
            _note(
                "Averaged spectra take segments from all parts that are left, and none that spans "
                "a gap. Estimators that transform a whole record take the longest part."
            ),
        ]
    )


def _noted(count: int) -> object:
    return alarming(count) if count else 0


def _note(text: str) -> Html:
    return element("p", text, class_="note")
