"""Drives: what becomes of a command before it is a torque on the joint."""

from __future__ import annotations

import math

from pydantic import Field, field_validator

from armimp_common.schema import Schema

_SLOWEST = 2.0


class ActuatorParameters(Schema):
    """Drives, all alike: a command is late, limited, and followed by a current loop.

    On the torque of the loop come ripple, in proportion to it, and cogging, both by the angle of
    the joint.
    """

    bandwidth: float = Field(default=0.0, ge=0.0, le=1e5)
    """Bandwidth of the current loop of the drives, of first order (Hz); 0 for no lag at all."""
    delay: float = Field(default=0.0, ge=0.0, le=0.02)
    """Delay with which commands act (s), rounded to steps of the integration."""
    limit: float = Field(default=0.0, ge=0.0)
    """Largest torque of a drive (N·m); 0 for no limit."""
    ripple: float = Field(default=0.0, ge=0.0, lt=1.0)
    """Amplitude of the torque ripple as a share of the torque of the drive (–)."""
    ripple_cycles: float = Field(default=60.0, gt=0.0)
    """Periods of the torque ripple in a turn of the joint (–)."""
    cogging: float = Field(default=0.0, ge=0.0)
    """Amplitude of the cogging torque of a drive (N·m)."""
    cogging_cycles: float = Field(default=120.0, gt=0.0)
    """Periods of the cogging in a turn of the joint (–)."""

    @field_validator("bandwidth")
    @classmethod
    def _not_slower_than_any_drive(cls, bandwidth: float) -> float:
        if 0.0 < bandwidth < _SLOWEST:
            raise ValueError(f"must be 0 or at least {_SLOWEST:g}")
        return bandwidth

    @property
    def lag(self) -> float:
        """Time constant of the current loop, s; 0 for none."""
        return 1.0 / (2.0 * math.pi * self.bandwidth) if self.bandwidth else 0.0

    @property
    def direct(self) -> bool:
        """Whether the torque on the joint is what is commanded."""
        return not any((self.bandwidth, self.delay, self.limit, self.ripple, self.cogging))
