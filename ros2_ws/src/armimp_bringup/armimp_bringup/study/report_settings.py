"""How a study was made: values of the levels, configuration, software, and its other files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

from armimp_bringup.study.entry import StudyEntry
from armimp_estimation.report.formats import code
from armimp_estimation.report.html import Group, Html, element, join, section, table
from armimp_estimation.report.provenance import origin
from armimp_estimation.report.result import setting
from armimp_estimation.report.settings_part import configuration, identity, marked, written

_LEVELLED: Final[Mapping[str, tuple[str, tuple[str, ...]]]] = {
    "friction": ("arm_sim", ("friction.",)),
    "resolution": ("arm_sim", ("sensors.encoder_resolution", "sensors.torque_resolution")),
    "perturbation": ("imbic_controller", ("perturbation.peak",)),
}
"""Node and beginnings of the parameters that each factor sets."""


def levels_section(entries: Sequence[StudyEntry]) -> Html | None:
    """What the levels of each factor mean; None if the configuration does not tell."""
    tables = [
        found for factor in _LEVELLED if (found := _levels_table(entries, factor)) is not None
    ]
    if not tables:
        return None
    return section(
        "levels",
        "What the levels mean",
        element("p", "Lists have one value for each joint. SI units; angles in rad."),
        *tables,
    )


def _levels_table(entries: Sequence[StudyEntry], factor: str) -> Html | None:
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
            rows.append([code(name), *cells, marked(origin(first, node, name))])
    columns = ["parameter", *(f"level {level}" for level in levels), "where from"]
    return table(f"{factor.capitalize()}", columns, [Group(rows=rows)], words=(len(levels) + 1,))


def made_section(entries: Sequence[StudyEntry]) -> Html:
    """Software, seeds, and the configuration but for what the levels set."""
    config = dict(entries[0].config)
    seeds = sorted({entry.seed for entry in entries})
    return section(
        "settings",
        "How it was made",
        identity(config, _ranges(seeds)),
        element(
            "p",
            "The configuration of the first condition follows; the others differ by seed and "
            "levels only.",
        ),
        *configuration(config),
    )


def _ranges(seeds: Sequence[int]) -> str:
    """Numbers in order, runs of them as ranges: ``0 to 9, 77``."""
    runs: list[list[int]] = []
    for seed in seeds:
        if runs and seed == runs[-1][1] + 1:
            runs[-1][1] = seed
        else:
            runs.append([seed, seed])
    return ", ".join(f"{first} to {last}" if last > first else f"{first}" for first, last in runs)


def files_section(files: Mapping[str, str]) -> Html:
    """Links to what else is in the directory."""
    pairs = (
        join([element("dt", element("a", name, href=name)), element("dd", text)])
        for name, text in files.items()
    )
    return section("files", "Files beside this report", element("dl", *pairs, class_="terms"))
