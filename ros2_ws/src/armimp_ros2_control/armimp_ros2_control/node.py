"""The bridge: takes the place of ``arm_sim`` in front of a robot that ros2_control drives."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from typing import Any

from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn

from armimp_common.driver_base import ProtectedDriver
from armimp_common.errors import MalformedMessageError
from armimp_common.executor import run_node, steady_timer
from armimp_common.protection import Protection
from armimp_common.pubsub import CommandPublisher, subscribe_raw, take_all
from armimp_common.realtime import realtime_scheduling
from armimp_common.topics import JOINT_STATES
from armimp_ros2_control.parameters import BridgeParameters
from armimp_ros2_control.readings import Readings, Stamps

STATES = "joint_state_broadcaster/joint_states"
"""Joint states of ros2_control, as a joint_state_broadcaster with local topics publishes them."""
EFFORTS = "armimp_efforts/commands"
"""Commands for ros2_control, as a forward_command_controller of that name takes them."""

_SILENCE_PERIOD = 0.01
"""Time within which joint states have to come, and between two checks of that (s)."""


class Ros2ControlBridge(ProtectedDriver[BridgeParameters]):
    """Splits joint states into angles and torques, and passes commands through its protection."""

    def __init__(self, **kwargs: Any) -> None:
        self._scheduling = ExitStack()
        super().__init__(BridgeParameters(), "the drives are on", **kwargs)

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Read the parameters, and create the topics of both sides."""
        parameters = self._settings = self.declared.load()
        names = parameters.joints
        self._readings = Readings(parameters)
        protection = Protection(len(names), parameters.limits)
        self.set_up(protection, names)
        self._efforts = CommandPublisher(self, EFFORTS, len(names))
        self._states = subscribe_raw(self, STATES, self._on_state, JOINT_STATES)
        steady_timer(self, _SILENCE_PERIOD, self._check_silence)
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Begin to pass on samples and commands, once both sides are there."""
        self.declared.require_unchanged()
        self.wait_for_controller([self._efforts], [self._states])
        self._scheduling.enter_context(realtime_scheduling(self._settings.realtime.priority))
        self._stamps = Stamps()
        self._heard = self._heard_before = 0
        # Last, as robots always publish: what queued up meanwhile would come as one burst.
        take_all(self._states)
        self.active = True
        # A forward controller holds the last command that it got, whoever sent it.
        self.torque_was_taken()
        return super().on_activate(state)

    def _on_state(self, data: bytes) -> None:
        if not self.active:
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
        for name, value in zip(self._settings.names_there(), torques, strict=True):
            if math.isnan(value):
                # A broadcaster also sends this if there is no effort interface.
                self.latch(f"{STATES}: the effort of {name!r} is not a number")
        self.check_sample(angles, steps)
        self.publish_sample(stamp_ns, angles, torques)

    def drive(self, torque: Sequence[float]) -> None:
        """Command torques of the joints (n,), N·m, in the directions of ros2_control."""
        self._efforts.publish(self._readings.commands(torque))

    def obey_again(self) -> None:
        """Clear a fault, and check stamps afresh, as they may have jumped meanwhile."""
        super().obey_again()
        self._stamps = Stamps()

    def _check_silence(self) -> None:
        # What queued up while this process was held up is heard before the next check.
        if self.active and self._heard:
            if self._heard == self._heard_before:
                self.latch(f"{STATES}: nothing for {1e3 * _SILENCE_PERIOD:g} ms")
            self._heard_before = self._heard
        if self.active and self.limiter.fault:
            # The forward controller subscribes as best effort, so a single message may be lost.
            self.drive(self.limiter.applied)

    def values(self) -> dict[str, Any]:
        """Numbers of samples that were lost on the way here, and that were left out."""
        if not self.active:
            return {}
        return {"lost": self._stamps.lost, "left_out": self._stamps.left_out}

    def rest(self) -> None:
        """Command zero torque, and obey no further commands."""
        if not self.active:
            return
        self.active = False
        self.limiter.rest()
        if self.context.ok():
            self.torque_was_taken()
        self._scheduling.close()


def main() -> int:
    """Run the bridge as a process."""
    return run_node(Ros2ControlBridge)


if __name__ == "__main__":
    sys.exit(main())
