"""How a result was made: its configuration, where each value comes from, and what is assumed."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Any

from markupsafe import Markup

from armimp_estimation.report.formats import code, setting, written
from armimp_estimation.report.page import Content, Table

ASSUMPTION = "assumption"
DESIGN = "study design"
CHOSEN = "set for this run"
_BY_JOINTS: Mapping[str, Mapping[int, str]] = {
    table: {
        1: f"paper, {table}, elbow",
        2: f"paper, {table}",
        3: f"paper, {table}; wrist: {ASSUMPTION}",
    }
    for table in ("Table I", "Table III")
}
"""Tables of the paper by the number of joints; for more of them, all is assumed."""
_ORIGINS: tuple[tuple[str, str], ...] = (
    (r"arm\.", "Table I"),
    (r"robot\.|friction\.", ASSUMPTION),
    (r"sensors\..*\.resolution", "paper, Table II"),
    (r"sensors\.|actuators\.|substeps|perturbation\.(cutoff|order)", DESIGN),
    (r"perturbation\.peak", "Table III"),
    (r"law\.kind", "paper: imbic"),
    (
        r"voluntary\.|reflex\.|muscle\.|cuff\.|target\.|law\.|safety\.|tare\.|sequence\.(settle|rest)",
        ASSUMPTION,
    ),
    (r"known\.", "as simulated"),
    (r"sequence\.duration", "paper: 50 s"),
)
_IMPERFECTIONS = {
    "sensors.torque.offset": "an offset",
    "sensors.torque.drift": "drift",
    "sensors.torque.gain": "a wrong gain",
    "sensors.torque.delay": "a delay",
    "sensors.torque.cutoff": "a low-pass",
    "sensors.torque.cross_talk": "cross-talk",
    "sensors.torque.hysteresis": "hysteresis",
    "sensors.torque.noise": "noise",
    "sensors.torque.hum": "hum",
    "sensors.torque.limit": "clipping",
}


def identity(config: Mapping[str, Any], seed: object) -> list[tuple[str, object]]:
    """Versions, seed, and whatever else the configuration has beside its groups of values."""
    rows: list[tuple[str, object]] = [("seed", written(seed))]
    single = {name: value for name, value in config.items() if not isinstance(value, dict)}
    rows += [(name.replace("_", " "), written(value)) for name, value in single.items()]
    armimp = setting(config, "versions", "armimp")
    return rows if armimp is None else [("armimp", written(armimp)), *rows]


def configuration(config: Mapping[str, Any]) -> list[tuple[str, int, Table]]:
    """Name, size and table of every group of values, with where each value comes from."""
    found = []
    for node, values in config.items():
        if isinstance(values, dict) and values:
            origins = [marked_origin(config, node, name) for name in values]
            rows: list[list[object]] = [[code(name), written(v)] for name, v in values.items()]
            columns = ["name", "value"]
            if any(origins):
                columns = ["parameter", "value", "where from"]
                rows = [[*row, one] for row, one in zip(rows, origins, strict=True)]
            caption = "Values as they were recorded"
            table = Table(caption=caption, columns=columns, groups=[(None, rows)], words=(1, 2))
            found.append((node, len(values), table))
    return found


def marked_origin(config: Mapping[str, Any], node: str, name: str) -> str:
    """Where a parameter comes from, see `origin`, set off if it is assumed."""
    where = origin(config, node, name)
    return Markup("<em>{}</em>").format(where) if ASSUMPTION in where else where


def origin(config: Mapping[str, Any], node: str, name: str) -> str:
    """Where a parameter of a node comes from: the paper, an assumption, or empty if unknown."""
    if setting(config, "experiment") is None:
        return ""
    if name in set(_dotted(setting(config, "experiment", node))):
        return CHOSEN
    source = next((source for pattern, source in _ORIGINS if re.match(pattern, name)), "")
    if source in _BY_JOINTS:
        joints = setting(config, "experiment", "joints")
        return _BY_JOINTS[source].get(joints, ASSUMPTION)
    return source


def _dotted(values: object, prefix: str = "") -> Iterator[str]:
    if isinstance(values, Mapping):
        for name, value in values.items():
            yield f"{prefix}{name}"
            yield from _dotted(value, f"{prefix}{name}.")


def assumptions_content(
    config: Mapping[str, Any], *, friction: str | None = None
) -> Content | None:
    """What the simulation assumes; None where nothing is known to be simulated.

    The configuration may be of any form. Levels of friction are told in words where there is more
    than one.
    """
    if setting(config, "experiment") is None or setting(config, "arm_sim") is None:
        return None
    return {
        "joints": setting(config, "experiment", "joints"),
        "friction": friction or f"level {setting(config, 'experiment', 'friction')}",
        "sensors": _of_sensors(config),
    }


def _of_sensors(config: Mapping[str, Any]) -> str:
    """What the simulated sensors have, in words."""
    words = ["a resolution"]
    for name, what in _IMPERFECTIONS.items():
        value = setting(config, "arm_sim", name)
        neutral = 1.0 if name == "sensors.torque.gain" else 0.0
        values = value if isinstance(value, list) else [value]
        if any(one not in (None, neutral) for one in values):
            words.append(what)
    return ", ".join(words[:-1]) + " and " + words[-1] if len(words) > 1 else words[0]
