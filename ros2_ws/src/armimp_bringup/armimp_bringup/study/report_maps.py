"""Every condition of a study at a glance: maps of the worst values, and a table."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from armimp_bringup.study.entry import StudyEntry
from armimp_bringup.study.heat_maps import Cell, HeatMap, Panel, heat_map_view
from armimp_bringup.study.verdict import COLUMNS, Column, Scale, targets, values
from armimp_estimation.report.formats import NONE
from armimp_estimation.report.look import looks
from armimp_estimation.report.page import Table
from armimp_estimation.report.plots import Plot, View
from armimp_estimation.verdict import Limits

Found = tuple[str, float]
"""Where a value was found, and the value."""


@dataclass(frozen=True, kw_only=True, order=True)
class LevelCell:
    """Levels without a seed."""

    friction: int
    resolution: int
    perturbation: int

    @classmethod
    def of(cls, entry: StudyEntry) -> LevelCell:
        """That of a result."""
        return cls(
            friction=entry.friction, resolution=entry.resolution, perturbation=entry.perturbation
        )


def conditions_content(entries: Sequence[StudyEntry]) -> dict[str, Any]:
    """Maps of the worst score in each condition, and a table that can be sorted."""
    return {
        "seeds": len({entry.seed for entry in entries}),
        "plots": [_scores_map(entries, name) for name in looks(entries[0].estimators)],
        "table": _table(entries),
    }


def locking_content(entries: Sequence[StudyEntry]) -> dict[str, Any] | None:
    """How still the held joints were in each condition; None where none is held."""
    if entries[0].joints == 1:
        return None
    limits = Limits()
    scale = Scale(unit=" %", floor=False, digits=3)
    parts: list[tuple[str, float, Callable[[StudyEntry], list[Found]]]] = [
        ("motion of held joints", 100.0 * limits.lock_ratio, _lock_ratios),
        ("bias that it may cause", 100.0 * limits.bias_bound, _bias_bounds),
    ]
    views = [_view(entries, name, scale, limit, found) for name, limit, found in parts]
    worst = [
        f"{name}: at most {max(value for entry in entries for _, value in found(entry)):.3f} % "
        f"(limit {limit:g} %)"
        for name, limit, found in parts
    ]
    plot = Plot(
        identifier="map-locking",
        caption="Worst trial in each condition",
        description="Motion of held joints relative to the perturbed one in each condition.",
        views=views,
        height=_height(entries),
    )
    return {"worst": "; ".join(worst).capitalize(), "plot": plot}


def _lock_ratios(entry: StudyEntry) -> list[Found]:
    return [
        (f"joint {i + 1} while {trial.k} is perturbed", 100.0 * ratio)
        for trial in entry.trials
        for i, ratio in enumerate(trial.lock_ratio)
        if i != trial.k - 1
    ]


def _bias_bounds(entry: StudyEntry) -> list[Found]:
    return [
        (f"Z{i + 1}{trial.k}", 100.0 * bound)
        for trial in entry.trials
        for i, bound in enumerate(trial.bias_bound)
    ]


def _scores_map(entries: Sequence[StudyEntry], estimator: str) -> Plot:
    limits = targets(entries[0].joints).get(estimator, {})

    def found(column: Column) -> Callable[[StudyEntry], list[Found]]:
        return lambda entry: [
            (element, value) for element, _, _, value in values(entry, estimator, column.quantity)
        ]

    return Plot(
        identifier=f"map-{estimator.replace('_', '-')}",
        caption=looks([estimator])[estimator].label,
        description=f"Worst values of {estimator} in each condition.",
        views=[
            _view(entries, column.quantity, column, limits.get(column.quantity), found(column))
            for column in COLUMNS
        ],
        height=_height(entries),
    )


def _height(entries: Sequence[StudyEntry]) -> int:
    return 130 + 34 * len({entry.friction for entry in entries})


def _view(
    entries: Sequence[StudyEntry],
    name: str,
    scale: Scale,
    limit: float | None,
    found: Callable[[StudyEntry], list[Found]],
) -> View:
    """Map over friction (rows) and resolution (columns), one panel for each perturbation."""
    frictions = sorted({entry.friction for entry in entries})
    resolutions = sorted({entry.resolution for entry in entries})
    worst = {cell: _worst(group, scale, found) for cell, group in _groups(entries).items()}
    panels = [
        Panel(
            title=f"perturbation {p}",
            columns=[f"R{r}" for r in resolutions],
            cells=[
                [
                    worst.get(LevelCell(friction=f, resolution=r, perturbation=p))
                    for r in resolutions
                ]
                for f in frictions
            ],
        )
        for p in sorted({entry.perturbation for entry in entries})
    ]
    return heat_map_view(
        HeatMap(
            name=name,
            rows=[f"F{f}" for f in frictions],
            panels=panels,
            floor=scale.floor,
            limit=limit,
            unit=scale.unit,
            row_title="friction level",
            column_title="resolution level",
        )
    )


def _groups(entries: Sequence[StudyEntry]) -> dict[LevelCell, list[StudyEntry]]:
    groups: dict[LevelCell, list[StudyEntry]] = {}
    for entry in entries:
        groups.setdefault(LevelCell.of(entry), []).append(entry)
    return dict(sorted(groups.items()))


def _worst(
    entries: Sequence[StudyEntry], scale: Scale, found: Callable[[StudyEntry], list[Found]]
) -> Cell:
    by_seed = []
    for entry in entries:
        where, value = max(found(entry), key=lambda one: scale.badness(one[1]))
        by_seed.append((value, f"{where}, seed {entry.seed}" if len(entries) > 1 else where))
    by_seed.sort(key=lambda one: scale.badness(one[0]))
    value, where = by_seed[-1]
    notes = [f"in {where}"]
    if len(by_seed) > 1:
        notes.append(f"best seed {scale.format(by_seed[0][0])}")
    written = NONE if math.isnan(value) else scale.format(value).removesuffix(scale.unit)
    return Cell(value=value, written=written, notes=notes)


def _table(entries: Sequence[StudyEntry]) -> Table:
    estimators = looks(entries[0].estimators)
    rows: list[list[object]] = []
    for cell, group in _groups(entries).items():
        row: list[object] = [cell.friction, cell.resolution, cell.perturbation]
        row.append("yes" if all(entry.valid for entry in group) else "no")
        locks = [value for entry in group for _, value in _lock_ratios(entry)]
        row.append(f"{max(locks):.3f}" if locks else NONE)
        for name in estimators:
            for column in COLUMNS:
                numbers = [v for e in group for _, _, _, v in values(e, name, column.quantity)]
                worst = max(numbers, key=column.badness)
                # Units are in the headings, as cells are sorted as numbers.
                row.append(
                    NONE if math.isnan(worst) else column.format(worst).removesuffix(column.unit)
                )
        rows.append(row)
    heads: list[object] = ["F", "R", "P", "valid", "motion of held joints %"]
    spans: list[tuple[object, int]] = [("Levels", 3), ("", 2)]
    for look in estimators.values():
        heads += [f"{column.quantity}{column.unit}" for column in COLUMNS]
        spans.append((look.label, len(COLUMNS)))
    return Table(
        caption="Worst values of all elements",
        columns=heads,
        groups=[(None, rows)],
        spans=spans,
        sortable=True,
    )
