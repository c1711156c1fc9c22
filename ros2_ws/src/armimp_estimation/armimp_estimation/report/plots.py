"""Charts, and how a page shows them: plain data for plotly.js.

A chart says what is drawn; pages draw it with ``plots.js``, `armimp_estimation.figures` for paper.
Lines and bands carry tags (``meta``), by which controls of the page switch them off and on in all
plots at once. Colours are variables of the page's style, see `armimp_estimation.report.look`.
"""

from __future__ import annotations

import base64
import html
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from armimp_common.arrays import FloatArray
from armimp_estimation.report.formats import plain

Trace: TypeAlias = dict[str, Any]
Layout: TypeAlias = dict[str, Any]
Options: TypeAlias = Mapping[str, Any]

BANDS = "bands"
"""Tag of confidence bands."""
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
_TICKS = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0)


@dataclass(frozen=True, kw_only=True)
class Stroke:
    """How a line is drawn: a variable of the style, plotly's dash, pixels; tags switch it.

    One with a symbol, by plotly's name, is a row of marks instead.
    """

    name: str
    colour: str
    dash: str = "solid"
    width: float = 1.6
    tags: Sequence[str] = ()
    symbol: str = ""


@dataclass(frozen=True, kw_only=True)
class Axis:
    """An axis of a chart."""

    title: str
    """May contain ``<br>``."""
    ends: tuple[float, float] | None = None
    """As far as it goes; None leaves that to what is drawn."""
    log: bool = False
    """Whether it is logarithmic."""
    ticks: Sequence[float] = ()
    """Where its ticks are, if they are chosen."""
    labels: Sequence[str] = ()
    """Of these ticks, where they are not their numbers."""
    step: float | None = None
    """Distance of its ticks, if that is chosen."""
    hoverformat: str = ".4~g"
    """Of the numbers that the pointer shows."""
    unit: str = ""
    """Of an abscissa, shown with them."""

    def options(self) -> Options:
        """Options of plotly.js."""
        found: dict[str, Any] = {"hoverformat": self.hoverformat}
        if self.ends is not None:
            found["range"] = [math.log10(end) if self.log else end for end in self.ends]
        if self.log:
            found |= {"type": "log", "exponentformat": "none", "dtick": 1}
        if self.ticks:
            found["tickvals"] = list(self.ticks)
            if self.labels:
                found["ticktext"] = list(self.labels)
        elif self.step:
            found |= {"tick0": 0, "dtick": self.step}
        if self.unit:
            found["unifiedhovertitle"] = {"text": f"%{{x}} {self.unit}"}
        return axis(self.title, **found)


@dataclass(frozen=True, kw_only=True, eq=False)
class Line:
    """A line of a chart, a band about it, or both."""

    x: FloatArray | tuple[float, float]
    """Abscissas, or the first of them and their distance; shape (N,)."""
    y: FloatArray | None
    """Ordinates; NaN makes a gap; shape (N,)."""
    stroke: Stroke
    """How it is drawn."""
    row: int = 1
    """Its axis, counted from 1 at the top."""
    unit: str = ""
    """Shown where the pointer is."""
    ends: tuple[FloatArray, FloatArray] | None = None
    """Lower and upper end of a 95 % band; there is none where one is not finite. Of marks those of
    the bars."""

    @property
    def places(self) -> FloatArray:
        """All abscissas, shape (N,)."""
        if isinstance(self.x, tuple):
            first, step = self.x
            count = 0 if self.y is None else self.y.size
            return first + step * np.arange(count, dtype=np.float64)
        return self.x

    def band(self, axis: Axis) -> tuple[FloatArray, FloatArray, FloatArray] | None:
        """Abscissas, lower and upper ends of the band as an axis can show it; None without one."""
        if self.ends is None or self.stroke.symbol:
            return None
        lower, upper = self.ends
        known = np.isfinite(lower) & np.isfinite(upper)
        least = 1e-6 if axis.log else -np.inf  # a logarithmic axis has no zero
        return self.places[known], np.maximum(lower[known], least), upper[known]

    @property
    def reach(self) -> tuple[FloatArray, FloatArray]:
        """How far bars reach below and above their marks, each of shape (N,)."""
        assert self.y is not None
        lower, upper = (self.y, self.y) if self.ends is None else self.ends
        # Rounding may leave the mean of equal values beside them.
        return np.maximum(self.y - lower, 0.0), np.maximum(upper - self.y, 0.0)

    def traces(self, axis: Axis) -> list[Trace]:
        """Band and line as plotly.js takes them."""
        stroke = self.stroke
        common: Trace = {"type": "scatter", "mode": "lines", "yaxis": axis_name("y", self.row)}
        found: list[Trace] = []
        if (band := self.band(axis)) is not None:
            x, lower, upper = band
            found.append(
                {
                    **common,
                    "x": packed(np.concatenate((x, x[::-1]))),
                    "y": packed(np.concatenate((upper, lower[::-1]))),
                    "fill": "toself",
                    "fillcolor": f"{stroke.colour}/0.2",
                    "line": {"width": 0},
                    "hoverinfo": "skip",
                    "meta": [*stroke.tags, BANDS],
                }
            )
        if self.y is None:
            return found
        places = {"x0": self.x[0], "dx": self.x[1]}
        shown = f"%{{y}} {self.unit}"
        line: Trace = {
            **common,
            **(places if isinstance(self.x, tuple) else {"x": packed(self.x)}),
            "y": packed(self.y),
            "name": label(stroke.name),
            "line": {"color": stroke.colour, "dash": stroke.dash, "width": stroke.width},
            "meta": list(stroke.tags),
        }
        if self.ends is not None:
            line["customdata"] = packed(np.stack(self.ends, axis=1)) | {"shape": f"{self.y.size},2"}
            interval = "from" if stroke.symbol else "95 %:"
            shown += f" ({interval} %{{customdata[0]:.4~g}} to %{{customdata[1]:.4~g}})"
        if stroke.symbol:
            line["mode"] = "markers"
            line["marker"] = {"color": stroke.colour, "symbol": stroke.symbol, "size": 8}
            below, above = self.reach
            bars = {"array": packed(above), "arrayminus": packed(below), "symmetric": False}
            line["error_y"] = {"type": "data", **bars, "thickness": 1.4, "width": 0}
        line["hovertemplate"] = f"{shown}<extra>{label(stroke.name)}</extra>"
        return [*found, line]


@dataclass(frozen=True, kw_only=True)
class View:
    """What a plot shows: traces and layout as plotly.js takes them."""

    name: str = ""
    data: Sequence[Trace]
    layout: Layout


@dataclass(frozen=True, kw_only=True, eq=False)
class Chart:
    """Lines over a common abscissa, in axes one above the other."""

    abscissa: Axis
    """Common to all."""
    rows: Sequence[tuple[float, Axis]]
    """Relative height of each ordinate and what it is, from the top."""
    lines: Sequence[Line]
    """In the order in which they are drawn."""

    def values(self, row: int = 1) -> FloatArray:
        """All ordinates of an axis."""
        return np.concatenate([one.y for one in self.lines if one.row == row and one.y is not None])

    def view(self, name: str = "", **layout: Any) -> View:
        """Return the view of a page; what is given changes its layout, see `stacked`.

        With a ``legend`` among that, each name has one entry there.
        """
        rows = [(height, one.options()) for height, one in self.rows]
        gap, left = (0.05, 62) if len(rows) < 4 else (0.03, 78)
        data = [trace for one in self.lines for trace in one.traces(self.rows[one.row - 1][1])]
        whole = stacked(self.abscissa.options(), rows, gap=gap, left=left)
        if "legend" in layout:
            named = {trace["name"]: trace for trace in reversed(data)}
            for trace in data:
                first = named[trace["name"]] is trace
                trace |= {"legendgroup": trace["name"], "showlegend": first}
            whole |= {"showlegend": True, "margin": {**whole["margin"], "b": 84}}
        return View(name=name, data=data, layout=whole | layout)


@dataclass(frozen=True, kw_only=True)
class Plot:
    """A plot."""

    identifier: str
    """Unique in the page, of letters, digits and hyphens."""
    caption: object
    """Title, text or HTML."""
    description: str
    """What it shows, for those who can't see it."""
    views: Sequence[View]
    """The first one is shown; with more of them the reader chooses."""
    height: int
    """In pixels."""


def packed(values: ArrayLike) -> dict[str, str]:
    """Pack numbers as plotly.js takes them: single precision, base64; NaN makes a gap."""
    raw = np.ascontiguousarray(values, dtype="<f4").tobytes()
    return {"dtype": "f4", "bdata": base64.b64encode(raw).decode("ascii")}


def label(text: object) -> str:
    """Text for plotly.js, which would take some tags in it for formatting and links."""
    # A reader sees no difference, but plotly.js would put values in the place of %{…}.
    return html.escape(plain(text), quote=False).replace("%{", "%\N{WORD JOINER}{")


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
    gap, left : float
        Between the axes, as a part of the whole height, and margin for the titles, pixels.
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


def frequency_axis(grids: Sequence[FloatArray]) -> Axis:
    """Return a logarithmic abscissa that holds all of these frequencies (Hz)."""
    low, high = float(min(f[0] for f in grids)), float(max(f[-1] for f in grids))
    ticks = [tick for tick in _TICKS if low <= tick <= high]
    return Axis(
        title="frequency (Hz)",
        ends=(low, high),
        log=True,
        ticks=ticks,
        hoverformat=".3~f",
        unit="Hz",
    )


def axis_name(name: str, row: int) -> str:
    """Name that plotly.js has for the axis of a row: ``y``, ``y2`` and so on."""
    return name if row == 1 else f"{name}{row}"
