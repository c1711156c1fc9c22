"""Figures of the investigation of decomposition."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from research.decomposition_outcomes import Cell
from research.decomposition_statistics import OCTAVES, root_mean_square
from research.writing import COLOURS, MARKERS, WIDTH

LOOKS: Final[dict[str, Any]] = {
    name: {"color": COLOURS[number], "marker": MARKERS[number]}
    for number, name in enumerate(("lpm_full", "direct", "welch_full", "welch_siso", "mimo"))
}
"""Colour and marker of each estimator, the same in all figures."""


def decomposition_figures(cells: Sequence[Cell], voluntary: float) -> dict[str, Any]:
    """Return the figures by name.

    Parameters
    ----------
    cells : all of the investigation
    voluntary : torque at which errors of Z, and coupled inputs, are shown, N·m rms
    """
    figures = {"decomposition": _voluntary_figure(cells, voluntary)}
    coupled = [c for c in cells if c.correlation is not None and c.voluntary == voluntary]
    if len(coupled) > 1:
        alone = [c for c in cells if c.correlation is None and c.voluntary == voluntary]
        figures["decomposition_coupling"] = _coupling_figure(coupled, alone)
    return figures


def _voluntary_figure(cells: Sequence[Cell], voluntary: float) -> Any:
    """Draw bias and spread: of Z over frequency, and of K over the voluntary torque."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(WIDTH, 4.6), layout="constrained")
    axes = figure.subplots(2, 2)
    independent = [cell for cell in cells if cell.correlation in {None, 0.0}]
    for name, look in LOOKS.items():
        of_name = [cell for cell in independent if cell.estimator == name]
        for cell in of_name:
            if cell.voluntary == voluntary:
                _octaves(axes[0, 0], axes[1, 0], cell, look)
        torque = [cell.voluntary for cell in of_name]
        bias = [100.0 * root_mean_square(cell.total.bias[2]) for cell in of_name]
        spread = [100.0 * root_mean_square(cell.total.spread[2]) for cell in of_name]
        axes[0, 1].plot(torque, bias, **look, label=name)
        axes[1, 1].plot(torque, spread, **look)
    for row, what in enumerate(("bias", "spread")):
        axes[row, 0].set_xscale("log")
        axes[row, 0].set_ylabel(f"{what} of Z (%)")
        axes[row, 1].set_ylabel(f"{what} of K (%)")
        axes[row, 1].set_xscale("symlog", linthresh=0.1)
        axes[row, 1].set_xticks(sorted({cell.voluntary for cell in cells}))
        axes[row, 1].xaxis.set_major_formatter(lambda value, _: f"{value:g}")
        for panel in axes[row]:
            panel.set_yscale("log")
            panel.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
        axes[row, 0].set_xticks([0.2, 0.5, 1, 2, 5, 10])
        axes[row, 0].xaxis.set_major_formatter(lambda value, _: f"{value:g}")
        axes[row, 0].minorticks_off()
    axes[0, 0].set_title(f"Z, rms over its elements; voluntary torque {voluntary:g} N·m rms")
    axes[0, 0].set_ylabel("shift of Z by the torque (%)")
    axes[0, 1].set_title("K, rms over its elements")
    axes[1, 0].set_xlabel("frequency (Hz)")
    axes[1, 1].set_xlabel("voluntary torque (N·m rms)")
    figure.legend(loc="outside lower center", ncols=len(LOOKS), frameon=False)
    return figure


def _octaves(bias: Any, spread: Any, cell: Cell, look: Mapping[str, Any]) -> None:
    """Draw errors of Z by octave, rms over the elements and over real and imaginary parts."""
    shift = cell.octaves_shift
    limits = np.array(OCTAVES)[-1 - cell.octaves.bias.shape[-1] :]
    centres = np.sqrt(limits[:-1] * limits[1:])
    over = (0, 1, 2)
    if shift is not None:
        bias.plot(centres, 100.0 * root_mean_square(shift.bias, over), **look)
        # Bias that chance alone would leave.
        chance = 100.0 * root_mean_square(shift.uncertainty, over)
        bias.plot(centres, chance, color=look["color"], linestyle=":", linewidth=0.8)
    spread.plot(centres, 100.0 * root_mean_square(cell.octaves.spread, over), **look)


def _coupling_figure(coupled: Sequence[Cell], alone: Sequence[Cell]) -> Any:
    """Draw the effect of correlated perturbations on ``mimo``."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(WIDTH, 2.5), layout="constrained")
    inputs, spread = figure.subplots(1, 2)
    correlation = [cell.correlation for cell in coupled]
    inputs.plot(correlation, [cell.coherence for cell in coupled], "o-", color="0.3")
    inputs.set_ylabel("coherence of the inputs")
    inputs.set_ylim(0.0, 1.0)
    inflation = inputs.twinx()
    inflation.grid(visible=False)
    inflation.plot(correlation, [cell.inflation for cell in coupled], "s--", color=COLOURS[1])
    inflation.set_ylabel("variance inflation", color=COLOURS[1])
    inflation.set_ylim(bottom=0.0)
    for number, (letter, line) in enumerate(zip("MBK", ("-", "--", ":"), strict=True)):
        for cells, where in ((coupled, correlation), (alone, None)):
            for name in dict.fromkeys(cell.estimator for cell in cells):
                if name not in {"mimo", "welch_full"}:
                    continue
                values = [
                    100.0 * float(root_mean_square(cell.total.spread[number]))
                    for cell in cells
                    if cell.estimator == name
                ]
                look = {**LOOKS[name], "linestyle": line, "label": f"{letter}, {name}"}
                if where is None:
                    spread.axhline(values[0], **{**look, "marker": None})
                else:
                    spread.plot(where, values, **look)
    spread.set_yscale("log")
    spread.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    spread.set_ylabel("spread (%)")
    for panel in (inputs, spread):
        panel.set_xlabel("correlation of the perturbations")
    figure.legend(loc="outside right center", frameon=False)
    return figure
