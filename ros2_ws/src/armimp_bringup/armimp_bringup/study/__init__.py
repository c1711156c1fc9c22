"""Parts of a study: conditions and their results."""

from __future__ import annotations

import itertools
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from armimp_common.errors import ConfigurationError
from armimp_control.presets import LEVELS as PERTURBATION_LEVELS
from armimp_estimation.mbk import MBK
from armimp_estimation.summary import Summary
from armimp_sim.presets import LEVELS as SIMULATOR_LEVELS

LEVELS: Final[Mapping[str, tuple[int, ...]]] = {
    "friction": SIMULATOR_LEVELS,
    "resolution": SIMULATOR_LEVELS,
    "perturbation": PERTURBATION_LEVELS,
}
"""The factors of the study with all their levels."""

MOST_SEEDS: Final = 10_000
_MOST_SEED: Final = 2**63 - 1


@dataclass(frozen=True, kw_only=True, order=True)
class Condition:
    """One cell of the study: an experiment with a trial for each joint.

    Conditions are ordered by seed, then friction, resolution and perturbation level.
    """

    seed: int
    friction: int
    resolution: int
    perturbation: int

    @property
    def levels(self) -> dict[str, int]:
        """Level of each factor."""
        return {factor: getattr(self, factor) for factor in LEVELS}

    @property
    def name(self) -> str:
        """Name for files."""
        levels = "-".join(f"{factor}{level}" for factor, level in self.levels.items())
        return f"{levels}-seed{self.seed}"

    @property
    def short(self) -> str:
        """Levels for tables, as in ``F3 R0 P1``."""
        return " ".join(f"{factor[0].upper()}{level}" for factor, level in self.levels.items())

    def __str__(self) -> str:
        levels = ", ".join(f"{factor} {level}" for factor, level in self.levels.items())
        return f"{levels}, seed {self.seed}"


def select_conditions(only: Sequence[str], seeds: str) -> tuple[Condition, ...]:
    """Return the conditions of a study, in order and each once.

    Parameters
    ----------
    only : selections such as ``friction=0+3,resolution=0``; their union is taken. Empty: all 48
        combinations.
    seeds : as for `parse_seeds`

    Raises
    ------
    ConfigurationError
        If a selection or the seeds cannot be understood.
    """
    cells = {
        cell
        for selection in ([_parse_only(text) for text in only] or [dict(LEVELS)])
        for cell in itertools.product(*(selection[factor] for factor in LEVELS))
    }
    return tuple(
        sorted(
            Condition(seed=seed, friction=cell[0], resolution=cell[1], perturbation=cell[2])
            for cell, seed in itertools.product(cells, parse_seeds(seeds))
        )
    )


def _parse_only(text: str) -> dict[str, tuple[int, ...]]:
    found: dict[str, tuple[int, ...]] = {}
    for part in text.split(","):
        factor, _, values = (one.strip() for one in part.partition("="))
        known = LEVELS.get(factor, ())
        levels = [value.strip() for value in values.split("+")]
        if factor in found or not {*levels} <= {*map(str, known)}:
            raise ConfigurationError(
                f"--only {text!r}: {part.strip()!r} is not one of {', '.join(LEVELS)}, once, with "
                "its levels, as in friction=0+3,resolution=0"
            )
        found[factor] = tuple(map(int, levels))
    return {**LEVELS, **found}


def parse_seeds(text: str) -> tuple[int, ...]:
    """Return the seeds of comma-separated numbers and half-open ranges: ``77``, ``1,5,10:20``.

    Raises
    ------
    ConfigurationError
        If the text is something else, holds no seed or more than `MOST_SEEDS`, or one twice.
    """
    found: list[int] = []
    for part in text.split(","):
        numbers = re.fullmatch(r"\s*([0-9]{1,19})\s*(?::\s*([0-9]{1,19})\s*)?", part)
        first = int(numbers[1]) if numbers else 0
        end = int(numbers[2] or first + 1) if numbers else 0
        if not first < end <= _MOST_SEED + 1 or end - first + len(found) > MOST_SEEDS:
            raise ConfigurationError(
                f"--seeds {text!r}: {part!r} is neither a seed nor a range such as 0:10, of "
                f"at most {MOST_SEEDS} seeds"
            )
        found += range(first, end)
    if len(set(found)) < len(found):
        raise ConfigurationError(f"--seeds {text!r}: a seed is there twice")
    return tuple(found)


class StudyEntry(Summary):
    """The result of one condition: a summary with the levels; its seed is part of any summary."""

    seed: int
    friction: int
    resolution: int
    perturbation: int

    @property
    def condition(self) -> Condition:
        """The condition of the result."""
        return Condition(**self.model_dump(include={"seed", *LEVELS}))

    @property
    def arm(self) -> MBK:
        """The arm that was simulated."""
        assert self.truth is not None
        return self.truth
