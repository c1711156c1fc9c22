"""Mutual discovery: being sure that others know of this node before anything depends on it."""

import time
from collections.abc import Iterable

from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.subscription import Subscription
from std_msgs.msg import String

from armimp_common import contract, qos
from armimp_common.errors import GraphError
from armimp_common.heartbeat import Watch
from armimp_common.pubsub import HasPublisher, HasSubscription, wait_until_matched

_PATIENCE = 10.0
_POLL = 0.002


def wait_for_partners(
    node: Node,
    *,
    publishers: Iterable[Publisher | HasPublisher] = (),
    subscriptions: Iterable[Subscription | HasSubscription] = (),
    watches: Iterable[Watch] = (),
) -> None:
    """Wait until a node that is activated and those which it needs know of one another.

    Parameters
    ----------
    node
        The node; to be called in a callback of it.
    publishers, subscriptions
        What has to have a peer.
    watches
        Nodes that have to know of this one, if they offer a sign of life; see
        `wait_until_known_to`.

    Raises
    ------
    GraphError
        If somebody does not turn up within 10 s, or is lost but still listed.
    """
    lonely = wait_until_matched(
        node, publishers=publishers, subscriptions=subscriptions, timeout_s=_PATIENCE
    )
    if lonely:
        raise GraphError(f"nobody at the other end of {', '.join(lonely)}")
    watches = list(watches)
    for watch in watches:
        if watch.ghost:
            raise GraphError(watch.sentence)
    wait_until_known_to(node, [watch.name for watch in watches], timeout_s=_PATIENCE)


def wait_until_known_to(node: Node, names: Iterable[str], *, timeout_s: float) -> None:
    """Wait until these nodes know of every subscription that `node` has made so far.

    Discovery has two directions. A subscription that has found its publisher may still be unknown
    to that publisher, for up to some seconds between processes that were started apart from one
    another, and what is published meanwhile on a volatile topic never reaches it. A process learns
    of the subscriptions of another one in the order in which they were made. So once a latched
    message, the sign of life, has come back to a subscription made just now, the older ones are
    known too.

    To be called in a callback of `node`, or while it is not spun.

    Parameters
    ----------
    node
        Whose subscriptions are to be known.
    names
        Nodes by their names in the contract. Those that offer no sign of life, as drivers of
        others may not, are not waited for.
    timeout_s
        How long to wait (s).

    Raises
    ------
    GraphError
        If one of them gives no answer.
    """
    deadline = time.monotonic() + timeout_s
    probes = {
        name: node.create_subscription(String, topic, lambda _: None, qos.LATCHED)
        for name in names
        if node.count_publishers(topic := contract.alive(name))
    }
    awaited = dict(probes)
    try:
        while True:
            awaited = {name: probe for name, probe in awaited.items() if not _heard(probe)}
            if not awaited:
                return
            if time.monotonic() >= deadline:
                raise GraphError(f"no answer from {', '.join(awaited)}")
            time.sleep(_POLL)
    finally:
        for probe in probes.values():
            node.destroy_subscription(probe)


def _heard(probe: Subscription) -> bool:
    with probe.handle:
        return probe.handle.take_message(probe.msg_type, probe.raw) is not None
