"""Fixtures and helpers for tests with real nodes over real DDS, each test in a domain of its own.

A ``conftest.py`` takes the fixtures over by importing them.
"""

import time
from collections.abc import Callable, Iterator, Mapping

import pytest
import rclpy
from pydantic import BaseModel
from rclpy.context import Context
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions

from armimp_common.domain import DomainClaim
from armimp_common.schema import Value, flatten
from armimp_common.spin import Spinner

PATIENCE = 30.0
"""How long to wait for what must happen (s): long, as the machine may have other work."""

MOMENT = 0.2
"""How long to wait for what must not happen (s)."""


@pytest.fixture
def domain_id(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """A domain id that no other test on this machine has, also for child processes."""
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    with DomainClaim() as claim:
        monkeypatch.setenv("ROS_DOMAIN_ID", str(claim.domain_id))
        yield claim.domain_id


@pytest.fixture
def context(domain_id: int) -> Iterator[Context]:
    """An initialised context."""
    context = Context()
    rclpy.init(
        args=[],
        context=context,
        domain_id=domain_id,
        signal_handler_options=SignalHandlerOptions.NO,
    )
    yield context
    context.try_shutdown()


@pytest.fixture
def node(context: Context) -> Iterator[Node]:
    """A plain node."""
    node = Node("tester", context=context)
    yield node
    node.destroy_node()


def eventually(
    spinner: Spinner, condition: Callable[[], bool], what: str, patience: float = PATIENCE
) -> None:
    """Spin until a condition is met.

    Parameters
    ----------
    spinner
        Spins the nodes on which the condition depends.
    condition
        What must come true.
    what
        The condition in words, for the failure.
    patience
        How long to wait at most (s).

    Raises
    ------
    AssertionError
        If it is not met in time.
    """
    end = time.monotonic() + patience
    spinner.spin(lambda: condition() or time.monotonic() > end, period=0.01)
    assert condition(), f"did not happen within {patience} s: {what}"


def a_moment(spinner: Spinner) -> None:
    """Spin for a moment, in which something could happen that must not."""
    end = time.monotonic() + MOMENT
    spinner.spin(lambda: time.monotonic() > end, period=0.05)


def overrides(model: BaseModel, changes: Mapping[str, Value] | None = None) -> list[Parameter]:
    """Return the ``parameter_overrides`` that give a node the values of a schema.

    Parameters
    ----------
    model
        The values.
    changes
        Other values by dotted name, which need not be right.
    """
    values = {**flatten(model), **(changes or {})}
    return [Parameter(name, value=value) for name, value in values.items()]
