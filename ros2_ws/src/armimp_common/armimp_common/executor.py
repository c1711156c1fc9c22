"""Spin nodes with the fastest executor of rclpy; and the main function of node processes.

The events executor of rclpy is several times faster than the single-threaded one, with traps:
its ``spin()`` receives nothing from other processes; a timeout does not end a spin as long as
there is always another event; an exception in a coroutine, in a task or in the done-callback of a
future ends the process with a segmentation fault; guard conditions are not supported. So it is
always called with a finite timeout here, which a timer of one of the nodes enforces, and callbacks
of nodes must be ordinary functions. Their exceptions reach the caller of `Spinner.spin`.

Steady timers alone are not enough: built against an old C library, as the wheels are, the executor
turns each wait into a deadline of the wall clock, and so waits longer if that clock is set back.
So a thread watches for steps of the wall clock, and restarts all timers after one.
"""

import math
import os
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Final

import rclpy
from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.context import Context
from rclpy.executors import ExternalShutdownException
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future
from rclpy.timer import Timer
from rclpy.utilities import remove_ros_args

from armimp_common.errors import ArmimpError, ConfigurationError
from armimp_common.process import follow_parent, stop_on_signals

if TYPE_CHECKING:
    from typing_extensions import Self

PERIOD: Final = 0.05
"""Time between two checks of a stop condition (s); a node that is told to end does so within it."""

NO_LOG_FILES: Final = "--disable-external-lib-logs"
"""ROS argument with which ROS neither writes to its log directory nor creates it."""

_RESOLUTION: Final = 0.02
"""Period of the timer that ends spins, and time between two readings of the wall clock (s)."""
_STEP: Final = 1e-3
"""Smallest step of the wall clock that matters (s); slewing adds less between two readings."""
_USE_SIM_TIME: Final = "use_sim_time"
_REFUSAL: Final = (
    f"parameter '{_USE_SIM_TIME}' cannot be true: watchdogs and ramps must not depend on a clock"
    " that somebody can set or stop"
)


def _ahead() -> float:
    """Return by how much the wall clock is ahead of the steady one (s)."""
    # The thread may be held up between two readings: the quickest of three attempts counts.
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
    """Return a timer of `node` that no change of the wall clock or of simulated time affects.

    A node's own clock follows the wall clock, or ``/clock`` where ``use_sim_time`` is set. If that
    clock is set back, a timer on it stops for as long, and a watchdog with it.

    Parameters
    ----------
    node : owner of the timer: its executor calls back, and ``node.destroy_timer`` ends the timer
    period : time between two calls (s)
    callback : called each time
    autostart : whether the timer runs at once; otherwise it runs from ``reset()`` on
    """
    clock = Clock(clock_type=ClockType.STEADY_TIME)
    return node.create_timer(period, callback, clock=clock, autostart=autostart)


def refuse_simulated_time(node: Node) -> None:
    """Refuse ``use_sim_time``, now and whenever it is set.

    Raises
    ------
    ConfigurationError
        If the node was started with it.
    """
    if node.get_parameter(_USE_SIM_TIME).value is True:
        raise ConfigurationError(_REFUSAL)
    node.add_on_set_parameters_callback(_check)


def _check(parameters: list[Parameter]) -> SetParametersResult:
    refused = any(item.name == _USE_SIM_TIME and item.value is True for item in parameters)
    return SetParametersResult(successful=not refused, reason=_REFUSAL if refused else "")


class Spinner:
    """An executor of some nodes, which is only ever spun with a finite timeout.

    Parameters
    ----------
    nodes : nodes of one context to execute, at least one; more can be added
    """

    def __init__(self, nodes: Sequence[Node]) -> None:
        self._nodes: list[Node] = []
        self._timer: Timer | None = None
        self._done: Future = Future()
        self._deadline = math.inf
        self._closed = threading.Event()
        self.executor = EventsExecutor(context=nodes[0].context)
        for node in nodes:
            self.add_node(node)
        threading.Thread(target=self._look_at_clock, name="wall clock", daemon=True).start()

    def add_node(self, node: Node) -> None:
        """Execute the callbacks of this node too.

        Raises
        ------
        ConfigurationError
            If it was started with ``use_sim_time``; setting that later is refused as well.
        """
        refuse_simulated_time(node)
        self.executor.add_node(node)
        self._nodes.append(node)
        self._keep_time()

    def remove_node(self, node: Node) -> None:
        """Stop executing the callbacks of this node; call this before the node is destroyed."""
        if self._timer is not None and node is self._nodes[0]:
            node.destroy_timer(self._timer)
            self._timer = None
        self._nodes.remove(node)
        self.executor.remove_node(node)
        self._keep_time()

    def spin(self, should_stop: Callable[[], bool], *, period: float = PERIOD) -> None:
        """Execute callbacks until `should_stop` or until the context is shut down.

        Parameters
        ----------
        should_stop : asked every `period` (s); it need not be cheap

        Raises
        ------
        Exception
            Whatever a callback raises.
        """
        while not should_stop() and self.executor.context.ok():
            self._spin_for(Future(), period)

    def spin_until(self, future: Future, timeout: float) -> bool:
        """Execute callbacks until `future` is done, at most for `timeout` (s).

        Returns
        -------
        bool
            Whether it is done; the call returns as soon as it is.
        """
        if not future.done():
            self._spin_for(future, max(timeout, 0.0))
        return bool(future.done())

    def _spin_for(self, future: Future, timeout: float) -> None:
        self._done = done = Future()
        self._deadline = time.monotonic() + timeout
        future.add_done_callback(lambda _: None if done.done() else done.set_result(None))
        with suppress(ExternalShutdownException):  # `spin` looks at the context itself
            self.executor.spin_until_future_complete(done, timeout)

    def _keep_time(self) -> None:
        """Give the first node the timer that ends spins at their deadline, unless there is one."""
        if self._timer is None and self._nodes:
            self._timer = steady_timer(self._nodes[0], _RESOLUTION, self._on_timer)

    def _on_timer(self) -> None:
        if time.monotonic() >= self._deadline and not self._done.done():
            self._done.set_result(None)

    def _look_at_clock(self) -> None:
        now = _ahead()
        while not self._closed.is_set():
            time.sleep(_RESOLUTION)  # `Event.wait` may itself wait by the wall clock
            before, now = now, _ahead()
            if not abs(now - before) < _STEP and not self._closed.is_set():
                self.executor.create_task(self._begin_anew)

    def _begin_anew(self) -> None:
        """Restart every running timer, so that its wait begins anew; runs in the executor."""
        for timer in [timer for node in self._nodes for timer in node.timers]:
            if not timer.is_canceled():
                timer.reset()

    def close(self) -> None:
        """Release the nodes and shut down the executor; calling it again does nothing."""
        self._closed.set()
        for node in list(self._nodes):
            self.remove_node(node)
        self.executor.shutdown()

    def __enter__(self) -> "Self":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def run_node(factory: Callable[..., Node], args: Sequence[str] | None = None) -> int:
    """Run one node as a process: the whole main function of a node executable.

    Parameters
    ----------
    factory : makes the node, usually its class; called with ``context=``
    args : command line with the program name first, ``sys.argv`` by default

    Returns
    -------
    int
        Exit status: 0 after SIGINT or SIGTERM; 2 after a `ConfigurationError`, 1 after
        another `ArmimpError`, each with one line on standard error.
    """
    arguments = list(sys.argv if args is None else args)
    # A process that is killed while it holds locks in shared memory holds up whatever the others
    # publish, for a second for each lock. A setting of the user takes precedence.
    os.environ.setdefault("FASTDDS_BUILTIN_TRANSPORTS", "UDPv4")
    try:
        with stop_on_signals() as stopped, _initialised(arguments) as context:
            follow_parent()
            node = factory(context=context)
            try:
                with Spinner([node]) as spinner:
                    spinner.spin(stopped)
            finally:
                node.destroy_node()
    except ArmimpError as error:
        program = arguments[0].rpartition("/")[2] if arguments else "node"
        print(f"{program}: {error}", file=sys.stderr)
        return 2 if isinstance(error, ConfigurationError) else 1
    except KeyboardInterrupt:
        pass
    return 0


@contextmanager
def _initialised(arguments: list[str]) -> Iterator[Context]:
    context = Context()
    logs = "ROS_LOG_DIR" in os.environ or "ROS_HOME" in os.environ
    if not logs and not os.access(os.environ.get("HOME", ""), os.W_OK):
        arguments = [*arguments, "--ros-args", NO_LOG_FILES]
    try:
        rclpy.init(args=arguments, context=context, signal_handler_options=SignalHandlerOptions.NO)
        unknown = remove_ros_args(arguments)[1:]
    except (RuntimeError, ValueError) as error:
        # rcl appends places in its own sources, which are of no use to the user.
        reason = str(error).split(", at /")[0]
        raise ConfigurationError(f"wrong ROS arguments: {' '.join(reason.split())}") from None
    try:
        if unknown:
            raise ConfigurationError(f"unknown argument: {unknown[0]!r}")
        yield context
    finally:
        context.try_shutdown()
