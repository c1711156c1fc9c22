"""Selections of conditions on the command line: what they mean, and what is refused how."""

from __future__ import annotations

import itertools

import pytest

from armimp_bringup.study import (
    MOST_SEEDS,
    Condition,
    parse_seeds,
    select_conditions,
)
from armimp_common.errors import ConfigurationError


def _cell(condition: Condition) -> tuple[int, ...]:
    return condition.friction, condition.resolution, condition.perturbation


def test_without_a_selection_all_48_conditions_are_there_once_and_in_order() -> None:
    conditions = select_conditions([], "0:3")
    assert [_cell(one) for one in conditions[:48]] == list(
        itertools.product(range(4), range(4), range(1, 4))
    )
    assert len({one.name for one in conditions}) == len({str(one) for one in conditions}) == 144
    assert conditions[0].name == "friction0-resolution0-perturbation1-seed0"
    assert str(conditions[0]) == "friction 0, resolution 0, perturbation 1, seed 0"


@pytest.mark.parametrize(
    "text",
    [
        *("friction=4", "perturbation=0", "resolution=1+", "friction=²", "noise=1", "friction", ""),
        "friction=1,friction=2",
    ],
)
def test_selection_that_makes_no_sense_is_refused_with_its_text(text: str) -> None:
    with pytest.raises(ConfigurationError) as caught:
        select_conditions([text], "0")
    assert str(caught.value).startswith(
        f"--only {text!r}: {text.rsplit(',', maxsplit=1)[-1]!r} is not one of"
    )


def test_numbers_and_ranges_of_seeds_may_be_joined() -> None:
    assert parse_seeds("5, 0:3,10 : 12 ") == (5, 0, 1, 2, 10, 11)
    assert parse_seeds(str(2**63 - 1)) == (2**63 - 1,)


@pytest.mark.parametrize(
    "text",
    [
        *("", "-1", "0:10:2", "0:", "3:3", str(2**63), "9" * 20, "0:9223372036854775807"),
        f"{MOST_SEEDS},0:{MOST_SEEDS}",
    ],
)
def test_seeds_that_make_no_sense_are_refused_with_their_text(text: str) -> None:
    with pytest.raises(ConfigurationError) as caught:
        parse_seeds(text)
    part = text.rsplit(",", maxsplit=1)[-1]
    assert str(caught.value).startswith(f"--seeds {text!r}: {part!r} is neither a seed nor a range")
