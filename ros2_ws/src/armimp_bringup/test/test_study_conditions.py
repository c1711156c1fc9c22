"""Selections of conditions on the command line: what they mean, and what is refused how."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import TypeVar

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from armimp_bringup.study.conditions import (
    LEVELS,
    MOST_SEEDS,
    Condition,
    parse_only,
    parse_seeds,
    select_conditions,
)
from armimp_common.errors import ConfigurationError

Parsed = TypeVar("Parsed")
SUBSETS = st.fixed_dictionaries(
    {},
    optional={
        factor: st.lists(st.sampled_from(levels), min_size=1, unique=True)
        for factor, levels in LEVELS.items()
    },
).filter(bool)


def _text(chosen: dict[str, list[int]]) -> str:
    return ",".join(f"{factor}={'+'.join(map(str, levels))}" for factor, levels in chosen.items())


def _cells(chosen: dict[str, list[int]]) -> set[tuple[int, ...]]:
    return set(
        itertools.product(*(chosen.get(factor, levels) for factor, levels in LEVELS.items()))
    )


def _cell(condition: Condition) -> tuple[int, ...]:
    return condition.friction, condition.resolution, condition.perturbation


def _unless_refused(parse: Callable[[str], Parsed], text: str) -> Parsed | None:
    """What is understood; None if it is refused, which has to take one line."""
    refusal = None
    try:
        return parse(text)
    except ConfigurationError as error:
        refusal = str(error)
    assert len(refusal.splitlines()) == 1
    return None


def test_without_a_selection_all_48_conditions_are_there_once_and_in_order() -> None:
    conditions = select_conditions([], "0")
    assert [_cell(one) for one in conditions] == list(
        itertools.product(range(4), range(4), range(1, 4))
    )
    assert {one.seed for one in conditions} == {0}


@given(SUBSETS)
def test_selection_leaves_the_named_levels_and_all_of_the_other_factors(
    chosen: dict[str, list[int]],
) -> None:
    assert {_cell(one) for one in select_conditions([_text(chosen)], "0")} == _cells(chosen)


@given(st.lists(SUBSETS, min_size=1, max_size=3))
def test_several_selections_make_their_union(several: list[dict[str, list[int]]]) -> None:
    conditions = select_conditions([_text(chosen) for chosen in several], "0")
    assert len(conditions) == len(set(conditions))
    assert {_cell(one) for one in conditions} == set().union(*map(_cells, several))


@given(SUBSETS, st.lists(st.integers(0, 2**63 - 1), min_size=1, max_size=4, unique=True))
def test_every_seed_comes_with_every_condition(
    chosen: dict[str, list[int]], seeds: list[int]
) -> None:
    conditions = select_conditions([_text(chosen)], ",".join(map(str, seeds)))
    assert {(one.seed, *_cell(one)) for one in conditions} == {
        (seed, *cell) for seed in seeds for cell in _cells(chosen)
    }
    assert [one.seed for one in conditions] == sorted(one.seed for one in conditions)


def test_spaces_around_names_and_levels_do_not_matter() -> None:
    assert parse_only(" friction = 0 + 3 , resolution = 1 ") == {
        "friction": (0, 3),
        "resolution": (1,),
        "perturbation": (1, 2, 3),
    }


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("friction=4", "friction has the levels 0, 1, 2, 3, not '4'"),
        ("perturbation=0", "perturbation has the levels 1, 2, 3, not '0'"),
        ("resolution=", "resolution has the levels 0, 1, 2, 3, not ''"),
        ("resolution=1+", "not ''"),
        ("resolution=-1", "not '-1'"),
        ("friction=²", "not '²'"),
        ("noise=1", "'noise=1' is not friction, resolution, perturbation = levels"),
        ("friction", "'friction' is not"),
        ("", "'' is not"),
        ("friction=1,", "'' is not"),
        ("friction=1,friction=2", "friction is there twice"),
    ],
)
def test_selection_that_makes_no_sense_is_refused_with_its_text(text: str, complaint: str) -> None:
    with pytest.raises(ConfigurationError) as caught:
        parse_only(text)
    assert str(caught.value).startswith(f"--only {text!r}: ")
    assert complaint in str(caught.value)


@given(st.text(alphabet="friction=resolutionperturbation,+0123 \n\t²x"))
def test_any_text_is_a_selection_or_refused_in_one_line(text: str) -> None:
    levels = _unless_refused(parse_only, text)
    if levels is not None:
        assert list(levels) == list(LEVELS)
        assert all(set(levels[factor]) <= set(LEVELS[factor]) for factor in LEVELS)


@given(st.integers(0, 10**6), st.integers(0, 200), st.integers(1, 50))
def test_range_of_seeds_is_that_of_python(start: int, length: int, step: int) -> None:
    assume(length > 0)
    stop = start + length
    assert parse_seeds(f"{start}:{stop}") == tuple(range(start, stop))
    assert parse_seeds(f"{start}:{stop}:{step}") == tuple(range(start, stop, step))


def test_numbers_and_ranges_of_seeds_may_be_joined() -> None:
    assert parse_seeds("77") == (77,)
    assert parse_seeds("5,0:3,10:20:5") == (5, 0, 1, 2, 10, 15)
    assert parse_seeds(str(2**63 - 1)) == (2**63 - 1,)


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("", "'' is neither a number nor a range"),
        ("-1", "'-1' is neither"),
        ("1.5", "'1.5' is neither"),
        ("1:2:3:4", "'1:2:3:4' is neither"),
        ("0:", "'0:' is neither"),
        ("x", "'x' is neither"),
        ("3:3", "there is no number in '3:3'"),
        ("5:1", "there is no number in '5:1'"),
        ("0:5:0", "'0:5:0' is a range without a step"),
        ("1,1", "1 is there twice"),
        ("0:5,4", "4 is there twice"),
        (str(2**63), "is too large"),
        ("99999999999999999999", "is neither"),
        (f"0:{MOST_SEEDS + 1}", f"{MOST_SEEDS + 1} seeds are too many"),
        ("0:9223372036854775807", "seeds are too many"),
        (f"0:{MOST_SEEDS},{MOST_SEEDS}", "seeds are too many"),
    ],
)
def test_seeds_that_make_no_sense_are_refused_with_their_text(text: str, complaint: str) -> None:
    with pytest.raises(ConfigurationError) as caught:
        parse_seeds(text)
    assert str(caught.value).startswith(f"--seeds {text!r}: ")
    assert complaint in str(caught.value)


@given(st.text(alphabet="0123456789:,- \n²x"))
def test_any_text_is_seeds_or_refused_in_one_line(text: str) -> None:
    seeds = _unless_refused(parse_seeds, text)
    if seeds is not None:
        assert 1 <= len(seeds) == len(set(seeds)) <= MOST_SEEDS
        assert all(0 <= seed < 2**63 for seed in seeds)


def test_conditions_have_names_of_their_own_for_files_and_for_people() -> None:
    conditions = select_conditions([], "0:3")
    assert len({one.name for one in conditions}) == len({str(one) for one in conditions}) == 144
    assert conditions[0].name == "friction0-resolution0-perturbation1-seed0"
    assert str(conditions[0]) == "friction 0, resolution 0, perturbation 1, seed 0"
