"""A study in threads of the test, which need not start."""

from concurrent.futures import ThreadPoolExecutor
from functools import partial

from armimp_bringup.study.engine import Backend


def threads(workers: int) -> Backend:
    """So many threads."""
    pool = ThreadPoolExecutor(workers)
    close = partial(pool.shutdown, wait=False, cancel_futures=True)
    return Backend(pool=pool, workers=workers, close=close)
