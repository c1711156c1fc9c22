"""Plots over frequency: impedance with the distance of the estimates, and coherence."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from armimp_estimation.curves import ImpedanceCurve
from armimp_estimation.mbk import MBK
from armimp_estimation.report.curves import (
    distances,
    element_curve,
    magnitude_range,
    phase_range,
    phase_step,
    true_curve,
)
from armimp_estimation.report.formats import symbol
from armimp_estimation.report.look import looks
from armimp_estimation.report.plots import (
    Plot,
    Stroke,
    View,
    axis,
    band,
    frequency_axis,
    line,
    log_axis,
    stacked,
)

FloatArray = NDArray[np.float64]
BANDS = "bands"
"""Tag of confidence bands."""
TRUTH = "truth"
"""Tag of true curves."""
SIDE_BY_SIDE = 3
"""Joints up to which the elements of a matrix are shown beside each other."""
_IMPEDANCE = "N·m/rad"


def estimator_tag(name: str) -> str:
    """Tag of everything that an estimator found."""
    return f"estimator:{name}"


def plot_matrix(joints: int, plot: Callable[[int, int], Plot]) -> list[Plot]:
    """Plots of all elements (0-based), row by row; with many joints one plot to choose from."""
    plots = {(i, k): plot(i, k) for i in range(joints) for k in range(joints)}
    if joints <= SIDE_BY_SIDE:
        return list(plots.values())
    first = plots[0, 0]
    views = [
        replace(view, name=f"Z{i + 1}{k + 1}") for (i, k), p in plots.items() for view in p.views
    ]
    return [replace(first, caption="Element", views=views, height=first.height + 60)]


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
    grids = [curve.f for curve in curves.values()]
    parted = distances(curves, truth, i, k)
    data, every = [], []
    for name, look in looks(curves).items():
        tags = [estimator_tag(name)]
        stroke = Stroke(name=name, colour=look.variable, dash=look.dash, tags=tags)
        one = element_curve(curves[name], i, k)
        for row, values, ends, unit in (
            (1, one.magnitude, one.magnitude_band, _IMPEDANCE),
            (2, one.phase, one.phase_band, "°"),
        ):
            data.append(band(one.f, ends, look.variable, [*tags, BANDS], row=row))
            data.append(line(one.f, values, stroke, row=row, unit=unit, ends=ends))
        f, off, radius = parted.lines[name]
        data.append(band(f, (np.full(f.size, 1e-6), radius), look.variable, [*tags, BANDS], row=3))
        if off is not None:
            thin, ends = replace(stroke, width=1.1), (np.zeros(f.size), radius)
            data.append(line(f, off, thin, row=3, unit="%", ends=ends))
        every.append(one)
    if truth is not None:
        true = true_curve(truth, max(grids, key=len), i, k)
        stroke = Stroke(name="truth", colour="--ink", dash="dot", tags=[TRUTH])
        data.append(line(true.f, true.magnitude, stroke, unit=_IMPEDANCE))
        data.append(line(true.f, true.phase, stroke, row=2, unit="°"))
        every.append(true)
    phases = phase_range(every)
    rows = [
        (3.0, log_axis("magnitude (N·m/rad)", magnitude_range(every), ".4~g")),
        (
            2.0,
            axis(
                "phase (°)",
                range=list(phases),
                tick0=0,
                dtick=phase_step(phases, most=5),
                hoverformat=".1f",
            ),
        ),
        (2.4, log_axis("distance (%)", parted.ends, ".3~g")),
    ]
    sizes = np.concatenate([one.magnitude for one in every])
    return Plot(
        identifier=f"bode-{i + 1}-{k + 1}",
        caption=symbol("Z", i + 1, k + 1),
        description=(
            f"Magnitude and phase of Z {i + 1} {k + 1} over frequency: from {np.nanmin(sizes):.3g} "
            f"to {np.nanmax(sizes):.3g} N·m/rad, and the distance of the estimates."
        ),
        views=[View(data=data, layout=stacked(frequency_axis(grids), rows))],
        height=500,
    )


def coherence_plot(
    curves: Mapping[str, ImpedanceCurve], i: int, k: int, joint_names: Sequence[str], level: float
) -> Plot:
    """Coherences behind ``Z_ik`` over frequency.

    Parameters
    ----------
    curves : mapping of str to ImpedanceCurve
        By name of the estimator; at least one.
    i, k : int
        Element, 0-based.
    joint_names : sequence of str
        Names of the joints.
    level : float
        Coherence below which signals count as unrelated.
    """
    common = next(iter(curves.values())).coherence
    f, motion, torque = common.f, common.motion[k], common.torque[i, k]
    strokes = [
        Stroke(name=f"perturbation → angle of {joint_names[k]}", colour="--signal-0", width=1.3),
        Stroke(name=f"perturbation → torque of {joint_names[i]}", colour="--signal-1", width=1.3),
    ]
    shown = [motion, torque]
    for name, look in looks(curves).items():
        strokes.append(
            Stroke(
                name=f"derived, {name}",
                colour=look.variable,
                dash=look.dash,
                tags=[estimator_tag(name)],
            )
        )
        shown.append(curves[name].coherence.derived[i, k])
    data = [line(f, values, stroke) for values, stroke in zip(shown, strokes, strict=True)]
    limit = Stroke(name="unrelated signals stay below", colour="--soft", dash="dot", width=1.0)
    data.append(line(f[[0, -1]], np.full(2, level), limit) | {"hoverinfo": "skip"})
    ordinate = axis("coherence γ²", range=[0.0, 1.02], hoverformat=".4f")
    return Plot(
        identifier=f"coherence-{i + 1}-{k + 1}",
        caption=symbol("Z", i + 1, k + 1),
        description=(
            f"Coherences behind Z {i + 1} {k + 1} over frequency; the lowest is "
            f"{np.nanmin(shown):.2g}."
        ),
        views=[View(data=data, layout=stacked(frequency_axis([f]), [(1.0, ordinate)]))],
        height=250,
    )
