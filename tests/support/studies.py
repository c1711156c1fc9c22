"""A study in threads of the test, which need not start."""

from concurrent.futures import ThreadPoolExecutor

from armimp_bringup.study.engine import Backend


def threads(workers: int) -> Backend:
    """So many threads."""
    return Backend(ThreadPoolExecutor(workers), workers)
