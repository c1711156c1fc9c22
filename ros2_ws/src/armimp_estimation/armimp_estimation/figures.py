"""Figures of a result, fit for a paper."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from armimp_common.errors import DataError
from armimp_estimation.estimate import confidence_radius
from armimp_estimation.results import ImpedanceCurve, Summary

FIGURE_FILE = "impedance.png"
_LABELS = {"welch_siso": "Welch, single input (paper)", "welch_full": "Welch, full matrix"}
_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9")


def impedance_figure(summary: Summary, curves: Mapping[str, ImpedanceCurve]) -> Any:
    """Bode plot of every element of Z_h, with 95 % confidence bands and, if known, the truth.

    Parameters
    ----------
    summary : Summary
        Of the result.
    curves : mapping of str to ImpedanceCurve
        By name of the estimator.

    Returns
    -------
    matplotlib.figure.Figure
        Magnitude (N·m/rad) above phase (degrees), one pair for each element.
    """
    from matplotlib.figure import Figure

    n = summary.joints
    figure = Figure(figsize=(3.6 * n, 3.9 * n), layout="constrained")
    parts = figure.subfigures(n, n, squeeze=False)
    for i in range(n):
        for k in range(n):
            magnitude, phase = parts[i, k].subplots(2, 1, sharex=True, height_ratios=(3, 2))
            for colour, (name, curve) in zip(_COLOURS, curves.items(), strict=False):
                _draw(curve, i, k, magnitude, phase, colour, _LABELS.get(name, name))
            _draw_truth(summary, curves, i, k, magnitude, phase)
            magnitude.set_title(f"$Z_{{{i + 1}{k + 1}}}$", fontsize=10)
            if k == 0:
                magnitude.set_ylabel("magnitude (N·m/rad)")
                phase.set_ylabel("phase (°)")
            if i == n - 1:
                phase.set_xlabel("frequency (Hz)")
    handles, labels = parts[0, 0].axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), frameon=False)
    return figure


def write_impedance_figure(
    path: Path, summary: Summary, curves: Mapping[str, ImpedanceCurve]
) -> None:
    """Write the figure as PNG or PDF, as the name of the file says.

    Raises
    ------
    DataError
        If it can't be written.
    """
    try:
        impedance_figure(summary, curves).savefig(path, dpi=150)
    except OSError as error:
        raise DataError(f"{path}: cannot be written: {error.strerror}") from None


def _draw(
    curve: ImpedanceCurve, i: int, k: int, magnitude: Any, phase: Any, colour: str, label: str
) -> None:
    z = curve.Z[i, k]
    radius = confidence_radius(curve.variance[i, k], curve.averages)
    size = np.abs(z)
    band = {"color": colour, "alpha": 0.2, "linewidth": 0}
    magnitude.fill_between(curve.f, np.maximum(size - radius, 1e-3 * size), size + radius, **band)
    angle = np.degrees(np.unwrap(np.angle(z)))
    # A circle of confidence around Z is seen from the origin under this angle.
    spread = np.degrees(np.arcsin(np.minimum(radius / size, 1.0)))
    phase.fill_between(curve.f, angle - spread, angle + spread, **band)
    magnitude.loglog(curve.f, size, color=colour, lw=1.2, label=label)
    phase.semilogx(curve.f, angle, color=colour, lw=1.2)


def _draw_truth(
    summary: Summary,
    curves: Mapping[str, ImpedanceCurve],
    i: int,
    k: int,
    magnitude: Any,
    phase: Any,
) -> None:
    if summary.truth is not None:
        f = next(iter(curves.values())).f
        true = summary.truth.mbk().impedance(f)[i, k]
        magnitude.loglog(f, np.abs(true), "k--", lw=1.0, label="truth")
        phase.semilogx(f, np.degrees(np.unwrap(np.angle(true))), "k--", lw=1.0)
    for axes in (magnitude, phase):
        axes.grid(True, which="both", alpha=0.25, linewidth=0.5)
        axes.tick_params(labelsize=8)
