"""How much other work disturbed this machine, most of which cannot be seen from within it.

A virtual processor mostly is a thread of a core whose other thread works for somebody else. Plain
Python then takes up to twice as long, though no other process runs on this machine. Besides, the
host may give the processor to others for a while, which the system counts as stolen time.
"""

from __future__ import annotations

from collections.abc import Sequence
from statistics import median
from time import perf_counter

import psutil

_ROUNDS = 10_000


def loop_times(count: int = 100) -> list[float]:
    """Wall times of a short loop of plain Python, s; each takes about half a millisecond."""
    return [_loop() for _ in range(count)]


def disturbance(times: Sequence[float]) -> float:
    """Median over minimum of :func:`loop_times`; 1 at best."""
    return median(times) / min(times)


def stolen_time() -> float:
    """Time since the start of the system for which the host took its processors away, s.

    Summed over the processors.
    """
    return float(psutil.cpu_times().steal)


def _loop() -> float:
    began = perf_counter()
    total = 0
    for i in range(_ROUNDS):
        total += i * i
    return perf_counter() - began
