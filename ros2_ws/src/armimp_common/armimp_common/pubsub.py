"""Publishers and subscriptions that pass serialised bytes through the fast codecs."""

import time
from collections.abc import Callable, Iterable, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, UInt64

from armimp_common import contract, qos
from armimp_common.cdr import (
    CommandDecoder,
    CommandEncoder,
    JointStateDecoder,
    JointStateEncoder,
    decode_count,
    encode_clock,
    encode_count,
    next_number,
)
from armimp_common.contract import ValueField
from armimp_common.errors import MalformedMessageError
from armimp_common.lean_subscription import make_lean

OnMalformed = Callable[[MalformedMessageError], None]
_POLL = 0.005


class JointStatePublisher:
    """Publisher of JointState messages of one layout.

    Parameters
    ----------
    node, topic
        Where to publish.
    names, field
        As for `armimp_common.cdr.JointStateEncoder`.
    profile
        Quality of service.
    """

    def __init__(
        self,
        node: Node,
        topic: str,
        names: Sequence[str],
        field: ValueField,
        *,
        profile: QoSProfile = qos.SAMPLE,
    ) -> None:
        self.publisher: Publisher = node.create_publisher(JointState, topic, profile)
        self._send = sender(self.publisher)
        self._encode = JointStateEncoder(names, field).encode

    def publish(self, stamp_ns: int, values: Sequence[float] | NDArray[np.float64]) -> bytes:
        """Publish (n,) values with this stamp (ns), and return the bytes sent.

        Raises
        ------
        MalformedMessageError
            If the number of values is wrong.
        """
        data = self._encode(stamp_ns, values)
        self._send(data)
        return data


class CommandPublisher:
    """Publisher of commands for `n` joints, numbered from 1 on; see `JointStatePublisher`."""

    def __init__(self, node: Node, topic: str, n: int, *, profile: QoSProfile = qos.SAMPLE) -> None:
        self.publisher: Publisher = node.create_publisher(Float64MultiArray, topic, profile)
        self._send = sender(self.publisher)
        self._encode = CommandEncoder(n).encode
        self._number = 0

    def publish(self, values: Sequence[float] | NDArray[np.float64]) -> bytes:
        """Publish (n,) torques (N·m), and return the bytes sent.

        Raises
        ------
        MalformedMessageError
            If the number of values is wrong.
        """
        number = next_number(self._number)
        data = self._encode(values, number)
        self._number = number
        self._send(data)
        return data


class CountPublisher:
    """Publisher of counts, of which the last one is kept for whoever joins late."""

    def __init__(self, node: Node, topic: str, *, profile: QoSProfile = qos.LATCHED) -> None:
        self.publisher: Publisher = node.create_publisher(UInt64, topic, profile)
        self._send = sender(self.publisher)

    def publish(self, count: int) -> None:
        """Publish a count from 0 to 2⁶⁴ − 1."""
        self._send(encode_count(count))


class ClockPublisher:
    """Publisher of simulated time."""

    def __init__(self, node: Node) -> None:
        self.publisher: Publisher = node.create_publisher(Clock, contract.CLOCK, qos.CLOCK)
        self._send = sender(self.publisher)

    def publish(self, stamp_ns: int) -> None:
        """Publish a time (ns)."""
        self._send(encode_clock(stamp_ns))


def sender(publisher: Publisher) -> Callable[[bytes], None]:
    """Return what publishes serialised messages.

    `Publisher.publish` does the same after it has told them from others, and protected the
    publisher from being destroyed by another thread meanwhile: twice the time of the rest.
    """
    send: Callable[[bytes], None] = publisher.handle.publish_raw
    return send


class RawSubscription:
    """Subscription that delivers messages as the bytes that came, of any length.

    Parameters
    ----------
    node, topic
        Where to listen.
    message_type
        Message class of the topic.
    callback
        Called with each message.
    profile
        Quality of service.
    """

    def __init__(
        self,
        node: Node,
        topic: str,
        message_type: type[Any],
        callback: Callable[[bytes], None],
        *,
        profile: QoSProfile = qos.SAMPLE,
    ) -> None:
        self.subscription: Subscription = node.create_subscription(
            message_type, topic, callback, profile, raw=True
        )
        make_lean(self.subscription)


class JointStateSubscription(RawSubscription):
    """Subscription to JointState messages, decoded in the order of `names`.

    Parameters
    ----------
    node, topic
        Where to listen.
    names, field
        As for `armimp_common.cdr.JointStateDecoder`.
    callback
        Called with the stamp (ns) and the values; NaN and infinities are passed on.
    on_malformed
        Called instead for a message that cannot be decoded. Without it the error is raised and
        arrives at whoever spins, since dropping such a message silently would not be safe.
    profile
        Quality of service.
    """

    def __init__(
        self,
        node: Node,
        topic: str,
        names: Sequence[str],
        field: ValueField,
        callback: Callable[[int, tuple[float, ...]], None],
        *,
        on_malformed: OnMalformed | None = None,
        profile: QoSProfile = qos.SAMPLE,
    ) -> None:
        decode = JointStateDecoder(names, field).decode

        def on_message(data: bytes) -> None:
            try:
                stamp_ns, values = decode(data)
            except MalformedMessageError as error:
                if on_malformed is None:
                    raise
                on_malformed(error)
            else:
                callback(stamp_ns, values)

        super().__init__(node, topic, JointState, on_message, profile=profile)


class CommandSubscription(RawSubscription):
    """Subscription to commands for `n` joints; see `JointStateSubscription`.

    Parameters
    ----------
    on_number
        Called before `callback` with the number of the command, 0 if it has none.
    """

    def __init__(
        self,
        node: Node,
        topic: str,
        n: int,
        callback: Callable[[tuple[float, ...]], None],
        *,
        on_number: Callable[[int], None] = lambda _: None,
        on_malformed: OnMalformed | None = None,
        profile: QoSProfile = qos.SAMPLE,
    ) -> None:
        decode = CommandDecoder(n).decode_numbered

        def on_message(data: bytes) -> None:
            try:
                number, values = decode(data)
            except MalformedMessageError as error:
                if on_malformed is None:
                    raise
                on_malformed(error)
            else:
                on_number(number)
                callback(values)

        super().__init__(node, topic, Float64MultiArray, on_message, profile=profile)


class CountSubscription(RawSubscription):
    """Subscription to counts; one that cannot be decoded is logged and dropped."""

    def __init__(
        self,
        node: Node,
        topic: str,
        callback: Callable[[int], None],
        *,
        profile: QoSProfile = qos.LATCHED,
    ) -> None:
        def on_message(data: bytes) -> None:
            try:
                count = decode_count(data)
            except MalformedMessageError as error:
                node.get_logger().warning(f"{topic}: {error}")
            else:
                callback(count)

        super().__init__(node, topic, UInt64, on_message, profile=profile)


class HasPublisher(Protocol):
    """A publishing channel of this module."""

    publisher: Publisher


class HasSubscription(Protocol):
    """A subscribing channel of this module."""

    subscription: Subscription


def unmatched(
    node: Node,
    publishers: Iterable[Publisher | HasPublisher] = (),
    subscriptions: Iterable[Subscription | HasSubscription] = (),
) -> tuple[str, ...]:
    """Return the topic names of those publishers and subscriptions that have no peer yet."""
    lonely: list[str] = []
    for item in publishers:
        publisher = item if isinstance(item, Publisher) else item.publisher
        if publisher.get_subscription_count() == 0:
            lonely.append(publisher.topic_name)
    for entry in subscriptions:
        subscription = entry if isinstance(entry, Subscription) else entry.subscription
        if publisher_count(node, subscription) == 0:
            lonely.append(subscription.topic_name)
    return tuple(lonely)


def wait_until_matched(
    node: Node,
    *,
    publishers: Iterable[Publisher | HasPublisher] = (),
    subscriptions: Iterable[Subscription | HasSubscription] = (),
    timeout_s: float,
) -> tuple[str, ...]:
    """Wait until every publisher and subscription has at least one peer.

    What is published on a volatile topic before that is lost. Discovery goes on in threads of
    the middleware, so nothing needs to be spun meanwhile. A peer in another process may still
    need a moment to see this side: ask on both sides.

    Returns
    -------
    tuple of str
        Topic names of those still without a peer after `timeout_s`; empty on success.
    """
    publishers = list(publishers)
    subscriptions = list(subscriptions)
    deadline = time.monotonic() + timeout_s
    while lonely := unmatched(node, publishers, subscriptions):
        if time.monotonic() >= deadline:
            return lonely
        time.sleep(_POLL)
    return ()


def publisher_count(node: Node, subscription: Subscription) -> int:
    """Return how many publish to a subscription."""
    # Counting the matched ones came to rclpy late; the graph's count may run ahead of matching.
    if hasattr(subscription, "get_publisher_count"):
        return int(subscription.get_publisher_count())
    return int(node.count_publishers(subscription.topic_name))
