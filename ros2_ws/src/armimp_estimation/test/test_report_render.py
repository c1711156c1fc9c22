"""Whatever strings go into a page, they stay text."""

import json
from html.parser import HTMLParser

import pytest
from hypothesis import given
from hypothesis import strategies as st
from markupsafe import Markup, escape

from armimp_estimation.report.formats import plain, symbol
from armimp_estimation.report.page import Section, Table, render_page, script_json

HOSTILE = "\"><script>alert(1)</script><img src=x onerror=alert(1)>'&amp;{{ 7 * 7 }}"


class Elements(HTMLParser):
    """Start tags with attributes, and the text, as a browser would find them."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.found: list[tuple[str, dict[str, str | None]]] = []
        self.content = ""
        self.feed(page)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found.append((tag, dict(attrs)))

    def handle_data(self, data: str) -> None:
        self.content += data


def test_strings_in_cells_captions_and_titles_stay_text() -> None:
    table = Table(
        caption=HOSTILE,
        columns=[HOSTILE, "value"],
        groups=[(HOSTILE, [[HOSTILE, HOSTILE], ["none", None]])],
        spans=[(HOSTILE, 2)],
    )
    content = {"known": False, "table": table}
    section = Section(
        identifier="scores", title=HOSTILE, template="report/scores.html", content=content
    )
    made = render_page(HOSTILE, "report/assumptions.html", [section], content={"assumptions": []})
    body = made[made.index("<body>") : made.index("<script>")]
    page = Elements(body)
    assert {"script", "img"}.isdisjoint(tag for tag, _ in page.found)
    assert page.content.count(HOSTILE) == 7
    (frame,) = [given for _, given in page.found if given.get("role") == "region"]
    # Only what can have the focus can be scrolled with the keyboard.
    assert frame["tabindex"] == "0"
    scopes = [given.get("scope") for tag, given in page.found if tag == "th"]
    assert scopes == ["colgroup", "col", "col", "rowgroup", "row", "row"]


@pytest.mark.parametrize("value", ["a\x00b", "a\x1bb", "a\x7fb", "a\u202eb", "a\u2066b"])
def test_characters_which_deceive_are_shown_as_replaced(value: str) -> None:
    assert plain(value) == "a\N{REPLACEMENT CHARACTER}b"


def test_half_of_a_surrogate_pair_can_be_written_to_a_file() -> None:
    assert plain("a\ud800b").encode() == b"a?b"


def test_symbols_are_markup_whose_parts_are_escaped() -> None:
    assert symbol("Z", 1, 2) == "<var>Z</var><sub>12</sub>"
    assert symbol(HOSTILE) == Markup("<var>") + escape(HOSTILE) + Markup("</var>")


@given(st.recursive(st.text() | st.integers() | st.none(), st.lists))
def test_json_for_a_script_comes_back_and_cannot_end_the_element(value: object) -> None:
    made = script_json({"value": value, "</script>": "<!--"})
    assert "<" not in made
    assert json.loads(made) == {"value": value, "</script>": "<!--"}


def test_rows_and_columns_of_a_table_must_agree() -> None:
    with pytest.raises(ValueError, match="1 cells in 2 columns"):
        Table(caption="Title", columns=["a", "b"], groups=[(None, [["only one"]])])
