"""Whatever strings go into a page, they stay text."""

import html
import json
from html.parser import HTMLParser

import pytest
from armimp_estimation.report.html import (
    Group,
    Html,
    details,
    element,
    join,
    script_json,
    section,
    table,
    text,
)
from hypothesis import given
from hypothesis import strategies as st

HOSTILE = "\"><script>alert(1)</script><img src=x onerror=alert(1)>'&amp;"


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

    def tags(self) -> list[str]:
        return [tag for tag, _ in self.found]


@given(st.text())
def test_any_string_as_content_or_attribute_makes_no_element(value: str) -> None:
    page = Elements(element("p", value, title=value))
    ((tag, attributes),) = page.found
    assert tag == "p"
    assert set(attributes) == {"title"}


def test_text_comes_back_as_it_was() -> None:
    page = Elements(element("p", HOSTILE, title=HOSTILE))
    assert page.content == HOSTILE
    assert page.found == [("p", {"title": HOSTILE})]


def test_html_is_not_escaped_again() -> None:
    inner = element("b", "a < b")
    assert element("p", inner, " & ", 3, None) == "<p><b>a &lt; b</b> &amp; 3</p>"
    assert join(["<", Html("<br>")], ", ") == "&lt;, <br>"
    assert isinstance(join([]), Html)


def test_attributes_are_written_as_html_has_them() -> None:
    made = element("input", type="radio", checked=True, disabled=False, value=None, aria_label="a")
    assert made == '<input type="radio" checked aria-label="a">'
    assert element("p", class_="note") == '<p class="note"></p>'


@pytest.mark.parametrize("value", ["a\x00b", "a\x1bb", "a\x7fb", "a\u202eb", "a\u2066b"])
def test_characters_which_deceive_are_shown_as_replaced(value: str) -> None:
    assert text(value) == "a\N{REPLACEMENT CHARACTER}b"


def test_half_of_a_surrogate_pair_can_be_written_to_a_file() -> None:
    assert text("a\ud800b").encode() == b"a?b"


def test_lines_and_tabs_stay() -> None:
    assert text("a\n\tb") == "a\n\tb"


@given(st.recursive(st.text() | st.integers() | st.none(), st.lists))
def test_json_for_a_script_comes_back_and_cannot_end_the_element(value: object) -> None:
    made = script_json({"value": value, "</script>": "<!--"})
    assert made.count("<") == 2  # its own tags
    page = Elements(made)
    assert page.tags() == ["script"]
    assert json.loads(page.content) == {"value": value, "</script>": "<!--"}


def test_json_for_a_script_refuses_what_a_browser_could_not_read() -> None:
    with pytest.raises(ValueError, match="not JSON compliant"):
        script_json([float("nan")])


def test_a_table_tells_which_cells_a_header_is_for() -> None:
    made = Elements(
        table(
            "Title",
            ["element", "value"],
            [Group(title="group", rows=[["a", 1], ["b", HOSTILE]])],
            spans=[("", 1), ("above", 1)],
        )
    )
    scopes = [attributes.get("scope") for tag, attributes in made.found if tag == "th"]
    assert scopes == ["colgroup", "col", "col", "rowgroup", "row", "row"]
    assert "caption" in made.tags()
    assert "script" not in made.tags()


def test_a_wide_table_can_be_scrolled_with_the_keyboard() -> None:
    frame = Elements(table(Html("<var>K</var> &amp; <b>B</b>"), ["a"], [])).found[0]
    assert frame == (
        "div",
        {"class": "scroll", "role": "region", "tabindex": "0", "aria-label": "K & B"},
    )


def test_rows_and_columns_of_a_table_must_agree() -> None:
    with pytest.raises(ValueError, match="zip"):
        table("Title", ["a", "b"], [Group(rows=[["only one"]])])


def test_a_section_is_named_by_its_heading() -> None:
    made = Elements(section("part", "Title", details("more", "text")))
    assert made.found[0] == ("section", {"id": "part", "aria-labelledby": "part-title"})
    assert made.found[1] == ("h2", {"id": "part-title"})
    assert made.tags()[2:] == ["details", "summary"]
    assert html.unescape(made.content) == "Titlemoretext"
