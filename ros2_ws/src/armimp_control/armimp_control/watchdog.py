"""The watchdog over the samples."""

from __future__ import annotations

from armimp_control.safety import SafetyConfig


class Watchdog:
    """Tells for how long no sample came, and how far the ramp to zero has to be by now.

    Time is any monotonic clock in seconds; the caller feeds it, so tests need not wait.

    Parameters
    ----------
    config : SafetyConfig
    slowest_tick : longest wall time that may count as one period, s
    period : L, the pace of the ramp, s
    """

    def __init__(self, config: SafetyConfig, *, slowest_tick: float, period: float) -> None:
        self._patience = config.watchdog_ticks * slowest_tick
        self._period = period
        self._longest = config.ramp_ticks(period)
        self._last: float | None = None
        self._told = 0

    def feed(self, now: float) -> None:
        """A sample came at time ``now``, s."""
        self._last = now
        self._told = 0

    def expired(self, now: float) -> bool:
        """Whether samples have stayed away for too long (never before the first one)."""
        return self._last is not None and not now - self._last < self._patience

    def ticks_due(self, now: float) -> int:
        """Ticks of the ramp that have become due since this was asked last.

        The first is due when patience ends; all are, where the clock tells nonsense.
        """
        if self._last is None or not self.expired(now):
            return 0
        overdue = (now - self._last - self._patience) / self._period
        due = min(int(overdue) + 1, self._longest) if overdue < self._longest else self._longest
        new = max(due - self._told, 0)
        self._told = max(due, self._told)
        return new
