"""Encoders and torque transducers: what they read, when, and with which errors."""

from __future__ import annotations

from enum import Enum

import numpy as np
from pydantic import Field, field_validator

from armimp_common.compiled import compiled
from armimp_common.schema import Schema, Vector

ORDERS = 4
"""Highest order of the low-pass."""


class Sampling(str, Enum):
    """When the torque is read, relative to the command of the same tick."""

    BEFORE_UPDATE = "before_update"
    """Just before the new command takes effect: what a converter triggered by the tick sees."""
    INTERVAL_MEAN = "interval_mean"
    """Mean over the interval since the last sample: what an integrating converter sees."""


class ReadingParameters(Schema):
    """What stands between a signal and its reading, in this order; the same for both sensors.

    The signal passes a Butterworth low-pass and a delay, then gain and cross-talk, and hysteresis.
    Offset, drift, hum and noise are added, and the sum is clipped and rounded. Low-pass and delay
    act within the control period, on the grid of the integration.
    """

    resolution: float = Field(default=0.0, ge=0.0)
    """One count of the readings (rad, N·m); 0 for no rounding."""
    gain: Vector = (1.0,)
    """Factor on the readings (–); one value or one for each joint."""
    offset: Vector = (0.0,)
    """Offset of the readings (rad, N·m); one value or one for each joint."""
    drift: Vector = (0.0,)
    """Rate at which the offset of the readings grows from the start of the simulation on (rad/s,
    N·m/s); one value or one for each joint."""
    delay: float = Field(default=0.0, ge=0.0, le=0.1)
    """Delay of the readings (s), rounded to steps of the integration."""
    cutoff: float = Field(default=0.0, ge=0.0)
    """Cut-off frequency of the low-pass before the readings (Hz); 0 for none."""
    order: int = Field(default=1, ge=1, le=ORDERS)
    """Order of the Butterworth low-pass before the readings."""
    cross_talk: float = Field(default=0.0, ge=-0.5, le=0.5)
    """Share of the signal of every other joint that a reading shows (–)."""
    hysteresis: float = Field(default=0.0, ge=0.0)
    """Width by which the signal must turn back before the reading follows (rad, N·m)."""
    noise: float = Field(default=0.0, ge=0.0)
    """Rms of white noise on each reading (rad, N·m)."""
    hum: float = Field(default=0.0, ge=0.0)
    """Amplitude of the hum of the mains on readings (rad, N·m)."""
    hum_frequency: float = Field(default=50.0, gt=0.0, le=500.0)
    """Frequency of the hum (Hz)."""
    limit: float = Field(default=0.0, ge=0.0)
    """Largest absolute value of a reading, to which it is clipped (rad, N·m); 0 for none."""

    @field_validator("gain")
    @classmethod
    def _not_zero(cls, gain: Vector) -> Vector:
        if 0.0 in gain:
            raise ValueError("must not be 0")
        return gain

    @property
    def calibrated(self) -> bool:
        """Whether the gain is 1, and there is neither cross-talk nor hysteresis."""
        return set(self.gain) == {1.0} and not (self.cross_talk or self.hysteresis)


class SensorParameters(Schema):
    """Sensors of the rig."""

    sampling: Sampling = Sampling.BEFORE_UPDATE
    """Instant of the torque reading: before_update or interval_mean."""
    position: ReadingParameters = ReadingParameters()
    torque: ReadingParameters = ReadingParameters()


@compiled
def quantise(value: float, resolution: float) -> float:
    """Round ``value`` to the nearest multiple of ``resolution`` (0 leaves it as it is)."""
    return float(np.rint(value / resolution) * resolution) if resolution > 0.0 else value
