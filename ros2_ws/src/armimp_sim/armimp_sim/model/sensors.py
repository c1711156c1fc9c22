"""Encoders and torque transducers: what they read, when, and what they make of it."""

from __future__ import annotations

from enum import Enum

import numpy as np
from pydantic import Field, field_validator

from armimp_common.compiled import compiled
from armimp_common.errors import ConfigurationError
from armimp_common.schema import Schema

Vector = tuple[float, ...]

ORDERS = 4
"""Highest order of the low-pass."""


class Sampling(str, Enum):
    """When the torque is read, relative to the command of the same tick."""

    BEFORE_UPDATE = "before_update"
    """Just before the new command takes effect: what a converter triggered by the tick sees."""
    INTERVAL_MEAN = "interval_mean"
    """Mean over the interval since the last sample: what an integrating converter sees."""


class SensorParameters(Schema):
    """Sensors of the rig.

    The torque on the arm passes a Butterworth low-pass, is read late, and the reading is
    ``gain · τ + offset + drift · t``, which is then rounded. Filter and delay act within the
    control period, on the grid of the integration.
    """

    encoder_resolution: float = Field(
        default=0.0, ge=0.0, description="one count of the encoders (rad); 0 for no rounding"
    )
    torque_resolution: float = Field(
        default=0.0,
        ge=0.0,
        description="one count of the torque transducers (N·m); 0 for no rounding",
    )
    sampling: Sampling = Field(
        default=Sampling.BEFORE_UPDATE,
        description="instant of the torque reading: before_update or interval_mean",
    )
    torque_offset: Vector = Field(
        default=(0.0,),
        description="offset added to torque readings (N·m); one value for all joints or one for "
        "each",
    )
    torque_drift: Vector = Field(
        default=(0.0,),
        description="speed with which the offset of torque readings grows from the start of the "
        "simulation on (N·m/s); one value for all joints or one for each",
    )
    torque_gain: Vector = Field(
        default=(1.0,),
        description="factor on torque readings (–); one value for all joints or one for each",
    )
    torque_delay: float = Field(
        default=0.0,
        ge=0.0,
        le=0.1,
        description="delay of torque readings (s), rounded to steps of the integration",
    )
    torque_cutoff: float = Field(
        default=0.0,
        ge=0.0,
        description="cut-off frequency of the anti-alias low-pass of the torque (Hz); 0 for none",
    )
    torque_order: int = Field(
        default=1,
        ge=1,
        le=ORDERS,
        description="order of the Butterworth low-pass of the torque",
    )

    @field_validator("torque_gain")
    @classmethod
    def _not_zero(cls, gain: Vector) -> Vector:
        if 0.0 in gain:
            raise ValueError("must not be 0")
        return gain

    @property
    def direct(self) -> bool:
        """Whether readings are the torque on the arm, but for rounding."""
        return (
            not any(self.torque_offset)
            and not any(self.torque_drift)
            and set(self.torque_gain) == {1.0}
            and not (self.torque_delay or self.torque_cutoff)
        )

    def check(self, joints: int) -> None:
        """Check that the vectors fit so many joints.

        Raises
        ------
        ConfigurationError
            If one does not; the message carries the numbers.
        """
        for name in ("torque_offset", "torque_drift", "torque_gain"):
            count = len(getattr(self, name))
            if count not in (1, joints):
                raise ConfigurationError(f"sensors: {name} has {count} values, needs 1 or {joints}")


@compiled
def quantise(value: float, resolution: float) -> float:
    """``value`` rounded to the nearest multiple of ``resolution`` (0 leaves it as it is)."""
    return float(np.rint(value / resolution) * resolution) if resolution > 0.0 else value
