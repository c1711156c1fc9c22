"""Strings stay text whatever they hold, and numbers are written."""

import json

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from armimp_estimation.problems import ProblemCode
from armimp_estimation.report.formats import (
    difference,
    number,
    percent,
    plain,
    uncertain,
)
from armimp_estimation.report.page import render_page, script_json
from armimp_estimation.report.run import advised, assumptions


@pytest.mark.parametrize("value", ["a\x00b", "a\x1bb", "a\x7fb", "a\u202eb", "a\u2066b"])
def test_characters_which_deceive_are_shown_as_replaced(value: str) -> None:
    assert plain(value) == "a\N{REPLACEMENT CHARACTER}b"


@settings(max_examples=40)
@given(st.recursive(st.text() | st.integers() | st.none(), st.lists))
def test_json_for_a_script_comes_back_and_cannot_end_the_element(value: object) -> None:
    made = script_json({"value": value, "</script>": "<!--"})
    assert "<" not in made
    assert json.loads(made) == {"value": value, "</script>": "<!--"}


def test_problems_of_one_kind_come_together_in_their_order() -> None:
    found = advised(
        [
            (ProblemCode.NODE_FAILED, "node a died"),
            (ProblemCode.INTERRUPTED, "interrupted by the user"),
            (ProblemCode.NODE_FAILED, "node b died"),
        ]
    )
    assert [(kind.title, sentences) for kind, sentences in found] == [
        ("A node failed", ["node a died", "node b died"]),
        ("The run was stopped", ["interrupted by the user"]),
    ]


@pytest.mark.parametrize(("joints", "title"), [(3, "Third joint"), (5, "Arm")])
def test_of_more_than_two_joints_the_paper_says_nothing(joints: int, title: str) -> None:
    config = {"experiment": {"joints": joints}, "arm_sim": {}}
    made = render_page("", "report/assumptions.html", [], content=assumptions(config))
    assert f"<dt>{title}</dt><dd>The paper's arm has two joints." in made


def test_an_error_gets_two_digits_and_the_estimate_as_many_decimals() -> None:
    assert uncertain(0.184406, 0.00069951) == "0.18441 ± 0.00070"
    assert uncertain(-7.98196, 0.24772) == "−7.98 ± 0.25"
    assert uncertain(1234.5, 35.8) == "1234 ± 36"
    assert uncertain(2.0, float("nan")) == "2 ± –"
    assert uncertain(float("nan"), 0.0) == "– ± –"


def test_what_is_not_a_number_is_a_dash() -> None:
    assert number(float("inf")) == percent(float("nan")) == difference(1.0, 0.0) == "–"
    assert difference(1.1, 1.0) == "+10.00\N{NARROW NO-BREAK SPACE}%"
    assert number(62.708, ".1f", "°") == "62.7°"
