"""Signals end a check between two callbacks, and never within one."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.task import Future

from armimp_common.errors import InterruptionError
from armimp_common.executor import PERIOD, Spinner


class InterruptibleSpinner(Spinner):
    """A spinner that raises once a signal has come, and once only: torque must still be ended.

    Parameters
    ----------
    stopped : tells whether a signal has come
    others : as of :class:`armimp_common.executor.Spinner`
    """

    def __init__(self, *nodes: Any, stopped: Callable[[], bool], **others: Any) -> None:
        self._stopped: Callable[[], bool] | None = stopped
        super().__init__(*nodes, **others)

    def spin(self, should_stop: Callable[[], bool], *, period: float = PERIOD) -> None:
        """Execute callbacks until ``should_stop``.

        Raises
        ------
        InterruptionError
            The first time that a signal has come.
        """
        stopped = self._stopped or bool
        super().spin(lambda: stopped() or should_stop(), period=period)
        self._leave()

    def spin_until(self, future: Future, timeout: float) -> bool:
        """Execute callbacks until ``future`` is done; raises as :meth:`spin` does."""
        done = super().spin_until(future, timeout)
        self._leave()
        return done

    def _leave(self) -> None:
        if self._stopped is not None and self._stopped():
            self._stopped = None
            raise InterruptionError("interrupted")
