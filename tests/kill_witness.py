"""Program for test_graph_kills.py: listens to a graph from outside.

It is a process of its own, since the middleware reads its profile once in each process, and the
tests' has done so long before. It prints a line when it listens, and when all nodes know that; one
for each transition of a node, like ``activating arm_sim``; one for each phase of a trial, like
``perturb 1``; and ``moving`` when it has seen more of a perturbation than a bag may lack. When it
is told to end (SIGTERM), it prints, as JSON, what it saw, each with the monotonic time of this
machine, which all processes share.
"""

import json
import sys
import time
from contextlib import suppress
from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from lifecycle_msgs.msg import TransitionEvent
from rclpy.context import Context
from rclpy.node import Node

from armimp_bringup.nodes import NODES
from armimp_common import topics
from armimp_common.errors import GraphError
from armimp_common.executor import run_node, steady_timer
from armimp_common.heartbeat import HeartbeatMonitor
from armimp_common.pubsub import subscribe, subscribe_decoded, wait_for_partners
from armimp_common.status import values_of
from armimp_common.topics import SIM_NODE
from support.graph import raised

JOINTS = ("shoulder", "elbow")
_MOVING = 300
"""Samples of a perturbation: three times as many as a bag may lack."""


def _tell(*words: object) -> None:
    print(*words, flush=True)


class Witness(Node):
    """Hears commands, perturbations, trial states, transitions and the simulator's reports."""

    def __init__(self, *, context: Context) -> None:
        super().__init__("witness", context=context)
        self._seen: dict[str, Any] = {
            "torques": [],
            "resting": True,
            "stamps": [],
            "statuses": [],
            "reports": [],
        }
        self._perturbed = 0
        subscribe_decoded(self, topics.COMMANDS, JOINTS, self._on_command, raised)
        subscribe_decoded(self, topics.PERTURBATION, JOINTS, self._on_perturbation, raised)
        subscribe(self, topics.TRIAL, self._on_trial)
        subscribe(self, topics.DIAGNOSTICS, self._on_diagnostics)
        self._monitors = [HeartbeatMonitor(self, name, lambda _: None) for name in NODES]
        for name in NODES:
            told, topic = partial(self._on_transition, name), f"{name}/transition_event"
            self.create_subscription(TransitionEvent, topic, told, 10)
        self._timer = steady_timer(self, 0.01, self._look_around)
        _tell("listens")

    def _look_around(self) -> None:
        if all(one.subscription.get_publisher_count() for one in self._monitors):
            self._timer.cancel()
            with suppress(GraphError):  # who was killed before does not answer any more
                wait_for_partners(self, monitors=self._monitors)
                _tell("known")

    def _on_transition(self, name: str, event: TransitionEvent) -> None:
        _tell(event.goal_state.label, name)

    def _on_perturbation(self, stamp_ns: int, torque: tuple[float, ...]) -> None:
        self._seen["stamps"].append((time.monotonic(), stamp_ns))
        self._perturbed += any(torque)
        if self._perturbed == _MOVING:
            _tell("moving")

    def _on_command(self, _: int, command: tuple[float, ...]) -> None:
        self._seen["resting"] = not any(command)
        if any(command):
            self._seen["torques"].append(time.monotonic())

    def _on_trial(self, message: DiagnosticStatus) -> None:
        values = values_of(message)
        self._seen["statuses"].append((time.monotonic(), values))
        _tell(values["phase"], values["trial"])

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name.startswith(SIM_NODE):
                applied = values_of(status).get("applied", "")
                self._seen["reports"].append((time.monotonic(), status.message, applied))

    def destroy_node(self) -> None:
        """Print what was seen, then destroy the node."""
        _tell(json.dumps(self._seen))
        super().destroy_node()


if __name__ == "__main__":
    sys.exit(run_node(Witness))
