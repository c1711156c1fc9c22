"""Tables of what was estimated, and how well."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TypeAlias

from armimp_estimation.json_model import Matrix
from armimp_estimation.report.formats import (
    NAMES,
    UNITS,
    code,
    difference,
    number,
    percent,
    symbol,
    uncertain,
)
from armimp_estimation.report.html import Group, Html, element, join, listing, section, table
from armimp_estimation.report.look import looks
from armimp_estimation.results import EstimatorSummary, Summary


def parameters_section(summary: Summary) -> Html:
    """M, B and K by every estimator, beside the truth if it is known."""
    remarks = [
        join([element("strong", look.label), " (", code(look.name), "): ", look.remark])
        for look in looks(summary.estimators).values()
        if look.remark
    ]
    return section(
        "parameters",
        "Inertia, viscosity and stiffness",
        element(
            "p",
            "Fit of ",
            element("var", "Z"),
            "(",
            element("var", "s"),
            ") = ",
            join((symbol("M"), element("var", " s"), element("sup", 2), " + ")),
            join((symbol("B"), element("var", " s"), " + ", symbol("K"))),
            " to every element of the impedance matrix; row: torque, column: angle. Estimates are "
            "± one standard error, which counts random errors only, not bias.",
        ),
        parameter_table(summary),
        listing(remarks, class_="note") if remarks else None,
    )


def parameter_table(summary: Summary) -> Html:
    """Table of the elements of M, B and K: true value, estimates ± standard error, errors."""
    known = summary.truth is not None
    columns: list[object] = ["element"]
    spans: list[tuple[object, int]] = [("", 1)]
    if known:
        columns.append("true value")
        spans.append(("Simulation", 1))
    for look in looks(summary.estimators).values():
        columns += ["estimate ± s.e.", "error" if known else "relative s.e."]
        spans.append((look.label, 2))
    groups = [
        Group(
            title=join([NAMES[letter], " ", symbol(letter), f" ({UNITS[letter]})"]),
            rows=list(_parameter_rows(summary, letter)),
        )
        for letter in ("M", "B", "K")
    ]
    return table("Estimates", columns, groups, spans=spans)


def _parameter_rows(summary: Summary, letter: str) -> Iterator[list[object]]:
    for i in range(summary.joints):
        for k in range(summary.joints):
            cells: list[object] = [symbol(letter, i + 1, k + 1)]
            true = None
            if summary.truth is not None:
                true = float(getattr(summary.truth, letter)[i][k])
                cells.append(number(true, ".5g"))
            for one in summary.estimators.values():
                value = float(getattr(one, letter)[i][k])
                error = float(getattr(one, f"{letter}_se")[i][k])
                cells.append(uncertain(value, error))
                if true is not None:
                    cells.append(difference(value, true))
                else:
                    cells.append(percent(abs(error / value)) if value else "–")
            yield cells


def scores_section(summary: Summary) -> Html:
    """Scores of every element."""
    return section("scores", "Scores", scores_table(summary), definitions(summary))


def scores_table(summary: Summary) -> Html:
    """Table of VAF (if the truth is known), R² and coherences of every element."""
    groups = [
        (look.label, _scores(summary.estimators[name]))
        for name, look in looks(summary.estimators).items()
    ]
    # No matter of the estimator, so once is enough.
    torque = [one.coherence_torque for one in summary.estimators.values()]
    groups += [("Signals", [(_gamma("torque"), values, ".4f")]) for values in torque[:1]]
    scores = [score for _, members in groups for score in members]
    rows = [
        [symbol("Z", i + 1, k + 1), *(number(values[i][k], spec) for _, values, spec in scores)]
        for i in range(summary.joints)
        for k in range(summary.joints)
    ]
    return table(
        "Scores of the elements",
        ["element", *(title for title, _, _ in scores)],
        [Group(rows=rows)],
        spans=[("", 1), *((label, len(members)) for label, members in groups)],
    )


_Score: TypeAlias = tuple[object, Matrix, str]
"""Title, values of the elements, and how to write them."""


def _scores(one: EstimatorSummary) -> list[_Score]:
    found: list[_Score] = [] if one.vaf is None else [("VAF %", one.vaf, ".2f")]
    found.append(("R²", one.r2, ".4f"))
    found.append((_gamma("derived"), one.coherence_derived, ".4f"))
    return found


def _gamma(kind: str) -> Html:
    return join([element("var", "γ"), "² ", kind])


def definitions(summary: Summary) -> Html:
    """What the scores mean."""
    terms: list[tuple[object, object]] = [
        ("R²", "how well M s² + B s + K describes the estimated curve; 1 is perfect."),
        (
            "γ² derived",
            "band mean of the share of the torque that the estimated impedance explains, with "
            "the feedback loop taken out. It stays near 1 when held joints move: see the locking.",
        ),
        ("γ² torque", "band mean of the ordinary coherence of perturbation and measured torque."),
    ]
    if summary.truth is not None:
        terms.insert(
            0,
            (
                "VAF",
                "share of the true curve that the estimate accounts for (simulation only). High "
                "frequencies dominate it: errors of B and K hardly show.",
            ),
        )
    pairs = (join([element("dt", term), element("dd", text)]) for term, text in terms)
    return element("dl", *pairs, class_="terms")
