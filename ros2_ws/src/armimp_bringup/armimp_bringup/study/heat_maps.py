"""Maps of numbers by colour, with the numbers written in them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

from armimp_estimation.report.plots import Layout, Trace, View, axis, label, stacked

# From good to bad, within the limit and beyond it; dark is bad in print as well.
_WITHIN = ("#f2f7fb", "#6baed6")
_BEYOND = ("#f0a868", "#b03a00")
_GAP = 0.6


@dataclass(frozen=True, kw_only=True)
class Cell:
    """One field: its value, how it is written, and what the pointer shows besides."""

    value: float
    written: str
    notes: Sequence[str] = field(default=())


@dataclass(frozen=True, kw_only=True)
class Panel:
    """A block of fields, by row and column; None where there is nothing."""

    columns: Sequence[str]
    cells: Sequence[Sequence[Cell | None]]
    title: str = ""


@dataclass(frozen=True, kw_only=True)
class HeatMap:
    """Panels side by side.

    Parameters
    ----------
    name : str
        Of the quantity.
    rows : sequence of str
        Labels, from the top.
    panels : sequence of Panel
        At least one.
    floor : bool
        Whether small values are the bad ones.
    limit : float or None
        Where the colours of a miss begin.
    unit : str
        With a space before it.
    row_title, column_title : str
        Of the axes.
    logarithmic : bool
        Whether colours follow the logarithm of values, which must be positive then.
    """

    name: str
    rows: Sequence[str]
    panels: Sequence[Panel]
    floor: bool
    limit: float | None
    unit: str
    row_title: str
    column_title: str
    logarithmic: bool = False


def heat_map_view(heat_map: HeatMap) -> View:
    """Make what plotly.js draws of a map."""
    data: list[Trace] = []
    ticks: list[float] = []
    names: list[str] = []
    notes: list[dict[str, object]] = []
    start = 0.0
    for panel in heat_map.panels:
        positions = [start + number for number in range(len(panel.columns))]
        data.append(_trace(heat_map, panel, positions))
        ticks += positions
        names += panel.columns
        if panel.title:
            notes.append(_title(panel.title, (positions[0] + positions[-1]) / 2.0))
        start = positions[-1] + 1.0 + _GAP
    return View(name=heat_map.name, data=data, layout=_layout(heat_map, ticks, names, notes))


def _trace(heat_map: HeatMap, panel: Panel, positions: Sequence[float]) -> Trace:
    z, written, hover = [], [], []
    for name, row in zip(heat_map.rows, panel.cells, strict=True):
        z.append([None if cell is None else _colour(heat_map, cell.value) for cell in row])
        written.append(["" if cell is None else label(cell.written) for cell in row])
        hover.append(
            [
                "" if cell is None else _hover(heat_map, panel, (name, column), cell)
                for column, cell in zip(panel.columns, row, strict=True)
            ]
        )
    return {
        "type": "heatmap",
        "x": list(positions),
        "y": list(range(len(heat_map.rows))),
        "z": z,
        "text": written,
        "texttemplate": "%{text}",
        "hovertext": hover,
        "hovertemplate": "%{hovertext}<extra></extra>",
        "hoverongaps": False,
        "xgap": 2,
        "ygap": 2,
        "coloraxis": "coloraxis",
        "meta": [],
    }


def _hover(heat_map: HeatMap, panel: Panel, place: tuple[str, str], cell: Cell) -> str:
    title = f"{panel.title}, " if panel.title else ""
    value = f"{heat_map.name} {cell.written}{heat_map.unit if math.isfinite(cell.value) else ''}"
    return "<br>".join(label(line) for line in [f"{title}{' '.join(place)}", value, *cell.notes])


def _colour(heat_map: HeatMap, value: float) -> float | None:
    """Value on the scale of colours; None for no number."""
    if not math.isfinite(value):
        return None
    return math.log10(max(value, 1e-12)) if heat_map.logarithmic else value


def _scale(heat_map: HeatMap, found: Sequence[float]) -> dict[str, object]:
    """Axis of colours: what is within the limit never has the colour of what is beyond it."""
    limit = None if heat_map.limit is None else _colour(heat_map, heat_map.limit)
    known = list(found) if limit is None else [*found, limit]
    low, high = min(known, default=0.0), max(known, default=1.0)
    if high <= low:
        high = low + 1.0
    worst, best = (low, high) if heat_map.floor else (high, low)
    missed = limit is not None and worst != limit
    share = 1.0 if limit is None else abs(limit - best) / (high - low)
    # From the best to the worst value.
    stops = [(0.0, _WITHIN[0]), (share if missed else 1.0, _WITHIN[1])]
    if missed:
        stops += [(share, _BEYOND[0]), (1.0, _BEYOND[1])]
    if heat_map.floor:
        stops = [(1.0 - place, colour) for place, colour in reversed(stops)]
    bar: dict[str, object] = {
        "thickness": 12,
        "outlinewidth": 0,
        "title": {"text": label(heat_map.unit.strip()), "side": "top"},
        "tickfont": {"size": 10},
    }
    if heat_map.logarithmic:
        decades = range(math.floor(low), math.ceil(high) + 1)
        bar |= {"tickvals": list(decades), "ticktext": [f"{10.0**d:g}" for d in decades]}
    return {
        "colorscale": [list(stop) for stop in stops],
        "cmin": low,
        "cmax": high,
        "colorbar": bar,
    }


def _layout(
    heat_map: HeatMap, ticks: list[float], names: list[str], notes: list[dict[str, object]]
) -> Layout:
    found = [
        number
        for panel in heat_map.panels
        for row in panel.cells
        for cell in row
        if cell is not None and (number := _colour(heat_map, cell.value)) is not None
    ]
    x_axis = axis(
        heat_map.column_title,
        tickvals=ticks,
        ticktext=[label(name) for name in names],
        showgrid=False,
        showline=False,
        ticks="",
    )
    y_axis = axis(
        heat_map.row_title,
        tickvals=list(range(len(heat_map.rows))),
        ticktext=[label(row) for row in heat_map.rows],
        autorange="reversed",
        showgrid=False,
        showline=False,
        ticks="",
    )
    layout = stacked(x_axis, [(1.0, y_axis)])
    layout["hovermode"] = "closest"
    layout["annotations"] = notes
    layout["margin"] = {**layout["margin"], "t": 44}
    layout["coloraxis"] = _scale(heat_map, found)
    return layout


def _title(text: str, x: float) -> dict[str, object]:
    return {
        "text": label(text),
        "x": x,
        "y": 1.0,
        "yref": "paper",
        "yanchor": "bottom",
        "showarrow": False,
    }
