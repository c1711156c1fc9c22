"""Asking a service of another node, in a process that spins by itself."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any, Final, TypeAlias

from rclpy.client import Client
from rclpy.task import Future

from armimp_common.errors import GraphError

SpinUntil: TypeAlias = Callable[[Future, float], bool]
POLL: Final = 0.01
_CHECK_PERIOD: Final = 0.05
_REPEAT: Final = 2.0


def ask(
    client: Client,
    request: Any,
    whom: str,
    purpose: str,
    *,
    spin_until: SpinUntil,
    timeout: float,
    repeat: bool = True,
    check: Callable[[], None] = lambda: None,
) -> Any:
    """Wait for a service, call it, and return the answer.

    Parameters
    ----------
    client, request : what is asked
    whom, purpose : for the words of errors: ``node x did not answer to configure``
    spin_until : as for `armimp_common.lifecycle.LifecycleManager`
    timeout : for the service to appear, and to answer (s)
    repeat : whether the question is asked again where no answer comes
    check : called often; what it raises ends the waiting

    Raises
    ------
    GraphError
        If there is no answer in time.
    """
    deadline = time.monotonic() + timeout
    while not client.service_is_ready():
        if time.monotonic() >= deadline:
            raise GraphError(f"{whom} is not there to {purpose}")
        check()
        spin_until(Future(), POLL)
    while True:
        # An answer gets lost if the node has not yet discovered this side.
        patience = _REPEAT if repeat else math.inf
        future = client.call_async(request)
        try:
            if _await(future, min(deadline, time.monotonic() + patience), spin_until, check):
                return future.result()
        finally:
            if not future.done():
                client.remove_pending_request(future)
        if time.monotonic() >= deadline:
            raise GraphError(f"{whom} did not answer to {purpose} in {timeout} s")


def _await(
    future: Future, deadline: float, spin_until: SpinUntil, check: Callable[[], None]
) -> bool:
    while not spin_until(future, _CHECK_PERIOD):
        check()
        if time.monotonic() >= deadline:
            return False
    return True
