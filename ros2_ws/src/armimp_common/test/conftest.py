"""Fixtures for tests with real nodes over real DDS, each test in a domain of its own."""

from collections.abc import Iterator

import pytest
import rclpy
from rclpy.context import Context
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from armimp_common.domain import DomainClaim


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
