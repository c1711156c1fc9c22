"""Figures 3 and 4 of the paper as plots that answer to the pointer."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from armimp_bringup.study.conditions import LEVELS
from armimp_bringup.study.entry import StudyEntry
from armimp_bringup.study.levels import (
    MOST_JOINTS,
    LevelScore,
    Subject,
    coherence_scores,
    fit_scores,
    statistics,
)
from armimp_estimation.report.formats import number
from armimp_estimation.report.look import ELEMENT_COLOURS, looks
from armimp_estimation.report.plots import (
    Layout,
    Options,
    Plot,
    Trace,
    View,
    axis,
    label,
    packed,
    stacked,
)

_SYMBOLS = ("circle", "square", "triangle-up", "diamond", "triangle-down", "cross", "x")
_SUBSCRIPTS = str.maketrans("0123456789·", "₀₁₂₃₄₅₆₇₈₉.")
_GAP = 0.7
_LONG = {"VAF": "VAF (%)", "derived coherence": "derived γ²"}

Scores = Callable[[Sequence[StudyEntry], str], tuple[LevelScore, ...]]


def scores_content(entries: Sequence[StudyEntry]) -> dict[str, Any]:
    """VAF and R² by level of each factor."""
    return _content(entries, "scores", "VAF and R² by level (Fig. 3)", fit_scores)


def coherence_content(entries: Sequence[StudyEntry]) -> dict[str, Any]:
    """Coherences by level of each factor."""
    return _content(entries, "coherence", "Coherence by level (Fig. 4)", coherence_scores)


def _content(
    entries: Sequence[StudyEntry], identifier: str, title: str, scores: Scores
) -> dict[str, Any]:
    found = {
        look.label: scores(entries, name) for name, look in looks(entries[0].estimators).items()
    }
    one = next(iter(found.values()))
    plot = Plot(
        identifier=f"levels-{identifier}",
        caption=title,
        description=f"{title}: {', '.join(score.name for score in one)}.",
        views=[
            View(name=name, data=_data(entries, s), layout=_layout(entries, s))
            for name, s in found.items()
        ],
        height=90 + 190 * len(one),
    )
    return {"title": title, "plot": plot, "rows": entries[0].joints > MOST_JOINTS}


def _positions(entries: Sequence[StudyEntry]) -> dict[str, dict[int, float]]:
    """Abscissa of each level, factor by factor."""
    start, found = 0.0, {}
    for factor in LEVELS:
        levels = sorted({int(getattr(entry, factor)) for entry in entries})
        found[factor] = {level: start + n for n, level in enumerate(levels)}
        start += len(levels) + _GAP
    return found


def _data(entries: Sequence[StudyEntry], scores: Sequence[LevelScore]) -> list[Trace]:
    places = _positions(entries)
    subjects = list(dict.fromkeys(subject for score in scores for subject in score.values))
    ends = [min(places["friction"].values()), max(places["perturbation"].values())]
    data: list[Trace] = []
    for row, score in enumerate(scores, 1):
        for order, (subject, values) in enumerate(score.values.items()):
            shift = 0.7 * ((order + 0.5) / len(score.values) - 0.5)
            x, mean, low, high, notes = [], [], [], [], []
            for factor, place in places.items():
                found = statistics(entries, factor, values)
                x += [place[int(level)] + shift for level in found.levels]
                mean += found.mean.tolist()
                low += found.low.tolist()
                high += found.high.tolist()
                notes += [f"{factor} {level}" for level in found.levels]
            data.append(
                _marks(subject, subjects.index(subject), row, score.unit)
                | {
                    "x": packed(x),
                    "y": packed(mean),
                    "error_y": {
                        "type": "data",
                        "symmetric": False,
                        "array": packed(np.maximum(np.subtract(high, mean), 0.0)),
                        "arrayminus": packed(np.maximum(np.subtract(mean, low), 0.0)),
                        "thickness": 1.4,
                        "width": 0,
                    },
                    "text": [
                        f"{note}: worst {number(a, '.5g')}, best {number(b, '.5g')}"
                        for note, a, b in zip(notes, low, high, strict=True)
                    ],
                }
            )
        if score.limit is not None:
            data.append(_target(ends, score.limit, row))
    return data


def _marks(subject: Subject, look: int, row: int, unit: str) -> Trace:
    name = label(f"{subject.symbol}{subject.indices.translate(_SUBSCRIPTS)}")
    return {
        "type": "scatter",
        "mode": "markers",
        "name": name,
        "legendgroup": name,
        "showlegend": row == 1 or subject.symbol != "Z",
        "marker": {
            "color": ELEMENT_COLOURS[look % len(ELEMENT_COLOURS)],
            "symbol": _SYMBOLS[look % len(_SYMBOLS)],
            "size": 8,
        },
        "hovertemplate": f"{name}, %{{text}}<br>mean %{{y:.5g}} {unit}<extra></extra>",
        "meta": [],
        "yaxis": "y" if row == 1 else f"y{row}",
    }


def _target(ends: Sequence[float], limit: float, row: int) -> Trace:
    return {
        "type": "scatter",
        "mode": "lines",
        "x": [ends[0] - 0.5, ends[1] + 0.5],
        "y": [limit, limit],
        "name": "target",
        "showlegend": row == 1,
        "line": {"color": "--soft", "dash": "dash", "width": 1.2},
        "hovertemplate": f"target {limit:g}<extra></extra>",
        "meta": [],
        "yaxis": "y" if row == 1 else f"y{row}",
    }


def _layout(entries: Sequence[StudyEntry], scores: Sequence[LevelScore]) -> Layout:
    places = _positions(entries)
    ticks = [(x, f"{level}") for place in places.values() for level, x in place.items()]
    last = ticks[-1][0]
    x_axis = axis(
        "",
        tickvals=[x for x, _ in ticks],
        ticktext=[name for _, name in ticks],
        range=[-0.6, last + 0.6],
        showgrid=False,
    )
    rows: list[tuple[float, Options]] = [
        (1.0, axis(_LONG.get(score.name, score.name.replace("coherence", "γ²")), tickformat="~g"))
        for score in scores
    ]
    layout = stacked(x_axis, rows, left=78)
    layout["hovermode"] = "closest"
    layout["showlegend"] = True
    layout["legend"] = {"orientation": "h", "y": -0.16, "yanchor": "top", "x": 0}
    layout["margin"] = {**layout["margin"], "b": 84}
    layout["annotations"] = [
        {
            "text": f"{factor} level",
            "x": (min(place.values()) + max(place.values())) / 2.0,
            "y": 0.0,
            "yref": "paper",
            "yshift": -22,
            "yanchor": "top",
            "showarrow": False,
        }
        for factor, place in places.items()
    ]
    layout["shapes"] = [
        {
            "type": "line",
            "x0": min(place.values()) - 0.5 - _GAP / 2.0,
            "x1": min(place.values()) - 0.5 - _GAP / 2.0,
            "y0": 0,
            "y1": 1,
            "yref": "paper",
            "line": {"color": "--rule", "width": 1},
        }
        for place in list(places.values())[1:]
    ]
    return layout
