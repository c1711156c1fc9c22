"""Selections of conditions on the command line: what they mean, and what is refused how."""

from __future__ import annotations

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from armimp_bringup.study import (
    LEVELS,
    MOST_SEEDS,
    Condition,
    parse_seeds,
    select_conditions,
)
from armimp_common.errors import ConfigurationError

SUBSETS = st.fixed_dictionaries(
    {},
    optional={
        factor: st.lists(st.sampled_from(levels), min_size=1, unique=True)
        for factor, levels in LEVELS.items()
    },
).filter(bool)


def _cells(chosen: dict[str, list[int]]) -> set[tuple[int, ...]]:
    return set(
        itertools.product(*(chosen.get(factor, levels) for factor, levels in LEVELS.items()))
    )


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


@given(
    st.lists(SUBSETS, min_size=1, max_size=3),
    st.lists(st.integers(0, 2**63 - 1), min_size=1, max_size=4, unique=True),
)
def test_selections_make_their_union_and_every_seed_comes_with_each(
    several: list[dict[str, list[int]]], seeds: list[int]
) -> None:
    texts = [
        ", ".join(f" {factor} = {' + '.join(map(str, levels))}" for factor, levels in one.items())
        for one in several
    ]
    conditions = select_conditions(texts, ",".join(map(str, seeds)))
    cells = set[tuple[int, ...]]().union(*map(_cells, several))
    assert [(one.seed, *_cell(one)) for one in conditions] == sorted(
        (seed, *cell) for seed in seeds for cell in cells
    )


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


def test_a_seed_that_is_there_twice_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="--seeds '0:5,4': a seed is there twice"):
        parse_seeds("0:5,4")


@given(
    st.text(alphabet="friction=resolutionperturbation,+0123 \n\t²x"),
    st.text(alphabet="0123456789:,- \n²x"),
)
def test_any_text_is_understood_or_refused_in_one_line(only: str, seeds: str) -> None:
    for selection, numbers in (([only], "0"), (["friction=0"], seeds)):
        refusal = ""
        try:
            assert select_conditions(selection, numbers)
        except ConfigurationError as error:
            refusal = str(error)
        assert len(refusal.splitlines()) <= 1
