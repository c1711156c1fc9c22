"""Tables of the investigation of the controller on the terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from research.controller_outcomes import Cell, Setting
from research.writing import print_table


def print_cells(
    cells: Sequence[Cell],
    refused: Mapping[Setting, str],
    names: Mapping[str, str],
    seeds: int,
) -> None:
    """Print a table for each place and estimator, and what was refused.

    Parameters
    ----------
    cells : all of the investigation
    refused : settings that were not accepted, and why
    names : of the parameters, for people
    seeds : how many
    """
    groups = dict.fromkeys((cell.place, cell.estimator) for cell in cells)
    for place, estimator in groups:
        print_table(
            f"{estimator}, {place}, {seeds} seeds; errors in %",
            (
                *("setting", "rms M", "B", "K", "worst M", "B", "K", "bias M", "B", "K"),
                *(
                    "VAF %",
                    "coherence",
                    "lock ratio",
                    "lock bias",
                    "step N·m",
                    "largest N·m",
                    "clips",
                    "lost",
                ),
            ),
            [
                (
                    _named(cell.setting, names),
                    *(f"{100.0 * value:.2f}" for value in (*cell.rms, *cell.worst)),
                    *(f"{100.0 * value:+.2f}" for value in cell.bias),
                    f"{cell.vaf:.3f}",
                    f"{cell.coherence:.4f}",
                    f"{cell.lock_ratio:.4f}",
                    f"{100.0 * cell.lock_bias:.2f}",
                    f"{cell.command_step:.1f}",
                    f"{cell.largest_command:.0f}",
                    f"{cell.clipped}",
                    f"{cell.lost}",
                )
                for cell in cells
                if (cell.place, cell.estimator) == (place, estimator)
            ],
            "bias: mean over the seeds, of the worst element; VAF, coherence, lock ratio: worst;\n"
            "lock bias: of Z, that the motion of locked joints may cause, in %; "
            "lost: runs that were stopped",
        )
    for setting, reason in refused.items():
        print(f"refused: {_named(setting, names)}: {reason}")


def _named(setting: Setting, names: Mapping[str, str]) -> str:
    if setting.parameter is None:
        return "defaults"
    return f"{names[setting.parameter]} = {setting.value:g}"
