"""The bridge: takes the place of ``arm_sim`` in front of a robot that ros2_control drives."""

from __future__ import annotations

import math
import sys
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from armimp_common import contract, qos
from armimp_common.channels import (
    CommandPublisher,
    CommandSubscription,
    JointStatePublisher,
    RawSubscription,
)
from armimp_common.diagnostics import Level, make_array, make_status
from armimp_common.discovery import wait_for_partners
from armimp_common.errors import ArmimpError, GraphError, MalformedMessageError
from armimp_common.jitter import TIMING_NAME, TimingLedger
from armimp_common.lifecycle import reported
from armimp_common.liveliness import SignOfLife, Watch
from armimp_common.parameters import declare, guard, load
from armimp_common.spin import run_node
from armimp_common.urgency import Urgency
from armimp_driver_template.protection import Protection
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
_STOPPED = "emergency stop"


class Ros2ControlBridge(LifecycleNode):
    """Splits joint states into angles and torques, and lets commands through its protection."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(contract.SIM_NODE, **kwargs)
        self.transition_error = ""
        self._active = self._stopped = False
        self._listened = 0
        self._protection: Protection | None = None
        self._urgency: Urgency | None = None
        self._told = ""
        self._sign = SignOfLife(self, contract.SIM_NODE)
        self._controller = Watch(self, contract.CONTROLLER_NODE, self._on_controller)
        self.create_service(Trigger, contract.SIM_STOP_SERVICE, self._on_stop)
        self.create_service(Trigger, contract.SIM_RESET_SERVICE, self._on_reset)
        declare(self, BridgeParameters, BridgeParameters())
        guard(self, lambda: "the drives are on" if self._active else None)

    @reported
    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Read the parameters, and make the topics of both sides."""
        parameters = self._settings = load(self, BridgeParameters).checked()
        names, count = parameters.joints, len(parameters.joints)
        self._readings = Readings(parameters)
        self._protection = Protection(count, parameters.limits.limits())
        if self._stopped:
            self._protection.latch(_STOPPED)
        self._joint_states = JointStatePublisher(self, contract.JOINT_STATES, names, "position")
        self._torque_sensors = JointStatePublisher(self, contract.TORQUE_SENSORS, names, "effort")
        self._efforts = CommandPublisher(self, EFFORTS, count)
        self._diagnostics = self.create_publisher(
            DiagnosticArray, contract.DIAGNOSTICS, qos.DIAGNOSTICS
        )
        self._states = self._listen()
        self._commands = CommandSubscription(
            self, contract.COMMANDS, count, self._on_command, on_malformed=self._on_malformed
        )
        self._timer = self.create_timer(_LOOK_PERIOD, self._look)
        self._looks = 0
        return TransitionCallbackReturn.SUCCESS

    @reported
    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Begin to pass samples and commands on, once both sides are there."""
        wait_for_partners(
            self,
            publishers=[self._joint_states, self._torque_sensors, self._efforts],
            subscriptions=[self._states, self._commands],
            watches=[self._controller],
        )
        # Robots publish always. What piled up while this was waited for would come as one burst.
        self.destroy_subscription(self._states.subscription)
        self._states = self._listen()
        self._urgency = Urgency(self._settings.realtime)
        self._stamps, self._ledger = Stamps(), TimingLedger()
        self._heard = self._looked_at = self._sent_ns = 0
        self._begin_ns: int | None = None
        self._active = True
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
        protection = self._protection
        if not self._active or protection is None:
            return
        self._heard += 1
        try:
            stamp_ns, angles, torques = self._readings.decode(data)
            steps = self._stamps.step(stamp_ns)
        except MalformedMessageError as error:
            self._latch(f"{STATES}: {error}")
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
        self._joint_states.publish(stamp_ns, angles)
        self._torque_sensors.publish(stamp_ns, torques)
        # Nobody's clock starts with the first sample, which may have come late.
        begin_ns = now_ns - stamp_ns
        if self._begin_ns is not None:
            begin_ns = min(self._begin_ns + _DRIFT_NS * steps, begin_ns)
        self._begin_ns = begin_ns
        self._ledger.sent(begin_ns + stamp_ns, now_ns)

    def _on_command(self, command: tuple[float, ...]) -> None:
        protection = self._protection
        if not self._active or protection is None:
            return
        self._ledger.answered(time.monotonic_ns() - self._sent_ns)
        protection.command(command)
        self._drive()

    def _on_malformed(self, error: ArmimpError) -> None:
        self._latch(f"malformed command: {error}")

    def _drive(self) -> None:
        protection = self._protection
        assert protection is not None
        self._efforts.publish(self._readings.commands(protection.torque))

    def _latch(self, reason: str) -> None:
        protection = self._protection
        if protection is None or not (self._active or self._stopped):
            return
        protection.latch(reason)
        if self._active:
            self._drive()

    def _on_controller(self, controller: Watch) -> None:
        if controller.presence.lost:
            self._latch(controller.sentence)

    def _on_stop(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._stopped = True
        self._latch(_STOPPED)
        self._report()
        response.success = True
        response.message = f"no torque until {contract.SIM_RESET_SERVICE} is called"
        return response

    def _on_reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        try:
            if self._protection is not None:
                self._protection.reset()
        except GraphError as error:
            response.success, response.message = False, str(error)
            return response
        if self._active:
            self._stamps = Stamps()
        self._stopped = False
        response.success, response.message = True, "commands are obeyed"
        return response

    def _look(self) -> None:
        protection = self._protection
        if protection is None:
            return
        self._looks += 1
        # Those that piled up while this process was held up are heard before the next look.
        if self._active and self._heard:
            if self._heard == self._looked_at:
                protection.latch(f"{STATES}: nothing for {1e3 * _LOOK_PERIOD:g} ms")
            self._looked_at = self._heard
        if self._active and protection.fault:
            # The reader over there listens by best effort: once might be too seldom.
            self._drive()
        if protection.fault != self._told or self._looks % _REPORT_LOOKS == 0:
            self._report()

    def _report(self) -> None:
        protection = self._protection
        if protection is None or not self.context.ok():
            return
        fault = self._told = protection.fault
        level = Level.ERROR if fault else Level.OK
        words = fault or ("running" if self._active else "stopped")
        values: dict[str, Any] = {"applied": protection.torque}
        if self._active:
            values |= {"lost": self._stamps.lost, "left_out": self._stamps.left_out}
        statuses = [make_status(f"{contract.SIM_NODE}: rig", level, words, values)]
        if self._active:
            figures = self._ledger.figures()
            statuses.append(
                make_status(TIMING_NAME, Level.OK, "timing since activation", figures.to_values())
            )
        self._diagnostics.publish(make_array(self.get_clock().now().nanoseconds, statuses))

    @reported
    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Command no torque any more."""
        self._rest()
        return super().on_deactivate(state)

    @reported
    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Forget the topics; only an emergency stop remains."""
        self.destroy_timer(self._timer)
        for channel in (self._joint_states, self._torque_sensors, self._efforts):
            self.destroy_publisher(channel.publisher)
        self.destroy_publisher(self._diagnostics)
        for listener in (self._states, self._commands):
            self.destroy_subscription(listener.subscription)
        self._protection = None
        return TransitionCallbackReturn.SUCCESS

    @reported
    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Command no torque any more, for good."""
        self._rest()
        return TransitionCallbackReturn.SUCCESS

    def destroy_node(self) -> None:
        """Command no torque any more, should the node end while it is active."""
        self._rest()
        super().destroy_node()

    def _rest(self) -> None:
        if not self._active:
            return
        self._active = False
        assert self._protection is not None
        self._protection.rest()
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
