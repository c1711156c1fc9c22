"""A driver for an exoskeleton, step by step. Replace what `make_device` returns, and keep the rest.

It takes the place of ``arm_sim``, so it has that name in the graph.
"""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Sequence
from contextlib import AbstractContextManager
from typing import Any

from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from std_msgs.msg import UInt64

from armimp_common import qos, topics
from armimp_common.driver_base import DriverBase
from armimp_common.errors import ArmimpError, GraphError
from armimp_common.executor import run_node, steady_timer
from armimp_common.lifecycle import reported
from armimp_common.parameters import load, require_unchanged
from armimp_common.protection import Protection
from armimp_common.pubsub import wait_for_partners
from armimp_common.realtime import TimingMeter, wake_up_exactly
from armimp_common.status import TimingFigures
from armimp_common.topics import PERIOD_NS
from armimp_driver_template.conversion import Encoders, Transducers, Wiring
from armimp_driver_template.device import Device, Frame
from armimp_driver_template.mock import MockDevice
from armimp_driver_template.parameters import DriverParameters
from armimp_sim.flow_control import FlowControl

_FRAME_TIMEOUT, _PATIENCE = 0.002, 0.1
"""How long a frame is waited for (s): two periods on a bus, longer where commands set the pace."""
_LOST_FRAMES = 5
_REPORT_PERIOD = 1.0
"""How often it is reported how things are (s)."""


def make_device(parameters: DriverParameters) -> Device:
    """Return the device; a real one goes here, and refuses lockstep, since it cannot wait."""
    return MockDevice(parameters)


class ExoDriver(DriverBase[Protection]):
    """Publishes what the device measures, and passes torque on to it."""

    # Step 1: the node. What must work in every state comes from `DriverBase`: the sign of life, the
    # watch over the controller, emergency stop and reset, the parameters.
    def __init__(self, **kwargs: Any) -> None:
        self._lock = threading.RLock()
        self._thread: threading.Thread | None = None
        self._running = threading.Event()
        super().__init__(DriverParameters(), "the drives are on", **kwargs)

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
        protection = Protection(len(names), parameters.limits)
        self.open_gate(protection, names, self._on_command, self._on_malformed)
        self._backlog = FlowControl()
        self.own(
            self.create_subscription(UInt64, topics.RECEIVED, self._on_received, qos.LATCHED),
            steady_timer(self, _REPORT_PERIOD, self.report),
        )
        return TransitionCallbackReturn.SUCCESS

    # Step 3: activation. Nobody is waited for in vain, and then the device sets the rhythm.
    @reported
    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Start the thread that listens to the device."""
        require_unchanged(self)
        wait_for_partners(
            self,
            publishers=[self.joint_states, self.torque_sensors],
            subscriptions=[self.commands],
            monitors=[self.controller],
        )
        self._encoders = Encoders(self._settings.encoders())
        self._transducers = Transducers(self._settings.transducers())
        self._ledger = TimingMeter()
        self._begin_ns = self._sent_ns = 0
        self._lost = 0
        self._device.open()
        self.active = True
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
            self.latch(f"the device failed: {error}")

    def _miss(self) -> None:
        self._lost += 1
        if self._device.paced and self._lost >= _LOST_FRAMES:
            self.latch(f"the device has sent nothing for {_LOST_FRAMES} periods")

    # Step 5: a sample. Counts become radians and newton metres, and both messages get one stamp.
    def _publish(self, frame: Frame) -> None:
        angles = self._encoders.angles(self._wiring.to_joints(frame.encoder))
        torques = self._transducers.torques(self._wiring.to_joints(frame.transducer))
        protection = self.gate
        assert protection is not None
        with self._lock:
            protection.sample(angles)
            if self._device.paced:
                if protection.period():
                    self._ledger.missed()
                # Only what the driver changes by itself; commands go out as they come.
                if protection.fault:
                    self._drive(protection.applied)
        while self._backlog.full and self._running.is_set():
            time.sleep(0.0005)  # in lockstep only: a recorder that is behind would lose samples
        if not self._device.paced:
            self._backlog.count_sent()
        stamp_ns = frame.counter * PERIOD_NS
        now_ns = time.monotonic_ns()
        self._begin_ns = self._begin_ns or now_ns - stamp_ns
        self._sent_ns = now_ns
        self.joint_states.publish(stamp_ns, angles)
        self.torque_sensors.publish(stamp_ns, torques)
        self._ledger.sent(self._begin_ns + stamp_ns, now_ns)

    # Step 6: a command. It passes the driver's own protection before the drives get it.
    def _on_command(self, command: tuple[float, ...]) -> None:
        protection = self.gate
        if not self.active or protection is None:
            return
        self._ledger.answered(time.monotonic_ns() - self._sent_ns)
        with self._lock:
            protection.command(command)
            self._drive(protection.applied)

    def _drive(self, torque: Sequence[float]) -> None:
        """Give the drives torques of the joints (n,), N·m, in the device's order and directions."""
        pairs = zip(self._drives, torque, strict=True)
        raw = self._wiring.to_device([drive.torque(value) for drive, value in pairs])
        try:
            self._device.send(raw)
        except Exception as error:  # noqa: BLE001 (of whatever kind: the drives are out of hand)
            assert self.gate is not None
            self.gate.latch(f"the device takes no commands: {error}")

    def _on_received(self, message: UInt64) -> None:
        self._backlog.acknowledge(message.data)

    def _on_malformed(self, error: ArmimpError) -> None:
        self.latch(f"malformed command: {error}")
        if self.active and not self._device.paced:
            self._drive((0.0,) * len(self._settings.joints))

    # Step 7: faults. `DriverBase` has one latch for all of them; the drives learn of it here.
    def torque_was_taken(self) -> None:
        """Tell the drives; in lockstep torque is an answer, and no sample has asked for one."""
        if self._device.paced and self.gate is not None:
            self._drive(self.gate.applied)

    @property
    def alone(self) -> AbstractContextManager[object]:
        """Keeps the thread of the device away from the protection."""
        return self._lock

    # Step 8: telling. A fault is repeated until the reset, and at once when it comes.
    def timing(self) -> TimingFigures | None:
        """How regular samples and commands are, where the device sets the pace."""
        return self._ledger.figures() if self.active and self._device.paced else None

    # Step 9: the way back. No transition leaves torque behind.
    def rest(self) -> None:
        """Free the drives, and let go of the device."""
        self.active = False
        self._running.clear()
        if self._thread is not None:
            self._thread.join(2.0)
            self._thread = None
            assert self.gate is not None
            with self._lock:
                self.gate.rest()
                self._drive(self.gate.applied)
                self._device.close()


def main() -> int:
    """Run the driver as a process."""
    return run_node(ExoDriver)


if __name__ == "__main__":
    sys.exit(main())
