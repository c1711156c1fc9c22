"""The simulator with one defect that a driver may have: ``defective_driver.py DEFECT ...``."""

import sys
import threading
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


class BestEffort(ArmSimNode):
    """Angles by best effort."""

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        result = super().on_configure(state)
        profile = QoSProfile(depth=2000, reliability=ReliabilityPolicy.BEST_EFFORT)
        self.destroy_publisher(self.joint_states.publisher)
        self.joint_states = JointStatePublisher(
            self, topics.JOINT_STATES, self._settings.joints, "position", profile=profile
        )
        return result


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
