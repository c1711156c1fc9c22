"""Limits of the safety gate, what is done beyond them, and the numbers that compiled code needs."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from armimp_common.errors import ConfigurationError
from armimp_control.safety_limiter import CENTRE, RAMP, RATE, RULE_ROWS, STOPS


class Action(str, Enum):
    """What the gate does with a command beyond a limit."""

    CLIP = "clip"
    STOP = "stop"


class Limit(str, Enum):
    """What the gate limits; in the order of the numbers in :mod:`armimp_control.safety_limiter`."""

    POSITION = "position"
    VELOCITY = "velocity"
    TORQUE = "torque"
    RATE = "rate"
    POWER = "power"


@dataclass(frozen=True, kw_only=True)
class SafetyConfig:
    """Limits of the gate, and the patience of the watchdog.

    Limits that differ between joints are tuples with one value for all joints or one per joint.

    Parameters
    ----------
    position_limit : largest distance from the posture θ_rd, rad
    velocity_limit : largest speed over :data:`armimp_control.safety_limiter.WINDOW` ticks, rad/s
    torque_limit : largest commanded torque of any joint, N·m
    rate_limit : largest change of the command from tick to tick, N·m/s
    power_limit : largest |τ·θ̇| of a joint, W
    position_action, velocity_action, torque_action, rate_action, power_action : Action
    watchdog_ticks : periods without a sample after which torque is taken away; 1 to 100
    ramp_time : s within which a stop brings the torque to zero, at most 0.05. Short by default: the
        ramp begins at the last command, which may be a peak of chatter, and would push on with it

    Raises
    ------
    ConfigurationError
        If a value is out of range, or the rate limit does not let the ramp end in time.
    """

    position_limit: tuple[float, ...] = (0.5,)
    velocity_limit: tuple[float, ...] = (4.0,)
    torque_limit: float = 80.0
    rate_limit: float = 150e3
    power_limit: float = 200.0
    position_action: Action = Action.STOP
    velocity_action: Action = Action.STOP
    torque_action: Action = Action.CLIP
    rate_action: Action = Action.CLIP
    power_action: Action = Action.CLIP
    watchdog_ticks: int = 5
    ramp_time: float = 0.01

    def __post_init__(self) -> None:
        for limit in Limit:
            for value in self._values(limit):
                if not 0.0 < value < math.inf:
                    raise ConfigurationError(
                        f"safety: {limit.value}_limit must be positive and finite, got {value}"
                    )
        # Endless patience would be a watchdog switched off.
        if not 1 <= self.watchdog_ticks <= 100:
            raise ConfigurationError(
                "safety: the watchdog can't be switched off: watchdog_ticks must be 1 to 100, "
                f"got {self.watchdog_ticks}"
            )
        if not 0.0 <= self.ramp_time <= 0.05:
            raise ConfigurationError(
                f"safety: ramp_time must lie between 0 and 0.05 s, got {self.ramp_time}"
            )

    def _values(self, limit: Limit) -> tuple[float, ...]:
        value: float | tuple[float, ...] = getattr(self, f"{limit.value}_limit")
        return value if isinstance(value, tuple) else (value,)

    def ramp_ticks(self, period: float) -> int:
        """Ticks in which a stop brings the torque to zero; the first is that of the stop itself.

        Parameters
        ----------
        period : L, s
        """
        return max(math.floor(self.ramp_time / period + 1e-9), 1)

    def rules(self, posture: NDArray[np.float64], period: float) -> NDArray[np.float64]:
        """What compiled code needs, (RULE_ROWS, n), as :mod:`armimp_control.safety_limiter` has it.

        Parameters
        ----------
        posture : (n,) θ_rd, from which positions are counted, rad
        period : L, s

        Raises
        ------
        ConfigurationError
            If the number of values does not fit the number of joints, or a stop could not bring
            the torque to zero in time without a step larger than the rate limit.
        """
        n, ticks = posture.size, self.ramp_ticks(period)
        rows = np.empty((RULE_ROWS, n))
        for i, limit in enumerate(Limit):
            values = self._values(limit)
            if len(values) not in {1, n}:
                raise ConfigurationError(
                    f"safety: {limit.value}_limit has {len(values)} values, needs 1 or {n}: "
                    f"{list(values)}"
                )
            rows[i] = values
            rows[STOPS + i] = getattr(self, f"{limit.value}_action") is Action.STOP
        rows[RATE] *= period
        rows[CENTRE] = posture
        rows[RAMP] = ticks
        if not self.rate_limit * period * ticks >= self.torque_limit:
            raise ConfigurationError(
                f"safety: with rate_limit {self.rate_limit} N·m/s a stop can't bring torque_limit "
                f"{self.torque_limit} N·m to zero within {ticks * period:g} s"
            )
        return rows
