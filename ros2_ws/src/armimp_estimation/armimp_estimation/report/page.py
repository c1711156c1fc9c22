"""A page that holds everything it needs: no request leaves it, and none could."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Sequence
from importlib.resources import files
from typing import TypeAlias

from armimp_estimation.report.html import Html, element

_STYLE = "style.css"
_SCRIPTS = ("plots.js", "tables.js")


Chapter: TypeAlias = "tuple[str, str, Html | None]"
"""Identifier of a section, its title in the list of contents, and itself; None is left out."""


def page(title: str, header: object, chapters: Sequence[Chapter], *, plots: bool = True) -> str:
    """Put a page together.

    Parameters
    ----------
    title : str
        Of the document.
    header : object
        Heading and introduction.
    chapters : sequence of Chapter
        Content, see `armimp_estimation.report.html.section`.
    plots : bool
        Whether there are plots, which take the 5 MB of plotly.js.
    """
    scripts = [_plotly(), *map(_resource, _SCRIPTS)] if plots else []
    # Only these scripts run, and nothing is fetched, whatever strings of strangers may contain.
    policy = "; ".join(
        [
            "default-src 'none'",
            " ".join(["script-src", *(_hash(script) for script in scripts)]) if scripts else "",
            "style-src 'unsafe-inline'",
            "img-src data: blob:",
            "base-uri 'none'",
            "form-action 'none'",
        ]
    )
    head = element(
        "head",
        element("meta", charset="utf-8"),
        element("meta", http_equiv="Content-Security-Policy", content=policy),
        element("meta", name="viewport", content="width=device-width, initial-scale=1"),
        element("meta", name="color-scheme", content="light"),
        element("title", title),
        element("style", Html(_resource(_STYLE))),
    )
    body = element(
        "body",
        element("a", "Skip to the result", href="#content", class_="skip"),
        element("noscript", element("p", "The plots need JavaScript.")) if plots else None,
        element("header", header, contents([(name, t) for name, t, part in chapters if part])),
        element("main", *(part for _, _, part in chapters), id="content"),
        *(element("script", Html(script)) for script in scripts),
    )
    return "<!DOCTYPE html>\n" + element("html", head, body, lang="en") + "\n"


def contents(links: Sequence[tuple[str, object]]) -> Html:
    """List of links to sections, by identifier and title."""
    items = (element("li", element("a", title, href=f"#{name}")) for name, title in links)
    return element("nav", element("ul", *items), aria_label="Contents")


def _plotly() -> str:
    from plotly.offline import get_plotlyjs

    return str(get_plotlyjs())


def _resource(name: str) -> str:
    return files(__package__).joinpath(name).read_text(encoding="utf-8")


def _hash(script: str) -> str:
    digest = hashlib.sha256(script.encode("utf-8")).digest()
    return f"'sha256-{base64.b64encode(digest).decode('ascii')}'"
