"""Formats of numbers, symbols and streams in a report."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping
from typing import Any

from markupsafe import Markup

from armimp_common import topics

# Control characters are not allowed in HTML; those for the direction of writing can make one text
# look like another.
_UNWANTED = re.compile(
    "[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\u061c\u200e\u200f\u202a-\u202e\u2066-\u2069]"
)
NONE = "–"
"""Placeholder for a number that is missing."""
STREAMS: Mapping[str, str] = {
    topics.JOINT_STATES: "joint angles",
    topics.TORQUE_SENSORS: "torques on the arm",
    topics.COMMANDS: "torque commands",
    topics.PERTURBATION: "perturbation",
}


def plain(value: object) -> str:
    """Write a value as text of a page, with unwanted and impossible characters replaced."""
    possible = str(value).encode("utf-8", "replace").decode("utf-8")
    return _UNWANTED.sub("\N{REPLACEMENT CHARACTER}", possible)


def number(value: float, spec: str = ".4g", unit: str = "") -> str:
    """Write a number as `format` does, or a dash if it is not finite.

    A unit follows after a narrow space; the degree sign follows without a space.
    """
    if not math.isfinite(value):
        return NONE
    written = format(value, spec).replace("-", "−")
    if unit in ("", "°"):
        return f"{written}{unit}"
    return f"{written}\N{NARROW NO-BREAK SPACE}{unit}"


def percent(ratio: float, spec: str = ".2f") -> str:
    """Write a ratio as a percentage."""
    return number(100.0 * ratio, spec, "%")


def digits(error: float) -> str:
    """Format specification of numbers with this standard error, for two digits of that."""
    if not (math.isfinite(error) and error > 0.0):
        return ".5g"
    return f".{min(max(1 - math.floor(math.log10(error)), 0), 12)}f"


def uncertain(value: float, error: float) -> str:
    """Write an estimate with its standard error to two significant digits."""
    spec = digits(error)
    return f"{number(value, spec)} ± {number(error, spec) if spec != '.5g' else NONE}"


def difference(value: float, true: float) -> str:
    """Write the error of a value relative to the true one as a percentage."""
    return number(100.0 * (value / true - 1.0), "+.2f", "%") if true else NONE


def symbol(letter: str, *indices: object) -> Markup:
    """Write a symbol with its indices, which are 1-based."""
    below = Markup("<sub>{}</sub>").format("".join(map(str, indices))) if indices else ""
    return Markup("<var>{}</var>{}").format(plain(letter), below)


def code(value: object) -> Markup:
    """Mark up a name from files and programs as code."""
    return Markup("<code>{}</code>").format(plain(value))


def alarming(value: object) -> Markup:
    """Mark up a value so that it stands out as wrong."""
    return Markup('<strong class="beyond">{}</strong>').format(value)


def mark(met: bool) -> object:
    """Write whether a limit is met."""
    return "✓\N{NO-BREAK SPACE}within" if met else alarming("✗\N{NO-BREAK SPACE}beyond")


def written(value: object) -> str:
    """Write a value; numbers are rounded to seven digits, as nobody reads more."""
    if isinstance(value, float):
        return f"{value:.7g}"
    if isinstance(value, list):
        return ", ".join(written(item) for item in value) or "none"
    if value is None:
        return NONE
    if value == {}:
        return "none"
    return value if isinstance(value, str) else json.dumps(value)


def setting(config: Mapping[str, Any], *path: str) -> Any:
    """Look up a value in a configuration of any structure; None if it is not there."""
    found: Any = config
    for key in path:
        if not isinstance(found, Mapping) or key not in found:
            return None
        found = found[key]
    return found
