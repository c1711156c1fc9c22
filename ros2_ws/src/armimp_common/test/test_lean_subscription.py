"""Subscriptions that an executor asks less of."""

import sys
from collections.abc import Callable
from types import FrameType
from typing import Any

import pytest
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription
from std_msgs.msg import UInt64

from armimp_common.executor import ExecutorKind, Spinner
from armimp_common.lean_subscription import LeanSubscription, make_lean
from support.graph import PATIENCE

PROFILE = QoSProfile(depth=10)


def python_calls(action: Callable[[], object]) -> list[str]:
    """Names of the functions that run meanwhile, without that of the action."""
    called: list[str] = []

    def on_event(frame: FrameType, event: str, argument: Any) -> None:
        if event == "call":
            called.append(frame.f_code.co_name)

    sys.setprofile(on_event)
    try:
        action()
    finally:
        sys.setprofile(None)
    return called[1:]


# The events executor cannot call anything that wants to know more of a message, lean or not.
@pytest.mark.parametrize(
    ("kind", "informed"), [("events", False), ("single", False), ("single", True)]
)
def test_every_message_arrives_as_without_it(
    node: Node, kind: ExecutorKind, informed: bool
) -> None:
    heard: list[int] = []

    def on_message(message: UInt64) -> None:
        heard.append(message.data)

    def on_informed_message(message: UInt64, info: Any) -> None:
        assert info["received_timestamp"] > 0
        heard.append(message.data)

    callback: Any = on_informed_message if informed else on_message
    subscription = node.create_subscription(UInt64, "number", callback, PROFILE)
    make_lean(subscription)
    publisher = node.create_publisher(UInt64, "number", PROFILE)
    left = iter(range(5))

    def send() -> None:
        if publisher.get_subscription_count() and (number := next(left, None)) is not None:
            publisher.publish(UInt64(data=number))

    node.create_timer(0.01, send)
    rounds = iter(range(int(PATIENCE / 0.05)))
    with Spinner([node], kind=kind) as spinner:
        spinner.spin(lambda: len(heard) == 5 or next(rounds, None) is None)

    assert heard == [0, 1, 2, 3, 4]
    assert subscription.get_publisher_count() == 1
    assert subscription.topic_name == "/number"
    assert node.destroy_subscription(subscription)


def test_what_an_executor_asks_for_runs_no_python_code(node: Node) -> None:
    subscription = node.create_subscription(UInt64, "number", lambda _: None, PROFILE)

    def ask() -> None:
        _ = subscription.handle, subscription.callback
        assert subscription.CallbackType.MessageOnly.value == 0

    usual = python_calls(ask)
    make_lean(subscription)

    assert {"handle", "callback"} <= set(usual)
    assert python_calls(ask) == []


def test_subscriptions_of_another_make_stay_as_they_are(node: Node) -> None:
    class Special(Subscription):
        pass

    subscription = node.create_subscription(UInt64, "number", lambda _: None, PROFILE)
    subscription.__class__ = Special

    make_lean(subscription)

    assert type(subscription) is Special
    assert not isinstance(subscription, LeanSubscription)
