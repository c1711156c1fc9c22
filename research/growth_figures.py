"""Figure of the investigation of more joints."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Final

from research.decomposition_figures import LOOKS
from research.growth_outcomes import Cell
from research.writing import WIDTH

_LINES: Final[tuple[Any, ...]] = ("-", "--", ":", "-.")


def growth_figure(cells: Sequence[Cell], target: float) -> Any:
    """Draw accuracy, time of recording and time of computing over the number of joints.

    Parameters
    ----------
    cells : all of the investigation
    target : spread for which the recording is needed
    """
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

    panels: tuple[tuple[str, Callable[[Cell], float]], ...] = (
        ("100 − worst VAF (%)", lambda cell: 100.0 - cell.worst_vaf),
        ("bias of B (%)", lambda cell: 100.0 * float(cell.bias[1])),
        (
            f"recording for {100.0 * target:g} % spread (s)",
            lambda cell: cell.needed,
        ),
        ("estimation (s)", lambda cell: cell.seconds),
    )
    figure = Figure(figsize=(WIDTH, 4.4), layout="constrained")
    axes = figure.subplots(2, 2, sharex=True)
    names = list(dict.fromkeys(cell.estimator for cell in cells))
    torques = sorted({cell.voluntary for cell in cells})
    for panel, (label, value) in zip(axes.flat, panels, strict=True):
        for name in names:
            for torque, line in zip(torques, _LINES, strict=False):
                shown = [c for c in cells if (c.estimator, c.voluntary) == (name, torque)]
                joints = [cell.joints for cell in shown]
                panel.plot(joints, [value(c) for c in shown], linestyle=line, **LOOKS[name])
        panel.set_yscale("log")
        panel.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
        panel.set_ylabel(label)
    for panel in axes[1]:
        panel.set_xlabel("joints")
        panel.set_xticks(sorted({cell.joints for cell in cells}))
    handles = [Line2D([], [], **LOOKS[name], label=name) for name in names]
    handles += [
        Line2D([], [], color="0.4", linestyle=line, label=f"{torque:g} N·m rms")
        for torque, line in zip(torques, _LINES, strict=False)
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), frameon=False)
    return figure
