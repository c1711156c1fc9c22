"""The bridge: takes the place of ``arm_sim`` in front of a robot that ros2_control drives."""

from __future__ import annotations

import math
import sys
import time
from typing import Any

from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from sensor_msgs.msg import JointState

from armimp_common.driver_base import DriverBase
from armimp_common.errors import ArmimpError, MalformedMessageError
from armimp_common.executor import run_node, steady_timer
from armimp_common.lifecycle import reported
from armimp_common.parameters import load, require_unchanged
from armimp_common.protection import Protection
from armimp_common.pubsub import CommandPublisher, RawSubscription, wait_for_partners
from armimp_common.realtime import RealtimeScheduling, TimingMeter
from armimp_common.status import TimingFigures
from armimp_ros2_control.parameters import BridgeParameters
from armimp_ros2_control.readings import Readings, Stamps

STATES = "joint_state_broadcaster/joint_states"
"""Joint states of ros2_control, as a joint_state_broadcaster with local topics publishes them."""
EFFORTS = "armimp_efforts/commands"
"""Commands for ros2_control, as a forward_command_controller of that name takes them."""

_LOOK_PERIOD = 0.01
_REPORT_LOOKS = 100
_DRIFT_NS = 20
"""How much slower the clock of the stamps may run, in one period (ns)."""


class Ros2ControlBridge(DriverBase[Protection]):
    """Splits joint states into angles and torques, and lets commands through its protection."""

    def __init__(self, **kwargs: Any) -> None:
        self._listened = 0
        self._urgency: RealtimeScheduling | None = None
        super().__init__(BridgeParameters(), "the drives are on", **kwargs)

    @reported
    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Read the parameters, and make the topics of both sides."""
        parameters = self._settings = load(self, BridgeParameters).checked()
        names = parameters.joints
        self._readings = Readings(parameters)
        protection = Protection(len(names), parameters.limits)
        self.open_gate(protection, names, self._on_command, self._on_malformed)
        self._efforts = CommandPublisher(self, EFFORTS, len(names))
        self._states = self._listen()
        self._looks = 0
        self.own(self._efforts.publisher, steady_timer(self, _LOOK_PERIOD, self._look))
        return TransitionCallbackReturn.SUCCESS

    @reported
    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Begin to pass samples and commands on, once both sides are there."""
        require_unchanged(self)
        wait_for_partners(
            self,
            publishers=[self.joint_states, self.torque_sensors, self._efforts],
            subscriptions=[self._states, self.commands],
            monitors=[self.controller],
        )
        self._urgency = RealtimeScheduling(self._settings.realtime)
        self._stamps, self._ledger = Stamps(), TimingMeter()
        self._heard = self._looked_at = self._sent_ns = 0
        self._begin_ns: int | None = None
        # Last, as robots publish always: what piled up meanwhile would come as one burst.
        self.destroy_subscription(self._states.subscription)
        self._states = self._listen()
        self.active = True
        # A forward controller holds what it was last told, by whomever.
        self._drive()
        return super().on_activate(state)

    def _listen(self) -> RawSubscription:
        """Listen from now on; what an older subscription still delivers is not heard any more."""
        self._listened += 1
        listened = self._listened

        def on_state(data: bytes) -> None:
            if listened == self._listened:
                self._on_state(data)

        return RawSubscription(self, STATES, JointState, on_state)

    def _on_state(self, data: bytes) -> None:
        protection = self.gate
        if not self.active or protection is None:
            return
        self._heard += 1
        try:
            stamp_ns, angles, torques = self._readings.decode(data)
            steps = self._stamps.step(stamp_ns)
        except MalformedMessageError as error:
            self.latch(f"{STATES}: {error}")
            return
        if not steps:
            return
        for name, value in zip(self._settings.names, torques, strict=True):
            if math.isnan(value):
                # What a broadcaster says where there is no such interface, too.
                protection.latch(f"{STATES}: the effort of {name!r} is not a number")
        protection.sample(angles)
        for _ in range(steps):
            if protection.period():
                self._ledger.missed()
        if protection.fault:
            self._drive()
        now_ns = self._sent_ns = time.monotonic_ns()
        self.joint_states.publish(stamp_ns, angles)
        self.torque_sensors.publish(stamp_ns, torques)
        # Nobody's clock starts with the first sample, which may have come late.
        begin_ns = now_ns - stamp_ns
        if self._begin_ns is not None:
            begin_ns = min(self._begin_ns + _DRIFT_NS * steps, begin_ns)
        self._begin_ns = begin_ns
        self._ledger.sent(begin_ns + stamp_ns, now_ns)

    def _on_command(self, command: tuple[float, ...]) -> None:
        protection = self.gate
        if not self.active or protection is None:
            return
        self._ledger.answered(time.monotonic_ns() - self._sent_ns)
        protection.command(command)
        self._drive()

    def _on_malformed(self, error: ArmimpError) -> None:
        self.latch(f"malformed command: {error}")

    def _drive(self) -> None:
        protection = self.gate
        assert protection is not None
        self._efforts.publish(self._readings.commands(protection.applied))

    def torque_was_taken(self) -> None:
        """Tell the robot."""
        self._drive()

    def obey_again(self) -> None:
        """Undo a fault; stamps may have jumped meanwhile."""
        super().obey_again()
        if self.active:
            self._stamps, self._begin_ns = Stamps(), None

    def _look(self) -> None:
        protection = self.gate
        if protection is None:
            return
        self._looks += 1
        # Those that piled up while this process was held up are heard before the next look.
        if self.active and self._heard:
            if self._heard == self._looked_at:
                protection.latch(f"{STATES}: nothing for {1e3 * _LOOK_PERIOD:g} ms")
            self._looked_at = self._heard
        if self.active and protection.fault:
            # The reader over there listens by best effort: once might be too seldom.
            self._drive()
        if self._looks % _REPORT_LOOKS == 0:
            self.report()
        else:
            self.report_news()

    def values(self) -> dict[str, Any]:
        """Samples that were lost on the way here, and those that were left out."""
        if not self.active:
            return {}
        return {"lost": self._stamps.lost, "left_out": self._stamps.left_out}

    def timing(self) -> TimingFigures | None:
        """How regular samples and commands are."""
        return self._ledger.figures() if self.active else None

    @reported
    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Forget the topics; only an emergency stop remains."""
        self.destroy_subscription(self._states.subscription)
        return super().on_cleanup(state)

    def rest(self) -> None:
        """Command no torque any more."""
        if not self.active:
            return
        self.active = False
        assert self.gate is not None
        self.gate.rest()
        if self.context.ok():
            self._drive()
        if self._urgency is not None:
            self._urgency.give_back()
            self._urgency = None


def main() -> int:
    """Run the bridge as a process."""
    return run_node(Ros2ControlBridge)


if __name__ == "__main__":
    sys.exit(main())
