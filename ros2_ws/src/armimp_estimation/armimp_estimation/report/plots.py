"""Interactive plots for pages: plain data for plotly.js, and the frame that holds them.

A page draws them with ``plots.js``. Lines and bands carry tags (``meta``), by which controls of
the page switch them off and on in all plots at once.
"""

from __future__ import annotations

import base64
import html
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armimp_estimation.report.html import Html, element, join, plain, script_json

FloatArray = NDArray[np.float64]
Trace: TypeAlias = dict[str, Any]
Layout: TypeAlias = dict[str, Any]
Options: TypeAlias = Mapping[str, Any]

_GRID = "#e3e6ea"
_INK = "#333a42"
_AXIS: Options = {
    "gridcolor": _GRID,
    "linecolor": _INK,
    "ticks": "outside",
    "ticklen": 4,
    "tickcolor": _INK,
    "showline": True,
    "zeroline": False,
}


@dataclass(frozen=True, kw_only=True)
class View:
    """What a plot shows: traces and layout as plotly.js takes them."""

    name: str = ""
    data: Sequence[Trace]
    layout: Layout


@dataclass(frozen=True, kw_only=True)
class Plot:
    """A plot in its frame.

    Attributes
    ----------
    identifier : str
        Unique in the page, of letters, digits and hyphens.
    caption : object
        Title, text or HTML.
    description : str
        What it shows, for those who can't see it.
    views : sequence of View
        The first one is shown; with more of them the reader chooses.
    height : int
        In pixels.
    """

    identifier: str
    caption: object
    description: str
    views: Sequence[View]
    height: int


@dataclass(frozen=True, kw_only=True)
class Stroke:
    """How a line is drawn.

    Attributes
    ----------
    name : str
        Shown where the pointer is.
    colour, dash : str
        As CSS and plotly.js have them.
    width : float
        In pixels.
    tags : sequence of str
        By which it is switched off and on.
    """

    name: str
    colour: str
    dash: str = "solid"
    width: float = 1.6
    tags: Sequence[str] = ()


def frame(plot: Plot) -> Html:
    """HTML of a plot."""
    canvas = element(
        "div",
        class_="canvas",
        role="img",
        aria_label=plot.description,
        style=f"height:{plot.height}px",
    )
    return element(
        "figure",
        element("figcaption", plot.caption),
        _choice(plot) if len(plot.views) > 1 else None,
        canvas,
        join(script_json({"data": v.data, "layout": v.layout}) for v in plot.views),
        class_="plot",
        id=plot.identifier,
    )


def _choice(plot: Plot) -> Html:
    name = f"{plot.identifier}-view"
    buttons = (
        element(
            "label",
            # Browsers that remember what was chosen would show a view that is not drawn.
            element("input", type="radio", name=name, value=n, checked=n == 0, autocomplete="off"),
            view.name,
        )
        for n, view in enumerate(plot.views)
    )
    return element("fieldset", element("legend", "Show"), *buttons, class_="choice")


def packed(values: ArrayLike) -> dict[str, str]:
    """Pack numbers as plotly.js takes them: single precision, base64; NaN makes a gap."""
    raw = np.ascontiguousarray(values, dtype="<f4").tobytes()
    return {"dtype": "f4", "bdata": base64.b64encode(raw).decode("ascii")}


def label(text: object) -> str:
    """Text for plotly.js, which would take some tags in it for formatting and links."""
    return html.escape(plain(text), quote=False)


def line(x: FloatArray, y: FloatArray, stroke: Stroke, *, row: int = 1) -> Trace:
    """Make a line on the axis of a row, counted from 1 at the top."""
    return drawn({"x": packed(x), "y": packed(y)}, stroke, row)


def even_line(start: float, step: float, y: FloatArray, stroke: Stroke, *, row: int = 1) -> Trace:
    """Make a line through values at even distances."""
    return drawn({"x0": start, "dx": step, "y": packed(y)}, stroke, row)


def drawn(values: Options, stroke: Stroke, row: int) -> Trace:
    """Make a line of values that are packed already."""
    return {
        "type": "scatter",
        "mode": "lines",
        **values,
        "name": label(stroke.name),
        "line": {"color": stroke.colour, "dash": stroke.dash, "width": stroke.width},
        "meta": list(stroke.tags),
        "yaxis": _row("y", row),
    }


def band(
    x: FloatArray, ends: tuple[FloatArray, FloatArray], colour: str, tags: Sequence[str], row: int
) -> Trace:
    """Make a band between two lines; where an end is not finite, there is none."""
    lower, upper = ends
    known = np.isfinite(lower) & np.isfinite(upper)
    x, lower, upper = x[known], lower[known], upper[known]
    return {
        "type": "scatter",
        "mode": "lines",
        "x": packed(np.concatenate((x, x[::-1]))),
        "y": packed(np.concatenate((upper, lower[::-1]))),
        "fill": "toself",
        "fillcolor": colour,
        "line": {"width": 0},
        "hoverinfo": "skip",
        "meta": list(tags),
        "yaxis": _row("y", row),
    }


def stacked(
    x_axis: Options, rows: Sequence[tuple[float, Options]], *, gap: float = 0.05, left: int = 62
) -> Layout:
    """Lay out axes one above the other, on a common abscissa.

    Parameters
    ----------
    x_axis : mapping
        Options of the abscissa, see `axis`.
    rows : sequence of (float, mapping)
        Relative height and options of each ordinate, from the top.
    gap : float
        Between the axes, as a part of the whole height.
    left : int
        Margin for the titles, pixels.
    """
    layout: Layout = {
        "font": {"family": "system-ui, sans-serif", "size": 12, "color": _INK},
        "paper_bgcolor": "rgba(0,0,0,0)",
        "plot_bgcolor": "#ffffff",
        # The buttons of plotly.js are in the upper margin, beside the caption.
        "margin": {"l": left, "r": 12, "t": 30, "b": 44},
        "modebar": {"bgcolor": "rgba(0,0,0,0)", "color": "#8b949d", "activecolor": _INK},
        "showlegend": False,
        "hovermode": "x unified",
        # What the reader zoomed into stays when lines are switched.
        "uirevision": "keep",
        "xaxis": {**x_axis, "anchor": _row("y", len(rows))},
    }
    usable = (1.0 - gap * (len(rows) - 1)) / sum(height for height, _ in rows)
    top = 1.0
    for number, (height, options) in enumerate(rows, 1):
        bottom = max(top - usable * height, 0.0)
        layout[_row("yaxis", number)] = {**options, "domain": [bottom, top]}
        top = bottom - gap
    return layout


def axis(title: str, **options: object) -> Options:
    """Options of an axis; the title may contain ``<br>``."""
    return {**_AXIS, "title": {"text": title, "standoff": 8}, **options}


def _row(name: str, number: int) -> str:
    return name if number == 1 else f"{name}{number}"
