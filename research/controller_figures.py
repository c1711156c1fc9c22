"""Figure of the investigation of the controller."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

from research.writing import COLOURS, MARKERS, WIDTH

_ROWS: Final = (
    ("bias_bound", "bias by the lock (%)", None),
    ("welch_siso_vaf", "100 % − VAF, welch_siso", 0.5),
    ("lpm_full_B", "error of B, lpm_full (%)", 0.5),
)


def controller_figure(
    rows: Sequence[Mapping[str, Any]], names: Mapping[str, str], reference: str
) -> Any:
    """Draw the accuracy of each setting over the chatter of its commands.

    Parameters
    ----------
    rows : of all settings that ran
    names : labels of the parameters
    reference : parameter of the setting that stands in every panel
    """
    from matplotlib.figure import Figure

    levels = list(dict.fromkeys(_levels(row) for row in rows))
    figure = Figure(figsize=(WIDTH, 5.4), layout="constrained")
    axes = figure.subplots(len(_ROWS), len(names), sharey="row", sharex=True, squeeze=False)
    for column, parameter in enumerate(names):
        for line, (quantity, label, limit) in enumerate(_ROWS):
            panel = axes[line, column]
            for number, level in enumerate(levels):
                look = {"color": COLOURS[number % len(COLOURS)], "marker": MARKERS[number % 7]}
                for which, style in ((parameter, "-"), (reference, "")):
                    of_line = [r for r in rows if (r["parameter"], _levels(r)) == (which, level)]
                    panel.plot(
                        [r["command_step"] for r in of_line],
                        [_value(r, quantity) for r in of_line],
                        linestyle=style,
                        markerfacecolor="none" if which == reference else look["color"],
                        label=level if which == parameter else None,
                        **look,
                    )
            if limit is not None:
                panel.axhline(limit, color="0.6", linewidth=0.8, linestyle="--")
            panel.axvline(2.0, color="0.6", linewidth=0.8, linestyle="--")
            panel.set_xscale("log")
            panel.set_yscale("log")
            axes[line, 0].set_ylabel(label)
        axes[0, column].set_title(names[parameter])
        axes[-1, column].set_xlabel("command step, rms (N·m)")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), frameon=False)
    return figure


def _levels(row: Mapping[str, Any]) -> str:
    return f"{row['friction']}/{row['resolution']}/{row['perturbation']}"


def _value(row: Mapping[str, Any], quantity: str) -> float:
    value = float(row[quantity])
    return max(100.0 - value if quantity.endswith("_vaf") else value, 1e-3)
