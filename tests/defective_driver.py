"""The simulator with one defect that a driver may have: ``defective_driver.py DEFECT ...``."""

import sys
import threading
from collections import deque
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger

from armimp_common import qos, topics
from armimp_common.executor import run_node
from armimp_common.pubsub import CommandPublisher, JointStatePublisher
from armimp_common.realtime import Pacer
from armimp_common.topics import PERIOD_NS
from armimp_sim.node import ArmSimNode

Readings: TypeAlias = NDArray[np.float64]


class WrongField(ArmSimNode):
    """Sends torques as positions."""

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        result = super().on_configure(state)
        self.destroy_publisher(self.torque_sensors.publisher)
        names = self._settings.joints
        self.torque_sensors = JointStatePublisher(self, topics.TORQUE_SENSORS, names, "position")
        return result


class WrongSign(ArmSimNode):
    """Turns every torque round."""

    def _on_command(self, command: tuple[float, ...]) -> None:
        super()._on_command(tuple(-value for value in command))


class Altered(ArmSimNode):
    """Sends what it measures in some other way."""

    def _send(self) -> None:
        rig = self.limiter
        assert rig is not None
        self.tell(rig.tick, rig.stamp_ns, rig.position, rig.torque)

    def tell(self, tick: int, stamp_ns: int, angles: Readings, torques: Readings) -> None:
        """Send one sample; to be overridden."""
        self.joint_states.publish(stamp_ns, angles)
        self.torque_sensors.publish(stamp_ns, torques)

    def _renamed(self, topic: str, names: tuple[str, ...], profile: QoSProfile) -> None:
        """Make the publisher of the angles or of the torques anew."""
        angles = topic == topics.JOINT_STATES
        old = self.joint_states if angles else self.torque_sensors
        self.destroy_publisher(old.publisher)
        field = topics.VALUE_FIELD[topic]
        new = JointStatePublisher(self, topic, names, field, profile=profile)
        if angles:
            self.joint_states = new
        else:
            self.torque_sensors = new


class Degrees(Altered):
    """Angles in degrees."""

    def tell(self, tick: int, stamp_ns: int, angles: Readings, torques: Readings) -> None:
        super().tell(tick, stamp_ns, np.degrees(angles), torques)


class Unpaired(Altered):
    """Each message has the time of its sending."""

    def tell(self, tick: int, stamp_ns: int, angles: Readings, torques: Readings) -> None:
        self.joint_states.publish(stamp_ns, angles)
        self.torque_sensors.publish(stamp_ns + 20_000, torques)


class Doubled(Altered):
    """A sample comes twice now and then."""

    def tell(self, tick: int, stamp_ns: int, angles: Readings, torques: Readings) -> None:
        super().tell(tick, stamp_ns, angles, torques)
        if tick % 100 == 50:
            self.joint_states.publish(stamp_ns, angles)


class FastClock(Altered):
    """The clock of the stamps runs fast by a thousandth."""

    def tell(self, tick: int, stamp_ns: int, angles: Readings, torques: Readings) -> None:
        super().tell(tick, stamp_ns * 1001 // 1000, angles, torques)


class BackInTime(Altered):
    """The clock of the stamps is set back once."""

    def tell(self, tick: int, stamp_ns: int, angles: Readings, torques: Readings) -> None:
        super().tell(tick, stamp_ns - 10 * PERIOD_NS * (tick > 500), angles, torques)


class NotFinite(Altered):
    """A transducer has nothing to say once."""

    def tell(self, tick: int, stamp_ns: int, angles: Readings, torques: Readings) -> None:
        super().tell(tick, stamp_ns, angles, np.where(tick == 300, np.nan, torques))


class Wraps(Altered):
    """The counter of the shoulder wraps a bit above where it is."""

    def tell(self, tick: int, stamp_ns: int, angles: Readings, torques: Readings) -> None:
        turned = angles.copy()
        turned[0] -= 2.0 * np.pi * (angles[0] > 1.0950)
        super().tell(tick, stamp_ns, turned, torques)


class WrongName(Altered):
    """Torques of a joint that there is not."""

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        result = super().on_configure(state)
        self._renamed(topics.TORQUE_SENSORS, ("shoulder", "wrist"), qos.SAMPLE)
        return result


class BestEffort(Altered):
    """Angles by best effort."""

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        result = super().on_configure(state)
        profile = QoSProfile(depth=2000, reliability=ReliabilityPolicy.BEST_EFFORT)
        self._renamed(topics.JOINT_STATES, tuple(self._settings.joints), profile)
        return result


class SensorSign(Altered):
    """Transducers that read the torque of the arm on the robot."""

    def tell(self, tick: int, stamp_ns: int, angles: Readings, torques: Readings) -> None:
        super().tell(tick, stamp_ns, angles, -torques)


class TwoForOne(ArmSimNode):
    """Takes two steps for each command."""

    def _on_command(self, command: tuple[float, ...]) -> None:
        super()._on_command(command)
        super()._on_command(command)


class Swapped(ArmSimNode):
    """Commands in another order."""

    def _on_command(self, command: tuple[float, ...]) -> None:
        super()._on_command(command[::-1])


class Strong(ArmSimNode):
    """Takes newton metres for something far larger."""

    def _on_command(self, command: tuple[float, ...]) -> None:
        super()._on_command(tuple(150.0 * value for value in command))


class Late(ArmSimNode):
    """Six commands are always on their way."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self._queue: deque[tuple[float, ...]] = deque()

    def _on_command(self, command: tuple[float, ...]) -> None:
        self._queue.append(command)
        first = self._queue.popleft() if len(self._queue) > 6 else (0.0,) * len(command)
        super()._on_command(first)


class Moody(ArmSimNode):
    """Stops by itself after some time under torque."""

    _patience = 1000

    def _on_command(self, command: tuple[float, ...]) -> None:
        self._patience -= any(command)
        if self._patience == 0:
            self.latch("the mood")
        super()._on_command(command)


class Gullible(ArmSimNode):
    """Obeys whoever commands."""

    def accuse(self, reason: str) -> None:
        """Believe that it is well."""


class Mute(ArmSimNode):
    """Tells nobody of its faults."""

    def report(self) -> None:
        if self.limiter is not None:
            self.told, self._told_tick = self.limiter.fault, self.limiter.tick


class Stubborn(ArmSimNode):
    """Grants no reset."""

    def _on_reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success, response.message = False, "not today"
        return response


class Faulty(ArmSimNode):
    """Has a fault from the beginning."""

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        result = super().on_activate(state)
        self.latch("a cable is missing")
        return result


class NoStop(ArmSimNode):
    """Has no emergency stop."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        for service in list(self.services):
            if service.service_name.endswith(topics.SIM_STOP_SERVICE):
                self.destroy_service(service)


class DeafStop(ArmSimNode):
    """Says that it stops, and goes on."""

    def _on_stop(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success = True
        return response


class WrongType(LifecycleNode):
    """Takes the torque of each joint in a JointState, and sends angles without names."""

    def __init__(self, **options: Any) -> None:
        super().__init__(topics.SIM_NODE, **options)
        self._commands = self.create_subscription(JointState, topics.COMMANDS, lambda _: None, 10)
        self._sensors = self.create_publisher(Float64MultiArray, topics.JOINT_STATES, 10)


class Slow(Node):
    """No lifecycle node, no services, half the rate, and torques by best effort."""

    def __init__(self, **options: Any) -> None:
        super().__init__(topics.SIM_NODE, **options)
        names = ("shoulder", "elbow")
        hasty = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
        self._angles = JointStatePublisher(self, topics.JOINT_STATES, names, "position")
        self._torques = JointStatePublisher(
            self, topics.TORQUE_SENSORS, names, "effort", profile=hasty
        )
        self._listener = self.create_subscription(
            Float64MultiArray, topics.COMMANDS, lambda _: None, qos.SAMPLE
        )
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def destroy_node(self) -> None:
        self._ended.set()
        self._thread.join()
        super().destroy_node()

    def _run(self) -> None:
        pacer = Pacer(2 * PERIOD_NS)
        pacer.start()
        tick = 0
        while not self._ended.is_set():
            stamp_ns = 2 * PERIOD_NS * tick
            self._angles.publish(stamp_ns, (1.0, 1.0))
            self._torques.publish(stamp_ns, (0.0, 0.0))
            tick += 1
            pacer.wait(tick)


class InUse(Slow):
    """Somebody commands it already."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self._commander = CommandPublisher(self, topics.COMMANDS, 2)


KINDS = (ArmSimNode, WrongType, Slow, InUse)
DEFECTS: dict[str, Any] = {kind.__name__: kind for kind in KINDS}

if __name__ == "__main__":
    sys.exit(run_node(DEFECTS[sys.argv[1]], [sys.argv[0], *sys.argv[2:]]))
