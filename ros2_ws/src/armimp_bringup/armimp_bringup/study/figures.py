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
from matplotlib import rc_context
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MultipleLocator

from armimp_bringup.bench import available_cores
from armimp_bringup.study.conditions import LEVELS, Condition
from armimp_bringup.study.scores import COHERENCE_SCORES, FIT_SCORES, Score, Table, statistics
from armimp_common.errors import DataError
from armimp_estimation.curves import ImpedanceCurve
from armimp_estimation.figures import DASHES as MPL_DASHES
from armimp_estimation.figures import (
    STYLE,
    TWO_COLUMNS,
    element_matrix,
    frequency_axis,
    line_key,
    log_axis,
    save_figure,
    title,
)
from armimp_estimation.mbk import MBK
from armimp_estimation.report.curves import deviation_percent, phase_about
from armimp_estimation.report.look import ELEMENT_COLOURS, LEVEL_COLOURS, LEVEL_DASHES

Curves = Callable[[Condition], Mapping[str, ImpedanceCurve]]
_Drawing = Callable[[Any, Any], Figure]

_MARKERS: Final = ("o", "s", "^", "D", "v", "P", "X", "<", ">")
_LEAST_PANEL: Final = 2.3  # inches; with many joints Figure 2 is a poster
_LEGEND_COLUMNS: Final = 8
_WORTH_A_PROCESS: Final = 3
"""Figures that take longer to draw than another process takes to start."""
_TRUE: Final[Any] = {"color": "black", "linestyle": (0, (4, 3)), "linewidth": 1.1}
_TARGET: Final[Any] = {"color": "0.45", "linewidth": 0.8, "linestyle": (0, (5, 3))}


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


@rc_context(STYLE)
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
    grid = max((curve.f for curve in curves.values()), key=len)
    true = truth.impedance(grid)
    by_friction = [
        line_key(f"friction {level}", LEVEL_COLOURS[level])
        for level in sorted({one.friction for one in curves})
    ]
    by_resolution = [
        line_key(f"resolution {level}", "0.4", LEVEL_DASHES[level])
        for level in sorted({one.resolution for one in curves})
    ]
    # Legends are filled column by column: friction above resolution.
    pairs = itertools.zip_longest(by_friction, by_resolution)
    keys = [key for pair in pairs for key in pair if key is not None]
    keys.append(Line2D([], [], label="truth", **_TRUE))
    width = max(TWO_COLUMNS, _LEAST_PANEL * n)
    figure, cells = element_matrix(n, width, cell_height=2.7, rows=(3, 2, 2), keys=keys)
    for (i, k), (magnitude, phase, error) in cells.items():
        sizes, errors = [np.abs(true[i, k])], []
        for condition, curve in curves.items():
            z, centre = curve.Z[i, k], truth.impedance(curve.f)[i, k]
            style: dict[str, Any] = {
                "color": LEVEL_COLOURS[condition.friction],
                "linestyle": MPL_DASHES[LEVEL_DASHES[condition.resolution]],
                "linewidth": 0.8,
            }
            sizes.append(np.abs(z))
            errors.append(deviation_percent(centre, z))
            magnitude.plot(curve.f, sizes[-1], **style)
            phase.plot(curve.f, phase_about(centre, z), **style)
            error.plot(curve.f, errors[-1], **{**style, "linewidth": 0.5})
        magnitude.plot(grid, sizes[0], **_TRUE)
        phase.plot(grid, np.degrees(np.unwrap(np.angle(true[i, k]))), **_TRUE)
        for axes, values in ((magnitude, sizes), (error, errors)):
            low, high = (end(np.concatenate(values)) for end in (np.min, np.max))
            log_axis(axes, (0.8 * low, 1.25 * high))
        phase.yaxis.set_major_locator(MultipleLocator(45))
        title(magnitude, f"$Z_{{{i + 1}{k + 1}}}$")
        if k == 0:
            magnitude.set_ylabel("magnitude (N·m/rad)")
            phase.set_ylabel("phase (°)")
            error.set_ylabel("error (%)")
        frequency_axis(error, [grid], last=i == n - 1)
    return figure


@rc_context(STYLE)
def levels_figure(table: Table, scores: Sequence[Score]) -> Figure:
    """Figs. 3 and 4: scores by friction, resolution and perturbation level.

    Marks are means over all conditions with that level, bars reach from the worst to the best.

    Parameters
    ----------
    table : ndarray, shape (n_conditions, n, n)
        Results of one estimator.
    scores : sequence of Score
        One row of panels each.

    Returns
    -------
    matplotlib.figure.Figure
        Rows of scores, columns of factors.
    """
    figure = Figure(figsize=(TWO_COLUMNS, 1.9 * len(scores) + 0.6), layout="constrained")
    panels = figure.subplots(len(scores), len(LEVELS), sharey="row", squeeze=False)
    subjects = list(dict.fromkeys(one for score in scores for one in score.subjects(table)))
    keys: dict[str, Any] = {}
    for row, score in zip(panels, scores, strict=True):
        found = score.subjects(table)
        spread = 0.5 if len(found) <= 4 else 0.8
        limit = score.limit(table.shape[-1], table["estimator"].flat[0])
        for panel, factor in zip(row, LEVELS, strict=True):
            for number, (subject, values) in enumerate(found.items()):
                look = subjects.index(subject)
                levels, mean, low, high = statistics(table, factor, values)
                reach = np.array([mean - low, high - mean])
                keys[_label(*subject)] = panel.errorbar(
                    np.add(levels, spread * ((number + 0.5) / len(found) - 0.5)),
                    mean,
                    # Rounding may leave the mean of equal values beside them.
                    yerr=np.maximum(reach, 0.0),
                    color=ELEMENT_COLOURS[look % len(ELEMENT_COLOURS)],
                    marker=_MARKERS[look % len(_MARKERS)],
                    linestyle="none",
                    elinewidth=0.9,
                )
            if limit is not None:
                keys["target"] = panel.axhline(limit, **_TARGET)
            ticks = np.unique(table[factor])
            panel.set_xticks(ticks)
            panel.set_xlim(ticks[0] - 0.5, ticks[-1] + 0.5)
            panel.grid(visible=False, axis="x")
            panel.ticklabel_format(axis="y", useOffset=False)
            if score is scores[-1]:
                panel.set_xlabel(f"{factor} level")
        name = score.name.replace("τΔ → ", r"$\tau_\Delta \to$ ")
        row[0].set_ylabel(f"{name} ({score.unit.strip()})" if score.unit else name)
    columns = min(len(keys), _LEGEND_COLUMNS)
    figure.legend(
        keys.values(), keys.keys(), loc="outside lower center", ncols=columns, frameon=False
    )
    return figure


def _label(symbol: str, indices: str) -> str:
    symbol, indices = symbol.replace("θ", r"\theta"), indices.replace("·", r"\cdot")
    return f"${symbol}_{{{indices}}}$"
