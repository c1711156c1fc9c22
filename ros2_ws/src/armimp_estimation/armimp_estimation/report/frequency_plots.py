"""Plots over frequency: impedance with the distance of the estimates, and coherence."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from armimp_estimation.mbk import MBK
from armimp_estimation.report.curves import (
    BodeCurve,
    CoherenceCurves,
    element_curve,
    magnitude_range,
    phase_range,
    phase_step,
    true_curve,
)
from armimp_estimation.report.formats import symbol
from armimp_estimation.report.look import Look, looks
from armimp_estimation.report.plots import (
    Options,
    Plot,
    Stroke,
    Trace,
    View,
    axis,
    band,
    line,
    stacked,
)
from armimp_estimation.results import ImpedanceCurve

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

BANDS = "bands"
"""Tag of confidence bands."""
TRUTH = "truth"
"""Tag of true curves."""
SIDE_BY_SIDE = 3
"""Joints up to which the elements of a matrix are shown beside each other."""
_REFERENCE = "lpm_full"
_IMPEDANCE, _MAGNITUDE_STEPS = "N·m/rad", 1


def estimator_tag(name: str) -> str:
    """Tag of everything that an estimator found."""
    return f"estimator:{name}"


def plot_matrix(joints: int, plot: Callable[[int, int], Plot]) -> list[Plot]:
    """Plots of all elements (0-based), row by row; with many joints one plot to choose from."""
    plots = [plot(i, k) for i in range(joints) for k in range(joints)]
    if joints <= SIDE_BY_SIDE:
        return plots
    views = [
        replace(view, name=f"Z{i // joints + 1}{i % joints + 1}")
        for i, one in enumerate(plots)
        for view in one.views
    ]
    first = plots[0]
    return [replace(first, caption="Element", views=views, height=first.height + 60)]


def reference_of(curves: Mapping[str, ImpedanceCurve], truth: MBK | None) -> str:
    """What estimates are compared with: the truth (empty), or the name of an estimator."""
    if truth is not None:
        return ""
    return _REFERENCE if _REFERENCE in curves else next(iter(curves))


def bode_plot(curves: Mapping[str, ImpedanceCurve], truth: MBK | None, i: int, k: int) -> Plot:
    """Bode plot of ``Z_ik``: every estimate with its 95 % band, the truth, and how far they part.

    Parameters
    ----------
    curves : mapping of str to ImpedanceCurve
        By name of the estimator; at least one.
    truth : MBK or None
        True matrices.
    i, k : int
        Element, 0-based: torque of joint i over angle of joint k.
    """
    shown = {name: element_curve(curve, i, k) for name, curve in curves.items()}
    data = [t for name, look in looks(curves).items() for t in _bode_traces(shown[name], look)]
    every = list(shown.values())
    if truth is not None:
        finest = max((curve.f for curve in curves.values()), key=len)
        true = true_curve(truth, finest, i, k)
        stroke = Stroke(name="truth", colour="--ink", dash="dot", tags=[TRUTH])
        data.append(line(true.f, true.magnitude, stroke, unit=_IMPEDANCE))
        data.append(line(true.f, true.phase, stroke, row=2, unit="°"))
        every.append(true)
    distances, ends = _distances(curves, truth, i, k)
    layout = stacked(
        frequency_axis([curve.f for curve in curves.values()]),
        [
            (3.0, _magnitude_axis(every)),
            (2.0, _phase_axis(every)),
            (2.4, _distance_axis("distance (%)", ends)),
        ],
    )
    sizes = np.concatenate([one.magnitude for one in every])
    return Plot(
        identifier=f"bode-{i + 1}-{k + 1}",
        caption=symbol("Z", i + 1, k + 1),
        description=(
            f"Magnitude and phase of Z {i + 1} {k + 1} over frequency: from {np.nanmin(sizes):.3g} "
            f"to {np.nanmax(sizes):.3g} N·m/rad, and the distance of the estimates."
        ),
        views=[View(data=[*data, *distances], layout=layout)],
        height=500,
    )


def _distances(
    curves: Mapping[str, ImpedanceCurve], truth: MBK | None, i: int, k: int
) -> tuple[list[Trace], list[float]]:
    """Lines and bands of the distance panel (%), and the ends of its axis."""
    reference = reference_of(curves, truth)
    data: list[Trace] = []
    found: list[FloatArray] = []
    for name, look in looks(curves).items():
        curve = curves[name]
        if name == reference and len(curves) > 1:
            centre = curve.Z[i, k]
        elif truth is not None:
            centre = truth.impedance(curve.f)[i, k]
        else:
            other = curves[reference]
            centre = np.interp(curve.f, other.f, other.Z[i, k])
        size = np.abs(centre)
        off = 100.0 * np.abs(curve.Z[i, k] - centre) / size
        radius = 100.0 * element_curve(curve, i, k).radius / size
        tags = [estimator_tag(name)]
        floor = np.full(curve.f.size, 1e-6)
        data.append(band(curve.f, (floor, radius), look.variable, [*tags, BANDS], 3))
        found.append(radius[np.isfinite(radius)])
        if name != reference:
            stroke = Stroke(
                name=look.label, colour=look.variable, dash=look.dash, width=1.1, tags=tags
            )
            limits = (np.zeros(curve.f.size), radius)
            data.append(line(curve.f, off, stroke, row=3, unit="%", ends=limits))
            found.append(off)
    values = np.concatenate(found)
    values = values[values > 0.0]
    if not values.size:
        return data, [0.01, 100.0]
    return data, [float(np.quantile(values, 0.02)), float(np.quantile(values, 0.995)) * 1.5]


def _distance_axis(title: str, ends: Sequence[float]) -> Options:
    low, high = (math.log10(end) for end in ends)
    return axis(
        title,
        type="log",
        range=[min(low, high - 1.0), high],
        dtick=1,
        exponentformat="none",
        hoverformat=".3~g",
    )


def _bode_traces(curve: BodeCurve, look: Look) -> Iterator[Trace]:
    tags = [estimator_tag(look.name)]
    stroke = Stroke(name=look.label, colour=look.variable, dash=look.dash, tags=tags)
    for row, values, ends, unit in (
        (1, curve.magnitude, curve.magnitude_band, _IMPEDANCE),
        (2, curve.phase, curve.phase_band, "°"),
    ):
        yield band(curve.f, ends, look.variable, [*tags, BANDS], row=row)
        yield line(curve.f, values, stroke, row=row, unit=unit, ends=ends)


def _magnitude_axis(curves: Sequence[BodeCurve]) -> Options:
    return axis(
        "magnitude (N·m/rad)",
        type="log",
        range=[math.log10(end) for end in magnitude_range(curves)],
        dtick=1,
        exponentformat="none",
        hoverformat=".4~g",
    )


def _phase_axis(curves: Sequence[BodeCurve]) -> Options:
    ends = phase_range(curves)
    step = phase_step(ends, most=5)
    return axis("phase (°)", range=list(ends), tick0=0, dtick=step, hoverformat=".1f")


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


def coherence_plot(
    curves: CoherenceCurves,
    i: int,
    k: int,
    *,
    joint_names: Sequence[str],
    levels: Sequence[tuple[str, float, str]],
) -> Plot:
    """Coherences behind ``Z_ik`` over frequency.

    Parameters
    ----------
    curves : CoherenceCurves
        The coherences.
    i, k : int
        Element, 0-based.
    joint_names : sequence of str
        Names of the joints.
    levels : sequence of (str, float, str)
        Name, value and dash of each limit; all are within the axis.
    """
    f = curves.f
    motion = Stroke(
        name=f"perturbation → angle of {joint_names[k]}", colour="--signal-0", width=1.3
    )
    torque = Stroke(
        name=f"perturbation → torque of {joint_names[i]}", colour="--signal-1", width=1.3
    )
    data = [line(f, curves.motion, motion), line(f, curves.torque, torque)]
    for name, look in looks(curves.derived).items():
        stroke = Stroke(
            name=f"derived, {look.label}",
            colour=look.variable,
            dash=look.dash,
            tags=[estimator_tag(name)],
        )
        data.append(line(f, curves.derived[name], stroke))
    for name, value, dash in levels:
        level = Stroke(name=name, colour="--soft", dash=dash, width=1.0)
        data.append(line(f[[0, -1]], np.full(2, value), level) | {"hoverinfo": "skip"})
    ordinate = axis("coherence γ²", range=[0.0, 1.02], hoverformat=".4f")
    return Plot(
        identifier=f"coherence-{i + 1}-{k + 1}",
        caption=symbol("Z", i + 1, k + 1),
        description=(
            f"Coherences behind Z {i + 1} {k + 1} over frequency; the lowest is "
            f"{curves.lowest:.2g}."
        ),
        views=[View(data=data, layout=stacked(frequency_axis([f]), [(1.0, ordinate)]))],
        height=250,
    )
