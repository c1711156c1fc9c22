"""Plots over frequency: impedance and coherence."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

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
from armimp_estimation.report.look import MOTION_COLOUR, TORQUE_COLOUR, TRUTH_COLOUR, Look, looks
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

BANDS = "bands"
"""Tag of confidence bands."""
TRUTH = "truth"
"""Tag of true curves."""


def estimator_tag(name: str) -> str:
    """Tag of everything that an estimator found."""
    return f"estimator:{name}"


def bode_plot(
    curves: Mapping[str, ImpedanceCurve], truth: MBK | None, i: int, k: int, *, prefix: str = "bode"
) -> Plot:
    """Bode plot of ``Z_ik``: every estimate with its 95 % band, and the truth.

    Parameters
    ----------
    curves : mapping of str to ImpedanceCurve
        By name of the estimator; at least one.
    truth : MBK or None
        True matrices.
    i, k : int
        Element, 0-based: torque of joint i over angle of joint k.
    prefix : str
        Of the identifier.
    """
    shown = {name: element_curve(curve, i, k) for name, curve in curves.items()}
    data = [t for name, look in looks(curves).items() for t in _bode_traces(shown[name], look)]
    every = list(shown.values())
    if truth is not None:
        finest = max((curve.f for curve in curves.values()), key=len)
        true = true_curve(truth, finest, i, k)
        stroke = Stroke(name="truth", colour=TRUTH_COLOUR, dash="dot", tags=[TRUTH])
        data.append(line(true.f, true.magnitude, stroke))
        data.append(line(true.f, true.phase, stroke, row=2))
        every.append(true)
    layout = stacked(
        frequency_axis([curve.f for curve in curves.values()]),
        [(3.0, _magnitude_axis(every)), (2.0, _phase_axis(every))],
    )
    sizes = np.concatenate([one.magnitude for one in every])
    return Plot(
        identifier=f"{prefix}-{i + 1}-{k + 1}",
        caption=symbol("Z", i + 1, k + 1),
        description=(
            f"Magnitude and phase of Z {i + 1} {k + 1} over frequency: from {np.nanmin(sizes):.3g} "
            f"to {np.nanmax(sizes):.3g} N·m/rad."
        ),
        views=[View(data=data, layout=layout)],
        height=370,
    )


def _bode_traces(curve: BodeCurve, look: Look) -> Iterator[Trace]:
    tags = [estimator_tag(look.name)]
    stroke = Stroke(name=look.label, colour=look.colour, dash=look.dash, tags=tags)
    yield band(curve.f, curve.magnitude_band, look.pale, [*tags, BANDS], row=1)
    yield line(curve.f, curve.magnitude, stroke)
    yield band(curve.f, curve.phase_band, look.pale, [*tags, BANDS], row=2)
    yield line(curve.f, curve.phase, stroke, row=2)


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
    )


def coherence_plot(
    curves: CoherenceCurves,
    i: int,
    k: int,
    *,
    significance: float,
    floor: float = 0.0,
    prefix: str = "coherence",
) -> Plot:
    """Coherences behind ``Z_ik`` over frequency.

    Parameters
    ----------
    curves : CoherenceCurves
        The coherences.
    i, k : int
        Element, 0-based.
    significance : float
        Coherence above which signals are related.
    floor : float
        Lower end of the axis.
    prefix : str
        Of the identifier.
    """
    f = curves.f
    motion = Stroke(name=f"to angle {k + 1}", colour=MOTION_COLOUR, width=1.3)
    torque = Stroke(name=f"to torque {i + 1}", colour=TORQUE_COLOUR, width=1.3)
    data = [line(f, curves.motion, motion), line(f, curves.torque, torque)]
    for name, look in looks(curves.derived).items():
        stroke = Stroke(
            name=f"derived, {look.label}",
            colour=look.colour,
            dash=look.dash,
            tags=[estimator_tag(name)],
        )
        data.append(line(f, curves.derived[name], stroke))
    level = Stroke(name="significant above", colour=TRUTH_COLOUR, dash="dot", width=1.0)
    data.append(line(f[[0, -1]], np.full(2, significance), level))
    ordinate = axis("coherence γ²", range=[floor, 1.01], hoverformat=".4f")
    return Plot(
        identifier=f"{prefix}-{i + 1}-{k + 1}",
        caption=symbol("Z", i + 1, k + 1),
        description=(
            f"Coherences behind Z {i + 1} {k + 1} over frequency; the lowest is "
            f"{curves.lowest:.2g}."
        ),
        views=[View(data=data, layout=stacked(frequency_axis([f]), [(1.0, ordinate)]))],
        height=250,
    )
