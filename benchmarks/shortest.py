"""The shortest of several times: it was disturbed least by other programs."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor


def shortest(work: Callable[[], object], repeats: int, threads: int = 1) -> float:
    """Shortest of several times in which each of the threads does the work once, s."""
    times = []
    with ThreadPoolExecutor(threads) as pool:
        for _ in range(repeats):
            began = time.perf_counter()
            list(pool.map(lambda _: work(), range(threads)))
            times.append(time.perf_counter() - began)
    return min(times)
