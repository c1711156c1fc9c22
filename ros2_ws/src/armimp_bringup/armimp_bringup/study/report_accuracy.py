"""Accuracy by element of the matrix, and in words why some elements are less accurate."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armimp_bringup.study.accuracy import (
    LETTERS,
    ElementErrors,
    Resolvable,
    element_errors,
    inertia_vaf,
    resolvable,
)
from armimp_bringup.study.entry import StudyEntry
from armimp_bringup.study.heat_maps import Cell, HeatMap, Panel, heat_map_view
from armimp_bringup.study.verdict import COLUMNS, targets, values
from armimp_estimation.report.formats import UNITS, number, symbol
from armimp_estimation.report.look import looks
from armimp_estimation.report.page import Table
from armimp_estimation.report.plots import Plot, View

FloatArray = NDArray[np.float64]

_SCORES = ("VAF", "R²", "derived coherence")


def accuracy_content(entries: Sequence[StudyEntry]) -> dict[str, Any] | None:
    """Largest errors of each element and their reasons; None without a truth."""
    errors = {
        name: [found for letter in LETTERS if (found := element_errors(entries, name, letter))]
        for name in looks(entries[0].estimators)
    }
    if not all(errors.values()):
        return None
    labels = looks(errors)
    return {
        "table": _table(errors),
        "estimators": [
            (labels[name].label, list(explanation(entries, name, found)))
            for name, found in errors.items()
        ],
        "plots": [_map(entries, name, found) for name, found in errors.items()],
    }


def explanation(
    entries: Sequence[StudyEntry], estimator: str, errors: Sequence[ElementErrors]
) -> Iterator[str]:
    """Say how accurate an estimator is and why not more, in sentences from the numbers alone."""
    yield _about_vaf(entries, estimator)
    if math.isnan(errors[0].yardstick):
        return
    beyond = [one for one in errors if one.beyond.any()]
    if not beyond:
        yield "Every element of M, B and K is within the error that is allowed with two joints."
        return
    seen = resolvable(entries)
    for one in beyond:
        yield _about_size(one)
        if one.letter == "K" and seen is not None:
            yield _about_counts(one, seen)
    shares = ", ".join(f"{100.0 * one.covered:.0f} % (of {one.letter})" for one in errors)
    yield (
        "Noise alone would leave 95 % of all errors within 1.96 standard errors; it is "
        f"{shares}. A share far below that means bias, however small the errors may be."
    )


def _about_vaf(entries: Sequence[StudyEntry], estimator: str) -> str:
    found = [one for entry in entries for one in values(entry, estimator, "VAF")]
    name, _, _, worst = min(found, key=lambda one: -math.inf if math.isnan(one[3]) else one[3])
    text = f"VAF is at least {worst:.3f} % ({name})"
    limit = targets(entries[0].joints).get(estimator, {}).get("VAF")
    if limit is not None:
        far = worst - limit
        side = "above" if far >= 0.0 else "below"
        text += f", {abs(far):.3f} points {side} the target"
    truth = entries[0].truth
    assert truth is not None  # the caller knows
    bare = inertia_vaf(truth.mbk())
    return (
        f"{text}. It mostly tells of M: with the true M alone, and B = K = 0, it would be "
        f"{np.median(bare):.1f} % in the median element ({np.min(bare):.1f} to "
        f"{np.max(bare):.1f} %)."
    )


def _about_size(errors: ElementErrors) -> str:
    letter, beyond = errors.letter, errors.beyond
    count, total = int(beyond.sum()), beyond.size
    i, k = np.unravel_index(int(np.argmax(errors.relative)), errors.relative.shape)
    off = count - int(np.diag(beyond).sum())
    size = float(np.median(errors.size[beyond]))
    sizes = f"has a median of {_percent(size)} there"
    small = ""
    if count < total:
        others = float(np.median(errors.size[~beyond]))
        sizes += f" and of {_percent(others)} elsewhere"
        small = "They are small beside their diagonal: " if size < others else ""
    return (
        f"{letter} is more than {errors.yardstick:g} % wrong in {count} of {total} elements, "
        f"{off} of them off the diagonal. {small}"
        f"|{letter}ij|/√|{letter}ii {letter}jj| {sizes}. The worst, {letter}{i + 1}{k + 1} = "
        f"{number(float(errors.true[i, k]), '.3g')} {UNITS[letter]}, is wrong by "
        f"{_percent(float(errors.relative[i, k]))} of itself, which is "
        f"{_percent(float(errors.scaled[i, k]))} on the scale of its diagonal; no element is wrong "
        f"by more than {_percent(float(np.max(errors.scaled)))} on that scale."
    )


def _about_counts(errors: ElementErrors, seen: Resolvable) -> str:
    counts = seen.stiffness_torque / seen.count
    below = counts < 1.0
    i, k = np.unravel_index(int(np.argmin(counts)), counts.shape)
    shared = int((below & errors.beyond).sum())
    return (
        f"At the smallest perturbation and the coarsest resolution, {int(below.sum())} of "
        f"{below.size} elements of K never make a static torque of one count of the transducer "
        f"({seen.count:g} N·m); {shared} of those {int(errors.beyond.sum())} are among them. "
        f"K{i + 1}{k + 1} makes {counts[i, k]:.2g} counts. The perturbation of the last joint "
        f"peaks at {seen.peak[-1]:g} N·m, {seen.peak[-1] / seen.count:.1f} counts."
    )


def _percent(value: float) -> str:
    """Three significant digits, without an exponent."""
    digits = 0 if value >= 100.0 else 1 if value >= 10.0 else 2
    return number(value, f".{digits}f", "%")


def _table(errors: dict[str, list[ElementErrors]]) -> Table:
    columns = ["matrix", "allowed with two joints"]
    columns += ["within", "worst", "element", "within", "worst", "element"]
    groups = [
        (look.label, [_row(one) for one in errors[name]]) for name, look in looks(errors).items()
    ]
    return Table(
        caption="Largest errors of M, B and K",
        columns=columns,
        groups=groups,
        spans=[("", 2), ("relative error", 3), ("scaled error", 3)],
    )


def _row(errors: ElementErrors) -> list[object]:
    row: list[object] = [symbol(errors.letter), number(errors.yardstick, "g", "%")]
    for worst in (errors.relative, errors.scaled):
        i, k = np.unravel_index(int(np.argmax(worst)), worst.shape)
        within = int((worst <= errors.yardstick).sum())
        row += [
            "–" if math.isnan(errors.yardstick) else f"{within} of {worst.size}",
            _percent(float(worst[i, k])),
            symbol(errors.letter, f"{i + 1}{k + 1}"),
        ]
    return row


def _map(entries: Sequence[StudyEntry], estimator: str, errors: Sequence[ElementErrors]) -> Plot:
    n = entries[0].joints
    names = [str(index + 1) for index in range(n)]

    def panels(kind: str) -> list[Panel]:
        return [
            Panel(
                title=f"{one.letter} ({UNITS[one.letter]})",
                columns=names,
                cells=[
                    [_cell(one, float(getattr(one, kind)[i, k]), i, k) for k in range(n)]
                    for i in range(n)
                ],
            )
            for one in errors
        ]

    def view(
        name: str, found: list[Panel], unit: str, *, floor: bool, limit: float | None, log: bool
    ) -> View:
        return heat_map_view(
            HeatMap(
                name=name,
                rows=names,
                panels=found,
                floor=floor,
                limit=limit,
                unit=unit,
                row_title="torque of joint",
                column_title="angle of joint",
                logarithmic=log,
            )
        )

    views = [
        view("relative error", panels("relative"), " %", floor=False, limit=None, log=True),
        view("scaled error", panels("scaled"), " %", floor=False, limit=None, log=True),
        view("size beside the diagonal", panels("size"), " %", floor=True, limit=None, log=True),
    ]
    for column in COLUMNS:
        if column.quantity in _SCORES:
            worst = np.full((n, n), math.inf)
            for entry in entries:
                for _, i, k, value in values(entry, estimator, column.quantity):
                    worst[i, k] = min(worst[i, k], value)
            cells = [
                [
                    Cell(
                        value=float(value),
                        written=column.format(value).removesuffix(column.unit),
                    )
                    for value in row
                ]
                for row in worst
            ]
            limit = targets(n).get(estimator, {}).get(column.quantity)
            panel = Panel(title=column.quantity, columns=names, cells=cells)
            one = view(column.quantity, [panel], column.unit, floor=True, limit=limit, log=False)
            views.append(one)
    return Plot(
        identifier=f"elements-{estimator.replace('_', '-')}",
        caption=looks([estimator])[estimator].label,
        description=f"Largest errors of each element by {estimator}.",
        views=views,
        height=130 + 34 * n,
    )


def _cell(errors: ElementErrors, value: float, i: int, k: int) -> Cell:
    name = f"{errors.letter}{i + 1}{k + 1}"
    written = "–" if math.isnan(value) else _percent(value).split("\N{NARROW NO-BREAK SPACE}")[0]
    notes = [
        f"{name} = {number(float(errors.true[i, k]), '.4g')} {UNITS[errors.letter]}",
        f"relative error {_percent(float(errors.relative[i, k]))}, "
        f"scaled {_percent(float(errors.scaled[i, k]))}",
    ]
    return Cell(value=value, written=written, notes=notes)
