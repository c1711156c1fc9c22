"""Tare of the torque transducers: their readings while the arm rests, before each trial.

All joints are held in the posture θ_0, where the arm has no elastic torque. What the transducers
read there is their offset, and the mean torque of the person's muscles, which is no answer to the
perturbation either. The law of the perturbed joint acts on the reading without it; otherwise an
offset c would hold that joint at a distance c/(K_rd + K_h) from θ_0. A drift is not followed within
a trial.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armimp_common.errors import ConfigurationError

FloatArray = NDArray[np.float64]

PARTS = 4
"""Parts of the readings whose scatter tells how sure the tare is."""


@dataclass(frozen=True, kw_only=True)
class TareConfig:
    """When a tare is taken, and which is accepted.

    Parameters
    ----------
    duration : of the readings, s; 0: no tare
    wait : before them, until the arm rests, s
    limit : largest tare of a joint, N·m
    noise : largest standard error of it, N·m

    Raises
    ------
    ConfigurationError
        If a value is out of range.
    """

    duration: float = 0.0
    wait: float = 0.5
    limit: float = 5.0
    noise: float = 0.05

    def __post_init__(self) -> None:
        # Each part has to be far longer than a period of what is to average out: dither, mains.
        if self.duration != 0.0 and not 0.4 <= self.duration <= 60.0:
            raise ConfigurationError(
                f"tare: duration must be 0, or between 0.4 and 60 s, got {self.duration} s"
            )
        if not 0.0 <= self.wait <= 60.0:
            raise ConfigurationError(f"tare: wait must be between 0 and 60 s, got {self.wait} s")
        for name in ("limit", "noise"):
            if not 0.0 < getattr(self, name) < np.inf:
                raise ConfigurationError(
                    f"tare: {name} must be positive, got {getattr(self, name)} N·m"
                )

    def ticks(self, period: float) -> int:
        """Ticks of waiting and reading together, 0 without a tare."""
        return round((self.wait + self.duration) / period) if self.duration else 0

    def of(self, torque: FloatArray, period: float) -> Tare:
        """Tare from the readings (n, ticks) while all joints were held, N·m."""
        return tare(torque[:, round(self.wait / period) :])


@dataclass(frozen=True, kw_only=True)
class Tare:
    """Offsets of the transducers.

    Attributes
    ----------
    offset : of each joint, N·m
    error : standard error of each, N·m
    """

    offset: tuple[float, ...]
    error: tuple[float, ...]

    def refusal(self, config: TareConfig, names: Sequence[str]) -> str:
        """Why no trial may begin with this tare, in words; else empty."""
        for name, offset, error in zip(names, self.offset, self.error, strict=True):
            # Written so that NaN fails.
            if not abs(offset) <= config.limit:
                return (
                    f"tare: the torque of {name} reads {offset:.3g} N·m at rest, "
                    f"tare.limit is {config.limit:g} N·m"
                )
            if not error <= config.noise:
                return (
                    f"tare: the torque of {name} does not rest: {offset:.3g} ± {error:.2g} N·m, "
                    f"tare.noise is {config.noise:g} N·m"
                )
        return ""


def tare(torque: FloatArray) -> Tare:
    """Mean readings at rest, and how sure they are.

    The readings are cut into :data:`PARTS` of equal length. Of each the mean is taken with a Hann
    window, which the dither of held joints and mains hum do not pass. The tare is the mean of
    these; its standard error comes from their scatter, so it also shows slow unrest and drift.

    Parameters
    ----------
    torque : (n, ticks) N·m
    """
    length = torque.shape[1] // PARTS
    parts = torque[:, torque.shape[1] - PARTS * length :].reshape(len(torque), PARTS, length)
    window = 0.5 - 0.5 * np.cos(2.0 * np.pi * (np.arange(length) + 0.5) / length)
    means = np.sum(parts * window, axis=2) / np.sum(window)
    error = np.std(means, axis=1, ddof=1) / np.sqrt(PARTS)
    return Tare(
        offset=tuple(means.mean(axis=1).tolist()),
        error=tuple(error.tolist()),
    )
