"""The gate through which every command passes, and the watchdog over the samples.

Comparisons are written so that a NaN fails them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armimp_common.compiled import compiled_entry
from armimp_common.errors import ConfigurationError

REFUSED = -1
"""Result of :func:`limit_torque` for a vector with a non-finite element."""


@dataclass(frozen=True, kw_only=True)
class SafetyConfig:
    """Limits of the gate.

    Parameters
    ----------
    torque_limit : largest commanded torque of any joint, N·m
    watchdog_ticks : periods without a sample after which torque is taken away; 1 to 100
    ramp_time : s within which the watchdog brings the torque to zero, at most 0.05

    Raises
    ------
    ConfigurationError
        If a value is out of range.
    """

    torque_limit: float = 80.0
    watchdog_ticks: int = 5
    ramp_time: float = 0.05

    def __post_init__(self) -> None:
        if not 0.0 < self.torque_limit < np.inf:
            raise ConfigurationError(
                f"safety: torque_limit must be positive and finite, got {self.torque_limit}"
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


@compiled_entry
def limit_torque(command: NDArray[np.float64], limit: float) -> int:
    """Clip a command in place.

    Parameters
    ----------
    command : (n,) N·m, changed
    limit : largest magnitude, N·m

    Returns
    -------
    int
        Number of elements clipped, or :data:`REFUSED` if any element is not finite, in which case
        the whole vector is set to zero: no part of it can be trusted.
    """
    for i in range(command.size):
        if not abs(command[i]) < np.inf:
            command[:] = 0.0
            return REFUSED
    clipped = 0
    for i in range(command.size):
        if not command[i] <= limit:
            command[i] = limit
            clipped += 1
        elif not command[i] >= -limit:
            command[i] = -limit
            clipped += 1
    return clipped


class Watchdog:
    """Tells for how long no sample came, and how much torque is still allowed.

    Time is any monotonic clock in seconds; the caller feeds it, so tests need not wait.

    Parameters
    ----------
    config : SafetyConfig
    period : of control, s
    """

    def __init__(self, config: SafetyConfig, *, period: float) -> None:
        self._patience = config.watchdog_ticks * period
        self._ramp = config.ramp_time
        self._last: float | None = None

    def feed(self, now: float) -> None:
        """A sample came at time ``now``, s."""
        self._last = now

    def expired(self, now: float) -> bool:
        """Whether samples have stayed away for too long (never before the first one)."""
        return self._last is not None and not now - self._last < self._patience

    def allowance(self, now: float) -> float:
        """Share of the last command still allowed, from 1 (fed) down to 0 at the ramp's end."""
        if self._last is None:
            return 0.0
        overdue = now - self._last - self._patience
        if overdue < 0.0:
            return 1.0
        return max(0.0, 1.0 - overdue / self._ramp) if self._ramp > 0.0 else 0.0
