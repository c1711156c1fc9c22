"""Helpers for tests."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from armimp_control.safety_limiter import SafetyParameters


def torque_only(limit: float) -> SafetyParameters:
    """A limiter of the torque, N·m, and of nothing else; what is not finite still stops it."""
    return SafetyParameters(
        position_limit=(1e300,),
        velocity_limit=(1e300,),
        torque_limit=limit,
        rate_limit=1e306,
        power_limit=1e306,
    )


def within_torque(command: NDArray[np.float64], limit: float) -> NDArray[np.float64]:
    """What is left of a command (n,), N·m, that asks some joint for more than the limit."""
    share = max(1.0, float(np.max(np.abs(command))) / limit)
    return np.asarray(command / share)
