"""A driver for an exoskeleton, step by step. Replace what `make_device` returns, and keep the rest.

It takes the place of ``arm_sim``, so it has that name in the graph.
"""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Sequence
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from std_msgs.msg import UInt64
from std_srvs.srv import Trigger

from armimp_common import contract, qos
from armimp_common.channels import CommandSubscription, JointStatePublisher
from armimp_common.contract import PERIOD_NS
from armimp_common.diagnostics import Level, make_array, make_status
from armimp_common.discovery import wait_for_partners
from armimp_common.errors import ArmimpError, GraphError
from armimp_common.jitter import TIMING_NAME, TimingLedger
from armimp_common.lifecycle import reported
from armimp_common.liveliness import SignOfLife, Watch
from armimp_common.parameters import declare, guard, load
from armimp_common.spin import run_node
from armimp_common.urgency import wake_up_exactly
from armimp_driver_template.conversion import Encoders, Transducers, Wiring
from armimp_driver_template.device import Device, Frame
from armimp_driver_template.mock import MockDevice
from armimp_driver_template.parameters import DriverParameters
from armimp_driver_template.protection import Protection
from armimp_sim.backlog import Backlog

_FRAME_TIMEOUT, _PATIENCE = 0.002, 0.1
"""How long a frame is waited for (s): two periods on a bus, longer where commands set the pace."""
_LOST_FRAMES = 5
_REPORT_PERIOD = 1.0
_STOPPED = "emergency stop"


def make_device(parameters: DriverParameters) -> Device:
    """Return the device; a real one goes here, and refuses lockstep, since it cannot wait."""
    return MockDevice(parameters)


class ExoDriver(LifecycleNode):
    """Publishes what the device measures, and passes torque on to it."""

    # Step 1: the node. What must work in every state is made here: the sign of life, the watch over
    # the controller, the emergency stop, the parameters.
    def __init__(self, **kwargs: Any) -> None:
        super().__init__(contract.SIM_NODE, **kwargs)
        self.transition_error = ""
        self._active = self._stopped = False
        self._protection: Protection | None = None
        self._lock = threading.Lock()
        self._thread: threading.Thread | None = None
        self._running = threading.Event()
        self._told = ""
        self._sign = SignOfLife(self, contract.SIM_NODE)
        self._controller = Watch(self, contract.CONTROLLER_NODE, self._on_controller)
        self.create_service(Trigger, contract.SIM_STOP_SERVICE, self._on_stop)
        self.create_service(Trigger, contract.SIM_RESET_SERVICE, self._on_reset)
        declare(self, DriverParameters, DriverParameters())
        guard(self, lambda: "the drives are on" if self._active else None)

    # Step 2: configuration. Parameters are read and checked, the device is made, topics appear.
    @reported
    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Make the device and the topics."""
        parameters = self._settings = load(self, DriverParameters)
        parameters.check()
        names = parameters.joints
        self._device = make_device(parameters)
        if parameters.mode == "lockstep" and self._device.paced:
            raise GraphError("mode lockstep is for a device that can wait")
        self._wiring = Wiring(self._device.names, parameters.names_at_device())
        self._drives = parameters.drives()
        self._protection = Protection(len(names), parameters.limits.limits())
        if self._stopped:
            self._protection.latch(_STOPPED)
        self._joint_states = JointStatePublisher(self, contract.JOINT_STATES, names, "position")
        self._torque_sensors = JointStatePublisher(self, contract.TORQUE_SENSORS, names, "effort")
        self._diagnostics = self.create_publisher(
            DiagnosticArray, contract.DIAGNOSTICS, qos.DIAGNOSTICS
        )
        self._commands = CommandSubscription(
            self, contract.COMMANDS, len(names), self._on_command, on_malformed=self._on_malformed
        )
        self._backlog = Backlog()
        self._received = self.create_subscription(
            UInt64, contract.RECEIVED, self._on_received, qos.LATCHED
        )
        self._timer = self.create_timer(_REPORT_PERIOD, self._report)
        self._look = self.create_timer(0.02, self._report_news)
        return TransitionCallbackReturn.SUCCESS

    # Step 3: activation. Nobody is waited for in vain, and then the device sets the rhythm.
    @reported
    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Start the thread that listens to the device."""
        wait_for_partners(
            self,
            publishers=[self._joint_states, self._torque_sensors],
            subscriptions=[self._commands],
            watches=[self._controller],
        )
        self._encoders = Encoders(self._settings.encoders())
        self._transducers = Transducers(self._settings.transducers())
        self._ledger = TimingLedger()
        self._begin_ns = self._sent_ns = 0
        self._lost = 0
        self._device.open()
        self._active = True
        self._running.set()
        self._thread = threading.Thread(target=self._listen, name="device", daemon=True)
        self._thread.start()
        return super().on_activate(state)

    # Step 4: the rhythm. The device says when there is a sample; its counter makes the stamp, so
    # that a frame which is lost leaves a gap that everybody can see.
    def _listen(self) -> None:
        wake_up_exactly()
        timeout = _FRAME_TIMEOUT if self._device.paced else _PATIENCE
        try:
            while self._running.is_set():
                frame = self._device.receive(timeout)
                if frame is None:
                    self._miss()
                else:
                    self._lost = 0
                    self._publish(frame)
        except Exception as error:  # noqa: BLE001 (of whatever kind: without this thread no torque)
            self._latch(f"the device failed: {error}")

    def _miss(self) -> None:
        self._lost += 1
        if self._device.paced and self._lost >= _LOST_FRAMES:
            self._latch(f"the device has sent nothing for {_LOST_FRAMES} periods")

    # Step 5: a sample. Counts become radians and newton metres, and both messages get one stamp.
    def _publish(self, frame: Frame) -> None:
        angles = self._encoders.angles(self._wiring.to_joints(frame.encoder))
        torques = self._transducers.torques(self._wiring.to_joints(frame.transducer))
        protection = self._protection
        assert protection is not None
        with self._lock:
            protection.sample(angles)
            if self._device.paced:
                if protection.period():
                    self._ledger.missed()
                # Only what the driver changes by itself; commands go out as they come.
                if protection.fault:
                    self._drive(protection.torque)
        while self._backlog.full and self._running.is_set():
            time.sleep(0.0005)  # in lockstep only: a recorder that is behind would lose samples
        if not self._device.paced:
            self._backlog.count_sent()
        stamp_ns = frame.counter * PERIOD_NS
        now_ns = time.monotonic_ns()
        self._begin_ns = self._begin_ns or now_ns - stamp_ns
        self._sent_ns = now_ns
        self._joint_states.publish(stamp_ns, angles)
        self._torque_sensors.publish(stamp_ns, torques)
        self._ledger.sent(self._begin_ns + stamp_ns, now_ns)

    # Step 6: a command. It passes the driver's own protection before the drives get it.
    def _on_command(self, command: tuple[float, ...]) -> None:
        protection = self._protection
        if not self._active or protection is None:
            return
        self._ledger.answered(time.monotonic_ns() - self._sent_ns)
        with self._lock:
            protection.command(command)
            self._drive(protection.torque)

    def _drive(self, torque: Sequence[float]) -> None:
        """Give the drives torques of the joints (n,), N·m, in the device's order and directions."""
        pairs = zip(self._drives, torque, strict=True)
        raw = self._wiring.to_device([drive.torque(value) for drive, value in pairs])
        try:
            self._device.send(raw)
        except Exception as error:  # noqa: BLE001 (of whatever kind: the drives are out of hand)
            assert self._protection is not None
            self._protection.latch(f"the device takes no commands: {error}")

    def _on_received(self, message: UInt64) -> None:
        self._backlog.acknowledge(message.data)

    def _on_malformed(self, error: ArmimpError) -> None:
        self._latch(f"malformed command: {error}")
        if self._active and not self._device.paced:
            self._drive((0.0,) * len(self._settings.joints))

    # Step 7: faults. One latch for all of them; the first reason stays until the reset.
    def _latch(self, reason: str) -> None:
        protection = self._protection
        if protection is None or not (self._active or self._stopped):
            return
        with self._lock:
            protection.latch(reason)
            # In lockstep torque is an answer, and no sample has asked for one.
            if self._active and self._device.paced:
                self._drive(protection.torque)

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
                with self._lock:
                    self._protection.reset()
        except GraphError as error:
            response.success, response.message = False, str(error)
            return response
        self._stopped = False
        response.success, response.message = True, "commands are obeyed"
        return response

    # Step 8: telling. A fault is repeated until the reset, and at once when it comes.
    def _report_news(self) -> None:
        protection = self._protection
        if protection is not None and protection.fault != self._told:
            self._report()

    def _report(self) -> None:
        protection = self._protection
        if protection is None or not self.context.ok():
            return
        fault = self._told = protection.fault
        level = Level.ERROR if fault else Level.OK
        words = fault or ("running" if self._active else "stopped")
        values = {"applied": protection.torque}
        statuses = [make_status(f"{contract.SIM_NODE}: rig", level, words, values)]
        if self._active and self._device.paced:
            figures = self._ledger.figures()
            statuses.append(
                make_status(TIMING_NAME, Level.OK, "timing since activation", figures.to_values())
            )
        self._diagnostics.publish(make_array(self.get_clock().now().nanoseconds, statuses))

    # Step 9: the way back. No transition leaves torque behind.
    @reported
    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Free the drives."""
        self._rest()
        return super().on_deactivate(state)

    @reported
    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Forget the device; only an emergency stop remains."""
        for timer in (self._timer, self._look):
            self.destroy_timer(timer)
        for channel in (self._joint_states, self._torque_sensors):
            self.destroy_publisher(channel.publisher)
        self.destroy_publisher(self._diagnostics)
        self.destroy_subscription(self._commands.subscription)
        self.destroy_subscription(self._received)
        self._protection = None
        return TransitionCallbackReturn.SUCCESS

    @reported
    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Free the drives for good."""
        self._rest()
        return TransitionCallbackReturn.SUCCESS

    def destroy_node(self) -> None:
        """Free the drives, should the node end while it is active."""
        self._rest()
        super().destroy_node()

    def _rest(self) -> None:
        self._active = False
        self._running.clear()
        if self._thread is not None:
            self._thread.join(2.0)
            self._thread = None
            assert self._protection is not None
            with self._lock:
                self._protection.rest()
                self._drive(self._protection.torque)
                self._device.close()


def main() -> int:
    """Run the driver as a process."""
    return run_node(ExoDriver)


if __name__ == "__main__":
    sys.exit(main())
