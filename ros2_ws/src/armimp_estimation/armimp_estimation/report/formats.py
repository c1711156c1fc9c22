"""How numbers, symbols and streams are written in a report."""

from __future__ import annotations

import math
from collections.abc import Mapping

from armimp_common import contract
from armimp_estimation.report.html import Html, element, join

NONE = "–"
"""What stands for a number that is not there."""
UNITS: Mapping[str, str] = {"M": "kg·m²", "B": "N·m·s/rad", "K": "N·m/rad"}
NAMES: Mapping[str, str] = {"M": "Inertia", "B": "Viscosity", "K": "Stiffness"}
STREAMS: Mapping[str, str] = {
    contract.JOINT_STATES: "joint angles",
    contract.TORQUE_SENSORS: "torques on the arm",
    contract.COMMANDS: "torque commands",
    contract.PERTURBATION: "perturbation",
}


def number(value: float, spec: str = ".4g", unit: str = "") -> str:
    """Write a number; a dash for one that is not finite.

    Parameters
    ----------
    value : float
        The number.
    spec : str
        As for `format`.
    unit : str
        Follows after a narrow space, the sign for degrees without.
    """
    if not math.isfinite(value):
        return NONE
    written = format(value, spec).replace("-", "−")
    if unit in ("", "°"):
        return f"{written}{unit}"
    return f"{written}\N{NARROW NO-BREAK SPACE}{unit}"


def percent(ratio: float, spec: str = ".2f") -> str:
    """Write a ratio in per cent."""
    return number(100.0 * ratio, spec, "%")


def uncertain(value: float, error: float) -> str:
    """Write an estimate with its standard error, which gets two significant digits."""
    if not (math.isfinite(error) and error > 0.0):
        return f"{number(value, '.5g')} ± {NONE}"
    decimals = min(max(1 - math.floor(math.log10(error)), 0), 12)
    return f"{number(value, f'.{decimals}f')} ± {number(error, f'.{decimals}f')}"


def difference(value: float, true: float) -> str:
    """Write the error of a value relative to the true one, in per cent."""
    return number(100.0 * (value / true - 1.0), "+.2f", "%") if true else NONE


def symbol(letter: str, *indices: object) -> Html:
    """Write a symbol with its indices, which are 1-based."""
    below = element("sub", *indices) if indices else None
    return join([element("var", letter), below])


def code(value: object) -> Html:
    """Write a name as it is in files and programs."""
    return element("code", value)


def alarming(value: object) -> Html:
    """Set off what is not as it should be."""
    return element("strong", value, class_="beyond")
