"""The checker's node: listens to a driver, answers it as a controller would, calls its services.

It only talks and records; nothing is judged here.
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from copy import copy
from functools import partial
from typing import NamedTuple, TypeAlias

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from rclpy.subscription import Subscription
from rclpy.task import Future
from std_srvs.srv import Trigger

from armimp_bringup.driver_check import SENSOR_TOPICS, Call, Endpoint, Message, readings
from armimp_bringup.graph import GraphContext
from armimp_common import qos, topics
from armimp_common.arrays import FloatArray
from armimp_common.cdr import decode_joint_state
from armimp_common.errors import InterruptionError, MalformedMessageError
from armimp_common.executor import Spinner
from armimp_common.pubsub import CommandPublisher, subscribe, subscribe_raw
from armimp_common.status import Level
from armimp_common.topics import JOINT_STATES, NS_PER_S

_NODE = "armimp_check_driver"
_FAREWELLS = 5  # zero commands sent when torque is let go
_TAKEN = "torque taken away"
Torque: TypeAlias = "tuple[float, ...]"
Step: TypeAlias = "tuple[int, Torque | None]"
"""A number of samples, and the torque that answers each of them; None: no answer."""


class Error(NamedTuple):
    """A status of level ERROR, and the monotonic time of its arrival, s."""

    when: float
    name: str
    message: str

    def __str__(self) -> str:
        """Return it in one line."""
        return f"{self.name}: {self.message}"


class MotionGuard:
    """The checker's own limit of motion, applied to every sample while torque may be commanded.

    Each joint may go as far as ``most``, rad, from where it was at the first sample.
    """

    def __init__(self, joints: Sequence[str], most: float) -> None:
        self._joints, self._most = tuple(joints), most
        self._first: FloatArray | None = None
        self.largest = 0.0  # rad, how far a joint has gone so far
        self.objection = ""  # why there must not be any torque any more

    def allows(self, message: Message | None) -> bool:
        """Check a message of ``joint_states``; return whether torque may be commanded."""
        angles = readings(self._joints, JOINT_STATES, [message])
        if not angles.size:
            self.objection = self.objection or f"the angles cannot be read: {_TAKEN}"
            return False
        self._first = angles if self._first is None else self._first
        for name, moved in zip(self._joints, np.abs(angles - self._first)[:, 0], strict=True):
            # Written so that NaN fails.
            if moved <= self._most:
                self.largest = max(self.largest, float(moved))
            elif not self.objection:
                self.objection = f"{name} went {moved:.3g} rad from where it was: {_TAKEN}"
        return not self.objection


class Answering(ABC):
    """Keeps the messages of a driver, and answers each sample with the torque that is set.

    Parameters
    ----------
    joints : names, in the order of commands
    """

    def __init__(self, joints: Sequence[str]) -> None:
        self.guard: MotionGuard | None = None  # when it objects, zero torque is the answer
        self.zero: Torque = (0.0,) * len(joints)
        self.torque: Torque | None = None  # answer to each sample outside of a script
        self.samples = 0  # complete samples that came
        # Monotonic times (s) of the last command, and of the last one before a silence.
        self.last_sent = self.silent_since = 0.0
        self.gap = 0.0  # s, longest time between two commands, without intended silences
        self.kept: dict[str, list[Message | None]] = {topic: [] for topic in SENSOR_TOPICS}
        self.script: deque[Step] = deque()  # answers to the next samples

    @abstractmethod
    def command(self, torque: Torque) -> None:
        """Command torques of the joints (n,), N·m."""

    def now_ns(self) -> int:
        """Return the time of a monotonic clock, ns."""
        return time.monotonic_ns()

    def now(self) -> float:
        """Return the time of the clock, s."""
        return self.now_ns() / NS_PER_S

    def answer(self) -> None:
        """Answer the newest sample."""
        torque = self.torque
        if self.script:
            count, torque = self.script.popleft()
            if count > 1:
                self.script.appendleft((count - 1, torque))
        if torque is None:
            self.silent_since = self.last_sent or self.silent_since
            self.last_sent = 0.0
            return
        if self.guard is not None and self.guard.objection:
            torque = self.zero
        self.command(torque)
        now = self.now()
        if self.last_sent:
            self.gap = max(self.gap, now - self.last_sent)
        self.last_sent = now

    def let_go(self) -> None:
        """Drop the script, and command zero torque now, several times."""
        self.script.clear()
        for _ in range(_FAREWELLS):
            self.command(self.zero)
            time.sleep(0.005)

    def hear(self, topic: str, data: bytes) -> None:
        """Take a message of a sensor stream; answer if it makes a sample complete."""
        message = None
        with suppress(MalformedMessageError):
            message = Message(self.now_ns(), *decode_joint_state(data))
        self.kept[topic].append(message)
        guard = self.guard
        if guard is not None and topic == JOINT_STATES and not guard.allows(message):
            self.script.clear()
        # A sample is complete with the second of its two messages, in either order. Stamps are not
        # used to pair them, as they are still to be judged.
        complete = min(map(len, self.kept.values()))
        if complete > self.samples:
            self.samples = complete
            self.answer()


class Conversation(Node, Answering):
    """The node that talks with a driver.

    ``joints`` are in the order of commands; ``interrupted`` returns whether the user wants to end.
    """

    def __init__(
        self,
        graph: GraphContext,
        joints: Sequence[str],
        namespace: str,
        interrupted: Callable[[], bool],
    ) -> None:
        super().__init__(
            _NODE, namespace=namespace, context=graph.context, use_global_arguments=False
        )
        Answering.__init__(self, joints)
        self._interrupted: Callable[[], bool] | None = interrupted
        self.errors: list[Error] = []
        self._sensors: list[Subscription] = []
        self._triggers = {
            name: self.create_client(Trigger, name)
            for name in (topics.SIM_STOP_SERVICE, topics.SIM_RESET_SERVICE)
        }
        subscribe(self, topics.DIAGNOSTICS, self._on_diagnostics)
        self.spinner = Spinner([self])

    def listen(self) -> None:
        """Subscribe to the sensor streams, as reliably as offered; create the command publisher."""
        # Not earlier: a driver that is in use takes a second publisher for a fault.
        self._commands = CommandPublisher(self, topics.COMMANDS, len(self.zero))
        for topic in SENSOR_TOPICS:
            offered = self.get_publishers_info_by_topic(topic)
            kinds = {info.qos_profile.reliability for info in offered}
            profile = copy(qos.SAMPLE)
            # A subscriber that requests more than is offered receives nothing at all.
            if ReliabilityPolicy.BEST_EFFORT in kinds:
                profile.reliability = ReliabilityPolicy.BEST_EFFORT
            self._sensors.append(
                subscribe_raw(self, topic, partial(self.hear, topic), profile=profile)
            )

    @contextmanager
    def intruder(self, patience: float) -> Iterator[None]:
        """Provide a second publisher of commands, which sends one command of zero torque."""
        second = CommandPublisher(self, topics.COMMANDS, len(self.zero))
        heard = self._commands.publisher.get_subscription_count()
        try:
            self.wait(lambda: second.publisher.get_subscription_count() >= heard, patience)
            second.publish(self.zero)
            yield
        finally:
            self.destroy_publisher(second.publisher)

    def endpoints(self) -> list[Endpoint]:
        """Return who publishes and listens on the topics of a driver, apart from this node."""
        found: list[Endpoint] = []
        for topic in (*SENSOR_TOPICS, topics.COMMANDS):
            publishers = self.get_publishers_info_by_topic(topic)
            for info in (*publishers, *self.get_subscriptions_info_by_topic(topic)):
                place, profile = info.node_namespace.rstrip("/"), info.qos_profile
                end = Endpoint(
                    topic,
                    "publisher" if info in publishers else "subscriber",
                    f"{place}/{info.node_name}",
                    info.topic_type,
                    reliable=profile.reliability is not ReliabilityPolicy.BEST_EFFORT,
                    transient=profile.durability is DurabilityPolicy.TRANSIENT_LOCAL,
                )
                found += [end] if info.node_name != _NODE else []
        return found

    def safety_services(self) -> frozenset[str]:
        """Return the safety services that are there."""
        # The graph's lists of services would hold the clients of this node, too.
        clients = self._triggers.items()
        return frozenset(name for name, client in clients if client.service_is_ready())

    def call(self, service: str, patience: float, since: float | None = None) -> Call:
        """Call a service and wait for the answer, whose time counts from now or ``since``."""
        begin = self.now() if since is None else since
        client = self._triggers[service]
        if not client.service_is_ready():
            return Call(success=None)
        future: Future = client.call_async(Trigger.Request())
        done = self.spinner.spin_until(future, patience)
        self.check()
        if not done:
            return Call(success=None)
        answer = future.result()
        return Call(bool(answer.success), str(answer.message), self.now() - begin)

    def wait(self, condition: Callable[[], bool], patience: float) -> bool:
        """Spin until a condition is met or a time (s) is over; return whether it is met."""
        end = time.monotonic() + patience

        def over() -> bool:
            return condition() or time.monotonic() > end or self._stopped()

        self.spinner.spin(over, period=0.005)
        self.check()
        return condition()

    def check(self) -> None:
        """Raise an InterruptionError if the user wants to end.

        It is raised between two callbacks, and only once, as torque has to be removed afterwards.
        """
        if self._stopped():
            self._interrupted = None
            raise InterruptionError("interrupted")

    def _stopped(self) -> bool:
        return self._interrupted is not None and self._interrupted()

    def close(self) -> None:
        """Leave the graph."""
        self.spinner.close()
        self.destroy_node()

    def command(self, torque: Torque) -> None:
        """Publish torques of the joints (n,), N·m."""
        self._commands.publish(torque)

    def _on_diagnostics(self, array: DiagnosticArray) -> None:
        for status in array.status:
            if status.level == bytes([Level.ERROR]):
                self.errors.append(Error(self.now(), status.name, status.message))
