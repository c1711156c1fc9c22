"""Strings stay text whatever they hold, and numbers are written."""

import json

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from markupsafe import Markup, escape

from armimp_estimation.problems import ProblemCode
from armimp_estimation.report.formats import (
    difference,
    number,
    percent,
    plain,
    symbol,
    uncertain,
)
from armimp_estimation.report.page import Section, Table, render_page, script_json
from armimp_estimation.report.run import advised, assumptions
from support.pages import Page

HOSTILE = "\"><script>alert(1)</script><img src=x onerror=alert(1)>'&amp;{{ 7 * 7 }}"


def test_strings_in_cells_captions_and_titles_stay_text() -> None:
    table = Table(
        caption=HOSTILE,
        columns=[HOSTILE, "value"],
        groups=[(HOSTILE, [[HOSTILE, HOSTILE], ["none", None]])],
        spans=[(HOSTILE, 2)],
    )
    content = {"valid": False, "title": "Title", "problems": [], "notes": [], "limits": table}
    section = Section(
        identifier="verdict", title=HOSTILE, template="report/verdict.html", content=content
    )
    assumed = {"joints": 2, "friction": "level 3"}
    made = render_page(HOSTILE, "report/assumptions.html", [section], content=assumed)
    body = made[made.index("<body>") : made.index("<script>")]
    page = Page(body)
    assert {"script", "img"}.isdisjoint(tag for tag, _ in page.elements)
    assert page.words.count(HOSTILE) == 7
    (frame,) = [given for _, given in page.elements if given.get("role") == "region"]
    # Only what can have the focus can be scrolled with the keyboard.
    assert frame["tabindex"] == "0"
    scopes = [given.get("scope") for tag, given in page.elements if tag == "th"]
    assert scopes == ["colgroup", "col", "col", "rowgroup", "row", "row"]


@pytest.mark.parametrize("value", ["a\x00b", "a\x1bb", "a\x7fb", "a\u202eb", "a\u2066b"])
def test_characters_which_deceive_are_shown_as_replaced(value: str) -> None:
    assert plain(value) == "a\N{REPLACEMENT CHARACTER}b"


def test_half_of_a_surrogate_pair_can_be_written_to_a_file() -> None:
    assert plain("a\ud800b").encode() == b"a?b"


def test_symbols_are_markup_whose_parts_are_escaped() -> None:
    assert symbol("Z", 1, 2) == "<var>Z</var><sub>12</sub>"
    assert symbol(HOSTILE) == Markup("<var>") + escape(HOSTILE) + Markup("</var>")


@settings(max_examples=40)
@given(st.recursive(st.text() | st.integers() | st.none(), st.lists))
def test_json_for_a_script_comes_back_and_cannot_end_the_element(value: object) -> None:
    made = script_json({"value": value, "</script>": "<!--"})
    assert "<" not in made
    assert json.loads(made) == {"value": value, "</script>": "<!--"}


def test_rows_and_columns_of_a_table_must_agree() -> None:
    with pytest.raises(ValueError, match="1 cells in 2 columns"):
        Table(caption="Title", columns=["a", "b"], groups=[(None, [["only one"]])])


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


@pytest.mark.parametrize("config", [{}, {"experiment": "text"}, {"experiment": None}, {"a": [1]}])
def test_a_configuration_of_another_kind_is_taken_without_assumptions(
    config: dict[str, object],
) -> None:
    assert assumptions(config) is None


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
