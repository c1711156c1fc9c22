"""Subscriptions whose messages wait until they are taken, whatever the executor does."""

from collections.abc import Iterator

import pytest
from rclpy.context import Context
from rclpy.exceptions import InvalidHandle
from rclpy.qos import QoSProfile
from rclpy.serialization import serialize_message
from std_msgs.msg import UInt64

from armimp_common.cdr import decode_count
from armimp_common.executor import ExecutorKind, Spinner
from armimp_common.polled_subscription import PolledSubscription, PollingNode
from armimp_common.pubsub import unmatched, wait_until_matched
from support.graph import PATIENCE, eventually

PROFILE = QoSProfile(depth=10)


@pytest.fixture
def node(context: Context) -> Iterator[PollingNode]:
    node = PollingNode("poller", context=context)
    yield node
    node.destroy_node()


def numbers(messages: list[bytes]) -> list[int]:
    return [decode_count(message) for message in messages]


@pytest.mark.parametrize("kind", ["events", "single"])
def test_messages_wait_in_their_order_while_the_node_is_spun(
    node: PollingNode, kind: ExecutorKind
) -> None:
    heard: list[int] = []
    polled = PolledSubscription(node, "number", UInt64, profile=PROFILE)

    def on_message(message: UInt64) -> None:
        heard.append(message.data)

    node.create_subscription(UInt64, "number", on_message, PROFILE)
    publisher = node.create_publisher(UInt64, "number", PROFILE)
    assert not wait_until_matched(
        node, publishers=[publisher], subscriptions=[polled], timeout_s=PATIENCE
    )

    with Spinner([node], kind=kind) as spinner:
        for number in range(3):
            publisher.publish(UInt64(data=number))
        eventually(spinner, lambda: heard == [0, 1, 2], "messages of the other subscription")
        first = polled.take()
        publisher.publish(UInt64(data=3))
        eventually(spinner, lambda: heard == [0, 1, 2, 3], "one more")
        second = polled.take()

    assert numbers(first) == [0, 1, 2]
    assert numbers(second) == [3]
    assert polled.take() == []


def test_messages_are_the_bytes_that_came(node: PollingNode) -> None:
    polled = PolledSubscription(node, "number", UInt64, profile=PROFILE)
    publisher = node.create_publisher(UInt64, "number", PROFILE)
    sent = serialize_message(UInt64(data=2**63 + 5))
    taken: list[bytes] = []

    def arrived() -> bool:
        if publisher.get_subscription_count():
            publisher.publish(sent)
        taken.extend(polled.take())
        return bool(taken)

    with Spinner([node]) as spinner:
        eventually(spinner, arrived, "a message")

    assert taken[0] == sent


def test_beyond_the_depth_the_newest_are_kept(node: PollingNode) -> None:
    polled = PolledSubscription(node, "number", UInt64, profile=PROFILE)
    publisher = node.create_publisher(UInt64, "number", PROFILE)
    assert not wait_until_matched(
        node, publishers=[publisher], subscriptions=[polled], timeout_s=PATIENCE
    )

    for number in range(25):
        publisher.publish(UInt64(data=number))
    taken: list[int] = []

    def arrived() -> bool:
        taken.extend(numbers(polled.take()))
        return 24 in taken

    with Spinner([node]) as spinner:
        eventually(spinner, arrived, "the last message")

    assert taken == list(range(25 - PROFILE.depth, 25))


def test_a_destroyed_one_is_gone_from_the_graph(node: PollingNode) -> None:
    polled = PolledSubscription(node, "number", UInt64, profile=PROFILE)
    publisher = node.create_publisher(UInt64, "number", PROFILE)
    with Spinner([node]) as spinner:
        eventually(spinner, lambda: unmatched(node, [publisher], [polled]) == (), "a match")

        assert node.destroy_subscription(polled.subscription)

        eventually(spinner, lambda: bool(unmatched(node, [publisher])), "no match any more")
        with pytest.raises(InvalidHandle):
            polled.take()
