"""The simulator with one defect that a driver may have: ``defective_driver.py DEFECT ...``."""

import sys
import threading
from typing import Any

from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger

from armimp_common import qos, topics
from armimp_common.executor import run_node
from armimp_common.pubsub import CommandPublisher, JointStatePublisher
from armimp_common.realtime import Pacer
from armimp_common.topics import PERIOD_NS
from armimp_sim.node import ArmSimNode


class Strong(ArmSimNode):
    """Takes newton metres for something far larger."""

    def _on_command(self, command: tuple[float, ...]) -> None:
        super()._on_command(tuple(150.0 * value for value in command))


class Stubborn(ArmSimNode):
    """Grants no reset."""

    def _on_reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success, response.message = False, "not today"
        return response


class DeafStop(ArmSimNode):
    """Says that it stops, and goes on."""

    def _on_stop(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success = True
        return response


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


DEFECTS: dict[str, Any] = {kind.__name__: kind for kind in (Slow, InUse)}

if __name__ == "__main__":
    sys.exit(run_node(DEFECTS[sys.argv[1]], [sys.argv[0], *sys.argv[2:]]))
