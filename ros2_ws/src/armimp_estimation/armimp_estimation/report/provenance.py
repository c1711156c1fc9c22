"""Where the parameters of a simulated experiment come from: from the paper, or assumed."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Any

from armimp_estimation.report.result import setting

ASSUMPTION = "assumption"
DESIGN = "study design"
CHOSEN = "set for this run"
_THIRD = "paper, Table I, for two joints; third joint: assumption"
_PEAK = "paper, Table III, for two joints; third joint: assumption"

_ORIGINS: tuple[tuple[str, str, str], ...] = (
    # Parameter; origin for two joints; for more.
    (r"arm\.", "paper, Table I", _THIRD),
    (r"robot\.", ASSUMPTION, ASSUMPTION),
    (r"friction\.", ASSUMPTION, ASSUMPTION),
    (r"sensors\..*_resolution", "paper, Table II", "paper, Table II"),
    (r"sensors\.|substeps|perturbation\.(cutoff|order)", DESIGN, DESIGN),
    (r"perturbation\.peak", "paper, Table III", _PEAK),
    (r"voluntary\.|target\.|law\.|safety\.|sequence\.(settle|rest)", ASSUMPTION, ASSUMPTION),
    (r"known\.", "as simulated", "as simulated"),
    (r"sequence\.duration", "paper: 50 s", "paper: 50 s"),
)


def origin(config: Mapping[str, Any], node: str, name: str) -> str:
    """Where a parameter comes from; empty if that is not known.

    Parameters
    ----------
    config : mapping
        Configuration of a result, of any form.
    node, name : str
        The parameter, by its dotted name.
    """
    if setting(config, "experiment") is None:
        return ""
    if name in set(_dotted(setting(config, "experiment", node))):
        return CHOSEN
    two = setting(config, "experiment", "joints") == 2
    for pattern, for_two, for_more in _ORIGINS:
        if re.match(pattern, name):
            return for_two if two else for_more
    return ""


def assumptions(config: Mapping[str, Any]) -> list[tuple[str, str]]:
    """What the simulation assumes, as title and explanation; empty for anything else."""
    if setting(config, "experiment") is None or setting(config, "arm_sim") is None:
        return []
    level = setting(config, "experiment", "friction")
    found = [
        (
            "Friction",
            f"LuGre friction of level {level}. The paper cites a source for its values but does "
            "not state them.",
        ),
        (
            "Robot inertia",
            "Link lengths, masses and moments are chosen to give an endpoint mass of about 1 kg.",
        ),
        (
            "Controller gains",
            "Target impedance, stiffness of the locked joints, internal model and velocity "
            "feedback gain are chosen; the paper does not state them.",
        ),
        (
            "Sensors and arm",
            "Sensors have a resolution but no other noise. The arm is linear about its posture, "
            "relaxed, and strapped in without play.",
        ),
    ]
    if setting(config, "experiment", "joints") == 3:
        found.insert(
            0,
            (
                "Third joint",
                "The paper's arm has two joints. All values of the wrist, and the couplings with "
                "it, are chosen.",
            ),
        )
    return found


def _dotted(values: object, prefix: str = "") -> Iterator[str]:
    if isinstance(values, Mapping):
        for name, value in values.items():
            yield f"{prefix}{name}"
            yield from _dotted(value, f"{prefix}{name}.")
