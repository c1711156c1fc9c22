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
    """Seed, versions, the whole configuration, and what is known of the torque readings."""
    config = result.summary.config
    known = result.summary.torque_reading
    told = []
    if known is not None:
        text = (
            f"Torques were read {known.reading().sentence}. All estimates are corrected for delay "
            "and low-pass, lpm_full for the instant as well."
        )
        told.append(element("p", text))
    if not config:
        text = "The recordings carry no configuration: they were made elsewhere."
        return section("settings", "How it was made", element("p", text), *told)
    return section(
        "settings",
        "How it was made",
        identity(config, written(result.summary.seed)),
        *told,
        *configuration(config),
    )


def identity(config: Mapping[str, Any], seed: object) -> Html:
    """Versions, seed, and whatever else the configuration has beside its groups of values."""
    rows: list[tuple[str, object]] = [("seed", seed)]
    plain = {name: value for name, value in config.items() if not isinstance(value, dict)}
    rows += [(name.replace("_", " "), written(value)) for name, value in plain.items()]
    armimp = setting(config, "versions", "armimp")
    if armimp is not None:
        rows.insert(0, ("armimp", written(armimp)))
    pairs = (join([element("dt", name), element("dd", value)]) for name, value in rows)
    return element("dl", *pairs, class_="facts")


def configuration(config: Mapping[str, Any]) -> list[Html]:
    """Every group of values in a table that unfolds, with where each value comes from."""
    return [
        details(join([code(name), f" ({len(values)} values)"]), _table(config, name, values))
        for name, values in config.items()
        if isinstance(values, dict) and values
    ]


def _table(config: Mapping[str, Any], node: str, values: Mapping[str, Any]) -> Html:
    origins = {name: origin(config, node, name) for name in values}
    if any(origins.values()):
        rows = [[code(n), written(v), marked(origins[n])] for n, v in values.items()]
        columns = ["parameter", "value", "where from"]
    else:
        rows = [[code(name), written(value)] for name, value in values.items()]
        columns = ["name", "value"]
    return table("Values as they were recorded", columns, [Group(rows=rows)], words=(1, 2))


def marked(where: str) -> object:
    """Set off where a value comes from, if it is assumed."""
    return element("em", where) if ASSUMPTION in where else where


def written(value: object) -> str:
    """Write a value; long numbers are cut to seven digits, as nobody reads the rest."""
    if isinstance(value, float):
        return f"{value:.7g}"
    if isinstance(value, list):
        return ", ".join(written(item) for item in value) or "none"
    if value is None:
        return NONE
    if value == {}:
        return "none"
    return value if isinstance(value, str) else json.dumps(value)


def assumptions_section(config: Mapping[str, Any], *, friction: str | None = None) -> Html | None:
    """What the simulation assumes; None where nothing is known to be simulated.

    Parameters
    ----------
    config : mapping
        Configuration of a result, of any form.
    friction : str, optional
        Levels of friction in words, where there is more than one.
    """
    found = assumptions(config, friction=friction)
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
