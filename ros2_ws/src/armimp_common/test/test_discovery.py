"""Mutual discovery: what is published after the wait arrives; who does not answer is named."""

import signal
import subprocess
import threading
from functools import partial

import pytest
from rclpy.node import Node
from std_msgs.msg import String

from armimp_common import qos, topics
from armimp_common.errors import GraphError
from armimp_common.executor import Spinner
from armimp_common.pubsub import wait_until_known_to, wait_until_matched
from support.graph import PATIENCE, eventually

ROUNDS = 20


def test_what_a_known_publisher_sends_from_now_on_arrives(
    node: Node, other: "subprocess.Popen[bytes]"
) -> None:
    question = node.create_publisher(String, "question", qos.SAMPLE)
    assert not wait_until_matched(node, publishers=[question], timeout_s=PATIENCE)

    with Spinner([node]) as spinner:
        # Often, since without the wait most of the answers would arrive as well.
        for number in range(ROUNDS):
            answers: list[String] = []
            # It will hear of this subscription and of the question at about the same time.
            other.send_signal(signal.SIGSTOP)
            threading.Timer(0.05, other.send_signal, [signal.SIGCONT]).start()
            listener = node.create_subscription(String, "answer", answers.append, qos.SAMPLE)
            wait_until_known_to(node, ["other"], timeout_s=PATIENCE)
            question.publish(String(data=f"{number}"))
            eventually(spinner, partial(bool, answers), "an answer")
            assert answers == [String(data=f"{number}")]
            node.destroy_subscription(listener)


def test_when_a_node_gives_no_answer_expect_it_named_and_nothing_left_behind(
    node: Node, other: "subprocess.Popen[bytes]"
) -> None:
    sign = node.create_subscription(String, topics.alive("other"), print, qos.LATCHED)
    assert not wait_until_matched(node, subscriptions=[sign], timeout_s=PATIENCE)
    before = len(list(node.subscriptions))
    other.send_signal(signal.SIGSTOP)

    with pytest.raises(GraphError, match="no answer from other"):
        wait_until_known_to(node, ["other"], timeout_s=0.5)

    assert len(list(node.subscriptions)) == before
