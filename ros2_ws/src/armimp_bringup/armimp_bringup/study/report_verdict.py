"""The verdict of a study in words, and the worst value of everything beside its target."""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterator, Sequence

from armimp_bringup.study.entry import StudyEntry
from armimp_bringup.study.verdict import COLUMNS, Column, StudyVerdict, WorstValue, values
from armimp_estimation.report.advice import advise
from armimp_estimation.report.formats import NONE, code, symbol
from armimp_estimation.report.html import Group, Html, element, join, listing, section, table
from armimp_estimation.report.look import looks
from armimp_estimation.report.verdict_part import mark

_COLUMN = {column.quantity: column for column in COLUMNS}
_MOST_PROBLEMS = 10


def verdict_section(entries: Sequence[StudyEntry], verdict: StudyVerdict) -> Html:
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
    return section(
        "verdict",
        title,
        listing(_sentences(verdict)),
        None
        if verdict.joints == 2
        else element(
            "p",
            f"With {verdict.joints} joints, only the VAF of ",
            code("lpm_full"),
            " has a target. How far everything else is from the targets of two joints, and why: ",
            element("a", "accuracy of each element", href="#accuracy"),
            ".",
        ),
        *_problems(verdict),
        _worst_table(verdict, seeds=many),
        element(
            "p",
            "Each is the worst over all elements and conditions. Relative errors are those of an "
            "element of M, B or K against its true value; scaled ones are against "
            "√|",
            symbol("X", "ii"),
            " ",
            symbol("X", "kk"),
            "|, the size that an element has beside its diagonal. F, R and P are the levels of "
            "friction, resolution and perturbation.",
            class_="note",
        ),
        _seeds_table(entries, verdict) if many else None,
        class_="good" if verdict.met else "bad",
    )


def _sentences(verdict: StudyVerdict) -> Iterator[Html]:
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
        yield join([element("strong", look.label), " (", code(name), ") ", text])


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


def _problems(verdict: StudyVerdict) -> Iterator[Html]:
    shown = verdict.problems[:_MOST_PROBLEMS]
    for advice, sentences in advise(shown):
        yield element("h3", advice.title)
        yield listing(sentences, class_="problems")
        if advice.text:
            yield element("p", element("strong", "What to do: "), advice.text, class_="advice")
    if len(verdict.problems) > len(shown):
        yield element("p", f"And {len(verdict.problems) - len(shown)} more, see verdict.json.")


def _worst_table(verdict: StudyVerdict, *, seeds: bool) -> Html:
    groups = [
        Group(
            title=look.label,
            rows=[_worst_row(one, seeds=seeds) for one in verdict.worst if one.estimator == name],
        )
        for name, look in looks(dict.fromkeys(one.estimator for one in verdict.worst)).items()
    ]
    columns = ["quantity", "worst", "target", "verdict", "element", "condition"]
    return table("Worst values and targets", columns, groups, words=(3, 4, 5))


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


def _seeds_table(entries: Sequence[StudyEntry], verdict: StudyVerdict) -> Html:
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
        groups.append(Group(title=look.label, rows=rows))
    columns = ["worst value of a seed", "worst seed", "median seed", "best seed", "seeds in target"]
    return table(f"Spread over {len(seeds)} seeds", columns, groups)


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
