"""Subscriptions whose messages wait in the middleware until somebody takes them.

For every message that comes, an executor is told, wakes up, looks for the subscription that it is
meant for, and calls back: several times the cost of the message itself. Who wants the messages of
several streams together, or many at once, need not be told of each.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription

from armimp_common import qos


class _Unattended(Subscription):
    """A subscription that executors are not told of."""


class PollingNode(Node):
    """Base of a node that has polled subscriptions: hides them from its executor."""

    @property
    def subscriptions(self) -> Iterator[Subscription]:
        """The subscriptions that an executor attends to."""
        return (one for one in super().subscriptions if not isinstance(one, _Unattended))


class PolledSubscription:
    """Subscription that keeps messages, as the bytes that came, until they are taken.

    Beyond the depth of its profile, the oldest are lost. To be made in the thread of the executor,
    which might attend to it otherwise before it is hidden.

    Parameters
    ----------
    node, topic
        Where to listen.
    message_type
        Message class of the topic.
    profile
        Quality of service.
    """

    def __init__(
        self,
        node: PollingNode,
        topic: str,
        message_type: type[Any],
        *,
        profile: QoSProfile = qos.SAMPLE,
    ) -> None:
        self.subscription: Subscription = node.create_subscription(
            message_type, topic, _nobody, profile, raw=True
        )
        self.subscription.__class__ = _Unattended

    def take(self) -> list[bytes]:
        """Take all messages that have come, in their order.

        Raises
        ------
        rclpy.exceptions.InvalidHandle
            If the subscription was destroyed.
        """
        return take_all(self.subscription)


def take_all(subscription: Subscription) -> list[bytes]:
    """Take all messages that have come to a subscription, as bytes in their order.

    An executor that attends to it finds none of them any more.

    Raises
    ------
    rclpy.exceptions.InvalidHandle
        If the subscription was destroyed.
    """
    handle: Any = subscription.handle
    taken: list[bytes] = []
    with handle:
        while (found := handle.take_message(subscription.msg_type, True)) is not None:
            taken.append(found[0])
    return taken


def _nobody(message: bytes) -> None:
    """Would be called by an executor that attends to the subscription nevertheless."""
    raise AssertionError("nobody is to be told of this message")
