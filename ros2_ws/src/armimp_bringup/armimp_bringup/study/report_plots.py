"""Plots of the report of a study: maps of numbers, levels, and all curves over the truth."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from armimp_bringup.study.conditions import LEVELS, Condition
from armimp_bringup.study.scores import FloatArray, Score, Table, statistics
from armimp_estimation.curves import ImpedanceCurve
from armimp_estimation.mbk import MBK
from armimp_estimation.report.curves import deviation_percent, phase_about
from armimp_estimation.report.formats import NONE, number, symbol
from armimp_estimation.report.look import ELEMENT_COLOURS, LEVEL_DASHES
from armimp_estimation.report.plots import (
    Layout,
    Plot,
    Stroke,
    Trace,
    View,
    axis,
    axis_name,
    frequency_axis,
    label,
    line,
    log_axis,
    packed,
    stacked,
)
from armimp_estimation.report.result_plots import TRUTH, estimator_tag

# From good to bad, within the limit and beyond it; dark is bad in print as well.
_WITHIN: Final = ("#f2f7fb", "#6baed6")
_BEYOND: Final = ("#f0a868", "#b03a00")
_GAP: Final = 0.6
_SYMBOLS: Final = ("circle", "square", "triangle-up", "diamond", "triangle-down", "cross", "x")
_SUBSCRIPTS: Final = str.maketrans("0123456789·", "₀₁₂₃₄₅₆₇₈₉.")


# --- maps --------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True, eq=False)
class Panel:
    """A block of fields of a map.

    Attributes
    ----------
    title : str
        Above it; may be empty.
    columns : sequence of str
        Labels.
    values : ndarray, shape (n_rows, n_columns)
        NaN where there is no number.
    notes : sequence of sequence of sequence of str
        Lines that the pointer shows, for each field; None where there is no field.
    """

    title: str
    columns: Sequence[str]
    values: FloatArray
    notes: Sequence[Sequence[Sequence[str] | None]]


def heat_map(
    score: Score,
    rows: Sequence[str],
    panels: Sequence[Panel],
    *,
    titles: tuple[str, str],
    limit: float | None = None,
) -> View:
    """Map of the values of a score by colour, with the numbers in the fields.

    Parameters
    ----------
    score : Score
        What is shown.
    rows : sequence of str
        Labels of the rows, from the top.
    panels : sequence of Panel
        Side by side, at least one.
    titles : tuple of str
        Of the axis of the rows, and of that of the columns.
    limit : float, optional
        Where the colours of a miss begin.
    """
    data: list[Trace] = []
    ticks: list[float] = []
    notes: list[dict[str, object]] = []
    start = 0.0
    for panel in panels:
        places = [start + place for place in range(len(panel.columns))]
        fields = [
            list(zip(values, lines, strict=True))
            for values, lines in zip(panel.values.tolist(), panel.notes, strict=True)
        ]
        data.append(
            {
                "type": "heatmap",
                "x": places,
                "y": list(range(len(rows))),
                "z": [[value if math.isfinite(value) else None for value, _ in r] for r in fields],
                "text": [[_written(score, *field) for field in row] for row in fields],
                "texttemplate": "%{text}",
                "hovertext": [
                    ["<br>".join(map(label, lines or ())) for _, lines in r] for r in fields
                ],
                "hovertemplate": "%{hovertext}<extra></extra>",
                "hoverongaps": False,
                "xgap": 2,
                "ygap": 2,
                "coloraxis": "coloraxis",
                "meta": [],
            }
        )
        ticks += places
        if panel.title:
            notes.append(_note(panel.title, (places[0] + places[-1]) / 2.0, 1.0, yanchor="bottom"))
        start = places[-1] + 1.0 + _GAP
    bare: dict[str, Any] = {"showgrid": False, "showline": False, "ticks": ""}
    names = [label(column) for panel in panels for column in panel.columns]
    abscissa = axis(titles[1], tickvals=ticks, ticktext=names, **bare)
    ordinate = axis(
        titles[0],
        tickvals=list(range(len(rows))),
        ticktext=[label(row) for row in rows],
        autorange="reversed",
        **bare,
    )
    layout = stacked(abscissa, [(1.0, ordinate)])
    layout |= {"hovermode": "closest", "annotations": notes}
    layout["margin"] = {**layout["margin"], "t": 44}
    found = np.concatenate([panel.values.ravel() for panel in panels])
    layout["coloraxis"] = _colours(score, found[np.isfinite(found)], limit)
    return View(name=score.name, data=data, layout=layout)


def _written(score: Score, value: float, lines: Sequence[str] | None) -> str:
    """The number in a field of a map."""
    if lines is None:
        return ""
    return label(NONE if math.isnan(value) else score.format(value).removesuffix(score.unit))


def _colours(score: Score, found: FloatArray, limit: float | None) -> dict[str, object]:
    """Axis of colours: what is within the limit never has the colour of what is beyond it."""
    known = found if limit is None else np.append(found, limit)
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 1.0)
    high = max(high, low + 1.0) if high <= low else high
    worst, best = (low, high) if score.floor else (high, low)
    # From the best to the worst value.
    stops = [(0.0, _WITHIN[0]), (1.0, _WITHIN[1])]
    if limit is not None and worst != limit:
        share = abs(limit - best) / (high - low)
        stops = [(0.0, _WITHIN[0]), (share, _WITHIN[1]), (share, _BEYOND[0]), (1.0, _BEYOND[1])]
    if score.floor:
        stops = [(1.0 - place, colour) for place, colour in reversed(stops)]
    return {
        "colorscale": [list(stop) for stop in stops],
        "cmin": low,
        "cmax": high,
        "colorbar": {
            "thickness": 12,
            "outlinewidth": 0,
            "title": {"text": label(score.unit.strip()), "side": "top"},
            "tickfont": {"size": 10},
        },
    }


def _note(text: str, x: float, y: float, **more: object) -> dict[str, object]:
    return {"text": label(text), "x": x, "y": y, "yref": "paper", "showarrow": False, **more}


# --- levels ------------------------------------------------------------------------------------


def levels_view(name: str, table: Table, scores: Sequence[Score]) -> View:
    """Scores of one estimator by level of each factor, as Figures 3 and 4 of the paper.

    Parameters
    ----------
    name : str
        Of the estimator, for people.
    table : ndarray, shape (n_conditions, n, n)
        Its results.
    scores : sequence of Score
        One row each.
    """
    places: dict[str, dict[int, float]] = {}
    start, gap = 0.0, 0.7
    for factor in LEVELS:
        places[factor] = {int(one): start + n for n, one in enumerate(np.unique(table[factor]))}
        start += len(places[factor]) + gap
    subjects = list(dict.fromkeys(one for score in scores for one in score.subjects(table)))
    ends = -0.5, start - gap - 0.5
    data: list[Trace] = []
    for row, score in enumerate(scores, 1):
        found = score.subjects(table)
        for order, (subject, values) in enumerate(found.items()):
            shift = 0.7 * ((order + 0.5) / len(found) - 0.5)
            data.append(
                _marks(table, values, places, shift)
                | _mark_style(subject, subjects.index(subject), row, score.unit.strip())
            )
        limit = score.limit(table.shape[-1], table["estimator"].flat[0])
        if limit is not None:
            data.append(_target(ends, limit, row))
    ticks = [(x, f"{level}") for place in places.values() for level, x in place.items()]
    abscissa = axis(
        "",
        tickvals=[x for x, _ in ticks],
        ticktext=[text for _, text in ticks],
        range=[ends[0] - 0.1, ends[1] + 0.1],
        showgrid=False,
    )
    short = {"VAF": "VAF (%)", "derived coherence": "derived γ²"}
    titles = (short.get(score.name, score.name.replace("coherence", "γ²")) for score in scores)
    layout = stacked(abscissa, [(1.0, axis(one, tickformat="~g")) for one in titles], left=78)
    layout |= {
        "hovermode": "closest",
        "showlegend": True,
        "legend": {"orientation": "h", "y": -0.16, "yanchor": "top", "x": 0},
        "margin": {**layout["margin"], "b": 84},
    }
    middles = {factor: sum(place.values()) / len(place) for factor, place in places.items()}
    layout["annotations"] = [
        _note(f"{factor} level", x, 0.0, yshift=-22, yanchor="top") for factor, x in middles.items()
    ]
    borders = [min(place.values()) - 0.5 - gap / 2.0 for place in places.values()][1:]
    rule = {
        "type": "line",
        "y0": 0,
        "y1": 1,
        "yref": "paper",
        "line": {"color": "--rule", "width": 1},
    }
    layout["shapes"] = [rule | {"x0": x, "x1": x} for x in borders]
    return View(name=name, data=data, layout=layout)


def _marks(
    table: Table,
    values: FloatArray,
    places: Mapping[str, Mapping[int, float]],
    shift: float,
) -> Trace:
    """Mean and range at every level of every factor."""
    x, notes, found = [], [], []
    for factor, place in places.items():
        levels, *of_factor = statistics(table, factor, values)
        x += [place[level] + shift for level in levels]
        notes += [f"{factor} {level}" for level in levels]
        found.append(of_factor)
    mean, low, high = np.concatenate(found, axis=1)
    return {
        "x": packed(x),
        "y": packed(mean),
        "error_y": {
            "type": "data",
            "symmetric": False,
            "array": packed(np.maximum(high - mean, 0.0)),
            "arrayminus": packed(np.maximum(mean - low, 0.0)),
            "thickness": 1.4,
            "width": 0,
        },
        "text": [
            f"{note}: worst {number(a, '.5g')}, best {number(b, '.5g')}"
            for note, a, b in zip(notes, low, high, strict=True)
        ],
    }


def _mark_style(subject: tuple[str, str], look: int, row: int, unit: str) -> Trace:
    name = label(f"{subject[0]}{subject[1].translate(_SUBSCRIPTS)}")
    return {
        "type": "scatter",
        "mode": "markers",
        "name": name,
        "legendgroup": name,
        "showlegend": row == 1 or subject[0] != "Z",
        "marker": {
            "color": ELEMENT_COLOURS[look % len(ELEMENT_COLOURS)],
            "symbol": _SYMBOLS[look % len(_SYMBOLS)],
            "size": 8,
        },
        "hovertemplate": f"{name}, %{{text}}<br>mean %{{y:.5g}} {unit}<extra></extra>",
        "meta": [],
        "yaxis": axis_name("y", row),
    }


def _target(ends: tuple[float, float], limit: float, row: int) -> Trace:
    return {
        "type": "scatter",
        "mode": "lines",
        "x": list(ends),
        "y": [limit, limit],
        "name": "target",
        "showlegend": row == 1,
        "line": {"color": "--soft", "dash": "dash", "width": 1.2},
        "hovertemplate": f"target {limit:g}<extra></extra>",
        "meta": [],
        "yaxis": axis_name("y", row),
    }


# --- curves ------------------------------------------------------------------------------------


def overlay_plot(
    curves: Mapping[Condition, Mapping[str, ImpedanceCurve]], truth: MBK, i: int, k: int
) -> Plot:
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
    data: list[Trace] = []
    sizes: list[FloatArray] = []
    for condition, found in curves.items():
        levels = {factor: getattr(condition, factor) for factor in LEVELS}
        for name, curve in found.items():
            z, centre = curve.Z[i, k], truth.impedance(curve.f)[i, k]
            words = ", ".join(f"{factor} {level}" for factor, level in levels.items())
            stroke = Stroke(
                name=f"{name}, {words}",
                colour=f"--level-{condition.friction}",
                dash=LEVEL_DASHES[condition.resolution],
                width=1.2,
                tags=[
                    estimator_tag(name),
                    *(f"{factor}:{level}" for factor, level in levels.items()),
                ],
            )
            sizes.append(np.abs(z))
            data.append(line(curve.f, sizes[-1], stroke, unit="N·m/rad"))
            data.append(line(curve.f, phase_about(centre, z), stroke, row=2, unit="°"))
            data.append(line(curve.f, deviation_percent(centre, z), stroke, row=3, unit="%"))
    grid = max((curve.f for found in curves.values() for curve in found.values()), key=len)
    true = truth.impedance(grid)[i, k]
    stroke = Stroke(name="truth", colour="--ink", width=2.0, dash="dot", tags=[TRUTH])
    data.append(line(grid, np.abs(true), stroke, unit="N·m/rad"))
    data.append(line(grid, np.degrees(np.unwrap(np.angle(true))), stroke, row=2, unit="°"))
    low, high = (float(end(np.concatenate(sizes))) for end in (np.min, np.max))
    error = axis("error (%)", type="log", dtick=1, exponentformat="none", hoverformat=".3~g")
    layout: Layout = stacked(
        frequency_axis([grid]),
        [
            (3.0, log_axis("magnitude (N·m/rad)", (0.8 * low, 1.25 * high), ".4~g")),
            (2.0, axis("phase (°)", dtick=90, hoverformat=".1f")),
            (2.0, error),
        ],
    )
    return Plot(
        identifier=f"overlay-{i + 1}-{k + 1}",
        caption=symbol("Z", i + 1, k + 1),
        description=f"Estimates of Z {i + 1} {k + 1} in all conditions over the truth.",
        # One box for all lines would cover the plot.
        views=[View(data=data, layout=layout | {"hovermode": "closest"})],
        height=470,
    )
