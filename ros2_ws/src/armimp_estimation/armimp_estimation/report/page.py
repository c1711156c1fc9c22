"""The engine of all reports: it renders templates into one self-contained page.

A page sends no requests, and could not: its content security policy lets only its own scripts run.
"""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

from jinja2 import Environment, PackageLoader, PrefixLoader, StrictUndefined
from markupsafe import Markup
from plotly.offline import get_plotlyjs

from armimp_estimation.report.formats import (
    NONE,
    code,
    difference,
    digits,
    mark,
    number,
    percent,
    plain,
    setting,
    symbol,
    uncertain,
    written,
)
from armimp_estimation.report.plots import style_rule

Content = dict[str, Any]
Rows = list[list[object]]
"""Rows of a table; the first cell of each row is its header."""


@dataclass(frozen=True)
class Section:
    """A section of a page; it is left out if it has no content."""

    identifier: str
    title: str
    """Title in the table of contents."""
    content: Content | None
    """Variables of the template."""
    template: str = ""
    """Name of the template, by default ``report/<identifier>.html``."""


def _shown(value: object) -> object:
    return value if isinstance(value, Markup) else "" if value is None else plain(value)


def render_page(
    title: str,
    header: str,
    sections: Sequence[Section],
    *,
    packages: Mapping[str, str] | None = None,
    **content: Any,
) -> str:
    """Return the HTML of a page; all text that is not markup is escaped.

    Parameters
    ----------
    title : title of the document
    header : template of heading and introduction, with the variables `content`
    sections : sections in order
    packages : further packages with ``templates/``, by the prefix of the names of their templates
    """
    loaders = {
        prefix: PackageLoader(name)
        for prefix, name in {"report": __package__, **(packages or {})}.items()
    }
    environment = Environment(
        loader=PrefixLoader(loaders),
        autoescape=True,
        undefined=StrictUndefined,
        finalize=_shown,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    written_by = (code, difference, digits, mark, setting, symbol, uncertain, written)
    environment.globals |= {"NONE": NONE, **{one.__name__: one for one in written_by}}
    environment.filters |= {"number": number, "percent": percent}
    compact = {"ensure_ascii": True, "allow_nan": False, "separators": (",", ":")}
    environment.policies["json.dumps_kwargs"] = compact
    scripts = [str(get_plotlyjs()), _resource("plots.js")]
    return environment.get_template("report/page.html").render(
        title=title,
        header=header,
        sections=[one for one in sections if one.content is not None],
        style=Markup(style_rule() + _resource("style.css")),
        scripts=[Markup(script) for script in scripts],
        script_hashes=[_hash(script) for script in scripts],
        **content,
    )


def _resource(name: str) -> str:
    return files(__package__).joinpath(name).read_text(encoding="utf-8")


def _hash(script: str) -> str:
    digest = hashlib.sha256(script.encode("utf-8")).digest()
    return f"'sha256-{base64.b64encode(digest).decode('ascii')}'"
