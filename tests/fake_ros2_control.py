"""A robot as ros2_control shows it: one joint state for everything, and efforts that are held.

Topics, quality of service and habits are those of joint_state_broadcaster and
forward_command_controller; the rig behind them is the simulated one.
"""

import random
import sys
from typing import Any

from rclpy.node import Node
from rclpy.qos import qos_profile_system_default
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from armimp_common.executor import run_node, steady_timer
from armimp_common.status import to_time
from armimp_common.topics import PERIOD, PERIOD_NS
from armimp_ros2_control.node import EFFORTS, STATES
from armimp_sim.parameters import SimulatorParameters
from armimp_sim.simulator import SimulatedRig

NAMES = ("exo_elbow", "camera_pan", "exo_shoulder")
_EPOCH_NS = 1_700_000_000_000_000_000
_JITTER_NS = 50_000


class FakeRobot(Node):
    """Publishes each millisecond, whoever listens, and holds the last efforts for ever."""

    def __init__(self, **options: Any) -> None:
        super().__init__("controller_manager", **options)
        self._rig = SimulatedRig(SimulatorParameters.preset())
        self._efforts = [0.0, 0.0]
        self._states = self.create_publisher(JointState, STATES, qos_profile_system_default)
        self._listener = self.create_subscription(
            Float64MultiArray, EFFORTS, self._on_efforts, qos_profile_system_default
        )
        self._random = random.Random(1)
        self._timer = steady_timer(self, PERIOD, self._on_timer)

    def _on_efforts(self, message: Float64MultiArray) -> None:
        if len(message.data) == len(self._efforts):
            self._efforts = list(message.data)

    def _on_timer(self) -> None:
        shoulder, elbow = self._rig.position.tolist()
        torques = self._rig.torque.tolist()
        state = JointState(name=NAMES, velocity=[0.0] * 3)
        stamp_ns = self._rig.tick * PERIOD_NS + self._random.randint(0, _JITTER_NS)
        state.header.stamp = to_time(_EPOCH_NS + stamp_ns)
        state.position = [elbow, float("nan"), shoulder]
        state.effort = [torques[1], float("nan"), torques[0]]
        self._states.publish(state)
        self._rig.step(self._efforts)


if __name__ == "__main__":
    sys.exit(run_node(FakeRobot))
