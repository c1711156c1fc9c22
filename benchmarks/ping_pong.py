"""The bare exchange of the messages of an experiment in lockstep, and nothing else.

Three nodes exchange the four streams of the contract, in its message types, as bytes that were made
beforehand: no plant, no law, no decoding, no bag. The time of a tick here is the lower bound for a
tick of the node graph on this machine at this moment.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Mapping
from typing import Any, Final

from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, UInt64

from armimp_common import qos, topics
from armimp_common.cdr import CommandEncoder, JointStateEncoder
from armimp_common.executor import run_node, steady_timer

PING, PONG, TAP = NAMES = ("ping", "pong", "tap")
TOOK: Final = "ping/took"
"""Topic of the wall time that all exchanges took, ns."""
READY: Final = "pong/ready"
"""Topic on which the answering node tells that its answers will reach everybody."""
BACKLOG: Final = 45
"""Exchanges that may be ahead of what the listener has acknowledged, as in the graph."""

_TYPES: Final[Mapping[str, type[Any]]] = {
    topics.JOINT_STATES: JointState,
    topics.TORQUE_SENSORS: JointState,
    topics.COMMANDS: Float64MultiArray,
    topics.PERTURBATION: JointState,
}


class _Bare(Node):
    """Base of the nodes: publishers and subscriptions of raw bytes for the streams."""

    def __init__(self, name: str, **kwargs: Any) -> None:
        super().__init__(name, **kwargs)
        self.joints = int(self.declare_parameter("joints", 2).value)

    def stream(self, topic: str) -> tuple[Any, bytes]:
        """Publisher of a topic, and a message for it."""
        publisher = self.create_publisher(_TYPES[topic], topic, qos.SAMPLE)
        values = [0.1] * self.joints
        if topic == topics.COMMANDS:
            return publisher, CommandEncoder(self.joints).encode(values)
        names = [f"joint_{i + 1}" for i in range(self.joints)]
        encoder = JointStateEncoder(names, topics.VALUE_FIELD[topic])
        return publisher, encoder.encode(0, values)

    def listen(self, topic: str, callback: Callable[[bytes], None]) -> None:
        """Subscribe to a topic."""
        self.create_subscription(_TYPES[topic], topic, callback, qos.SAMPLE, raw=True)


class PingNode(_Bare):
    """Takes the place of the simulator: two messages out, one command back, then the next two."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(PING, **kwargs)
        self._exchanges = int(self.declare_parameter("exchanges", 1000).value)
        self._done = self._acknowledged = 0
        self._held = self._awaited = False
        self._streams = [
            self.stream(topic) for topic in (topics.JOINT_STATES, topics.TORQUE_SENSORS)
        ]
        self._result = self.create_publisher(UInt64, TOOK, qos.LATCHED)
        self.listen(topics.COMMANDS, self._on_command)
        self.create_subscription(UInt64, topics.RECEIVED, self._on_received, qos.LATCHED)
        self.create_subscription(UInt64, READY, self._on_ready, qos.LATCHED)
        self._start = steady_timer(self, 0.02, self._begin)

    def _begin(self) -> None:
        publishers = [publisher for publisher, _ in self._streams]
        ready = all(publisher.get_subscription_count() == 2 for publisher in publishers)
        if not (ready and self._awaited and self._acknowledged):
            return
        self.destroy_timer(self._start)
        self._began = time.monotonic_ns()
        self._ping()

    def _on_ready(self, _: UInt64) -> None:
        self._awaited = True

    def _ping(self) -> None:
        for publisher, message in self._streams:
            publisher.publish(message)

    def _on_command(self, _: bytes) -> None:
        self._done += 1
        if self._done == self._exchanges:
            self._result.publish(UInt64(data=time.monotonic_ns() - self._began))
        elif self._done < self._exchanges:
            self._held = self._done + 1 >= self._acknowledged + BACKLOG
            if not self._held:
                self._ping()

    def _on_received(self, message: UInt64) -> None:
        self._acknowledged = message.data
        if self._held and self._done < self._exchanges:
            self._held = False
            self._ping()


class PongNode(_Bare):
    """Takes the place of the controller: answers each pair of messages with another."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(PONG, **kwargs)
        self._heard = 0
        self._streams = [self.stream(topic) for topic in (topics.COMMANDS, topics.PERTURBATION)]
        for topic in (topics.JOINT_STATES, topics.TORQUE_SENSORS):
            self.listen(topic, self._on_message)
        # As in the controller, which monitors whether samples are still recorded.
        self.create_subscription(UInt64, topics.RECEIVED, lambda _: None, qos.LATCHED)
        self._ready = self.create_publisher(UInt64, READY, qos.LATCHED)
        self._start = steady_timer(self, 0.02, self._begin)

    def _begin(self) -> None:
        # Ping and tap listen to commands, tap to perturbations, too. Messages published before the
        # subscriptions are known would be lost for good.
        if [publisher.get_subscription_count() for publisher, _ in self._streams] == [2, 1]:
            self.destroy_timer(self._start)
            self._ready.publish(UInt64(data=1))

    def _on_message(self, _: bytes) -> None:
        self._heard += 1
        if self._heard % 2 == 0:
            for publisher, message in self._streams:
                publisher.publish(message)


class TapNode(_Bare):
    """Takes the place of the recorder: hears everything, and acknowledges it."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(TAP, **kwargs)
        self._heard = 0
        self._received = self.create_publisher(UInt64, topics.RECEIVED, qos.LATCHED)
        for topic in _TYPES:
            self.listen(topic, self._on_message)
        self._start = steady_timer(self, 0.02, self._begin)

    def _begin(self) -> None:
        if all(self.count_publishers(topic) for topic in _TYPES):
            self.destroy_timer(self._start)
            self._received.publish(UInt64(data=1))

    def _on_message(self, _: bytes) -> None:
        self._heard += 1
        if self._heard % (4 * topics.RECEIVED_EVERY) == 0:
            self._received.publish(UInt64(data=self._heard // 4))


CLASSES: Final[Mapping[str, Callable[..., Node]]] = {PING: PingNode, PONG: PongNode, TAP: TapNode}


def main() -> int:
    """Run the node that the first argument names as a process."""
    name = sys.argv.pop(1)
    return run_node(CLASSES[name])


if __name__ == "__main__":
    sys.exit(main())
