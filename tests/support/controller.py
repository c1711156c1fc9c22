"""Controller parameters for short trials, and a stand-ins for those who talk to a node."""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn
from rclpy.node import Node
from std_srvs.srv import Trigger

from armimp_common import topics
from armimp_common.executor import Spinner
from armimp_common.pubsub import (
    CommandPublisher,
    create_publisher,
    subscribe,
    subscribe_decoded,
    wait_for_partners,
)
from armimp_common.status import Level, values_of
from armimp_common.topics import JOINT_STATES, TORQUE_SENSORS
from armimp_control.parameters import ControllerParameters
from armimp_control.sequence import SequenceParameters
from support import laws
from support.graph import PATIENCE, eventually, raised

NAMES = ("shoulder", "elbow")
POSTURE = tuple(laws.POSTURE.tolist())
SUCCESS, FAILURE = TransitionCallbackReturn.SUCCESS, TransitionCallbackReturn.FAILURE
Sample = tuple[int, tuple[float, ...]]


def controller_parameters(
    *ticks: int, law: Any = "observer", **groups: Any
) -> ControllerParameters:
    """Parameters for robot and arm of the study; `ticks` of settling, perturbation and rest."""
    preset = ControllerParameters.preset(
        joints=NAMES,
        posture=laws.POSTURE,
        robot_inertia=laws.ROBOT,
        arm_inertia=laws.ARM,
        seed=1,
        law=law,
    )
    if ticks:
        settle, perturb, rest = (count / 1000 for count in ticks)
        groups["sequence"] = SequenceParameters(duration=perturb, settle=settle, rest=rest)
    return preset.model_copy(update=groups)


def wobble(ticks: int) -> list[tuple[tuple[float, ...], tuple[float, ...]]]:
    """Angles of an arm that moves a little, and torques on it."""
    rng = np.random.default_rng(4)
    theta = POSTURE + np.cumsum(rng.normal(scale=1e-6, size=(ticks, 2)), axis=0)
    tau_h = rng.normal(scale=0.1, size=(ticks, 2))
    return [(tuple(a), tuple(b)) for a, b in zip(theta.tolist(), tau_h.tolist(), strict=True)]


class Partner:
    """A node of a test that talks to those which are tested."""

    def __init__(self, node: Node, spinner: Spinner) -> None:
        self.node, self.spinner = node, spinner

    def until(self, condition: Callable[[], bool], what: str) -> None:
        eventually(self.spinner, condition, what)

    def call(self, service: str) -> tuple[bool, str]:
        """Call a service without arguments; return whether it succeeded, and its message."""
        client = self.node.create_client(Trigger, service)
        self.until(client.service_is_ready, f"the service {service}")
        future = client.call_async(Trigger.Request())
        assert self.spinner.spin_until(future, PATIENCE)
        response = future.result()
        return response.success, response.message


class ScriptedController(Partner):
    """Stand-in for controller, recorder and operator: commands a rig and keeps its messages."""

    def __init__(self, node: Node, spinner: Spinner) -> None:
        super().__init__(node, spinner)
        self.answer: tuple[float, ...] | None = None
        self.diagnostics: list[DiagnosticStatus] = []
        self.positions: list[Sample] = []
        self.torques: list[Sample] = []
        self.samples = {JOINT_STATES: self.positions, TORQUE_SENSORS: self.torques}
        self.commands = CommandPublisher(node, topics.COMMANDS, len(NAMES))
        self.received = create_publisher(node, topics.RECEIVED)
        self.subscriptions = [
            subscribe_decoded(node, topic, NAMES, partial(self.on_sample, topic), raised)
            for topic in self.samples
        ]
        self.subscriptions.append(subscribe(node, topics.DIAGNOSTICS, self._on_diagnostics))

    def on_sample(self, topic: str, stamp_ns: int, values: tuple[float, ...]) -> None:
        self.samples[topic].append((stamp_ns, values))
        if topic == TORQUE_SENSORS and self.answer is not None:
            self.commands.publish(self.answer)

    def _on_diagnostics(self, array: DiagnosticArray) -> None:
        self.diagnostics += array.status

    def bring_up(self, rig: LifecycleNode) -> None:
        """Configure and activate a rig, once it and this node have discovered each other."""
        assert rig.trigger_configure() is SUCCESS
        wait_for_partners(self.node, publishers=[self.commands], subscriptions=self.subscriptions)
        assert rig.trigger_activate() is SUCCESS, getattr(rig, "transition_error", "")

    @property
    def count(self) -> int:
        """Number of samples received."""
        return min(map(len, self.samples.values()))

    @property
    def faults(self) -> list[tuple[str, str]]:
        """Faults reported so far, each with the torque that the drives applied then."""
        error = bytes([Level.ERROR])
        found = [one for one in self.diagnostics if one.level == error]
        return [(one.message, values_of(one).get("applied", "")) for one in found]

    def await_samples(self, number: int) -> None:
        self.until(lambda: self.count >= number, f"{number} samples")

    def command(self, *torque: float) -> None:
        """Command a torque, and wait for the sample that follows."""
        wanted = self.count + 1
        self.commands.publish(torque)
        self.await_samples(wanted)

    def await_fault(self, words: str = "") -> tuple[str, str]:
        """Wait for a fault with these words; return the first one and the applied torque."""

        def found() -> list[tuple[str, str]]:
            return [fault for fault in self.faults if words in fault[0]]

        self.until(lambda: bool(found()), f"the fault {words}")
        return found()[0]
