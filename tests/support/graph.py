"""Fixtures and helpers for tests with real nodes over real DDS, each in a domain of its own."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any, TypeAlias, TypeVar

import pytest
import rclpy
from pydantic import BaseModel
from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.lifecycle import LifecycleNode
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions

from armimp_bringup.graph import DomainClaim
from armimp_common import topics
from armimp_common.errors import MalformedMessageError
from armimp_common.executor import Spinner
from armimp_common.heartbeat import HeartbeatMonitor
from armimp_common.schema import Value, flatten

NodeT = TypeVar("NodeT", bound=Node)
PATIENCE = 30.0
"""How long to wait for what must happen (s): long, as the machine may be busy."""

MOMENT = 0.2
"""How long to wait for what must not happen (s)."""

CHOICES = (
    "ROS_AUTOMATIC_DISCOVERY_RANGE",
    "FASTRTPS_DEFAULT_PROFILES_FILE",
    "ROS_DOMAIN_ID",
    "ROS_LOCALHOST_ONLY",
    "ROS_STATIC_PEERS",
)
"""Variables by which a user chooses who can hear an experiment."""

CLOCK_STEPS = (-600.0, 3600.0)
"""Steps by which tests set the clock (s)."""


@pytest.fixture(scope="session", autouse=True)
def interruptible() -> None:
    """Have child processes receive SIGINT, which shells disable for background commands."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture
def domain_id(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """A domain id that no other test on this machine has, also for child processes."""
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    with DomainClaim() as claim:
        monkeypatch.setenv("ROS_DOMAIN_ID", str(claim.domain_id))
        yield claim.domain_id


def free_domain() -> int:
    """Return a free domain id, for another process to claim."""
    with DomainClaim() as claim:
        return claim.domain_id


def joined(domain_id: int, *arguments: str) -> Context:
    """Return a new context in a domain, with ROS arguments; the caller shuts it down."""
    context = Context()
    rclpy.init(
        args=[*arguments],
        context=context,
        domain_id=domain_id,
        signal_handler_options=SignalHandlerOptions.NO,
    )
    return context


@contextmanager
def hosted(make: Callable[[Context], NodeT], domain_id: int) -> Iterator[NodeT]:
    """Run a node in a context and a thread of its own, which is quicker than a process."""
    context = joined(domain_id)
    node = make(context)
    ended = threading.Event()

    def spin() -> None:
        with Spinner([node]) as spinner:
            spinner.spin(ended.is_set)

    thread = threading.Thread(target=spin)
    thread.start()
    try:
        yield node
    finally:
        ended.set()
        thread.join()
        node.destroy_node()
        context.try_shutdown()


@pytest.fixture
def context(domain_id: int) -> Iterator[Context]:
    """An initialised context."""
    context = joined(domain_id)
    yield context
    context.try_shutdown()


@pytest.fixture
def node(context: Context) -> Iterator[Node]:
    """A plain node."""
    node = Node("tester", context=context)
    yield node
    node.destroy_node()


@pytest.fixture
def spinner(node: Node) -> Iterator[Spinner]:
    """Spinner of the plain node, and of nodes that are added later."""
    with Spinner([node]) as spinner:
        yield spinner


OTHER = """
from armimp_common import qos
from armimp_common.executor import run_node
from armimp_common.heartbeat import offer_heartbeat
from rclpy.node import Node
from std_msgs.msg import String

def make(*, context):
    node = Node("other", context=context)
    offer_heartbeat(node, "other")
    publisher = node.create_publisher(String, "answer", qos.SAMPLE)
    node.create_subscription(String, "question", publisher.publish, qos.SAMPLE)
    return node

raise SystemExit(run_node(make, ["other"]))
"""


@pytest.fixture
def other(domain_id: int) -> Iterator[subprocess.Popen[bytes]]:
    """A node in a process of its own, with a heartbeat, that echoes every question."""
    # The nodes discover each other with the middleware's defaults, which are slow.
    environment = {**os.environ, "ROS_DOMAIN_ID": str(domain_id)}
    environment.pop("FASTRTPS_DEFAULT_PROFILES_FILE", None)
    with subprocess.Popen([sys.executable, "-c", OTHER], env=environment) as process:
        yield process
        process.kill()


def eventually(spinner: Spinner, condition: Callable[[], bool], what: str) -> None:
    """Spin until a condition is met."""
    end = time.monotonic() + PATIENCE
    spinner.spin(lambda: condition() or time.monotonic() > end, period=0.01)
    assert condition(), f"did not happen within {PATIENCE} s: {what}"


def a_moment(spinner: Spinner) -> None:
    """Spin for a moment, in which something could happen that must not."""
    end = time.monotonic() + MOMENT
    spinner.spin(lambda: time.monotonic() > end, period=0.05)


def overrides(model: BaseModel, changes: Mapping[str, Value] | None = None) -> list[Parameter]:
    """Return the ``parameter_overrides`` that give a node the values of a schema."""
    values = {**flatten(model), **(changes or {})}
    return [Parameter(name, value=value) for name, value in values.items()]


def assert_locked_while_active(node: LifecycleNode, name: str, value: Value, why: str) -> None:
    """Check that an active node refuses another value of a parameter, and takes it afterwards."""
    change, before = Parameter(name, value=value), node.get_parameter(name).value
    (result,) = node.set_parameters([change])
    assert not result.successful
    assert result.reason == f"{name} cannot be changed now: {why}"
    assert node.get_parameter(name).value == before
    node.trigger_deactivate()
    (result,) = node.set_parameters([change])
    assert result.successful


def report(monitor: HeartbeatMonitor, *, alive: int, silent: int) -> None:
    """Tell a monitor what the middleware would report of another process's heartbeat."""
    # The event of the binding cannot be constructed by hand; this has the same attributes.
    event: Any = SimpleNamespace(alive_count=alive, not_alive_count=silent)
    monitor._on_event(event)


def set_clock(node: Node, step: float) -> None:
    """Step the clock of a node by so many seconds, and stop it there.

    To a timer that looks like a step of the wall clock, which is not touched.
    """
    clock: Any = node.get_clock()
    now = clock.now()
    clock._set_ros_time_is_active(True)
    clock.set_ros_time_override(now + Duration(nanoseconds=round(step * topics.NS_PER_S)))


def raised(error: MalformedMessageError) -> None:
    """Raise the error of a malformed message, so that it reaches the caller of ``spin``."""
    raise error


Launch: TypeAlias = Callable[..., Any]


@pytest.fixture
def launch(context: Context, spinner: Spinner) -> Iterator[Launch]:
    """Make a node with the values of a schema, some changed by name, and spin it."""
    made: list[Node] = []

    def factory(
        kind: Callable[..., NodeT],
        model: BaseModel,
        changes: Mapping[str, Value] | None = None,
        **kwargs: Any,
    ) -> NodeT:
        node = kind(context=context, parameter_overrides=overrides(model, changes), **kwargs)
        made.append(node)
        spinner.add_node(node)
        return node

    yield factory
    for node in made:
        spinner.remove_node(node)
        node.destroy_node()
