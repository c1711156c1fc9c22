"""Where in a trial commands were clipped: how many, and a bounded list of intervals."""

from __future__ import annotations

import itertools

LONGEST_LIST = 100
"""Most intervals that are kept."""


class SaturationCounter:
    """Counts clipped joint commands, and remembers the ticks in which that happened.

    The intervals hold every clipped tick. They hold others too only where there would be more than
    :data:`LONGEST_LIST`: then the two that are nearest to each other become one, the earliest of
    equals.
    """

    def __init__(self) -> None:
        self.clipped = 0
        self._intervals: list[tuple[int, int]] = []

    def add(self, tick: int, clipped: int) -> None:
        """``clipped`` joint commands were clipped in a tick; ticks come in increasing order."""
        if clipped <= 0:
            return
        self.clipped += clipped
        intervals = self._intervals
        if intervals and tick <= intervals[-1][1] + 1:
            intervals[-1] = intervals[-1][0], tick
            return
        intervals.append((tick, tick))
        if len(intervals) > LONGEST_LIST:
            gaps = [later[0] - one[1] for one, later in itertools.pairwise(intervals)]
            nearest = gaps.index(min(gaps))
            intervals[nearest : nearest + 2] = [(intervals[nearest][0], intervals[nearest + 1][1])]

    @property
    def text(self) -> str:
        """First and last tick of each interval: ``10-12 20-20``; in order, without overlap."""
        return " ".join(f"{first}-{last}" for first, last in self._intervals)
