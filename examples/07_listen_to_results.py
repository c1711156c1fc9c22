"""A node of your own in the graph: it listens to what the estimator publishes.

ROS_DOMAIN_ID=7 .venv/bin/python examples/07_listen_to_results.py &
.venv/bin/armimp run --duration 10 --domain-id 7
"""

import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.node import Node

from armimp_common import qos, topics


class Listener(Node):
    """Prints each column of the matrix as its trial ends, and the conclusion."""

    def __init__(self) -> None:
        super().__init__("listener")
        self.concluded = False
        # Results are latched: the quality of service has to ask for it (docs/interfaces.md).
        self.create_subscription(DiagnosticStatus, topics.RESULT, self._on_result, qos.LATCHED)
        self.get_logger().info("listens")

    def _on_result(self, message: DiagnosticStatus) -> None:
        print(f"{message.name}: {message.message}", flush=True)
        values = {item.key: item.value for item in message.values}
        if "lpm_full.K" in values:
            print("K row by row:", values["lpm_full.K"], "N·m/rad", flush=True)
            self.concluded = True


rclpy.init()
listener = Listener()
while rclpy.ok() and not listener.concluded:
    rclpy.spin_once(listener, timeout_sec=0.2)
listener.destroy_node()
rclpy.try_shutdown()
