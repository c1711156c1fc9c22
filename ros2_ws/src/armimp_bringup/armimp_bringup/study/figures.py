"""Figures 2 to 4 of the paper from a study, as PNG and PDF."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.figure import Figure

from armimp_bringup.bench import available_cores
from armimp_bringup.study.conditions import LEVELS, Condition
from armimp_bringup.study.report_plots import (
    level_marks,
    level_stroke,
    levels_chart,
    overlay_chart,
)
from armimp_bringup.study.scores import COHERENCE_SCORES, FIT_SCORES, Score, Table
from armimp_common.errors import DataError
from armimp_estimation.curves import ImpedanceCurve
from armimp_estimation.figures import TWO_COLUMNS, element_figure, matrix_figure, save_figure
from armimp_estimation.mbk import MBK
from armimp_estimation.report.result_plots import TRUE

Curves = Callable[[Condition], Mapping[str, ImpedanceCurve]]
_Drawing = Callable[[Any, Any], Figure]

_LEAST_PANEL: Final = 2.3  # inches; with many joints Figure 2 is a poster
_WORTH_A_PROCESS: Final = 3
"""Figures that take longer to draw than another process takes to start."""


def write_figures(
    directory: Path, conditions: Sequence[Condition], table: Table, truth: MBK, curves: Curves
) -> dict[str, str]:
    """Draw every figure for each estimator, and write it as PNG and PDF.

    Parameters
    ----------
    directory : Path
        Where to.
    conditions : sequence of Condition
        At least one. Figure 2 shows those with the first seed.
    table : ndarray, shape (n_conditions, n_estimators, n, n)
        Their results.
    truth : MBK
        True matrices.
    curves : callable
        Gives the curves of a condition.

    Returns
    -------
    dict of str to str
        What each file shows.

    Raises
    ------
    DataError
        If curves can't be read, or a figure not be written.
    """
    drawings: list[tuple[str, _Drawing, Any, Any]] = []
    shown: list[str] = []
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
                drawings.append((where, impedance_figure, of_level, truth))
                shown.append(
                    f"impedance in all conditions over the truth, {name}, perturbation {level}"
                )
        drawings.append((f"fig3-{name}", levels_figure, of_estimator, FIT_SCORES))
        drawings.append((f"fig4-{name}", levels_figure, of_estimator, COHERENCE_SCORES))
        shown += [f"VAF and R² by level, {name}", f"coherences by level, {name}"]
    files = _drawn(directory, drawings)
    return {path.name: one for one, paths in zip(shown, files, strict=True) for path in paths}


def _drawn(
    directory: Path, drawings: Sequence[tuple[str, _Drawing, Any, Any]]
) -> Iterator[list[Path]]:
    """Files of the figures, in their order; many are drawn side by side."""
    workers = min(available_cores(), len(drawings) // _WORTH_A_PROCESS)
    if workers < 2:
        yield from (_draw(directory, *one) for one in drawings)
        return
    try:
        with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
            yield from pool.map(_draw, itertools.repeat(directory), *zip(*drawings, strict=True))
    except BrokenProcessPool:
        raise DataError("figures: a process that draws them ended early") from None


def _draw(directory: Path, name: str, draw: _Drawing, *arguments: Any) -> list[Path]:
    return save_figure(draw(*arguments), directory / name)


def impedance_figure(curves: Mapping[Condition, ImpedanceCurve], truth: MBK) -> Figure:
    """Fig. 2: true and estimated transfer-function matrix at one perturbation level.

    Parameters
    ----------
    curves : mapping of Condition to ImpedanceCurve
        Of one perturbation level, seed and estimator; all are overlaid.
    truth : MBK
        True matrices.

    Returns
    -------
    matplotlib.figure.Figure
        For each element magnitude (N·m/rad), phase (degrees) and the relative error (%), without
        which all curves would look like one.
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
    table : ndarray, shape (n_conditions, n, n)
        Results of one estimator.
    scores : sequence of Score
        One axis each.
    """
    legend = level_marks(table, scores)
    return matrix_figure([[levels_chart(table, scores)]], [[""]], legend, row_height=1.6)
