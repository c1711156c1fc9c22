"""Statistics of timing in real time: how regular samples were, and how quickly they were answered.

All durations go in as integer nanoseconds and come out in seconds.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Mapping
from dataclasses import dataclass, fields
from itertools import accumulate
from typing import Final

from armimp_common.contract import NS_PER_S, PERIOD_NS, SIM_NODE
from armimp_common.errors import ConfigurationError, MalformedMessageError

TIMING_NAME: Final = f"{SIM_NODE}: timing"
"""``name`` of the status on ``/diagnostics`` that carries the figures."""

LATE_NS: Final = PERIOD_NS // 4
"""A sample is late if it is sent more than this after its deadline, ns."""

_COUNTS: Final = ("ticks", "late", "missed")
_FINEST_NS: Final = 1000
_WIDTH: Final = math.log(1.02)
_BINS: Final = 1000
"""Durations are counted in bins 2 % wide, from one microsecond to minutes; the last has no end."""


class Spread:
    """Distribution of durations, in memory that does not grow with their number.

    Attributes
    ----------
    count : number of durations
    """

    def __init__(self) -> None:
        self._bins = [0] * _BINS
        self._longest_ns = 0
        self.count = 0

    def add(self, duration_ns: int) -> None:
        """Count a duration, ns; one below zero counts as zero."""
        place = 0
        if duration_ns > _FINEST_NS:
            place = min(math.ceil(math.log(duration_ns / _FINEST_NS) / _WIDTH), _BINS - 1)
        self._bins[place] += 1
        self._longest_ns = max(self._longest_ns, duration_ns)
        self.count += 1

    def quantile(self, share: float) -> float:
        """Duration (s) that this share of all durations does not exceed, rounded up by at most 2 %.

        It is the smallest end of a bin up to which there are ``share · count`` durations, and
        never longer than the longest. NaN if there is none.
        """
        if not self.count:
            return math.nan
        up_to = list(accumulate(self._bins))
        place = bisect_left(up_to, max(share * self.count, 1.0))
        if place == _BINS - 1:
            return self.longest
        return min(_FINEST_NS * math.exp(place * _WIDTH), self._longest_ns) / NS_PER_S

    @property
    def longest(self) -> float:
        """The longest duration, s; exact. NaN if there is none."""
        return self._longest_ns / NS_PER_S if self.count else math.nan


@dataclass(frozen=True, kw_only=True)
class TimingFigures:
    """What was measured from the first sample on.

    Parameters
    ----------
    ticks : int
        Samples sent.
    late : int
        Those sent more than :data:`LATE_NS` after their deadline.
    missed : int
        Periods for which the command did not come in time, so that the last one was held.
    period_p50, period_p99, period_max : float
        Median, 99 % quantile and maximum of the time from one sample to the next, s.
    latency_p50, latency_p99, latency_max : float
        The same of the time from a sample to the command that answers it, both at the rig, s.

    Raises
    ------
    ConfigurationError
        If a count is negative or larger than the number of samples.
    """

    ticks: int
    late: int
    missed: int
    period_p50: float = math.nan
    period_p99: float = math.nan
    period_max: float = math.nan
    latency_p50: float = math.nan
    latency_p99: float = math.nan
    latency_max: float = math.nan

    def __post_init__(self) -> None:
        for name in _COUNTS:
            if not 0 <= getattr(self, name) <= self.ticks:
                raise ConfigurationError(
                    f"timing: {name} must lie between 0 and the number of samples, {self.ticks}, "
                    f"got {getattr(self, name)}"
                )

    @property
    def late_share(self) -> float:
        """Share of the samples that were late, from 0 to 1."""
        return self.late / self.ticks if self.ticks else 0.0

    @property
    def missed_share(self) -> float:
        """Share of the periods without a command in time, from 0 to 1."""
        return self.missed / self.ticks if self.ticks else 0.0

    def to_values(self) -> dict[str, int | float]:
        """Return the figures by name."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    @classmethod
    def from_values(cls, values: Mapping[str, str]) -> TimingFigures:
        """Rebuild figures from the key-values of a status; keys that are not known are ignored.

        Raises
        ------
        MalformedMessageError
            If one is missing, cannot be parsed, or contradicts another.
        """
        try:
            counts = {name: int(values[name]) for name in _COUNTS}
            return cls(
                **counts,
                period_p50=float(values["period_p50"]),
                period_p99=float(values["period_p99"]),
                period_max=float(values["period_max"]),
                latency_p50=float(values["latency_p50"]),
                latency_p99=float(values["latency_p99"]),
                latency_max=float(values["latency_max"]),
            )
        except KeyError as error:
            raise MalformedMessageError(f"timing: {error.args[0]} is missing") from None
        except (ValueError, ConfigurationError) as error:
            raise MalformedMessageError(f"timing: {error}") from None


class TimingLedger:
    """Measures the timing of a rig: told when samples leave, and when commands come back.

    Commands carry no stamp, so they are matched to samples by counting, as everywhere.
    """

    def __init__(self) -> None:
        self._period, self._latency = Spread(), Spread()
        self._last_ns: int | None = None
        self._ticks = self._late = self._missed = 0

    def sent(self, deadline_ns: int, sent_ns: int) -> None:
        """A sample that was due at a time was sent, ns."""
        self._ticks += 1
        self._late += sent_ns - deadline_ns > LATE_NS
        if self._last_ns is not None:
            self._period.add(sent_ns - self._last_ns)
        self._last_ns = sent_ns

    def answered(self, latency_ns: int) -> None:
        """A command came so long after its sample, ns."""
        self._latency.add(latency_ns)

    def missed(self) -> None:
        """A period began without the command that was meant for it."""
        self._missed += 1

    def figures(self) -> TimingFigures:
        """Return the figures so far."""
        return TimingFigures(
            ticks=self._ticks,
            late=self._late,
            # A gap may leave out more periods than samples were sent so far.
            missed=min(self._missed, self._ticks),
            period_p50=self._period.quantile(0.5),
            period_p99=self._period.quantile(0.99),
            period_max=self._period.longest,
            latency_p50=self._latency.quantile(0.5),
            latency_p99=self._latency.quantile(0.99),
            latency_max=self._latency.longest,
        )


@dataclass(frozen=True, kw_only=True)
class TimingLimits:
    """Limits beyond which a run in real time is not valid.

    Parameters
    ----------
    max_late_share : float
        Largest share of late samples, from 0 to 1.
    max_missed_share : float
        Largest share of periods for which the command did not come in time.
    max_latency : float
        Largest 99 % quantile of the time from a sample to its command, s.
    """

    max_late_share: float = 0.01
    max_missed_share: float = 0.01
    max_latency: float = 0.001


def judge_timing(figures: TimingFigures, limits: TimingLimits) -> list[str]:
    """Problems with the timing of a run, in words; comparisons are written so that NaN fails."""
    problems = []
    for what, count, share, limit in (
        (
            f"samples were sent more than {LATE_NS / 1e6:g} ms late",
            figures.late,
            figures.late_share,
            limits.max_late_share,
        ),
        (
            "commands did not come in time",
            figures.missed,
            figures.missed_share,
            limits.max_missed_share,
        ),
    ):
        if not share <= limit:
            problems.append(
                f"real time: {count} of {figures.ticks} {what}, {100 * share:.3g} % "
                f"(limit {100 * limit:.3g} %)"
            )
    if not figures.latency_p99 <= limits.max_latency:
        problems.append(
            "real time: the 99 % quantile of the time from a sample to its command is "
            f"{1e3 * figures.latency_p99:.3g} ms (limit {1e3 * limits.max_latency:.3g} ms)"
        )
    return problems
