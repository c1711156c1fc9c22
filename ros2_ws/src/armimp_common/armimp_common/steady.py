"""Time that nobody can set: what every wait, watchdog and ramp is measured with.

A node's own clock follows the wall clock, or ``/clock`` where ``use_sim_time`` is set. A timer on
it stops for as long as that clock was set back, and a watchdog with it.
"""

import time
from collections.abc import Callable
from typing import Final
from weakref import WeakSet

from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.timer import Timer

from armimp_common.errors import ConfigurationError

_USE_SIM_TIME = "use_sim_time"
_REFUSAL = (
    f"parameter '{_USE_SIM_TIME}' cannot be true: watchdogs and ramps must not depend on a clock"
    " that somebody can set or stop"
)
_refusing: WeakSet[Node] = WeakSet()
_STEP: Final = 1e-3
"""Steps of the wall clock that matter (s); slewing makes no such ones between two looks."""


class WallClock:
    """Finds out whether somebody has set the wall clock."""

    def __init__(self) -> None:
        self._ahead = _ahead()

    def was_set(self) -> bool:
        """Whether it was since this was asked last."""
        before, self._ahead = self._ahead, _ahead()
        return not abs(self._ahead - before) < _STEP


def _ahead() -> float:
    """By how much the wall clock is ahead of the steady one (s)."""
    # A thread may be held up between the two: the quickest of some looks counts.
    looks = []
    for _ in range(3):
        begin = time.monotonic()
        wall = time.time()
        end = time.monotonic()
        looks.append((end - begin, wall - begin))
    return min(looks)[1]


def steady_timer(
    node: Node, period: float, callback: Callable[[], object], *, autostart: bool = True
) -> Timer:
    """Return a timer of `node` that no change of the wall clock or of simulated time reaches.

    Parameters
    ----------
    node
        Its executor calls back; ``node.destroy_timer`` ends it.
    period
        Time between two calls (s).
    callback
        What is called.
    autostart
        Whether it runs at once; else from ``reset()`` on.
    """
    clock = Clock(clock_type=ClockType.STEADY_TIME)
    return node.create_timer(period, callback, clock=clock, autostart=autostart)


def refuse_simulated_time(node: Node) -> None:
    """Refuse ``use_sim_time``, now and whenever it is set; calling it again does nothing.

    Raises
    ------
    ConfigurationError
        If the node was started with it.
    """
    if node in _refusing:
        return
    if node.get_parameter(_USE_SIM_TIME).value is True:
        raise ConfigurationError(_REFUSAL)
    node.add_on_set_parameters_callback(_check)
    _refusing.add(node)


def _check(parameters: list[Parameter]) -> SetParametersResult:
    refused = any(item.name == _USE_SIM_TIME and item.value is True for item in parameters)
    return SetParametersResult(successful=not refused, reason=_REFUSAL if refused else "")
