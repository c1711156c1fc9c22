"""The verdict in words, and how far the result is from every limit."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from armimp_estimation.json_model import Matrix
from armimp_estimation.report.advice import advise
from armimp_estimation.report.formats import alarming, number, percent, symbol
from armimp_estimation.report.html import Group, Html, element, join, listing, section, table
from armimp_estimation.report.look import looks
from armimp_estimation.report.result import Result
from armimp_estimation.results import Summary
from armimp_estimation.verdict import Limits


def verdict_section(result: Result) -> Html:
    """Verdict, problems with advice, and the worst value of each score beside its limit."""
    summary = result.summary
    if summary.valid:
        title, content = "Valid", [element("p", _praise(summary))]
    else:
        count = len(summary.problems)
        title = f"Not valid: {count} problem{'' if count == 1 else 's'}"
        use = (
            "The numbers below are shown for diagnosis; do not use them as a result."
            if summary.estimators
            else "Nothing could be estimated, so there are no matrices and no curves."
        )
        content = [element("p", use), *(_problems(summary.problems))]
    if result.notes:
        content += [element("h3", "Remarks"), listing(result.notes)]
    if summary.estimators:
        content.append(_limits_table(result))
    return section("verdict", title, *content, class_="good" if summary.valid else "bad")


def _praise(summary: Summary) -> str:
    count = {2: "Both", 3: "All three"}.get(summary.joints, f"All {summary.joints}")
    return (
        f"{count} trials are complete, the held joints stayed still, and every "
        "element of the impedance matrix is coherent and has the form of inertia, viscosity and "
        "stiffness."
        if summary.joints > 1
        else "The trial is complete, and the impedance is coherent and has the form of inertia, "
        "viscosity and stiffness."
    )


def _problems(problems: Sequence[str]) -> Iterator[Html]:
    for advice, sentences in advise(problems):
        yield element("h3", advice.title)
        # A number and its unit stay on one line.
        unbroken = (sentence.replace(" %", "\N{NO-BREAK SPACE}%") for sentence in sentences)
        yield listing(unbroken, class_="problems")
        if advice.text:
            yield element("p", element("strong", "What to do: "), advice.text, class_="advice")


def _limits_table(result: Result) -> Html:
    rows = [
        [
            check.name,
            check.worst,
            check.limit,
            "not judged" if check.met is None else mark(check.met),
            check.where,
        ]
        for check in (*_locking(result), *_coherence(result), *_fits(result), _samples(result))
    ]
    columns = ["quantity", "worst", "limit", "verdict", "where"]
    return table("Worst values and limits", columns, [Group(rows=rows)], words=(3, 4))


def mark(met: bool) -> object:
    """Mark that a limit is met or not."""
    return "✓\N{NO-BREAK SPACE}within" if met else alarming("✗\N{NO-BREAK SPACE}beyond")


@dataclass(frozen=True, kw_only=True)
class _Check:
    """The worst value of one kind; `met` is None for what is not judged."""

    name: object
    worst: str
    where: object = ""
    limit: str = ""
    met: bool | None = None


_Found = tuple[float, object]
"""A value, and where it was found."""


def _locking(result: Result) -> Iterator[_Check]:
    limits, names, trials = Limits(), result.joint_names, result.summary.trials
    locks: list[_Found] = []
    bounds: list[_Found] = []
    for trial in trials:
        k = trial.k - 1
        for i, (name, ratio) in enumerate(zip(names, trial.lock_ratio, strict=False)):
            if i != k < len(names):
                locks.append((ratio, f"{name}, while {names[k]} is perturbed"))
        bounds += [(v, symbol("Z", i + 1, trial.k)) for i, v in enumerate(trial.bias_bound)]
    if locks:
        worst, where = _largest(locks)
        yield _Check(
            name="motion of held joints",
            worst=percent(worst),
            where=where,
            limit=f"≤ {percent(limits.lock_ratio, '.3g')}",
            met=worst <= limits.lock_ratio,
        )
        worst, where = _largest(bounds)
        yield _Check(
            name="bias that this may cause",
            worst=percent(worst),
            where=where,
            limit=f"≤ {percent(limits.bias_bound, '.3g')}",
            met=worst <= limits.bias_bound,
        )


def _coherence(result: Result) -> Iterator[_Check]:
    names, level = result.joint_names, result.significance
    first = next(iter(result.summary.estimators.values()))
    found: list[_Found] = [
        (value, f"angle, {names[k]} perturbed") for k, value in enumerate(first.coherence_motion)
    ]
    found += [
        (value, f"torque of {names[i]}, {names[k]} perturbed")
        for i, row in enumerate(first.coherence_torque)
        for k, value in enumerate(row)
    ]
    worst, where = _smallest(found)
    yield _Check(
        name="coherence with perturbation",
        worst=number(worst, ".4f"),
        where=where,
        limit="" if level is None else f"> {number(level, '.2f')}",
        met=None if level is None else worst > level,
    )


def _fits(result: Result) -> Iterator[_Check]:
    estimators = result.summary.estimators
    names = looks(estimators)
    derived: list[_Found] = []
    fits: list[_Found] = []
    lacks: list[_Found] = []
    limit = math.nan
    accounted: list[_Found] = []
    for name, one in estimators.items():
        derived += _elements(one.coherence_derived, names[name].label)
        fits += _elements(one.r2, names[name].label)
        # Of the others, bias is known to be part of the misfit.
        if name == "lpm_full":
            lacks += _elements(one.lack_of_fit, names[name].label)
            limit = one.lack_limit
        accounted += [] if one.vaf is None else _elements(one.vaf, names[name].label)
    if lacks:
        worst, where = _largest(lacks)
        yield _Check(
            name="lack of fit",
            worst=number(worst, ".2f"),
            where=where,
            limit=f"≤ {number(limit)}",
            met=worst <= limit,
        )
    for title, values in (("derived coherence", derived), ("R² of the fit", fits)):
        worst, where = _smallest(values)
        yield _Check(name=title, worst=number(worst, ".4f"), where=where)
    if accounted:
        worst, where = _smallest(accounted)
        yield _Check(name="VAF (simulation)", worst=number(worst, ".2f", "%"), where=where)


def _samples(result: Result) -> _Check:
    lost = sum(trial.lost for trial in result.summary.trials)
    return _Check(name="lost samples", worst=str(lost), limit="0", met=not lost)


def _elements(values: Matrix, estimator: str) -> list[_Found]:
    return [
        (value, join([symbol("Z", i + 1, k + 1), ", ", estimator]))
        for i, row in enumerate(values)
        for k, value in enumerate(row)
    ]


# What is not a number is worse than any number.
def _largest(values: Sequence[_Found]) -> _Found:
    return max(values, key=lambda pair: math.inf if math.isnan(pair[0]) else pair[0])


def _smallest(values: Sequence[_Found]) -> _Found:
    return min(values, key=lambda pair: -math.inf if math.isnan(pair[0]) else pair[0])
