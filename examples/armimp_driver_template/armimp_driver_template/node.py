"""A driver for an exoskeleton, step by step. Replace what `make_device` returns, and keep the rest.

It takes the place of ``arm_sim``, so it has that name in the graph.
"""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Sequence
from typing import Any

from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn

from armimp_common import topics
from armimp_common.driver_base import FlowControl, ProtectedDriver
from armimp_common.errors import ArmimpError, GraphError
from armimp_common.executor import run_node
from armimp_common.protection import Protection
from armimp_common.pubsub import subscribe_counts
from armimp_common.realtime import wake_up_exactly
from armimp_common.status import TimingFigures
from armimp_common.topics import PERIOD_NS
from armimp_driver_template.conversion import Drives, Encoders, Sensors, Wiring
from armimp_driver_template.device import Device, Frame
from armimp_driver_template.mock import MockDevice
from armimp_driver_template.parameters import DriverParameters

_FRAME_TIMEOUT, _PATIENCE = 0.002, 0.1
"""How long a frame is waited for (s): two periods on a bus, longer where commands set the pace."""
_LOST_FRAMES = 5  # in a row, after which the driver latches a fault


def make_device(parameters: DriverParameters) -> Device:
    """Return the device; a real one goes here, and refuses lockstep, since it cannot wait."""
    return MockDevice(parameters)


class ExoDriver(ProtectedDriver[DriverParameters]):
    """Publishes what the device measures, and passes torque on to it."""

    # Step 1: the node. What must work in every state comes from `DriverBase`: heartbeats, emergency
    # stop and reset, the parameters.
    def __init__(self, **kwargs: Any) -> None:
        self._thread: threading.Thread | None = None
        self._running = threading.Event()
        super().__init__(DriverParameters(), "the drives are on", **kwargs)

    # Step 2: configuration. Parameters are read and checked, the device is made, topics appear.
    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Make the device and the topics."""
        parameters = self._settings = self.declared.load()
        joints = len(parameters.joints)
        self._device = make_device(parameters)
        if parameters.mode == "lockstep" and self._device.paced:
            raise GraphError("mode lockstep is for a device that can wait")
        self._wiring = Wiring(self._device.names, parameters.names_at_device())
        self._encoders = Encoders("encoder", parameters.encoder, joints)
        self._transducers = Sensors("transducer", parameters.transducer, joints)
        self._drives = Drives(parameters.drive, joints)
        protection = Protection(joints, parameters.limits)
        self.set_up(protection, parameters.joints)
        self._flow = FlowControl()
        subscribe_counts(self, topics.RECEIVED, self._flow.acknowledge)
        return TransitionCallbackReturn.SUCCESS

    # Step 3: activation. The driver waits for the controller; then the device sets the pace.
    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Start the thread that listens to the device."""
        self.declared.require_unchanged()
        self.wait_for_controller()
        self._encoders.begin()
        self._lost = 0
        self._device.open()
        self.active = True
        self._running.set()
        self._thread = threading.Thread(target=self._listen, name="device", daemon=True)
        self._thread.start()
        return super().on_activate(state)

    # Step 4: the pace. The device says when there is a sample; its counter makes the stamp, so that
    # a lost frame leaves a gap that everybody can see.
    def _listen(self) -> None:
        wake_up_exactly()
        timeout = _FRAME_TIMEOUT if self._device.paced else _PATIENCE
        try:
            while self._running.is_set():
                frame = self._device.receive(timeout)
                if frame is not None:
                    self._lost = 0
                    self._publish(frame)
                    continue
                self._lost += 1
                if self._device.paced and self._lost >= _LOST_FRAMES:
                    self.latch(f"the device has sent nothing for {_LOST_FRAMES} periods")
        except Exception as error:  # noqa: BLE001 (of whatever kind: without this thread no torque)
            self.latch(f"the device failed: {error}")

    # Step 5: a sample. Counts become radians and newton metres, and both messages get one stamp.
    def _publish(self, frame: Frame) -> None:
        angles = self._encoders.angles(self._wiring.to_joints(frame.encoder))
        torques = self._transducers.values(self._wiring.to_joints(frame.transducer))
        self.check_sample(angles, periods=1 if self._device.paced else 0)
        while self._flow.full and self._running.is_set():
            time.sleep(0.0005)  # in lockstep only, where a recorder that is behind loses samples
        if not self._device.paced:
            self._flow.count_sent()
        self.publish_sample(frame.counter * PERIOD_NS, angles, torques)

    # Step 6: a command. It passes the driver's own protection before the drives get it.
    def drive(self, torque: Sequence[float]) -> None:
        """Give the drives torques of the joints (n,), N·m, in the device's order and directions."""
        raw = self._wiring.to_device(self._drives.of_drives(torque))
        try:
            self._device.send(raw)
        except Exception as error:  # noqa: BLE001 (of whatever kind: the drives are out of hand)
            self.limiter.latch(f"the device takes no commands: {error}")

    def on_malformed(self, error: ArmimpError) -> None:
        """Free the drives; in lockstep the device waits for an answer."""
        super().on_malformed(error)
        if self.active and not self._device.paced:
            self.drive((0.0,) * len(self._settings.joints))

    # Step 7: faults. `DriverBase` has one latch for all of them; the drives learn of it here.
    def torque_was_taken(self) -> None:
        """Tell the drives; not in lockstep, where torque only ever answers a sample."""
        if self._device.paced:
            super().torque_was_taken()

    # Step 8: reports. `DriverBase` reports a fault at once and every second, timing if it is given.
    def timing(self) -> TimingFigures | None:
        """Timing, where the device sets the pace."""
        return super().timing() if self._device.paced else None

    # Step 9: the way back. No transition leaves torque behind.
    def rest(self) -> None:
        """Free the drives, and let go of the device."""
        self.active = False
        self._running.clear()
        if self._thread is not None:
            self._thread.join(2.0)
            self._thread = None
            with self.limiter.lock:
                self.limiter.rest()
                self.drive(self.limiter.applied)
                self._device.close()


def main() -> int:
    """Run the driver as a process."""
    return run_node(ExoDriver)


if __name__ == "__main__":
    sys.exit(main())
