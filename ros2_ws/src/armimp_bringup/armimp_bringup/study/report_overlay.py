"""Fig. 2 of the paper as plots that answer to the pointer: all conditions over the truth."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from armimp_bringup.study.entry import StudyEntry
from armimp_bringup.study.figures import Curves
from armimp_bringup.study.levels import MOST_JOINTS
from armimp_estimation.report.curves import deviation_percent, phase_about
from armimp_estimation.report.formats import symbol
from armimp_estimation.report.frequency_plots import (
    TRUTH,
    estimator_tag,
    plot_matrix,
)
from armimp_estimation.report.look import looks
from armimp_estimation.report.page import box
from armimp_estimation.report.plots import (
    Layout,
    Plot,
    Stroke,
    Trace,
    View,
    axis,
    frequency_axis,
    line,
    stacked,
)
from armimp_estimation.results import ImpedanceCurve

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

_DASHES: Final = ("solid", "dash", "dashdot", "dot")
_BUDGET: Final = 2_000_000  # bytes for all curves of a page
_BYTES: Final = 2 * 4 * 4 / 3  # of a point of a line: two numbers of single precision in base64
_POINTS: Final = (40, 160)


def impedance_content(entries: Sequence[StudyEntry], curves: Curves) -> dict[str, Any]:
    """Magnitude, phase and error of every element in all conditions of the first seed."""
    shown = _shown(entries)
    n = entries[0].joints
    names = list(entries[0].estimators)
    read = {entry.condition: curves(entry.condition) for entry in shown}
    lines = n * n * len(shown) * len(names) * 3
    points = int(min(max(_BUDGET / (lines * _BYTES), _POINTS[0]), _POINTS[1]))
    thinned = {
        condition: {name: _thinned(curve, points) for name, curve in found.items()}
        for condition, found in read.items()
    }

    def plot(i: int, k: int) -> Plot:
        data: list[Trace] = []
        sizes: list[FloatArray] = []
        for entry in shown:
            for name in names:
                curve = thinned[entry.condition][name]
                data += _lines(entry, name, curve, (i, k))
                sizes.append(np.abs(curve.Z[i, k]))
        grid = max((curve.f for one in thinned.values() for curve in one.values()), key=len)
        true = _truth(shown[0], grid)[i, k]
        stroke = Stroke(name="truth", colour="--ink", width=2.0, dash="dot", tags=[TRUTH])
        data.append(line(grid, np.abs(true), stroke, unit="N·m/rad"))
        phase = np.degrees(np.unwrap(np.angle(true)))
        data.append(line(grid, phase, stroke, row=2, unit="°"))
        return Plot(
            identifier=f"overlay-{i + 1}-{k + 1}",
            caption=symbol("Z", i + 1, k + 1),
            description=f"Estimates of Z {i + 1} {k + 1} in all conditions over the truth.",
            views=[View(data=data, layout=_layout(grid, sizes))],
            height=470,
        )

    return {
        "seed": shown[0].seed if len({entry.seed for entry in entries}) > 1 else None,
        "points": points,
        "few": n > MOST_JOINTS,
        "choices": list(_choices(shown, names)),
        "switches": list(_boxes(shown)),
        "plots": plot_matrix(n, plot),
        "joints": n,
    }


def _shown(entries: Sequence[StudyEntry]) -> list[StudyEntry]:
    found = [entry for entry in entries if entry.seed == entries[0].seed]
    if entries[0].joints <= MOST_JOINTS:
        return found
    frictions = {one.friction for one in found}
    resolutions = {one.resolution for one in found}
    return [
        one
        for one in found
        if one.friction in (min(frictions), max(frictions))
        and one.resolution in (min(resolutions), max(resolutions))
    ]


def _choices(
    entries: Sequence[StudyEntry], names: Sequence[str]
) -> Iterator[tuple[str, str, list[tuple[str, str]]]]:
    """Name, legend and options of what there is to choose."""
    if len(names) > 1:
        options = [(estimator_tag(name), look.label) for name, look in looks(names).items()]
        yield "overlay-estimator", "Estimator", options
    perturbations = sorted({entry.perturbation for entry in entries})
    if len(perturbations) > 1:
        options = [(f"perturbation:{level}", f"level {level}") for level in perturbations]
        yield "overlay-perturbation", "Perturbation", options


def _boxes(entries: Sequence[StudyEntry]) -> Iterator[dict[str, Any]]:
    for level in sorted({entry.friction for entry in entries}):
        yield box(f"friction:{level}", f"friction {level}", f"--level-{level}")
    for level in sorted({entry.resolution for entry in entries}):
        yield box(f"resolution:{level}", f"resolution {level}", "--soft", _DASHES[level])
    yield box(TRUTH, "truth", "--ink", "dot")


def _thinned(curve: ImpedanceCurve, points: int) -> ImpedanceCurve:
    """About this many values, at frequencies that are evenly spaced over their logarithm."""
    wanted = np.geomspace(curve.f[0], curve.f[-1], points)
    chosen = np.unique(np.abs(curve.f[:, np.newaxis] - wanted).argmin(axis=0))
    return replace(curve, f=curve.f[chosen], Z=curve.Z[:, :, chosen])


def _truth(entry: StudyEntry, f: FloatArray) -> ComplexArray:
    assert entry.truth is not None  # these are simulations
    return entry.truth.mbk().impedance(f)


def _lines(
    entry: StudyEntry, name: str, curve: ImpedanceCurve, place: tuple[int, int]
) -> Iterator[Trace]:
    z, truth = curve.Z[place], _truth(entry, curve.f)[place]
    stroke = Stroke(
        name=(
            f"{looks([name])[name].label}, friction {entry.friction}, "
            f"resolution {entry.resolution}, perturbation {entry.perturbation}"
        ),
        colour=f"--level-{entry.friction}",
        dash=_DASHES[entry.resolution],
        width=1.2,
        tags=[
            estimator_tag(name),
            f"perturbation:{entry.perturbation}",
            f"friction:{entry.friction}",
            f"resolution:{entry.resolution}",
        ],
    )
    yield line(curve.f, np.abs(z), stroke, unit="N·m/rad")
    yield line(curve.f, phase_about(truth, z), stroke, row=2, unit="°")
    yield line(curve.f, deviation_percent(truth, z), stroke, row=3, unit="%")


def _layout(f: FloatArray, sizes: Sequence[FloatArray]) -> Layout:
    low, high = (float(end(np.concatenate(sizes))) for end in (np.min, np.max))
    magnitude = axis(
        "magnitude (N·m/rad)",
        type="log",
        range=[math.log10(low) - 0.1, math.log10(high) + 0.1],
        dtick=1,
        exponentformat="none",
        hoverformat=".4~g",
    )
    phase = axis("phase (°)", dtick=90, hoverformat=".1f")
    error = axis("error (%)", type="log", dtick=1, exponentformat="none", hoverformat=".3~g")
    layout = stacked(frequency_axis([f]), [(3.0, magnitude), (2.0, phase), (2.0, error)])
    # One box for all lines would cover the plot.
    layout["hovermode"] = "closest"
    return layout
