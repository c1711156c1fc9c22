"""Accuracy by element of the matrix, beside the sizes of the elements."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from armimp_bringup.study.report_plots import Panel, heat_map
from armimp_bringup.study.store import StudyEntry
from armimp_bringup.study.table import (
    LETTERS,
    FloatArray,
    scale,
)
from armimp_bringup.study.table import Table as Results
from armimp_bringup.study.verdict import QUANTITIES, Scale, targets
from armimp_estimation.mbk import MBK
from armimp_estimation.report.formats import NONE, UNITS, number, symbol
from armimp_estimation.report.page import Content, Table
from armimp_estimation.report.plots import Plot, View
from armimp_estimation.summary import NORMAL_95


@dataclass(frozen=True, kw_only=True, eq=False)
class ElementErrors:
    """Errors of one matrix by one estimator.

    Attributes
    ----------
    letter : str
        M, B or K.
    true : ndarray, shape (n, n)
        True values, SI units.
    size : ndarray, shape (n, n)
        ``|X_ij| / sqrt(|X_ii X_jj|)``, %.
    relative, scaled : ndarray, shape (n, n)
        Largest error of all conditions without its sign, %.
    covered : float
        Share of all errors that are within 1.96 standard errors.
    yardstick : float
        Relative error that is allowed with two joints, %; NaN for estimators without targets.
    """

    letter: str
    true: FloatArray
    size: FloatArray
    relative: FloatArray
    scaled: FloatArray
    covered: float
    yardstick: float


def element_errors(table: Results, truth: MBK, letter: str) -> ElementErrors:
    """Errors of a matrix over all conditions, from the results (n_conditions, n, n) of one."""
    true = getattr(truth, letter)
    limits = targets(2, table["estimator"].flat[0])
    with np.errstate(divide="ignore", invalid="ignore"):
        size = 100.0 * np.abs(true) / scale(true)
    off = np.abs(table[letter] - true)
    return ElementErrors(
        letter=letter,
        true=true,
        size=size,
        relative=np.abs(table[f"{letter}_error_percent"]).max(axis=0),
        scaled=np.abs(table[f"{letter}_scaled_error_percent"]).max(axis=0),
        covered=float(np.mean(off <= NORMAL_95 * table[f"{letter}_se"])),
        yardstick=limits.get("B error" if letter == "B" else "M, K error", math.nan),
    )


def accuracy_content(entries: Sequence[StudyEntry], table: Results) -> Content:
    """Largest errors of each element and their reasons."""
    first = entries[0]
    assert first.truth is not None  # these are simulations
    truth = first.truth.mbk()
    groups, plots = [], []
    for name, of_estimator in zip(first.estimators, np.moveaxis(table, 1, 0), strict=True):
        found = [element_errors(of_estimator, truth, letter) for letter in LETTERS]
        groups.append((name, [_row(one) for one in found]))
        plots.append(
            Plot(
                identifier=f"elements-{name.replace('_', '-')}",
                caption=name,
                description=f"Largest errors of each element by {name}.",
                views=_maps(of_estimator, found),
                height=130 + 34 * first.joints,
            )
        )
    columns = ["matrix", "allowed with two joints"]
    columns += ["within", "worst", "element"] * 2 + ["within 1.96 s.e."]
    spans = [("", 2), ("relative error", 3), ("scaled error", 3), ("", 1)]
    caption = "Largest errors of M, B and K"
    return {
        "table": Table(caption=caption, columns=columns, groups=groups, spans=spans),
        "plots": plots,
    }


def _percent(value: float) -> str:
    return number(value, _spec(value), "%")


def _spec(value: float) -> str:
    """Three significant digits, without an exponent."""
    return f".{0 if value >= 100.0 else 1 if value >= 10.0 else 2}f"


def _row(errors: ElementErrors) -> list[object]:
    row: list[object] = [symbol(errors.letter), number(errors.yardstick, "g", "%")]
    for worst in (errors.relative, errors.scaled):
        i, k = np.unravel_index(int(np.argmax(worst)), worst.shape)
        within = f"{int((worst <= errors.yardstick).sum())} of {worst.size}"
        row += [
            NONE if math.isnan(errors.yardstick) else within,
            _percent(float(worst[i, k])),
            symbol(errors.letter, f"{i + 1}{k + 1}"),
        ]
    return [*row, number(100.0 * errors.covered, ".0f", "%")]


def _maps(table: Results, errors: Sequence[ElementErrors]) -> list[View]:
    """Maps of the errors of M, B and K, and of the worst scores, by element."""
    n = table.shape[-1]
    names, titles = [f"{index + 1}" for index in range(n)], ("torque of joint", "angle of joint")

    def notes(one: ElementErrors) -> list[list[list[str]]]:
        return [
            [
                [
                    f"{one.letter}{i + 1}{k + 1} = {number(float(one.true[i, k]), '.4g')} "
                    f"{UNITS[one.letter]}",
                    f"relative error {_percent(float(one.relative[i, k]))}, "
                    f"scaled {_percent(float(one.scaled[i, k]))}",
                ]
                for k in range(n)
            ]
            for i in range(n)
        ]

    views = [
        heat_map(
            name,
            names,
            [
                Panel(
                    title=f"{one.letter} ({UNITS[one.letter]})",
                    columns=names,
                    values=getattr(one, kind),
                    notes=notes(one),
                )
                for one in errors
            ],
            Scale(unit=" %", floor=kind == "size", digits=2),
            titles=titles,
            written=lambda value: number(value, _spec(value)),
        )
        for name, kind in (
            ("relative error", "relative"),
            ("scaled error", "scaled"),
            ("size beside the diagonal", "size"),
        )
    ]
    for quantity in QUANTITIES:
        if quantity.floor:
            values = quantity.values(table)[:, 0]
            worst = np.where(np.isnan(values).any(axis=0), np.nan, values.min(axis=0))
            nothing: list[list[list[str]]] = [[[] for _ in names] for _ in names]
            panel = Panel(title=quantity.name, columns=names, values=worst, notes=nothing)
            limit = targets(n, table["estimator"].flat[0]).get(quantity.name)
            views.append(
                heat_map(quantity.name, names, [panel], quantity, titles=titles, limit=limit)
            )
    return views
