"""Plots of the report of a study: levels, and all curves over the truth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from armimp_bringup.study.conditions import LEVELS, Condition
from armimp_bringup.study.scores import Score, Table, statistics
from armimp_estimation.curves import ImpedanceCurve
from armimp_estimation.mbk import MBK
from armimp_estimation.report.formats import symbol
from armimp_estimation.report.look import LEVEL_DASHES, estimator_tag
from armimp_estimation.report.plots import (
    Axis,
    Chart,
    Line,
    Plot,
    Stroke,
    frequency_axis,
)
from armimp_estimation.report.result_plots import IMPEDANCE, TRUE, deviation_percent, phase_about

_TRUE: Final = replace(TRUE, width=2.0)
_TARGET: Final = Stroke(name="target", colour="--soft", dash="dash", width=1.2)
_GAP: Final = 0.6
_SYMBOLS: Final = ("circle", "square", "triangle-up", "diamond", "triangle-down", "cross", "x")
_SUBSCRIPTS: Final = str.maketrans("0123456789·", "₀₁₂₃₄₅₆₇₈₉.")


# --- levels ------------------------------------------------------------------------------------


def level_marks(table: Table, scores: Sequence[Score]) -> list[Stroke]:
    """Strokes of all marks of `levels_chart`, and that of the targets."""
    subjects = dict.fromkeys(one for score in scores for one in score.subjects(table))
    return [
        *(
            Stroke(
                name=f"{symbol}{indices.translate(_SUBSCRIPTS)}",
                colour=f"--element-{number % len(_SYMBOLS)}",
                symbol=_SYMBOLS[number % len(_SYMBOLS)],
            )
            for number, (symbol, indices) in enumerate(subjects)
        ),
        _TARGET,
    ]


def levels_chart(table: Table, scores: Sequence[Score]) -> Chart:
    """Scores of one estimator by level of each factor, as Figures 3 and 4 of the paper.

    Marks are means over all conditions with that level, bars reach from the worst to the best.

    Parameters
    ----------
    table : ndarray, shape (n_conditions, n, n)
        Results of one estimator.
    scores : sequence of Score
        One row each.
    """
    strokes = {stroke.name: stroke for stroke in level_marks(table, scores)}
    places: dict[str, float] = {}
    start = 0.0
    for factor in LEVELS:
        levels = np.unique(table[factor]).tolist()
        places |= {f"{factor[0].upper()}{one}": start + n for n, one in enumerate(levels)}
        start += len(levels) + _GAP
    ends = -0.6, start - _GAP - 0.4
    lines: list[Line] = []
    for row, score in enumerate(scores, 1):
        found = score.subjects(table)
        for order, ((letter, indices), values) in enumerate(found.items()):
            of_factors = [statistics(table, factor, values)[1:] for factor in LEVELS]
            mean, low, high = np.concatenate(of_factors, axis=1)
            lines.append(
                Line(
                    x=np.array([*places.values()]) + 0.7 * ((order + 0.5) / len(found) - 0.5),
                    y=mean,
                    stroke=strokes[f"{letter}{indices.translate(_SUBSCRIPTS)}"],
                    row=row,
                    unit=score.unit.strip(),
                    ends=(low, high),
                )
            )
        limit = score.limit(table.shape[-1], table["estimator"].flat[0])
        if limit is not None:
            lines.append(Line(x=np.array(ends), y=np.full(2, limit), stroke=_TARGET, row=row))
    short = {"VAF": "VAF (%)", "derived coherence": "derived γ²"}
    titles = (short.get(score.name, score.name.replace("coherence", "γ²")) for score in scores)
    abscissa = Axis(
        title="level of friction (F), resolution (R) and perturbation (P)",
        ends=ends,
        ticks=[*places.values()],
        labels=[*places],
    )
    rows = [(1.0, Axis(title=title, hoverformat=".5~g")) for title in titles]
    return Chart(abscissa=abscissa, rows=rows, lines=lines)


# --- curves ------------------------------------------------------------------------------------


def overlay_chart(
    curves: Mapping[Condition, Mapping[str, ImpedanceCurve]], truth: MBK, i: int, k: int
) -> Chart:
    """Fig. 2 for one element: magnitude, phase and error in all conditions over the truth.

    Parameters
    ----------
    curves : mapping of Condition to mapping of str to ImpedanceCurve
        By condition and estimator.
    truth : MBK
        True matrices.
    i, k : int
        Element, 0-based.
    """
    lines: list[Line] = []
    for condition, found in curves.items():
        levels = condition.levels
        words = ", ".join(f"{factor} {level}" for factor, level in levels.items())
        tags = [f"{factor}:{level}" for factor, level in levels.items()]
        for name, curve in found.items():
            z, centre = curve.Z[i, k], truth.impedance(curve.f)[i, k]
            stroke = replace(
                level_stroke(condition.friction, condition.resolution),
                name=f"{name}, {words}",
                tags=[estimator_tag(name), *tags],
            )
            for row, (values, unit) in enumerate(
                (
                    (np.abs(z), IMPEDANCE),
                    (phase_about(centre, z), "°"),
                    (deviation_percent(centre, z), "%"),
                ),
                1,
            ):
                lines.append(Line(x=curve.f, y=values, stroke=stroke, row=row, unit=unit))
    grid = max((curve.f for found in curves.values() for curve in found.values()), key=len)
    true = truth.impedance(grid)[i, k]
    phase = np.degrees(np.unwrap(np.angle(true)))
    lines.append(Line(x=grid, y=np.abs(true), stroke=_TRUE, unit=IMPEDANCE))
    lines.append(Line(x=grid, y=phase, stroke=_TRUE, row=2, unit="°"))
    ends = []
    for row in (1, 3):
        values = np.concatenate([one.y for one in lines if one.row == row and one.y is not None])
        ends.append((0.8 * float(values.min()), 1.25 * float(values.max())))
    rows = [
        (3.0, Axis(title="magnitude (N·m/rad)", ends=ends[0], log=True)),
        (2.0, Axis(title="phase (°)", step=90.0, hoverformat=".1f")),
        (2.0, Axis(title="error (%)", ends=ends[1], log=True, hoverformat=".3~g")),
    ]
    return Chart(abscissa=frequency_axis([grid]), rows=rows, lines=lines)


def level_stroke(friction: int | None = None, resolution: int | None = None) -> Stroke:
    """Stroke of one level or both: friction shows by the colour, resolution by the dashes."""
    return Stroke(
        name=f"resolution {resolution}" if friction is None else f"friction {friction}",
        colour="--soft" if friction is None else f"--level-{friction}",
        dash="solid" if resolution is None else LEVEL_DASHES[resolution],
        width=1.2,
    )


def overlay_plot(
    curves: Mapping[Condition, Mapping[str, ImpedanceCurve]], truth: MBK, i: int, k: int
) -> Plot:
    """Plot of a page with the chart of `overlay_chart`."""
    return Plot(
        identifier=f"overlay-{i + 1}-{k + 1}",
        caption=symbol("Z", i + 1, k + 1),
        description=f"Estimates of Z {i + 1} {k + 1} in all conditions over the truth.",
        # One box for all lines would cover the plot.
        views=[overlay_chart(curves, truth, i, k).view(hovermode="closest")],
        height=470,
    )
