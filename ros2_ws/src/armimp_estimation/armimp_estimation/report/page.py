"""The engine of all reports: templates in, one page that holds everything it needs out.

No request leaves a page, and none could: its policy lets only its own scripts run.
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
"""Of a table: the first cell of each row is its header."""
_FUNCTIONS = (symbol, code, setting, mark, uncertain, difference, written)
"""Functions of all templates."""


@dataclass(frozen=True)
class Section:
    """A section of a page; without content there is none."""

    identifier: str
    title: str
    """In the contents."""
    content: Content | None
    """What the template takes."""
    template: str = ""
    """By default that of the name ``report/<identifier>.html``."""


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
    """Put a page together; whatever is not markup is escaped.

    Parameters
    ----------
    title : str
        Of the document.
    header : str
        Template of heading and introduction, which takes `content`.
    sections : sequence of Section
        In their order.
    packages : mapping of str to str
        Packages with ``templates/`` of their own, by the prefix of their names.
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
    environment.globals |= {one.__name__: one for one in _FUNCTIONS} | {"NONE": NONE}
    environment.filters |= {one.__name__: one for one in (number, percent)}
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
