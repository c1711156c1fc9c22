"""How a study was made: values of the levels, configuration, software, and its other files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

from armimp_bringup.study.entry import StudyEntry
from armimp_estimation.report.formats import code, written
from armimp_estimation.report.page import Table
from armimp_estimation.report.result import setting
from armimp_estimation.report.settings import configuration, identity, marked_origin

_LEVELLED: Final[Mapping[str, tuple[str, tuple[str, ...]]]] = {
    "friction": ("arm_sim", ("friction.",)),
    "resolution": ("arm_sim", ("sensors.encoder_resolution", "sensors.torque_resolution")),
    "perturbation": ("imbic_controller", ("perturbation.peak",)),
}
"""Node and beginnings of the parameters that each factor sets."""


def levels_content(entries: Sequence[StudyEntry]) -> dict[str, Any] | None:
    """What the levels of each factor mean; None if the configuration does not tell."""
    found = [_levels_table(entries, factor) for factor in _LEVELLED]
    tables = [table for table in found if table is not None]
    return {"tables": tables} if tables else None


def _levels_table(entries: Sequence[StudyEntry], factor: str) -> Table | None:
    node, beginnings = _LEVELLED[factor]
    by_level = {getattr(entry, factor): entry for entry in reversed(entries)}
    levels = sorted(by_level)
    first = entries[0].config
    group = setting(first, node)
    if not isinstance(group, Mapping):
        return None
    rows: list[list[object]] = []
    for name in group:
        if name.startswith(beginnings):
            cells = [written(setting(by_level[level].config, node, name)) for level in levels]
            rows.append([code(name), *cells, marked_origin(first, node, name)])
    columns = ["parameter", *(f"level {level}" for level in levels), "where from"]
    return Table(
        caption=factor.capitalize(),
        columns=columns,
        groups=[(None, rows)],
        words=(len(levels) + 1,),
    )


def made_content(entries: Sequence[StudyEntry]) -> dict[str, Any]:
    """Software, seeds, and the configuration but for what the levels set."""
    config = dict(entries[0].config)
    seeds = sorted({entry.seed for entry in entries})
    return {
        "identity": identity(config, _ranges(seeds)),
        "reading": None,
        "conditions": True,
        "tables": configuration(config),
    }


def _ranges(seeds: Sequence[int]) -> str:
    """Numbers in order, runs of them as ranges: ``0 to 9, 77``."""
    runs: list[list[int]] = []
    for seed in seeds:
        if runs and seed == runs[-1][1] + 1:
            runs[-1][1] = seed
        else:
            runs.append([seed, seed])
    return ", ".join(f"{first} to {last}" if last > first else f"{first}" for first, last in runs)
