"""Where the parameters of a simulated experiment come from: from the paper, or assumed."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Any

from armimp_estimation.report.result import setting

ASSUMPTION = "assumption"
DESIGN = "study design"
CHOSEN = "set for this run"
_TABLE_I = {
    1: "paper, Table I, elbow",
    2: "paper, Table I",
    3: f"paper, Table I; wrist: {ASSUMPTION}",
}
_TABLE_III = {
    1: "paper, Table III, elbow",
    2: "paper, Table III",
    3: f"paper, Table III; wrist: {ASSUMPTION}",
}
"""By the number of joints; for more of them, all is assumed."""

_ORIGINS: tuple[tuple[str, str | Mapping[int, str]], ...] = (
    (r"arm\.", _TABLE_I),
    (r"robot\.|friction\.", ASSUMPTION),
    (r"sensors\..*_resolution", "paper, Table II"),
    (r"sensors\.|actuators\.|substeps|perturbation\.(cutoff|order)", DESIGN),
    (r"perturbation\.peak", _TABLE_III),
    (r"law\.kind", "paper: imbic"),
    (r"voluntary\.|target\.|law\.|safety\.|tare\.|sequence\.(settle|rest)", ASSUMPTION),
    (r"known\.", "as simulated"),
    (r"sequence\.duration", "paper: 50 s"),
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
    for pattern, source in _ORIGINS:
        if re.match(pattern, name):
            joints = setting(config, "experiment", "joints")
            return source if isinstance(source, str) else source.get(joints, ASSUMPTION)
    return ""


def assumptions(config: Mapping[str, Any], *, friction: str | None = None) -> list[tuple[str, str]]:
    """What the simulation assumes, as title and explanation; empty for anything else.

    Parameters
    ----------
    config : mapping
        Configuration of a result, of any form.
    friction : str, optional
        Levels of friction in words, if it is not that of the configuration alone.
    """
    if setting(config, "experiment") is None or setting(config, "arm_sim") is None:
        return []
    levels = friction or f"level {setting(config, 'experiment', 'friction')}"
    found = [
        (
            "Friction",
            f"LuGre friction of {levels}. The paper cites a source for its values but does "
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
            f"Sensors have {_of_sensors(config)} but no other noise. The arm is linear about its "
            "posture, relaxed, and strapped in without play.",
        ),
    ]
    joints = setting(config, "experiment", "joints")
    if joints == 3:
        wrist = "All values of the wrist, and the couplings with it, are chosen."
        found.insert(0, ("Third joint", f"The paper's arm has two joints. {wrist}"))
    elif isinstance(joints, int) and joints > 3:
        chain = "All values of this arm and its robot, and the size of its drives, are chosen."
        found.insert(0, ("Arm", f"The paper's arm has two joints. {chain}"))
    return found


_IMPERFECTIONS = {
    "sensors.torque_offset": "an offset",
    "sensors.torque_drift": "drift",
    "sensors.torque_gain": "a wrong gain",
    "sensors.torque_delay": "a delay",
    "sensors.torque_cutoff": "a low-pass",
}


def _of_sensors(config: Mapping[str, Any]) -> str:
    """What the simulated sensors have, in words."""
    words = ["a resolution"]
    for name, what in _IMPERFECTIONS.items():
        value = setting(config, "arm_sim", name)
        neutral = 1.0 if name == "sensors.torque_gain" else 0.0
        values = value if isinstance(value, list) else [value]
        if any(one not in (None, neutral) for one in values):
            words.append(what)
    return ", ".join(words[:-1]) + " and " + words[-1] if len(words) > 1 else words[0]


def _dotted(values: object, prefix: str = "") -> Iterator[str]:
    if isinstance(values, Mapping):
        for name, value in values.items():
            yield f"{prefix}{name}"
            yield from _dotted(value, f"{prefix}{name}.")
