"""Encoders and torque transducers: resolution and sampling instant."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np

from armimp_common.compiled import compiled
from armimp_common.errors import ConfigurationError


class Sampling(str, Enum):
    """When the torque is read, relative to the command of the same tick."""

    BEFORE_UPDATE = "before_update"
    """Just before the new command takes effect: what a converter triggered by the tick sees."""
    INTERVAL_MEAN = "interval_mean"
    """Mean over the interval since the last sample: what an integrating converter sees."""


@dataclass(frozen=True, kw_only=True)
class Sensors:
    """Resolution of the readings; 0 leaves them unquantised.

    Parameters
    ----------
    encoder_resolution : rad per count
    torque_resolution : N·m per count
    sampling : instant of the torque reading

    Raises
    ------
    ConfigurationError
        If a resolution is negative or not finite.
    """

    encoder_resolution: float
    torque_resolution: float
    sampling: Sampling = Sampling.BEFORE_UPDATE

    def __post_init__(self) -> None:
        for name in ("encoder_resolution", "torque_resolution"):
            value = getattr(self, name)
            if not 0.0 <= value < np.inf:
                raise ConfigurationError(f"sensors: {name} must not be negative, got {value}")


@compiled
def quantise(value: float, resolution: float) -> float:
    """``value`` rounded to the nearest multiple of ``resolution`` (0 leaves it as it is)."""
    return float(np.rint(value / resolution) * resolution) if resolution > 0.0 else value
