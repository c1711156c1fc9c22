"""How a result was made: configuration, versions, assumptions."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from armimp_estimation.report.formats import NONE, code
from armimp_estimation.report.html import Group, Html, details, element, join, section, table
from armimp_estimation.report.provenance import ASSUMPTION, assumptions, origin
from armimp_estimation.report.result import Result, setting


def settings_section(result: Result) -> Html:
    """Seed, versions, the whole configuration."""
    config = result.summary.config
    if not config:
        text = "The recordings carry no configuration: they were made elsewhere."
        return section("settings", "How it was made", element("p", text))
    folded = [
        details(join([code(name), f" ({len(values)} values)"]), _table(config, name, values))
        for name, values in config.items()
        if isinstance(values, dict) and values
    ]
    return section(
        "settings",
        "How it was made",
        _identity(result),
        *folded,
    )


def _identity(result: Result) -> Html:
    config = result.summary.config
    rows: list[tuple[str, object]] = [("seed", _value(result.summary.seed))]
    plain = {name: value for name, value in config.items() if not isinstance(value, dict)}
    rows += [(name.replace("_", " "), _value(value)) for name, value in plain.items()]
    armimp = setting(config, "versions", "armimp")
    if armimp is not None:
        rows.insert(0, ("armimp", _value(armimp)))
    pairs = (join([element("dt", name), element("dd", value)]) for name, value in rows)
    return element("dl", *pairs, class_="facts")


def _table(config: Mapping[str, Any], node: str, values: Mapping[str, Any]) -> Html:
    origins = {name: origin(config, node, name) for name in values}
    if any(origins.values()):
        rows = [[code(n), _value(v), _marked(origins[n])] for n, v in values.items()]
        columns = ["parameter", "value", "where from"]
    else:
        rows = [[code(name), _value(value)] for name, value in values.items()]
        columns = ["name", "value"]
    return table("Values as they were recorded", columns, [Group(rows=rows)], words=(1, 2))


def _marked(where: str) -> object:
    return element("em", where) if ASSUMPTION in where else where


def _value(value: object) -> str:
    """Write a value; long numbers are cut to seven digits, as nobody reads the rest."""
    if isinstance(value, float):
        return f"{value:.7g}"
    if isinstance(value, list):
        return ", ".join(_value(item) for item in value) or "none"
    if value is None:
        return NONE
    if value == {}:
        return "none"
    return value if isinstance(value, str) else json.dumps(value)


def assumptions_section(result: Result) -> Html | None:
    """What the simulation assumes; None where nothing is known to be simulated."""
    found = assumptions(result.summary.config)
    if not found:
        return None
    pairs = (join([element("dt", title), element("dd", text)]) for title, text in found)
    return section(
        "assumptions",
        "Assumptions",
        element(
            "p",
            "This is a simulation. The following is assumed, not taken from the paper or measured; "
            "the tables above mark each such value.",
        ),
        element("dl", *pairs, class_="terms"),
    )
