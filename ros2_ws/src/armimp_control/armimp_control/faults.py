"""What the journal of the gate says, in words."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from armimp_control.safety import Limit
from armimp_control.safety_limiter import (
    BAD_COMMAND,
    BAD_PERTURBATION,
    BAD_POSITION,
    BAD_TORQUE,
    CLIPS,
    LIMIT_CAUSE,
    NO_CAUSE,
    OTHER_CAUSE,
    POSITION,
    POWER,
    RATE,
    TORQUE,
    VELOCITY,
)

_NOT_FINITE = {
    BAD_POSITION: "position",
    BAD_TORQUE: "torque reading",
    BAD_PERTURBATION: "perturbation",
    BAD_COMMAND: "torque from the control law for",
}
_SENTENCES = {
    POSITION: ("joint {joint} is {value:.4g} rad away from the posture", "{limit:g} rad"),
    VELOCITY: ("velocity of joint {joint} is {value:.4g} rad/s", "{limit:g} rad/s"),
    TORQUE: ("torque asked of joint {joint} is {value:.4g} N·m", "{limit:g} N·m"),
    RATE: ("torque asked of joint {joint} changes by {value:.4g} N·m in a tick", "{limit:g} N·m"),
    POWER: ("power asked of joint {joint} is {value:.4g} W", "{limit:g} W"),
}


def in_words(journal: NDArray[np.float64], place: int, rules: NDArray[np.float64]) -> str:
    """A cause with its joint (from 1), the offending value and the limit; empty if there is none.

    Parameters
    ----------
    journal, rules : of the gate, see :mod:`armimp_control.safety_limiter`
    place : ``FAULT`` or ``PRESENT`` of :mod:`armimp_control.safety_limiter`
    """
    cause, joint, value = int(journal[place]), int(journal[place + 1]), float(journal[place + 2])
    if cause in {NO_CAUSE, OTHER_CAUSE}:
        return ""
    if cause < LIMIT_CAUSE:
        what = _NOT_FINITE[cause]
        of = "" if what.endswith(" for") else " of"
        return f"{what}{of} joint {joint + 1} is not finite: {value}"
    number = cause - LIMIT_CAUSE
    said, limit = _SENTENCES[number]
    return (
        said.format(joint=joint + 1, value=value)
        + ", beyond the limit of "
        + limit.format(limit=rules[number, joint])
    )


def clip_counts(journal: NDArray[np.float64]) -> dict[Limit, int]:
    """Number of clipped joint commands for each limit."""
    return {limit: int(journal[CLIPS + i]) for i, limit in enumerate(Limit)}
