"""Channels over real DDS: what is sent arrives, and peers are found."""

import signal
import subprocess
import time
from collections.abc import Sequence
from functools import partial

import pytest
from rclpy.node import Node
from rclpy.subscription import Subscription
from std_msgs.msg import String

from armimp_common import pubsub, qos
from armimp_common.errors import GraphError
from armimp_common.executor import Spinner
from armimp_common.heartbeat import HeartbeatMonitor
from armimp_common.pubsub import CommandPublisher, subscribe_raw, wait_for_partners
from armimp_common.topics import COMMANDS
from support.graph import eventually


def test_when_peers_are_missing_expect_their_topics_named(
    node: Node, monkeypatch: pytest.MonkeyPatch
) -> None:
    publisher = CommandPublisher(node, "spoken", 1)
    subscription = subscribe_raw(node, "heard", lambda _: None, COMMANDS)
    start = time.monotonic()

    def missed(names: str) -> None:
        with monkeypatch.context() as patch:
            patch.setattr(pubsub, "_PATIENCE", 0.1)
            with pytest.raises(GraphError, match=f"nobody at the other end of {names}$"):
                wait_for_partners(node, publishers=[publisher], subscriptions=[subscription])

    missed("/spoken, /heard")
    assert time.monotonic() - start >= 0.1
    subscribe_raw(node, "spoken", lambda _: None, COMMANDS)
    wait_for_partners(node, publishers=[publisher])
    missed("/heard")


ROUNDS = 20


def test_what_a_known_publisher_sends_from_now_on_arrives(
    node: Node, other: "subprocess.Popen[bytes]", monkeypatch: pytest.MonkeyPatch
) -> None:
    take_all = pubsub.take_all

    def look(probe: Subscription) -> Sequence[bytes]:
        other.send_signal(signal.SIGCONT)
        return take_all(probe)

    monkeypatch.setattr(pubsub, "take_all", look)
    question = node.create_publisher(String, "question", qos.SAMPLE)
    monitor = HeartbeatMonitor(node, "other", lambda _: None)
    # A heartbeat that isn't known yet is not waited for, and readers may be known before it.
    wait_for_partners(node, publishers=[question], subscriptions=[monitor.subscription])

    with Spinner([node]) as spinner:
        # Repeatedly, since most answers would arrive even without the wait.
        for number in range(ROUNDS):
            answers: list[String] = []
            # The other node will learn of this subscription and get the question almost together.
            other.send_signal(signal.SIGSTOP)
            listener = node.create_subscription(String, "answer", answers.append, qos.SAMPLE)
            wait_for_partners(node, monitors=[monitor])
            question.publish(String(data=f"{number}"))
            other.send_signal(signal.SIGCONT)
            eventually(spinner, partial(bool, answers), "an answer")
            assert answers == [String(data=f"{number}")]
            node.destroy_subscription(listener)


def test_when_a_node_gives_no_answer_expect_it_named_and_nothing_left_behind(
    node: Node, other: "subprocess.Popen[bytes]", monkeypatch: pytest.MonkeyPatch
) -> None:
    monitor = HeartbeatMonitor(node, "other", lambda _: None)
    wait_for_partners(node, subscriptions=[monitor.subscription])
    monkeypatch.setattr(pubsub, "_PATIENCE", 0.5)
    before = len(list(node.subscriptions))
    other.send_signal(signal.SIGSTOP)

    with pytest.raises(GraphError, match="no answer from other"):
        wait_for_partners(node, monitors=[monitor])

    assert len(list(node.subscriptions)) == before
