"""The simulator with one defect that a driver may have: ``defective_driver.py DEFECT ...``."""

import sys
from typing import Any

from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger

from armimp_common import contract
from armimp_common.channels import JointStatePublisher
from armimp_common.spin import run_node
from armimp_sim.node import ArmSimNode


class WrongField(ArmSimNode):
    """Sends torques as positions."""

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        result = super().on_configure(state)
        self.destroy_publisher(self._torque_sensors.publisher)
        names = self._settings.joints
        self._torque_sensors = JointStatePublisher(self, contract.TORQUE_SENSORS, names, "position")
        return result


class WrongSign(ArmSimNode):
    """Turns every torque round."""

    def _on_command(self, command: tuple[float, ...]) -> None:
        super()._on_command(tuple(-value for value in command))


class NoStop(ArmSimNode):
    """Has no emergency stop."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        for service in list(self.services):
            if service.service_name.endswith(contract.SIM_STOP_SERVICE):
                self.destroy_service(service)


class DeafStop(ArmSimNode):
    """Says that it stops, and goes on."""

    def _on_emergency_stop(
        self, request: Trigger.Request, response: Trigger.Response
    ) -> Trigger.Response:
        response.success = True
        return response


class WrongType(LifecycleNode):
    """Takes the torque of each joint in a JointState, and sends angles without names."""

    def __init__(self, **options: Any) -> None:
        super().__init__(contract.SIM_NODE, **options)
        self._commands = self.create_subscription(JointState, contract.COMMANDS, lambda _: None, 10)
        self._sensors = self.create_publisher(Float64MultiArray, contract.JOINT_STATES, 10)


DEFECTS = {kind.__name__: kind for kind in (WrongField, WrongSign, NoStop, DeafStop, WrongType)}

if __name__ == "__main__":
    sys.exit(run_node(DEFECTS[sys.argv[1]], [sys.argv[0], *sys.argv[2:]]))
