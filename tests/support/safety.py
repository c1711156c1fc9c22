"""Helpers for tests."""

from __future__ import annotations

from armimp_control.safety import SafetyConfig


def torque_only(limit: float) -> SafetyConfig:
    """A gate that limits the torque, N·m, and nothing else; what is not finite still stops it."""
    return SafetyConfig(
        position_limit=(1e300,),
        velocity_limit=(1e300,),
        torque_limit=limit,
        rate_limit=1e306,
        power_limit=1e306,
    )
