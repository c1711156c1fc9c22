"""Publishers and subscriptions that use the codecs of `armimp_common.cdr`; discovery of peers."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from importlib import import_module
from typing import Any
from weakref import WeakSet

from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription
from std_msgs.msg import String

from armimp_common import cdr, qos, topics
from armimp_common.arrays import FloatArray
from armimp_common.errors import GraphError, MalformedMessageError
from armimp_common.heartbeat import HeartbeatMonitor

OnMalformed = Callable[[MalformedMessageError], None]
_POLL = 0.005
"""Time between two checks while waiting for something (s)."""
_PATIENCE = 30.0
"""How long a node that is being activated waits for its peers, and then for their answers (s)."""


def message_class(topic: str) -> type[Any]:
    """Return the message class of a topic of :data:`armimp_common.topics.TOPICS`."""
    package, kind, name = topics.TOPICS[topic].type.split("/")
    found: type[Any] = getattr(import_module(f"{package}.{kind}"), name)
    return found


def create_publisher(node: Node, topic: str, like: str = "") -> Publisher:
    """Return a publisher as of `topic`, or of the topic of the contract that it is `like`."""
    like = like or topic
    return node.create_publisher(message_class(like), topic, qos.PROFILES[like])


def subscribe(node: Node, topic: str, callback: Callable[[Any], None]) -> Subscription:
    """Return a subscription with the type and quality of service of the topic."""
    return node.create_subscription(message_class(topic), topic, callback, qos.PROFILES[topic])


class RawPublisher:
    """Publisher of serialised messages.

    Parameters
    ----------
    node, topic, like : as :func:`create_publisher` takes them

    Attributes
    ----------
    send : publishes bytes; `Publisher.publish` takes twice the time, since it also checks the type
        of its argument and guards the publisher against destruction by another thread
    """

    def __init__(self, node: Node, topic: str, like: str = "") -> None:
        self.publisher = create_publisher(node, topic, like)
        self.send: Callable[[bytes], None] = self.publisher.handle.publish_raw


class JointStatePublisher(RawPublisher):
    """Publisher of a JointState topic of the contract, by `armimp_common.cdr.JointStateEncoder`."""

    def __init__(self, node: Node, topic: str, names: Sequence[str]) -> None:
        super().__init__(node, topic)
        self._encode = cdr.JointStateEncoder(names, topics.VALUE_FIELD[topic]).encode

    def publish(self, stamp_ns: int, values: Sequence[float] | FloatArray) -> None:
        """Publish (n,) values with this stamp (ns).

        Raises
        ------
        MalformedMessageError
            If the number of values is wrong.
        """
        self.send(self._encode(stamp_ns, values))


class CommandPublisher(RawPublisher):
    """Publisher of commands for `n` joints, numbered from 1 on."""

    def __init__(self, node: Node, topic: str, n: int) -> None:
        super().__init__(node, topic, topics.COMMANDS)
        self._encode = cdr.CommandEncoder(n).encode
        self._number = 0

    def publish(self, values: Sequence[float] | FloatArray) -> None:
        """Publish (n,) torques (N·m).

        Raises
        ------
        MalformedMessageError
            If the number of values is wrong.
        """
        number = cdr.next_number(self._number)
        data = self._encode(values, number)
        self._number = number
        self.send(data)


def subscribe_raw(
    node: Node,
    topic: str,
    callback: Callable[[bytes], None],
    like: str = "",
    profile: QoSProfile | None = None,
) -> Subscription:
    """Return a subscription that calls back with each message as bytes, of any length.

    It is as of `topic`, or of the topic of the contract that it is `like`, but for a `profile`.
    """
    like = like or topic
    profile = profile or qos.PROFILES[like]
    return node.create_subscription(message_class(like), topic, callback, profile, raw=True)


def subscribe_decoded(
    node: Node,
    topic: str,
    joints: Sequence[str],
    callback: Callable[[int, tuple[float, ...]], None],
    on_malformed: OnMalformed,
) -> Subscription:
    """Return a subscription to a data stream.

    Parameters
    ----------
    node, topic : where to listen
    joints : names, in the order of the values
    callback : called with the values, after the stamp (ns) of a JointState or the number of a
        command; NaN and infinities are passed on
    on_malformed : called instead for a message that cannot be decoded
    """
    decoder = cdr.decoder_of(topic, joints)

    def on_message(data: bytes) -> None:
        try:
            number, values = decoder.decode(data)
        except MalformedMessageError as error:
            on_malformed(error)
        else:
            callback(number, values)

    return subscribe_raw(node, topic, on_message)


def subscribe_counts(node: Node, topic: str, callback: Callable[[int], None]) -> Subscription:
    """Return a subscription to counts; one that cannot be decoded is logged and dropped."""

    def on_message(data: bytes) -> None:
        try:
            count = cdr.decode_count(data)
        except MalformedMessageError as error:
            node.get_logger().warning(f"{topic}: {error}")
        else:
            callback(count)

    return subscribe_raw(node, topic, on_message)


class PollingNode(Node):
    """Base of a node with polled subscriptions, which it hides from its executor."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        self._unattended = WeakSet[Subscription]()
        super().__init__(*arguments, **options)

    @property
    def subscriptions(self) -> Iterator[Subscription]:
        """The subscriptions that an executor attends to."""
        return (one for one in super().subscriptions if one not in self._unattended)

    def subscribe_unattended(self, topic: str) -> Subscription:
        """Return a subscription whose messages wait in the middleware for :func:`take_all`.

        Ordinarily the executor is notified of every message, wakes up, looks up its subscription
        and calls back: several times the cost of the message itself. A node that takes messages of
        several streams together, or many at once, need not be notified of each.

        Beyond the depth of :data:`armimp_common.qos.SAMPLE`, the oldest messages are lost. Call
        this in the thread of the executor, which might otherwise attend to the subscription before
        it is hidden.
        """
        made = subscribe_raw(self, topic, _nobody)
        self._unattended.add(made)
        return made


def take_all(subscription: Subscription) -> list[bytes]:
    """Take all messages waiting at a subscription, as bytes in their order.

    An executor that attends to the subscription no longer finds them.

    Raises
    ------
    rclpy.exceptions.InvalidHandle
        If the subscription was destroyed.
    """
    handle: Any = subscription.handle
    with handle:
        take = partial(handle.take_message, subscription.msg_type, True)
        return [message for message, _ in iter(take, None)]


def _nobody(message: bytes) -> None:
    raise AssertionError("nobody is to be told of this message")


def wait_for_partners(
    node: Node,
    *,
    publishers: Iterable[Publisher | RawPublisher] = (),
    subscriptions: Iterable[Subscription] = (),
    monitors: Iterable[HeartbeatMonitor] = (),
) -> None:
    """Wait until a node and its peers have discovered one another.

    Whatever is published on a volatile topic before that is lost. Discovery runs in threads of the
    middleware, so nothing needs to be spun meanwhile, and it has two directions: a subscription
    that has found its publisher may still be unknown to that publisher, for up to some seconds if
    the two processes were started separately. A process learns of the subscriptions of another one
    in the order of their creation. So once a latched message, the heartbeat, has arrived at a
    subscription created just now, the older ones are known too.

    Parameters
    ----------
    node : the node; call this in one of its callbacks, or while it is not spun
    publishers, subscriptions : those that must have a peer
    monitors : monitors of nodes that must know all subscriptions that `node` has created so far. A
        node without a heartbeat, as a third-party driver may be, is not waited for; nor is one
        whose heartbeat has not been discovered yet. A node creates its heartbeat first, so that is
        known once any other publisher of the node is: `subscriptions` should hold one to each such
        node.

    Raises
    ------
    GraphError
        If a peer does not appear or does not answer, or is lost but still listed.
    """
    sending = [one if isinstance(one, Publisher) else one.publisher for one in publishers]
    listening, monitors = list(subscriptions), list(monitors)

    def lonely() -> list[str]:
        return [
            *(one.topic_name for one in sending if not one.get_subscription_count()),
            *(one.topic_name for one in listening if not one.get_publisher_count()),
        ]

    _wait_until_none(lonely, "nobody at the other end of")
    for monitor in monitors:
        if monitor.ghost:
            raise GraphError(monitor.sentence)
    probes = {
        one.name: node.create_subscription(String, topic, lambda _: None, qos.LATCHED, raw=True)
        for one in monitors
        if node.count_publishers(topic := topics.alive(one.name))
    }
    answered: set[str] = set()

    def silent() -> list[str]:
        answered.update(
            name for name, one in probes.items() if name not in answered and take_all(one)
        )
        return [name for name in probes if name not in answered]

    try:
        _wait_until_none(silent, "no answer from")
    finally:
        for probe in probes.values():
            node.destroy_subscription(probe)


def _wait_until_none(missing: Callable[[], list[str]], words: str) -> None:
    deadline = time.monotonic() + _PATIENCE
    while names := missing():
        if time.monotonic() >= deadline:
            raise GraphError(f"{words} {', '.join(names)}")
        time.sleep(_POLL)
