"""Helpers for tests."""

from __future__ import annotations

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
