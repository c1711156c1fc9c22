"""Which conditions a study has: levels of friction, resolution and perturbation, and seeds."""

from __future__ import annotations

import itertools
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from armimp_common.errors import ConfigurationError
from armimp_control.presets import LEVELS as PERTURBATION_LEVELS
from armimp_sim.presets import LEVELS as SIMULATOR_LEVELS

LEVELS: Final[Mapping[str, tuple[int, ...]]] = {
    "friction": SIMULATOR_LEVELS,
    "resolution": SIMULATOR_LEVELS,
    "perturbation": PERTURBATION_LEVELS,
}
"""The factors of the study with all their levels."""

MOST_SEEDS: Final = 10_000
_LARGEST_SEED: Final = 2**63 - 1


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

    def __str__(self) -> str:
        levels = ", ".join(f"{factor} {level}" for factor, level in self.levels.items())
        return f"{levels}, seed {self.seed}"


def select_conditions(only: Sequence[str], seeds: str) -> tuple[Condition, ...]:
    """Conditions of a study, in order and each once.

    Parameters
    ----------
    only : sequence of str
        Selections such as ``friction=0+3,resolution=0``; their union is taken. None: all 48
        combinations.
    seeds : str
        As for `parse_seeds`.

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
        factor, equals, values = part.partition("=")
        factor = factor.strip()
        if not equals or factor not in LEVELS:
            raise ConfigurationError(
                f"--only {text!r}: {part.strip()!r} is not {', '.join(LEVELS)} = levels, as in "
                "friction=0+3,resolution=0"
            )
        if factor in found:
            raise ConfigurationError(
                f"--only {text!r}: {factor} is there twice; several levels are joined by +"
            )
        found[factor] = tuple(_level(text, factor, value.strip()) for value in values.split("+"))
    return {factor: found.get(factor, levels) for factor, levels in LEVELS.items()}


def parse_seeds(text: str) -> tuple[int, ...]:
    """Seeds from numbers and half-open ranges, joined by commas: ``77``, ``0:10``, ``1,5,10:20``.

    Raises
    ------
    ConfigurationError
        If it is something else, holds no seed or more than `MOST_SEEDS`, or one twice.
    """

    def refusal(words: str) -> ConfigurationError:
        return ConfigurationError(f"--seeds {text!r}: {words}")

    found: list[int] = []
    for part in text.split(","):
        numbers = re.fullmatch(r"\s*([0-9]{1,19})\s*(?::\s*([0-9]{1,19})\s*)?", part)
        if numbers is None:
            raise refusal(f"{part!r} is neither a number nor a range such as 0:10")
        first = int(numbers[1])
        end = int(numbers[2]) if numbers[2] else first + 1
        if end <= first:
            raise refusal(f"there is no number in {part!r}")
        if end - 1 > _LARGEST_SEED:
            raise refusal(f"{end - 1} is too large, {_LARGEST_SEED} is the largest seed")
        if (many := end - first + len(found)) > MOST_SEEDS:
            raise refusal(f"{many} seeds are too many, {MOST_SEEDS} are allowed")
        found += range(first, end)
    repeated = [seed for seed, times in Counter(found).items() if times > 1]
    if repeated:
        raise refusal(f"{repeated[0]} is there twice")
    return tuple(found)


def _level(text: str, factor: str, value: str) -> int:
    if not re.fullmatch("[0-9]", value) or int(value) not in LEVELS[factor]:
        raise ConfigurationError(
            f"--only {text!r}: {factor} has the levels {', '.join(map(str, LEVELS[factor]))}, "
            f"not {value!r}"
        )
    return int(value)
