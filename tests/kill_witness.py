"""Program for test_graph_kills.py: listens to a graph from outside, ``kill_witness.py FILE``.

It is a process of its own, since the middleware reads its profile once in each process, and the
tests' has done so long before. When its node is up the file exists, empty. When the nodes know of
its subscriptions, so that it will miss nothing, so does ``FILE.known``; when it has seen more of a
perturbation than a bag may lack, ``FILE.moving``. When it is told to end
(SIGTERM), it writes into FILE, as JSON, what it saw, each with the monotonic time of this machine,
which all processes share.
"""

import json
import sys
import time
from contextlib import suppress
from pathlib import Path

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.context import Context
from rclpy.node import Node

from armimp_common import qos, topics
from armimp_common.errors import GraphError, MalformedMessageError
from armimp_common.executor import run_node, steady_timer
from armimp_common.heartbeat import HeartbeatMonitor
from armimp_common.pubsub import (
    publisher_count,
    subscribe_commands,
    subscribe_joint_states,
    wait_for_partners,
)
from armimp_common.status import values_of
from armimp_common.topics import CONTROLLER_NODE, SIM_NODE

JOINTS = ("shoulder", "elbow")
_MOVING = 300
"""Samples of a perturbation: three times as many as a bag may lack."""


def _raise(error: MalformedMessageError) -> None:
    raise error


class Witness(Node):
    """Hears commands, perturbations, trial states and the simulator's reports."""

    def __init__(self, file: Path, *, context: Context) -> None:
        super().__init__("witness", context=context)
        self._file = file
        self._torques: list[float] = []
        self._resting = True
        self._stamps: list[tuple[float, int]] = []
        self._perturbed = 0
        self._statuses: list[tuple[float, dict[str, str]]] = []
        self._reports: list[tuple[float, str, str]] = []
        self._subscriptions = [
            subscribe_commands(self, topics.COMMANDS, len(JOINTS), self._on_command, _raise),
            subscribe_joint_states(
                self,
                topics.PERTURBATION,
                JOINTS,
                "effort",
                self._on_perturbation,
                _raise,
            ),
            self.create_subscription(DiagnosticStatus, topics.TRIAL, self._on_trial, qos.LATCHED),
            self.create_subscription(
                DiagnosticArray, topics.DIAGNOSTICS, self._on_diagnostics, qos.DIAGNOSTICS
            ),
        ]
        self._others = [
            HeartbeatMonitor(self, name, lambda _: None) for name in (SIM_NODE, CONTROLLER_NODE)
        ]
        self._timer = steady_timer(self, 0.01, self._look_around)
        file.touch()

    def _look_around(self) -> None:
        if all(publisher_count(self, one) for one in self._subscriptions):
            self._timer.cancel()
            with suppress(GraphError):  # who was killed before does not answer any more
                wait_for_partners(self, monitors=self._others)
                self._file.with_suffix(".known").touch()

    def _on_perturbation(self, stamp_ns: int, torque: tuple[float, ...]) -> None:
        self._stamps.append((time.monotonic(), stamp_ns))
        self._perturbed += any(torque)
        if self._perturbed == _MOVING:
            self._file.with_suffix(".moving").touch()

    def _on_command(self, _: int, command: tuple[float, ...]) -> None:
        self._resting = not any(command)
        if not self._resting:
            self._torques.append(time.monotonic())

    def _on_trial(self, message: DiagnosticStatus) -> None:
        self._statuses.append((time.monotonic(), values_of(message)))

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name.startswith(SIM_NODE):
                applied = values_of(status).get("applied", "")
                self._reports.append((time.monotonic(), status.message, applied))

    def destroy_node(self) -> None:
        """Leave what was seen behind."""
        seen = {
            "torques": self._torques,
            "resting": self._resting,
            "stamps": self._stamps,
            "statuses": self._statuses,
            "reports": self._reports,
        }
        self._file.write_text(json.dumps(seen))
        super().destroy_node()


if __name__ == "__main__":
    place = Path(sys.argv[1])
    sys.exit(run_node(lambda *, context: Witness(place, context=context), sys.argv[:1]))
