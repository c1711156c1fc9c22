"""Figures 2 to 4 of the paper from a study: for its report, and as PNG and PDF."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.figure import Figure

from armimp_bringup.bench import available_cores
from armimp_bringup.study import LEVELS, Condition
from armimp_bringup.study.engine import processes
from armimp_bringup.study.scores import COHERENCE_SCORES, FIT_SCORES, Score, Table
from armimp_common.arrays import BoolArray
from armimp_estimation.figures import TWO_COLUMNS, element_figure, matrix_figure, save_figure
from armimp_estimation.mbk import MBK
from armimp_estimation.report.plots import (
    IMPEDANCE,
    LEVEL_DASHES,
    TRUE,
    Axis,
    Chart,
    Line,
    Stroke,
    deviation_percent,
    estimator_tag,
    frequency_axis,
    phase_about,
)
from armimp_estimation.summary import ImpedanceCurve

Curves = Callable[[Condition], Mapping[str, ImpedanceCurve]]
_Drawing = tuple[str, str, Callable[[], Figure]]
"""Name, what it shows, and the function that draws it."""

_LEAST_PANEL: Final = 2.3  # inches, least width; with many joints Figure 2 is a poster
_WORTH_A_PROCESS: Final = 3
"""Number of figures that take longer to draw than another process takes to start."""

_TRUE: Final = replace(TRUE, width=2.0)
_TARGET: Final = Stroke(name="target", colour="--soft", dash="dash", width=1.2)
_GAP: Final = 0.6
_SYMBOLS: Final = ("circle", "square", "triangle-up", "diamond", "triangle-down", "cross", "x")


# --- levels ------------------------------------------------------------------------------------


def level_marks(table: Table, scores: Sequence[Score]) -> list[Stroke]:
    """Return the strokes of all marks of `levels_chart`, and that of the targets."""
    subjects = dict.fromkeys(one for score in scores for one in score.subjects(table))
    return [
        *(
            Stroke(
                name=name,
                colour=f"--element-{number % len(_SYMBOLS)}",
                symbol=_SYMBOLS[number % len(_SYMBOLS)],
            )
            for number, name in enumerate(subjects)
        ),
        _TARGET,
    ]


def levels_chart(table: Table, scores: Sequence[Score]) -> Chart:
    """Return a chart of scores by level of each factor, as in Figures 3 and 4 of the paper.

    Marks are means over all conditions with that level; bars reach from the worst to the best.

    Parameters
    ----------
    table : (n_conditions, n, n), results of one estimator
    scores : one row each
    """
    strokes = {stroke.name: stroke for stroke in level_marks(table, scores)}
    places: dict[str, float] = {}
    members: list[BoolArray] = []
    start = 0.0
    for factor in LEVELS:
        of_conditions = table[factor][:, 0, 0]
        levels = np.unique(of_conditions).tolist()
        places |= {f"{factor[0].upper()}{one}": start + n for n, one in enumerate(levels)}
        members += [of_conditions == one for one in levels]
        start += len(levels) + _GAP
    ends = -0.6, start - _GAP - 0.4
    lines: list[Line] = []
    for row, score in enumerate(scores, 1):
        found = score.subjects(table)
        for order, (name, values) in enumerate(found.items()):
            groups = [values[of_level] for of_level in members]
            mean, low, high = (
                np.array([of(group) for group in groups]) for of in (np.mean, np.min, np.max)
            )
            lines.append(
                Line(
                    x=np.array([*places.values()]) + 0.7 * ((order + 0.5) / len(found) - 0.5),
                    y=mean,
                    stroke=strokes[name],
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
    legend = {"orientation": "h", "y": -0.16, "yanchor": "top", "x": 0}
    return Chart(
        abscissa=abscissa,
        rows=rows,
        lines=lines,
        description=f"{', '.join(score.name for score in scores)} by the level of each factor.",
        layout={"hovermode": "closest", "legend": legend},
    )


# --- curves ------------------------------------------------------------------------------------


def overlay_chart(
    curves: Mapping[Condition, Mapping[str, ImpedanceCurve]], truth: MBK, i: int, k: int
) -> Chart:
    """Fig. 2 for one element: magnitude, phase and error in all conditions over the truth.

    Parameters
    ----------
    curves : by condition and estimator
    truth : true matrices
    i, k : element, 0-based
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
    lines.append(Line(x=grid, y=np.abs(true), stroke=_TRUE, unit=IMPEDANCE))
    phase = np.degrees(np.unwrap(np.angle(true)))
    lines.append(Line(x=grid, y=phase, stroke=_TRUE, row=2, unit="°"))
    chart = Chart(
        abscissa=frequency_axis([grid]),
        rows=[],
        lines=lines,
        description=f"Estimates of Z {i + 1} {k + 1} in all conditions over the truth.",
        layout={"hovermode": "closest"},  # one box for all lines would cover the plot
    )
    sizes, errors = (
        (0.8 * float(values.min()), 1.25 * float(values.max()))
        for values in (chart.values(1), chart.values(3))
    )
    rows = [
        (3.0, Axis(title="magnitude (N·m/rad)", ends=sizes, log=True)),
        (2.0, Axis(title="phase (°)", hoverformat=".1f")),
        (2.0, Axis(title="error (%)", ends=errors, log=True, hoverformat=".3~g")),
    ]
    return replace(chart, rows=rows)


def level_stroke(friction: int | None = None, resolution: int | None = None) -> Stroke:
    """Return the stroke of one level or both: colour shows friction, dashes show resolution."""
    return Stroke(
        name=f"resolution {resolution}" if friction is None else f"friction {friction}",
        colour="--soft" if friction is None else f"--level-{friction}",
        dash="solid" if resolution is None else LEVEL_DASHES[resolution],
        width=1.2,
    )


# --- for print ---------------------------------------------------------------------------------


def write_figures(
    directory: Path, conditions: Sequence[Condition], table: Table, truth: MBK, curves: Curves
) -> dict[str, str]:
    """Draw every figure for each estimator, and write it as PNG and PDF.

    Parameters
    ----------
    directory : where to
    conditions : at least one. Figure 2 shows those with the first seed.
    table : (n_conditions, n_estimators, n, n), their results
    truth : true matrices
    curves : returns the curves of a condition

    Returns
    -------
    dict of str to str
        What each file shows, by its name.

    Raises
    ------
    DataError
        If curves can't be read, or a figure not be written.
    """
    drawings: list[_Drawing] = []
    for of_estimator in np.moveaxis(table, 1, 0):
        name = of_estimator["estimator"].flat[0]
        for level in LEVELS["perturbation"]:
            of_level = {
                one: curves(one)[name]
                for one in conditions
                if (one.perturbation, one.seed) == (level, conditions[0].seed)
            }
            if of_level:
                where = f"fig2-{name}-perturbation{level}"
                words = f"impedance in all conditions over the truth, {name}, perturbation {level}"
                drawings.append((where, words, partial(impedance_figure, of_level, truth)))
        draw = partial(levels_figure, of_estimator, FIT_SCORES)
        drawings.append((f"fig3-{name}", f"VAF and R² by level, {name}", draw))
        draw = partial(levels_figure, of_estimator, COHERENCE_SCORES)
        drawings.append((f"fig4-{name}", f"coherences by level, {name}", draw))
    workers = min(available_cores(), len(drawings) // _WORTH_A_PROCESS)
    save = partial(_save, directory)
    paths = dict(processes(workers).run(save, drawings) if workers > 1 else map(save, drawings))
    return {path.name: words for name, words, _ in drawings for path in paths[name]}


def _save(directory: Path, drawing: _Drawing) -> tuple[str, list[Path]]:
    """Draw a figure; return its name and its files."""
    name, _, draw = drawing
    return name, save_figure(draw(), directory / name)


def impedance_figure(curves: Mapping[Condition, ImpedanceCurve], truth: MBK) -> Figure:
    """Fig. 2: true and estimated transfer-function matrix at one perturbation level.

    Parameters
    ----------
    curves : of one perturbation level, seed and estimator; all are overlaid
    truth : true matrices

    Returns
    -------
    matplotlib.figure.Figure
        For each element magnitude (N·m/rad), phase (degrees) and relative error (%); magnitudes and
        phases of all conditions nearly coincide.
    """
    n = len(truth.M)
    by_friction = [level_stroke(friction=one) for one in sorted({c.friction for c in curves})]
    by_resolution = [level_stroke(resolution=one) for one in sorted({c.resolution for c in curves})]
    # Legends are filled column by column: friction above resolution.
    pairs = itertools.zip_longest(by_friction, by_resolution)
    keys = [key for pair in pairs for key in pair if key is not None]
    of_condition = {condition: {"": curve} for condition, curve in curves.items()}
    return element_figure(
        n,
        lambda i, k: overlay_chart(of_condition, truth, i, k),
        [*keys, TRUE],
        row_height=0.38,
        width=max(TWO_COLUMNS, _LEAST_PANEL * n),
    )


def levels_figure(table: Table, scores: Sequence[Score]) -> Figure:
    """Figs. 3 and 4: scores by friction, resolution and perturbation level.

    Parameters
    ----------
    table : (n_conditions, n, n), results of one estimator
    scores : one axis each
    """
    legend = level_marks(table, scores)
    return matrix_figure([[levels_chart(table, scores)]], [[""]], legend, row_height=1.6)
