"""How much the machine was kept busy by others, of whom little can be seen from here.

A virtual processor mostly is a thread of a core whose other thread works for somebody else. Plain
Python then takes up to twice as long, though no other process of this machine runs. Besides, the
host may give the processor to others for a while, which the system counts as stolen time.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from statistics import median
from time import perf_counter

_ROUNDS = 10_000
_STEAL = 8
"""Place of the stolen time in the line of all processors."""


def loop_times(count: int = 100) -> list[float]:
    """Wall times of a short loop of plain Python, s; each takes about half a millisecond."""
    return [_loop() for _ in range(count)]


def disturbance(times: Sequence[float]) -> float:
    """How much longer than the fastest of :func:`loop_times` half of them took; 1 at best."""
    return median(times) / min(times)


def stolen_time(statistics: Path = Path("/proc/stat")) -> float:
    """Time since the start of the system for which the host took its processors away, s.

    Summed over the processors, see proc_stat(5); 0 where there is no such count.
    """
    try:
        fields = statistics.read_text(encoding="ascii").splitlines()[0].split()
        return int(fields[_STEAL]) / os.sysconf("SC_CLK_TCK")
    except (OSError, IndexError, ValueError):
        return 0.0


def _loop() -> float:
    began = perf_counter()
    total = 0
    for i in range(_ROUNDS):
        total += i * i
    return perf_counter() - began
