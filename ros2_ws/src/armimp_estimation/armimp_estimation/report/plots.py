"""Interactive plots for pages: plain data for plotly.js.

A page draws them with ``plots.js``. Lines and bands carry tags (``meta``), by which controls of
the page switch them off and on in all plots at once. Colours are variables of the page's style, see
`armimp_estimation.report.look`.
"""

from __future__ import annotations

import base64
import html
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armimp_estimation.report.formats import plain

FloatArray = NDArray[np.float64]
Trace: TypeAlias = dict[str, Any]
Layout: TypeAlias = dict[str, Any]
Options: TypeAlias = Mapping[str, Any]

_INK = "--ink"
_AXIS: Options = {
    "gridcolor": "--rule",
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
    """A plot.

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
    """How a line is drawn: a variable of the style, plotly's dash, pixels; tags switch it."""

    name: str
    colour: str
    dash: str = "solid"
    width: float = 1.6
    tags: Sequence[str] = ()


def packed(values: ArrayLike) -> dict[str, str]:
    """Pack numbers as plotly.js takes them: single precision, base64; NaN makes a gap."""
    raw = np.ascontiguousarray(values, dtype="<f4").tobytes()
    return {"dtype": "f4", "bdata": base64.b64encode(raw).decode("ascii")}


def label(text: object) -> str:
    """Text for plotly.js, which would take some tags in it for formatting and links."""
    # A reader sees no difference, but plotly.js would put values in the place of %{…}.
    return html.escape(plain(text), quote=False).replace("%{", "%\N{WORD JOINER}{")


def line(
    x: FloatArray | tuple[float, float],
    y: FloatArray,
    stroke: Stroke,
    *,
    row: int = 1,
    unit: str = "",
    ends: tuple[FloatArray, FloatArray] | None = None,
) -> Trace:
    """Make a line on the axis of a row, counted from 1 at the top.

    Parameters
    ----------
    x : ndarray of shape (N,), or tuple of float
        Abscissas, or the first of them and their distance.
    y : ndarray, shape (N,)
        Ordinates.
    stroke : Stroke
        How it is drawn.
    row : int
        Counted from 1 at the top.
    unit : str
        Shown where the pointer is.
    ends : tuple of ndarray, optional
        Of a 95 % band, shown there as well.
    """
    place = {"x0": x[0], "dx": x[1]} if isinstance(x, tuple) else {"x": packed(x)}
    trace: Trace = {
        "type": "scatter",
        "mode": "lines",
        **place,
        "y": packed(y),
        "name": label(stroke.name),
        "line": {"color": stroke.colour, "dash": stroke.dash, "width": stroke.width},
        "meta": list(stroke.tags),
        "yaxis": axis_name("y", row),
    }
    shown = f"%{{y}} {unit}"
    if ends is not None:
        trace["customdata"] = packed(np.stack(ends, axis=1)) | {"shape": f"{y.size},2"}
        shown += " (95 %: %{customdata[0]:.4~g} to %{customdata[1]:.4~g})"
    return trace | {"hovertemplate": f"{shown}<extra>{label(stroke.name)}</extra>"}


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
        "fillcolor": f"{colour}/0.2",
        "line": {"width": 0},
        "hoverinfo": "skip",
        "meta": list(tags),
        "yaxis": axis_name("y", row),
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
        "plot_bgcolor": "rgba(0,0,0,0)",
        "hoverlabel": {"bgcolor": "--paper", "font": {"color": _INK}, "namelength": -1},
        # The buttons of plotly.js are in the upper margin, beside the caption.
        "margin": {"l": left, "r": 12, "t": 30, "b": 44},
        "modebar": {"bgcolor": "rgba(0,0,0,0)", "color": "--soft", "activecolor": _INK},
        "showlegend": False,
        "hovermode": "x unified",
        # What the reader zoomed into stays when lines are switched.
        "uirevision": "keep",
        "xaxis": {**x_axis, "anchor": axis_name("y", len(rows))},
    }
    usable = (1.0 - gap * (len(rows) - 1)) / sum(height for height, _ in rows)
    top = 1.0
    for number, (height, options) in enumerate(rows, 1):
        bottom = max(top - usable * height, 0.0)
        layout[axis_name("yaxis", number)] = {**options, "domain": [bottom, top]}
        top = bottom - gap
    return layout


def axis(title: str, **options: object) -> Options:
    """Options of an axis; the title may contain ``<br>``."""
    return {**_AXIS, "title": {"text": title, "standoff": 8}, **options}


def log_axis(title: str, ends: tuple[float, float], hoverformat: str) -> Options:
    """Options of a logarithmic ordinate from one end to the other."""
    return axis(
        title,
        type="log",
        range=[math.log10(end) for end in ends],
        dtick=1,
        exponentformat="none",
        hoverformat=hoverformat,
    )


def frequency_axis(grids: Sequence[FloatArray]) -> Options:
    """Options of a logarithmic abscissa that holds all of these frequencies (Hz)."""
    ends = [min(f[0] for f in grids), max(f[-1] for f in grids)]
    return axis(
        "frequency (Hz)",
        type="log",
        range=[math.log10(end) for end in ends],
        tickvals=[0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50],
        hoverformat=".3~f",
        unifiedhovertitle={"text": "%{x} Hz"},
    )


def axis_name(name: str, row: int) -> str:
    """Name that plotly.js has for the axis of a row: ``y``, ``y2`` and so on."""
    return name if row == 1 else f"{name}{row}"
