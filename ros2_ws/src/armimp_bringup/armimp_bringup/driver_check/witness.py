"""A witness of the machine: whether this process was held up itself when something seemed late."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armimp_common.realtime import LATE_NS, Pacer, wake_up_exactly
from armimp_common.topics import PERIOD_NS


@dataclass(frozen=True, kw_only=True, eq=False)
class Stalls:
    """Times in which this process was held up, on the monotonic clock.

    Attributes
    ----------
    begin_ns, end_ns : (N,) from when to when, in order (ns)
    watched_ns : how long was watched (ns)
    """

    begin_ns: NDArray[np.int64]
    end_ns: NDArray[np.int64]
    watched_ns: int = 0

    @property
    def share(self) -> float:
        """Share of the time in which this process was held up."""
        lost = int(np.sum(self.end_ns - self.begin_ns))
        return lost / self.watched_ns if self.watched_ns else 0.0

    @property
    def longest(self) -> float:
        """Longest stall, s."""
        return float(np.max(self.end_ns - self.begin_ns, initial=0)) / 1e9

    def excuse(
        self, arrivals_ns: NDArray[np.int64], delay: NDArray[np.float64]
    ) -> NDArray[np.bool_]:
        """Tell of each arrival (N,) whether there was a stall while it was late.

        Parameters
        ----------
        arrivals_ns : (N,) when they came (ns)
        delay : (N,) how late that was (s)
        """
        due_ns = arrivals_ns - np.rint(1e9 * np.maximum(delay, 0.0)).astype(np.int64)
        # Stalls do not overlap, so both of their ends are sorted.
        first = np.searchsorted(self.end_ns, due_ns, side="left")
        last = np.searchsorted(self.begin_ns, arrivals_ns, side="right")
        found: NDArray[np.bool_] = last > first
        return found


def stalls(intervals: Sequence[tuple[int, int]] = (), watched_ns: int = 0) -> Stalls:
    """Return stalls from pairs of their begin and end, ns."""
    table = np.array(list(intervals), dtype=np.int64).reshape(-1, 2)
    return Stalls(begin_ns=table[:, 0], end_ns=table[:, 1], watched_ns=watched_ns)


class Witness:
    """A thread that wants to wake up each millisecond, and notes when it could not."""

    def __init__(self) -> None:
        self._found: list[tuple[int, int]] = []
        self._ended = threading.Event()
        self._pacer = Pacer(PERIOD_NS)
        self._begin_ns = self._pacer.now()
        self._thread = threading.Thread(target=self._run, name="witness", daemon=True)
        self._thread.start()

    def _run(self) -> None:
        wake_up_exactly()
        pacer, tick = self._pacer, 0
        pacer.start()
        while not self._ended.is_set():
            tick += 1
            due_ns = pacer.deadline_ns(tick)
            pacer.wait(tick)
            now_ns = pacer.now()
            if now_ns - due_ns > LATE_NS:
                self._found.append((due_ns, now_ns))
                # Deadlines that passed meanwhile belong to the same stall.
                tick += (now_ns - due_ns) // PERIOD_NS

    def stalls(self) -> Stalls:
        """Return what was noted so far."""
        return stalls(self._found, self._pacer.now() - self._begin_ns)

    def close(self) -> None:
        """Watch no more."""
        self._ended.set()
        self._thread.join()
