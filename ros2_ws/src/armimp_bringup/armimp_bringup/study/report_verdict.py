"""The verdict of a study in words, and the worst value of everything beside its target."""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterator, Sequence
from typing import Any

from armimp_bringup.study.entry import StudyEntry
from armimp_bringup.study.verdict import COLUMNS, Column, StudyVerdict, WorstValue, values
from armimp_estimation.report.formats import NONE, mark, symbol
from armimp_estimation.report.look import Look, looks
from armimp_estimation.report.page import Table
from armimp_estimation.report.run import advised

_COLUMN = {column.quantity: column for column in COLUMNS}
_MOST_PROBLEMS = 10


def verdict_content(entries: Sequence[StudyEntry], verdict: StudyVerdict) -> dict[str, Any]:
    """Which targets are met and missed, by how much, and where the worst values are."""
    judged = [one for one in verdict.worst if one.met is not None]
    missed = [one for one in judged if not one.met]
    if verdict.met:
        title = "All targets met" if judged else "Valid; there are no targets for this"
    else:
        parts = [f"{len(missed)} of {len(judged)} targets missed"] if missed else []
        if verdict.problems:
            parts.append(f"{len(verdict.problems)} of {verdict.conditions} conditions not valid")
        title = ", ".join(parts)
    many = len({entry.seed for entry in entries}) > 1
    shown = verdict.problems[:_MOST_PROBLEMS]
    return {
        "title": title,
        "met": verdict.met,
        "joints": verdict.joints,
        "sentences": list(_sentences(verdict)),
        "problems": advised(shown),
        "more": len(verdict.problems) - len(shown),
        "worst": _worst_table(verdict, seeds=many),
        "seeds": _seeds_table(entries, verdict) if many else None,
    }


def _sentences(verdict: StudyVerdict) -> Iterator[tuple[Look, str]]:
    for name, look in looks(dict.fromkeys(one.estimator for one in verdict.worst)).items():
        ones = [one for one in verdict.worst if one.estimator == name]
        judged = [one for one in ones if one.met is not None]
        missed = [one for one in judged if not one.met]
        if not judged:
            text = "has no targets; it is shown for comparison."
        elif missed:
            far = "; ".join(_miss(one) for one in missed)
            text = f"misses {len(missed)} of {len(judged)} targets: {far}."
        else:
            worst = ", ".join(f"{one.quantity} {_bound(one)}" for one in judged)
            count = "its target" if len(judged) == 1 else f"all {len(judged)} targets"
            text = f"meets {count}: {worst}."
        yield look, text


def _bound(one: WorstValue) -> str:
    column = _COLUMN[one.quantity]
    return f"{'at least' if column.floor else 'at most'} {column.format(one.worst)}"


def _miss(one: WorstValue) -> str:
    column = _COLUMN[one.quantity]
    assert one.limit is not None  # otherwise nothing is missed
    target = f"{column.format(one.worst)} where {column.format(one.limit)} is asked for"
    if math.isnan(one.worst):
        return f"{one.quantity} is unknown in {one.place}"
    return f"{one.quantity} {target}, in {one.place}"


def _worst_table(verdict: StudyVerdict, *, seeds: bool) -> Table:
    groups = [
        (
            look.label,
            [_worst_row(one, seeds=seeds) for one in verdict.worst if one.estimator == name],
        )
        for name, look in looks(dict.fromkeys(one.estimator for one in verdict.worst)).items()
    ]
    columns = ["quantity", "worst", "target", "verdict", "element", "condition"]
    return Table(
        caption="Worst values and targets", columns=columns, groups=groups, words=(3, 4, 5)
    )


def _worst_row(one: WorstValue, *, seeds: bool) -> list[object]:
    column = _COLUMN[one.quantity]
    place = f"F{one.friction} R{one.resolution} P{one.perturbation}"
    return [
        _title(column),
        NONE if math.isnan(one.worst) else column.format(one.worst),
        limit(one),
        "not judged" if one.met is None else mark(one.met),
        symbol(one.element[0], one.element[1:]),
        f"{place}, seed {one.seed}" if seeds else place,
    ]


def _title(column: Column) -> str:
    return column.quantity.replace("scaled", "error, scaled")


def limit(one: WorstValue) -> str:
    """Target with its sign; a dash where there is none."""
    column = _COLUMN[one.quantity]
    if one.limit is None:
        return NONE
    return f"{'≥' if column.floor else '≤'} {one.limit:g}{column.unit}"


def _seeds_table(entries: Sequence[StudyEntry], verdict: StudyVerdict) -> Table:
    seeds = sorted({entry.seed for entry in entries})
    groups = []
    for name, look in looks(entries[0].estimators).items():
        rows = []
        for one in verdict.worst:
            if one.estimator == name:
                column = _COLUMN[one.quantity]
                worst = [_worst_of(entries, name, column, seed) for seed in seeds]
                worst.sort(key=column.badness)
                limited = one.limit
                met = NONE
                if limited is not None:
                    count = sum(column.meets(value, limited) for value in worst)
                    met = f"{count} of {len(seeds)}"
                shown = [worst[-1], statistics.median(worst), worst[0]]
                rows.append([_title(column), *map(column.format, shown), met])
        groups.append((look.label, rows))
    columns = ["worst value of a seed", "worst seed", "median seed", "best seed", "seeds in target"]
    return Table(caption=f"Spread over {len(seeds)} seeds", columns=columns, groups=groups)


def _worst_of(entries: Sequence[StudyEntry], estimator: str, column: Column, seed: int) -> float:
    return max(
        (
            value
            for entry in entries
            if entry.seed == seed
            for _, _, _, value in values(entry, estimator, column.quantity)
        ),
        key=column.badness,
    )
