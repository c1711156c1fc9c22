"""HTML out of plain functions. Whatever is not marked as HTML is escaped, so any string is safe."""

from __future__ import annotations

import html
import json
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

# Control characters have no place in HTML; those for the direction of writing can make a text
# look like another one.
_UNWANTED = re.compile(
    "[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\u061c\u200e\u200f\u202a-\u202e\u2066-\u2069]"
)
_VOID = frozenset({"br", "input", "meta"})


class Html(str):
    """Text that is HTML already."""

    __slots__ = ()


def plain(value: object) -> str:
    """Text of a value as a page can hold it: unwanted and impossible characters are replaced."""
    possible = str(value).encode("utf-8", "replace").decode("utf-8")
    return _UNWANTED.sub("\N{REPLACEMENT CHARACTER}", possible)


def text(value: object) -> Html:
    """HTML of a value: itself if it is HTML, nothing if it is None, else its text, escaped."""
    if isinstance(value, Html):
        return value
    return Html("" if value is None else html.escape(plain(value)))


def join(parts: Iterable[object], separator: str = "") -> Html:
    """HTML of several values, one after the other."""
    return Html(text(separator).join(text(part) for part in parts))


def element(tag: str, *children: object, **attributes: object) -> Html:
    """Make an element.

    Parameters
    ----------
    tag : str
        Name of the element; must not come from data.
    *children : object
        Content, see `text`.
    **attributes : object
        Attributes. An underscore at the end is dropped (``class_``), others become hyphens
        (``aria_label``). True makes an attribute without a value; None and False make none.
    """
    start = tag
    for name, value in attributes.items():
        if value is None or value is False:
            continue
        start += f" {name.rstrip('_').replace('_', '-')}"
        if value is not True:
            start += f'="{html.escape(plain(value))}"'
    if tag in _VOID:
        return Html(f"<{start}>")
    return Html(f"<{start}>{join(children)}</{tag}>")


def section(identifier: str, title: object, *content: object, **attributes: object) -> Html:
    """Make a section with a heading, to which links can lead."""
    heading = element("h2", title, id=f"{identifier}-title")
    named = {"id": identifier, "aria_labelledby": f"{identifier}-title", **attributes}
    return element("section", heading, *content, **named)


def listing(items: Iterable[object], **attributes: object) -> Html:
    """Make a list without order."""
    return element("ul", *(element("li", item) for item in items), **attributes)


def details(summary: object, *content: object) -> Html:
    """Make a part that unfolds."""
    return element("details", element("summary", summary), *content)


@dataclass(frozen=True, kw_only=True)
class Group:
    """Rows of a table which belong together.

    Parameters
    ----------
    rows : sequence of sequences
        Cells; the first one of each row is its header.
    title : object
        Header of the group, None for a group without.
    """

    rows: Sequence[Sequence[object]]
    title: object = None


def table(
    caption: object,
    columns: Sequence[object],
    groups: Sequence[Group],
    *,
    spans: Sequence[tuple[object, int]] = (),
    words: Iterable[int] = (),
) -> Html:
    """Make a table, in a frame that scrolls where it is too wide.

    Parameters
    ----------
    caption : object
        Title.
    columns : sequence
        Header of each column.
    groups : sequence of Group
        Rows.
    spans : sequence of (object, int)
        Headers above those of the columns, with the number of columns that each is above.
    words : iterable of int
        Columns of words, aligned to the left as the first one is; numbers are aligned to the right.
    """
    left = {0, *words}
    kinds = ["words" if i in left else None for i in range(len(columns))]
    heads = []
    if spans:
        cells = (
            element("th", title, scope="colgroup", colspan=width, class_="span")
            if title
            else element("td", colspan=width)
            for title, width in spans
        )
        heads.append(element("tr", *cells))
    titles = zip(columns, kinds, strict=True)
    heads.append(element("tr", *(element("th", c, scope="col", class_=k) for c, k in titles)))
    frame = element(
        "table",
        element("caption", caption),
        element("thead", *heads),
        *(_body(group, kinds) for group in groups),
    )
    label = re.sub("<[^>]*>", "", text(caption))
    # Only what can have the focus can be scrolled with the keyboard.
    return element(
        "div", frame, class_="scroll", role="region", tabindex="0", aria_label=html.unescape(label)
    )


def _body(group: Group, kinds: Sequence[str | None]) -> Html:
    rows = []
    if group.title is not None:
        title = element("th", group.title, scope="rowgroup", colspan=len(kinds))
        rows.append(element("tr", title, class_="group"))
    for head, *cells in group.rows:
        values = zip(cells, kinds[1:], strict=True)
        rest = (element("td", cell, class_=kind) for cell, kind in values)
        rows.append(element("tr", element("th", head, scope="row"), *rest))
    return element("tbody", *rows)


def script_json(value: Any, **attributes: object) -> Html:
    """Put a value into a page as JSON for a script; nothing in it can end the element."""
    dumped = json.dumps(value, ensure_ascii=True, allow_nan=False, separators=(",", ":"))
    # Only strings can hold these characters, and there the escapes mean the same.
    for character in "<>&":
        dumped = dumped.replace(character, f"\\u{ord(character):04x}")
    return element("script", Html(dumped), type="application/json", **attributes)
