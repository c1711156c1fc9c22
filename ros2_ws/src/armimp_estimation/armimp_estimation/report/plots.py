"""Charts of a result as plain data, and their style in every report and figure.

A chart describes what to draw; ``plots.js`` draws it on pages, `armimp_estimation.figures` on
paper. Lines and bands carry tags (``meta``), with which controls of a page hide or show them in all
plots at once.

One colour stands for one thing. Estimators have the colours of Okabe and Ito, joints those of Tol's
muted scheme, elements those of his bright scheme, and levels steps from light to dark: colour-blind
people can distinguish them all. Lines also differ in their dashes. Charts name colours as variables
of the page's style, such as ``--estimator-0``; ``style.css`` has a lighter set for the dark mode.
A page looks them up in ``plots.js``, a figure with `printed`.
"""

from __future__ import annotations

import base64
import html
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from armimp_common.arrays import ComplexArray, FloatArray
from armimp_estimation.alignment.assemble import Trial
from armimp_estimation.distortion import Distortion
from armimp_estimation.estimators.estimate import confidence_radius
from armimp_estimation.estimators.registry import ESTIMATORS
from armimp_estimation.mbk import MBK
from armimp_estimation.record import TrialRecord
from armimp_estimation.report.formats import plain, symbol
from armimp_estimation.result import Result
from armimp_estimation.spectra import BAND as PERTURBED
from armimp_estimation.summary import ImpedanceCurve

Options: TypeAlias = dict[str, Any]
"""Options in the form of plotly.js."""
Band: TypeAlias = tuple[FloatArray, FloatArray]
"""Lower and upper end."""

_PALETTES: Mapping[str, Sequence[str]] = {
    "estimator": ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00"),
    "joint": ("#332288", "#cc6677", "#44aa99", "#999933", "#88ccee", "#882255", "#5f5f5f"),
    "level": ("#b8a500", "#35a06a", "#2f6f8f", "#440154"),
    "element": ("#4477aa", "#ee6677", "#228833", "#ccbb44", "#66ccee", "#aa3377", "#8f8f8f"),
    "signal": ("#8a8a8a", "#2b2b2b"),
    "ink": ("#1d2329",),
    "soft": ("#55606b",),
    "rule": ("#d5dae0",),
    "paper": ("#ffffff",),
    "shade": ("#f5f7f9",),
    "good": ("#00704f",),
    "bad": ("#b03a00",),
    "link": ("#005a94",),
}
LEVEL_DASHES = ("solid", "dash", "dashdot", "dot")
"""Dashes of levels of friction and resolution in a study."""
DASHES = ("solid", "dash", "dashdot", "longdash", "longdashdot", "dot")
"""Dashes by plotly's names; dotted comes last, as it stands for the truth."""

IMPEDANCE = "N·m/rad"
SIDE_BY_SIDE = 3
"""Most joints with which the elements of a matrix are shown side by side."""
BAND = 2.0 * PERTURBED[1]
"""Cut-off frequency of the signals shown, twice the upper end of the estimates, Hz."""
_ORDER = 4
_TICKS = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0)
_GAP = 0.04
"""Gap between axes above each other, as a share of the whole height."""
_EXCERPT = 2000
"""Number of last samples that are shown in full."""
_REFERENCE = "lpm_full"


@dataclass(frozen=True, kw_only=True)
class Stroke:
    """Style of a line: colour (a variable of the style), plotly's dash, width in pixels, and tags.

    With a symbol, by plotly's name, it is a series of markers instead.
    """

    name: str
    colour: str
    dash: str = "solid"
    width: float = 1.6
    tags: Sequence[str] = ()
    symbol: str = ""


TRUE = Stroke(name="truth", colour="--ink", dash="dot", tags=["truth"])
CONFIDENCE = Stroke(name="95 % confidence", colour="--rule", tags=["bands"])
MOTION = Stroke(name="perturbation → angle", colour="--signal-0", width=1.3)
TORQUE = Stroke(name="perturbation → torque", colour="--signal-1", width=1.3)
UNRELATED = Stroke(name="unrelated signals stay below", colour="--soft", dash="dot", width=1.0)


def estimator_tag(name: str) -> str:
    """Tag of all lines of an estimator."""
    return f"estimator:{name}"


def strokes(names: Iterable[str]) -> dict[str, Stroke]:
    """Strokes of estimators by name. Known ones always look the same, others get what is left."""
    wanted = list(names)
    order = [*ESTIMATORS, *(name for name in wanted if name not in ESTIMATORS)]
    numbers = {name: order.index(name) % len(DASHES) for name in wanted}
    return {
        name: Stroke(
            name=name,
            colour=f"--estimator-{number}",
            dash=DASHES[number],
            tags=[estimator_tag(name)],
        )
        for name, number in numbers.items()
    }


def joint_strokes(names: Sequence[str]) -> list[Stroke]:
    """Strokes of joints, in the order of their names."""
    return [
        Stroke(name=name, colour=f"--joint-{joint % 7}", width=1.0)
        for joint, name in enumerate(names)
    ]


def printed(colour: str) -> str:
    """Colour on paper, ``#rrggbb``, of a variable of the style."""
    name, _, number = colour.removeprefix("--").partition("-")
    return _PALETTES[name][int(number or 0)]


def style_rule() -> str:
    """Rule of a style sheet that defines the colours as variables."""
    colours = (
        f"--{name}{f'-{number}' if len(colours) > 1 else ''}:{colour};"
        for name, colours in _PALETTES.items()
        for number, colour in enumerate(colours)
    )
    return f":root{{{''.join(colours)}}}\n"


@dataclass(frozen=True, kw_only=True)
class Axis:
    """An axis of a chart."""

    title: str
    """May contain ``<br>``."""
    ends: tuple[float, float] | None = None
    """Its range; None fits it to the content."""
    log: bool = False
    """Whether it is logarithmic."""
    ticks: Sequence[float] = ()
    """Positions of its ticks, if they are chosen."""
    labels: Sequence[str] = ()
    """Labels of these ticks, if they are not the numbers."""
    hoverformat: str = ".4~g"
    """Format of the numbers that the pointer shows."""
    unit: str = ""
    """Unit of an abscissa, shown with these numbers."""

    def options(self, **others: object) -> Options:
        """Options of the axis for plotly.js."""
        found: Options = {"title": {"text": self.title}, "hoverformat": self.hoverformat, **others}
        if self.ends is not None:
            found["range"] = [math.log10(end) if self.log else end for end in self.ends]
        if self.log:
            found |= {"type": "log", "exponentformat": "none", "dtick": 1}
        if self.ticks:
            found["tickvals"] = list(self.ticks)
            if self.labels:
                found["ticktext"] = list(self.labels)
        if self.unit:
            found["unifiedhovertitle"] = {"text": f"%{{x}} {self.unit}"}
        return found


@dataclass(frozen=True, kw_only=True, eq=False)
class Line:
    """A line of a chart, with or without a band about it."""

    x: FloatArray
    """Abscissas, shape (N,)."""
    y: FloatArray
    """Ordinates; NaN makes a gap; shape (N,)."""
    stroke: Stroke
    """Its style."""
    row: int = 1
    """Its axis, counted from 1 at the top."""
    unit: str = ""
    """Unit of the ordinates that the pointer shows."""
    ends: Band | None = None
    """Lower and upper end of a 95 % band, with gaps where one is not finite; for markers, those of
    the error bars."""

    def band(self, axis: Axis) -> tuple[FloatArray, FloatArray, FloatArray] | None:
        """Abscissas, lower and upper ends of the band as an axis can show it; None without one."""
        if self.ends is None or self.stroke.symbol:
            return None
        lower, upper = self.ends
        known = np.isfinite(lower) & np.isfinite(upper)
        least = 1e-6 if axis.log else -np.inf  # a logarithmic axis has no zero
        return self.x[known], np.maximum(lower[known], least), upper[known]

    @property
    def reach(self) -> Band:
        """Lengths of the error bars below and above their markers, each of shape (N,)."""
        lower, upper = (self.y, self.y) if self.ends is None else self.ends
        # By rounding, the mean of equal values may lie outside of them.
        return np.maximum(self.y - lower, 0.0), np.maximum(upper - self.y, 0.0)

    def traces(self, axis: Axis) -> list[Options]:
        """Traces of band and line for plotly.js."""
        stroke = self.stroke
        common: Options = {"type": "scatter", "mode": "lines", "yaxis": axis_name("y", self.row)}
        found: list[Options] = []
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
                    "meta": [*stroke.tags, *CONFIDENCE.tags],
                }
            )
        shown = f"%{{y}} {self.unit}"
        line: Options = {
            **common,
            "x": packed(self.x),
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


@dataclass(frozen=True, kw_only=True, eq=False)
class Chart:
    """Lines over a common abscissa, in axes above each other."""

    abscissa: Axis
    """Common abscissa."""
    rows: Sequence[tuple[float, Axis]]
    """Relative height and ordinate of each row, from the top."""
    lines: Sequence[Line]
    """Lines in the order of drawing."""
    description: str = ""
    """Description for readers who can't see it."""
    layout: Options = field(default_factory=dict)
    """Further layout options on a page. With a ``legend``, each name has one entry there."""

    def values(self, row: int = 1) -> FloatArray:
        """All ordinates of the lines in a row."""
        return np.concatenate([one.y for one in self.lines if one.row == row])

    def drawn(self) -> Options:
        """Traces and layout for plotly.js; ``plots.js`` adds the options common to all charts."""
        layout = {"xaxis": self.abscissa.options(anchor=axis_name("y", len(self.rows)))}
        usable = (1.0 - _GAP * (len(self.rows) - 1)) / sum(height for height, _ in self.rows)
        top = 1.0
        for number, (height, one) in enumerate(self.rows, 1):
            bottom = max(top - usable * height, 0.0)
            layout[axis_name("yaxis", number)] = one.options(domain=[bottom, top])
            top = bottom - _GAP
        traces = [trace for one in self.lines for trace in one.traces(self.rows[one.row - 1][1])]
        return {"data": traces, "layout": layout | self.layout}


@dataclass(frozen=True, kw_only=True)
class Plot:
    """A plot of a page."""

    identifier: str
    """Identifier of letters, digits and hyphens, unique in the page."""
    caption: object
    """Title, text or HTML."""
    views: Mapping[str, Chart]
    """Charts by name; the first is shown, and the reader can choose others, which are described as
    it is."""
    height: int
    """Height in pixels."""


def packed(values: ArrayLike) -> dict[str, str]:
    """Pack numbers for plotly.js: single precision, base64; NaN makes a gap."""
    raw = np.ascontiguousarray(values, dtype="<f4").tobytes()
    return {"dtype": "f4", "bdata": base64.b64encode(raw).decode("ascii")}


def label(text: object) -> str:
    """Escape a text for plotly.js, which would interpret some tags as formatting or links."""
    # A reader sees no difference, but plotly.js would replace %{…} by values.
    return html.escape(plain(text), quote=False).replace("%{", "%\N{WORD JOINER}{")


def frequency_axis(grids: Sequence[FloatArray]) -> Axis:
    """Return a logarithmic abscissa that spans all of these frequencies (Hz)."""
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
    """Name of the axis of a row in plotly.js: ``y``, ``y2`` and so on."""
    return name if row == 1 else f"{name}{row}"


def element_plots(
    kind: str,
    joints: int,
    chart: Callable[[int, int], Chart],
    height: int,
) -> list[Plot]:
    """Plots of all elements of Z, row by row; with many joints, one plot of a selectable element.

    `chart` takes the indices of an element (0-based); the height is in pixels.
    """
    charts = {(i + 1, k + 1): chart(i, k) for i, k in np.ndindex(joints, joints)}
    plots = [
        Plot(
            identifier=f"{kind}-{i}-{k}",
            caption=symbol("Z", i, k),
            views={"": one},
            height=height,
        )
        for (i, k), one in charts.items()
    ]
    if joints <= SIDE_BY_SIDE:
        return plots
    views = {f"Z{i}{k}": one for (i, k), one in charts.items()}
    return [replace(plots[0], caption="Element", views=views, height=height + 60)]


def bode_chart(curves: Mapping[str, ImpedanceCurve], truth: MBK | None, i: int, k: int) -> Chart:
    """Bode plot of ``Z_ik``: every estimate with its 95 % band, the truth, and their distance.

    `curves` has at least one curve, by name of the estimator. The element is 0-based: torque of
    joint i over angle of joint k. Distances are those from the reference, see `reference_of`.
    """
    reference = reference_of(curves, truth)

    def centre(f: FloatArray) -> ComplexArray:
        if truth is not None:
            return np.asarray(truth.impedance(f)[i, k])
        other = curves[reference]
        return np.asarray(np.interp(f, other.f, other.Z[i, k]))

    lines: list[Line] = []
    parted: list[FloatArray] = []
    for name, stroke in strokes(curves).items():
        f, z = curves[name].f, curves[name].Z[i, k]
        circle = confidence_radius(curves[name].variance[i, k], curves[name].averages)
        magnitude, phase, about = np.abs(z), phase_of(z), centre(f)
        bands = bands_of(magnitude, phase, circle)
        off = np.full(f.size, np.nan) if name == reference else deviation_percent(about, z)
        radius = 100.0 * circle / np.abs(about)
        thin = replace(stroke, width=1.1)
        lines += [
            Line(x=f, y=magnitude, stroke=stroke, unit=IMPEDANCE, ends=bands[0]),
            Line(x=f, y=phase, stroke=stroke, row=2, unit="°", ends=bands[1]),
            Line(x=f, y=off, stroke=thin, row=3, unit="%", ends=(np.zeros(f.size), radius)),
        ]
        parted += [radius, off]
    grids = [curve.f for curve in curves.values()]
    if truth is not None:
        f = max(grids, key=len)
        true = truth.impedance(f)[i, k]
        lines.append(Line(x=f, y=np.abs(true), stroke=TRUE, unit=IMPEDANCE))
        lines.append(Line(x=f, y=phase_of(true), stroke=TRUE, row=2, unit="°"))
    chart = Chart(abscissa=frequency_axis(grids), rows=[], lines=lines)
    sizes = chart.values()
    magnitudes, phases = range_of(sizes, log=True), range_of(chart.values(2))
    values = np.concatenate(parted)
    values = values[np.isfinite(values) & (values > 0.0)]
    low, high = np.quantile(values, (0.02, 0.995)) if values.size else (0.01, 60.0)
    ends = float(min(low, 0.15 * high)), float(1.5 * high)
    rows = [
        (3.0, Axis(title="magnitude (N·m/rad)", ends=magnitudes, log=True)),
        (2.0, Axis(title="phase (°)", ends=phases, hoverformat=".1f")),
        (2.4, Axis(title="distance (%)", ends=ends, log=True, hoverformat=".3~g")),
    ]
    description = (
        f"Magnitude and phase of Z {i + 1} {k + 1} over frequency: from {np.nanmin(sizes):.3g} "
        f"to {np.nanmax(sizes):.3g} N·m/rad, and the distance of the estimates."
    )
    return replace(chart, rows=rows, description=description)


def coherence_chart(result: Result, i: int, k: int) -> Chart:
    """Chart of the coherences behind ``Z_ik`` (0-based) over frequency; the result has curves."""
    names, common = result.summary.joint_names, next(iter(result.curves.values())).coherence
    shown = [
        (common.motion[k], replace(MOTION, name=f"{MOTION.name} of {names[k]}")),
        (common.torque[i, k], replace(TORQUE, name=f"{TORQUE.name} of {names[i]}")),
    ]
    for name, stroke in strokes(result.curves).items():
        derived = result.curves[name].coherence.derived[i, k]
        shown.append((derived, replace(stroke, name=f"derived, {name}")))
    lines = [Line(x=common.f, y=values, stroke=stroke) for values, stroke in shown]
    level = np.full(2, result.significance)
    lines.append(Line(x=common.f[[0, -1]], y=level, stroke=UNRELATED))
    ordinate = Axis(title="coherence γ²", ends=(0.0, 1.02), hoverformat=".4f")
    lowest = min(float(np.nanmin(values)) for values, _ in shown)
    what = f"Coherences behind Z {i + 1} {k + 1} over frequency; the lowest is {lowest:.2g}."
    return Chart(
        abscissa=frequency_axis([common.f]), rows=[(1.0, ordinate)], lines=lines, description=what
    )


def distortion_plot(found: Distortion, trial: int) -> Plot:
    """Plot torque at lines of the perturbation and at other harmonics, and noise at all of them."""
    odd, even = found.odd, found.even
    shown = [
        (found.lines, Stroke(name="at lines", colour="--soft", symbol="circle")),
        (odd, Stroke(name="odd harmonics", colour="--element-1", symbol="square")),
        (even, Stroke(name="even harmonics", colour="--element-0", symbol="diamond")),
    ]
    lines = [Line(x=one.f, y=one.amplitude, stroke=mark, unit="N·m") for one, mark in shown]
    f = np.concatenate([one.f for one, _ in shown])
    order = np.argsort(f)
    noise = np.concatenate([one.noise for one, _ in shown])
    floor = Stroke(name="noise between harmonics", colour="--ink", dash="dot", width=1.0)
    lines.append(Line(x=f[order], y=noise[order], stroke=floor, unit="N·m"))
    chart = Chart(
        abscissa=frequency_axis([f]),
        rows=[(1.0, Axis(title="torque (N·m)", log=True, hoverformat=".3~g"))],
        lines=lines,
        description=(
            f"Torque at the harmonics of the perturbation: {found.lines.rms:.3g} N·m at its lines, "
            f"{odd.rms:.3g} at odd and {even.rms:.3g} at even ones beside them."
        ),
    )
    caption = f"Trial {trial}"
    return Plot(identifier=f"distortion-{trial}", caption=caption, views={"": chart}, height=280)


@dataclass(frozen=True, kw_only=True, eq=False)
class Row:
    """Signals that are drawn in one axis."""

    title: str
    unit: str
    """Unit of the axis."""
    joints: tuple[int, ...]
    """Joint of each signal, 0-based."""
    values: FloatArray
    """One value for each control period; NaN where there is none; shape (len(joints), N)."""


def rows_of(
    segments: Sequence[TrialRecord], start_ns: int, *, cutoff: float | None = BAND
) -> list[Row]:
    """Signals of a trial for display: low-pass filtered, and angles in degrees, about their mean.

    Locked joints have a separate row, as their motion is far smaller. Commands and torques chatter
    far above the band of the perturbation, so without a low-pass they would all be solid bars.

    Parameters
    ----------
    segments : parts of the trial without gaps, at least one
    start_ns : stamp of the first sample of the trial (ns)
    cutoff : cut-off frequency of the low-pass, Hz; None shows the signals as recorded
    """
    starts = [round(one.rate * (one.start_ns - start_ns) / 1e9) for one in segments]
    span = max(start + part.samples for start, part in zip(starts, segments, strict=True))

    def signal(field: str) -> FloatArray:
        """Signal of all segments, with NaN in the gaps; shape (n, span)."""
        whole = np.full((segments[0].joints, span), np.nan)
        for start, segment in zip(starts, segments, strict=True):
            values = getattr(segment, field)
            seen = values if cutoff is None else _smoothed(values, cutoff / segment.rate)
            whole[:, start : start + segment.samples] = seen
        return whole

    def row(title: str, unit: str, joints: tuple[int, ...], values: FloatArray) -> Row:
        return Row(title=title, unit=unit, joints=joints, values=values[list(joints)])

    everyone = tuple(range(segments[0].joints))
    perturbation, angle = signal("perturbation"), np.degrees(signal("position"))
    angle -= np.nanmean(angle, axis=1, keepdims=True)
    k = segments[0].perturbed_joint
    perturbed = tuple(j for j in everyone if j == k or np.nan_to_num(perturbation[j]).any())
    held = tuple(j for j in everyone if j not in perturbed)
    rows = [
        row("perturbation", "N·m", perturbed, perturbation),
        row("angle", "°", perturbed, angle),
        *([row("held joints", "°", held, angle)] if held else []),
        row("torque on arm", "N·m", everyone, signal("torque")),
    ]
    if all(segment.command is not None for segment in segments):
        rows.append(row("command", "N·m", everyone, signal("command")))
    return rows


def _smoothed(values: FloatArray, cutoff: float) -> FloatArray:
    """Signals behind a zero-phase low-pass with a cut-off frequency in cycles per sample."""
    # A discrete Butterworth filter forwards and backwards, on the signal and its mirror image. That
    # of scipy.signal does the same, but its import takes longer than writing the whole report.
    mirrored = np.concatenate((values, values[:, ::-1]), axis=1)
    ratio = np.tan(np.pi * np.fft.rfftfreq(mirrored.shape[1])) / np.tan(np.pi * cutoff)
    seen = np.fft.irfft(np.fft.rfft(mirrored) / (1.0 + ratio ** (2 * _ORDER)), mirrored.shape[1])
    return seen[:, : values.shape[1]]


def trace_plot(identifier: str, trial: Trial, buckets: int) -> Plot:
    """Plot a trial over time: the whole trial as `rows_of` gives it, and its end as recorded.

    The trial has at least one segment; `envelope` thins out the view of the whole.
    """
    first, start_ns = trial.segments[0], trial.window.start_ns
    rows, recorded = (rows_of(trial.segments, start_ns, cutoff=one) for one in (BAND, None))
    span = rows[0].values.shape[1]
    last = max(span - _EXCERPT, 0)
    end = f"last {(span - last) / first.rate:g} s as recorded"
    return Plot(
        identifier=identifier,
        caption="Signals over time",
        views={
            "whole trial": trace_chart(rows, first, 0, span, buckets),
            end: trace_chart(recorded, first, last, span, _EXCERPT),
        },
        height=125 * len(rows) + 50,
    )


def trace_chart(
    rows: Sequence[Row], record: TrialRecord, start: int, stop: int, buckets: int
) -> Chart:
    """Chart of the signals of a trial from one sample to another, thinned out by `envelope`.

    The record gives the names of the joints and the rate.
    """
    lines, of_joints = [], joint_strokes(record.joint_names)
    for number, row in enumerate(rows, 1):
        for joint, values in zip(row.joints, row.values, strict=True):
            own = of_joints[joint]
            stroke = replace(own, name=f"{row.title}, {own.name}")
            thinned, step = envelope(values[start:stop], buckets)
            time = (start + step * np.arange(thinned.size, dtype=np.float64)) / record.rate
            lines.append(Line(x=time, y=thinned, stroke=stroke, row=number, unit=row.unit))
    ends = start / record.rate, stop / record.rate
    title = "time since the perturbation began (s)"
    abscissa = Axis(title=title, ends=ends, hoverformat=".3f", unit="s")
    ordinates = [(1.0, Axis(title=f"{row.title}<br>({row.unit})")) for row in rows]
    what = f"Perturbation, angles, torques and commands of trial {record.trial}."
    return Chart(abscissa=abscissa, rows=ordinates, lines=lines, description=what)


def bands_of(magnitude: FloatArray, phase: FloatArray, radius: FloatArray) -> tuple[Band, Band]:
    """The 95 % bands of magnitude (N·m/rad) and phase (degrees) from the confidence circle."""
    # A logarithmic axis has no zero: the lower end stays positive, far below the curve.
    lower = np.maximum(magnitude - radius, 1e-3 * magnitude)
    with np.errstate(divide="ignore", invalid="ignore"):
        sine = radius / magnitude
    # Half the angle under which the origin sees the circle; all phases if the circle encloses it.
    spread = np.degrees(np.where(sine < 1.0, np.arcsin(np.minimum(sine, 1.0)), np.pi))
    return (lower, magnitude + radius), (phase - spread, phase + spread)


def phase_of(z: ComplexArray) -> FloatArray:
    """Unwrapped phase over frequency, degrees, in the turn closest to zero."""
    phase = np.degrees(np.unwrap(np.angle(z)))
    # The turn in which the unwrapped phase starts is arbitrary, above all if it starts with noise.
    return np.asarray(phase - 360.0 * np.round(np.median(phase) / 360.0))


def phase_about(truth: ComplexArray, z: ComplexArray) -> FloatArray:
    """Phase of an estimate, degrees, unwrapped relative to the phase of the truth.

    Both have shape (n_freq,), at the same frequencies, N·m/rad.
    """
    return np.degrees(np.unwrap(np.angle(truth)) + np.angle(z / truth))


def deviation_percent(truth: ComplexArray, z: ComplexArray) -> FloatArray:
    """Distance of an estimate from the truth in the complex plane, % of the truth."""
    return 100.0 * np.abs(z / truth - 1.0)


def reference_of(curves: Mapping[str, ImpedanceCurve], truth: MBK | None) -> str:
    """Name the estimator with which others are compared; empty if that is the truth."""
    if truth is not None:
        return ""
    return _REFERENCE if _REFERENCE in curves else next(iter(curves))


def range_of(values: FloatArray, *, log: bool = False) -> tuple[float, float]:
    """Range of an axis that shows all of the values.

    Pass the curves, not their bands: one very wide band must not flatten everything else.
    """
    known = values[np.isfinite(values) & ((values > 0.0) | (not log))]
    if not known.size:
        return (1.0, 10.0) if log else (0.0, 1.0)
    low, high = float(known.min()), float(known.max())
    if log:
        margin = 1.05 * (high / low) ** 0.06
        return low / margin, high * margin
    margin = 0.08 * (high - low) + 2.0
    return low - margin, high + margin


def envelope(values: FloatArray, buckets: int) -> tuple[FloatArray, float]:
    """Thin out a signal so that it looks the same on a plot with no more pixels than buckets.

    Parameters
    ----------
    values : (N,), the signal; NaN in gaps
    buckets : number of parts; each gives its smallest and its largest value, in their order in time

    Returns
    -------
    thinned : ndarray, shape (at most 2·buckets,)
        Thinned signal; the signal itself if it is no longer than that.
    step : float
        Distance between thinned values, in samples of the signal.
    """
    if values.size <= 2 * buckets:
        return values, 1.0
    size = -(-values.size // buckets)
    padded = np.full(-(-values.size // size) * size, np.nan)
    padded[: values.size] = values
    parts = padded.reshape(-1, size)
    gaps = np.isnan(parts)
    lowest = np.argmin(np.where(gaps, np.inf, parts), axis=1)
    highest = np.argmax(np.where(gaps, -np.inf, parts), axis=1)
    order = np.sort(np.stack([lowest, highest], axis=1), axis=1)
    return np.take_along_axis(parts, order, axis=1).ravel(), size / 2
