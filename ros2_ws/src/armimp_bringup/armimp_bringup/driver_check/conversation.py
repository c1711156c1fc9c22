"""The checker's node: listens to a driver, answers it as a controller would, calls its services.

It only talks and records; nothing is judged here.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from typing import Any, NamedTuple

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from rclpy.task import Future
from rclpy.topic_endpoint_info import TopicEndpointInfo
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from std_srvs.srv import Trigger

from armimp_bringup.driver_check.guard import MotionGuard
from armimp_bringup.driver_check.samples import SENSOR_TOPICS, Call, Endpoint, Message
from armimp_bringup.graph import GraphContext
from armimp_common import qos, topics
from armimp_common.errors import MalformedMessageError
from armimp_common.executor import Spinner
from armimp_common.pubsub import CommandPublisher, RawSubscription
from armimp_common.status import Level, TimingFigures, to_ns, values_of

_NODE = "armimp_check_driver"
_FAREWELLS = 5


class Error(NamedTuple):
    """A status of level ERROR.

    Attributes
    ----------
    when : monotonic time of its arrival (s)
    name, message : its words
    """

    when: float
    name: str
    message: str

    def __str__(self) -> str:
        """Say it in one line."""
        return f"{self.name}: {self.message}"


class Conversation(Node):
    """Keeps what a driver sends, and answers each sample with the torque that is set.

    Parameters
    ----------
    graph : GraphContext
    joints : names, in the order of commands
    namespace : of the driver

    Attributes
    ----------
    guard : asked about each sample of the angles; when it objects, zero torque is the answer
    torque : answer to each sample (n,), N·m, beside a script; None: no answer
    samples : complete samples that came
    answered : commands sent
    last_sent : monotonic time of the last command (s)
    silent_since : the same, of the last command before samples were left without answer
    gap : longest time between two commands that was not meant to be longer (s); may be set back
    errors : statuses of level ERROR that came
    timing : what the driver last reported of its timing
    process : identity of the driver's process, as its sign of life has it; empty without
    """

    def __init__(self, graph: GraphContext, joints: Sequence[str], namespace: str = "") -> None:
        super().__init__(
            _NODE, namespace=namespace, context=graph.context, use_global_arguments=False
        )
        self.guard: MotionGuard | None = None
        self._zero = (0.0,) * len(joints)
        self.torque: tuple[float, ...] | None = None
        self.samples = self.answered = 0
        self.last_sent = self.silent_since = 0.0
        self.gap = 0.0
        self.errors: list[Error] = []
        self.timing: TimingFigures | None = None
        self.process = ""
        self._raw: dict[str, list[tuple[int, bytes]]] = {topic: [] for topic in SENSOR_TOPICS}
        self._script: deque[tuple[int, tuple[float, ...] | None]] = deque()
        self._subscriptions_by_topic: dict[str, RawSubscription] = {}
        self._clients_by_service = {
            name: self.create_client(Trigger, name)
            for name in (topics.SIM_STOP_SERVICE, topics.SIM_RESET_SERVICE)
        }
        self.create_subscription(
            DiagnosticArray, topics.DIAGNOSTICS, self._on_diagnostics, qos.DIAGNOSTICS
        )

        self.create_subscription(String, topics.alive(topics.SIM_NODE), self._on_alive, qos.LATCHED)

    def listen(self) -> None:
        """Subscribe to the sensor streams, with the reliability that is offered, and command."""
        # Not before: a driver that is in use takes a second publisher for a fault.
        self._commands = CommandPublisher(self, topics.COMMANDS, len(self._zero))
        for topic in SENSOR_TOPICS:
            offered = self.get_publishers_info_by_topic(self._resolved(topic))
            best_effort = any(
                info.qos_profile.reliability is ReliabilityPolicy.BEST_EFFORT for info in offered
            )
            # A reader that asks for more than is offered hears nothing at all.
            profile = QoSProfile(
                history=qos.SAMPLE.history,
                depth=qos.SAMPLE.depth,
                reliability=ReliabilityPolicy.BEST_EFFORT
                if best_effort
                else ReliabilityPolicy.RELIABLE,
            )
            self._subscriptions_by_topic[topic] = RawSubscription(
                self, topic, JointState, partial(self._on_sensor, topic), profile=profile
            )

    def play(self, script: Iterable[tuple[int, tuple[float, ...] | None]]) -> None:
        """Answer so many samples with each of these torques (n,), N·m; None: not at all."""
        self._script.extend(script)

    @property
    def playing(self) -> bool:
        """Whether the script is not over."""
        return bool(self._script)

    def drop(self) -> None:
        """Forget the rest of the script."""
        self._script.clear()

    def answer(self) -> None:
        """Answer the newest sample; done as it comes, and again to set time going in lockstep."""
        torque = self.torque
        if self._script:
            count, torque = self._script.popleft()
            if count > 1:
                self._script.appendleft((count - 1, torque))
        if torque is None:
            self.silent_since = self.last_sent or self.silent_since
            self.last_sent = 0.0
            return
        if self.guard is not None and self.guard.reason:
            torque = self._zero
        self.answered += 1
        self._commands.publish(torque)
        now = time.monotonic()
        if self.last_sent:
            self.gap = max(self.gap, now - self.last_sent)
        self.last_sent = now

    def let_go(self) -> None:
        """Command zero torque now, more than once, whatever else there was to be done."""
        self.drop()
        for _ in range(_FAREWELLS):
            self._commands.publish(self._zero)
            time.sleep(0.005)

    @contextmanager
    def intruder(self, spinner: Spinner, patience: float) -> Iterator[None]:
        """Have a second publisher of commands, which has sent one of zero torque."""
        second = CommandPublisher(self, topics.COMMANDS, len(self._zero))
        heard = self._commands.publisher.get_subscription_count()
        try:
            self.wait(spinner, lambda: second.publisher.get_subscription_count() >= heard, patience)
            second.publish(self._zero)
            yield
        finally:
            self.destroy_publisher(second.publisher)

    def messages(self, topic: str) -> int:
        """Number of messages that came."""
        return len(self._raw[topic])

    def recent(self, topic: str, count: int, step: int) -> list[bytes]:
        """Every so many-th of the last messages."""
        return [data for _, data in self._raw[topic][-count::step]]

    def recorded(self) -> tuple[dict[str, list[Message]], dict[str, int]]:
        """Return the messages by topic, and the numbers of those that cannot be decoded."""
        streams: dict[str, list[Message]] = {topic: [] for topic in SENSOR_TOPICS}
        malformed = dict.fromkeys(SENSOR_TOPICS, 0)
        for topic, kept in self._raw.items():
            for arrival_ns, data in list(kept):
                message = _message(arrival_ns, data)
                if message is None:
                    malformed[topic] += 1
                else:
                    streams[topic].append(message)
        return streams, malformed

    def endpoints(self) -> list[Endpoint]:
        """Return who publishes and listens on the topics of a driver, apart from this node."""
        found: list[Endpoint] = []
        for topic in (*SENSOR_TOPICS, topics.COMMANDS):
            resolved = self._resolved(topic)
            for role, infos in (
                ("publisher", self.get_publishers_info_by_topic(resolved)),
                ("subscriber", self.get_subscriptions_info_by_topic(resolved)),
            ):
                found += [_endpoint(topic, role, info) for info in infos if info.node_name != _NODE]
        return found

    def safety_services(self) -> frozenset[str]:
        """Return the safety services that are there."""
        # Lists of the graph would hold the clients of this node, too.
        clients = self._clients_by_service.items()
        return frozenset(name for name, client in clients if client.service_is_ready())

    def ask(self, service: str) -> Future | None:
        """Call a service, None if it is not there."""
        client = self._clients_by_service[service]
        return client.call_async(Trigger.Request()) if client.service_is_ready() else None

    def call(self, service: str, spinner: Spinner, patience: float) -> Call:
        """Call a service and wait for the answer."""
        begin = time.monotonic()
        future = self.ask(service)
        if future is None or not spinner.spin_until(future, patience):
            return Call(success=None)
        return answered(future, time.monotonic() - begin)

    @staticmethod
    def wait(spinner: Spinner, condition: Callable[[], bool], patience: float) -> bool:
        """Spin until a condition is met or a time (s) is over, and tell whether it is met."""
        end = time.monotonic() + patience
        spinner.spin(lambda: condition() or time.monotonic() > end, period=0.005)
        return condition()

    def _resolved(self, topic: str) -> str:
        return str(self.resolve_topic_name(topic))

    def _on_sensor(self, topic: str, data: bytes) -> None:
        self._raw[topic].append((time.monotonic_ns(), data))
        if self.guard is not None and topic == topics.JOINT_STATES and not self.guard.look(data):
            self.drop()
        # A sample is complete with the second of its two messages, in either order. Stamps are what
        # is to be judged, so they are not asked.
        complete = min(len(kept) for kept in self._raw.values())
        if complete > self.samples:
            self.samples = complete
            self.answer()

    def _on_alive(self, message: String) -> None:
        self.process = message.data

    def _on_diagnostics(self, array: DiagnosticArray) -> None:
        for status in array.status:
            if status.level == bytes([Level.ERROR]):
                self.errors.append(Error(time.monotonic(), status.name, status.message))
            if status.name == TimingFigures.STATUS_NAME:
                try:
                    self.timing = TimingFigures.from_values(values_of(status))
                except MalformedMessageError:
                    continue


def answered(future: Future, seconds: float) -> Call:
    """Return what a finished call of a service brought."""
    answer = future.result()
    return Call(success=bool(answer.success), message=str(answer.message), seconds=seconds)


def _message(arrival_ns: int, data: bytes) -> Message | None:
    try:
        message: Any = deserialize_message(data, JointState)
        names = tuple(str(name) for name in message.name)
    except Exception:  # noqa: BLE001 (of whatever kind: foreign bytes are the finding)
        return None
    return Message(
        arrival_ns=arrival_ns,
        stamp_ns=to_ns(message.header.stamp),
        names=names,
        position=tuple(float(value) for value in message.position),
        effort=tuple(float(value) for value in message.effort),
    )


def _endpoint(topic: str, role: Any, info: TopicEndpointInfo) -> Endpoint:
    profile = info.qos_profile
    return Endpoint(
        topic=topic,
        role=role,
        node=f"{info.node_namespace.rstrip('/')}/{info.node_name}",
        type=info.topic_type,
        reliable=profile.reliability is not ReliabilityPolicy.BEST_EFFORT,
        transient=profile.durability is DurabilityPolicy.TRANSIENT_LOCAL,
        # Fast DDS does not tell of history and depth, which comes as a depth of 0.
        depth=profile.depth or None,
    )
