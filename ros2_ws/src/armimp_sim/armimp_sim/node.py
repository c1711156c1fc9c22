"""The simulator node: ROS around :class:`armimp_sim.simulator.SimulatedRig`."""

from __future__ import annotations

import sys
from contextlib import ExitStack
from typing import Any

from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from rosgraph_msgs.msg import Clock

from armimp_common import topics
from armimp_common.driver_base import DriverBase, FlowControl
from armimp_common.errors import ArmimpError
from armimp_common.executor import run_node
from armimp_common.heartbeat import HeartbeatMonitor
from armimp_common.pubsub import create_publisher, subscribe_counts, wait_for_partners
from armimp_common.realtime import Pacer, realtime_scheduling
from armimp_common.status import make_array, status_message, to_time
from armimp_sim.parameters import SimulatorParameters
from armimp_sim.simulator import RealtimeSimulator, SimulatedRig

_CLOCK_TICKS = 100
_DIAGNOSTICS_TICKS = 1000
_TIMING_TICKS = 100
"""Ticks between two reports of the timing in realtime."""


class ArmSimNode(DriverBase[SimulatedRig, SimulatorParameters]):
    """Publishes samples: one for each command (lockstep), or one each millisecond (realtime)."""

    def __init__(self, **kwargs: Any) -> None:
        self._simulator: RealtimeSimulator | None = None
        self._scheduling = ExitStack()
        self._holding = False
        self._told_timing = 0
        self._flow = FlowControl()
        super().__init__(SimulatorParameters.preset(), "the simulation is running", **kwargs)
        self._recorder = HeartbeatMonitor(self, topics.ESTIMATOR_NODE, self._on_recorder)

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Build the rig and its topics from the parameters."""
        parameters = self._settings = self.declared.load()
        rig = SimulatedRig(parameters)
        self.set_up(rig, parameters.joints)
        self._clock_publisher = create_publisher(self, topics.CLOCK)
        self._flow = FlowControl()
        self._flow.silent = self._recorder.presence.silent
        subscribe_counts(self, topics.RECEIVED, self._on_received)
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Send the first sample, once somebody listens and commands."""
        self.declared.require_unchanged()
        wait_for_partners(
            self,
            publishers=[self.joint_states, self.torque_sensors],
            subscriptions=[self.commands],
            monitors=[self.controller, self._recorder],
        )
        realtime = self._settings.mode == "realtime"
        if realtime:
            self._scheduling.enter_context(realtime_scheduling(self._settings.realtime.priority))
        self.active = True
        self._holding = False
        if self.limiter.fault:
            self.report()
        if realtime:
            self._told_timing = self.limiter.tick
            self._simulator = RealtimeSimulator(self.limiter, self._send, Pacer())
            self._simulator.start()
        else:
            self._publish()
        return super().on_activate(state)

    def stamp_ns(self) -> int:
        """Simulated time, ns."""
        return self.limiter.stamp_ns

    def values(self) -> dict[str, Any]:
        """Number of the sample, for reports on ``/diagnostics``."""
        return {"tick": self.limiter.tick}

    def rest(self) -> None:
        """End the thread that paces the rig, and leave the rig without torque."""
        active, self.active = self.active, False
        if self._simulator is not None:
            self._simulator.stop()
            if self.context.ok():
                self._report_timing(self._simulator)
            self._simulator = None
        self._scheduling.close()
        if active:
            self.limiter.rest()
            self.report()

    def on_command(self, command: tuple[float, ...]) -> None:
        """Let the rig take the step that a command triggers: now, or at the next sample."""
        if not self.active:
            return
        if self._simulator is not None:
            self._simulator.command(command)
            if self.limiter.tick - self._told_timing >= _TIMING_TICKS:
                # Now, since nothing else is due until the next sample.
                self._report_timing(self._simulator)
        elif self._holding:
            # The sample that the next command is to answer has not even been sent.
            if any(command):
                self.accuse("a command that answers no sample")
        else:
            self.limiter.step(command)
            if self.limiter.fault:
                self.report_news()
            self._holding = self._flow.full
            if not self._holding:
                self._publish()

    def on_malformed(self, error: ArmimpError) -> None:
        """Latch a fault, and go on without torque."""
        super().on_malformed(error)
        self.on_command((0.0,) * self.limiter.position.size)

    def _on_recorder(self, recorder: HeartbeatMonitor) -> None:
        """Wait for a silent recorder, which may only be suspended; a lost one ends the trial."""
        self._flow.silent = recorder.presence.silent
        if recorder.presence.gone and self._flow.recorded:
            self.latch(f"{recorder.sentence}, and a trial without recorder is of no use")
            self.report_news()
            self._flow.acknowledge(topics.RECORDER_GONE)
        self._go_on()

    def report_regularly(self) -> None:
        """Report in real time, and repeat a fault; in lockstep, other reports follow samples."""
        if self.limiter.fault or self._simulator is not None:
            self.report()

    def check(self) -> None:
        """Raise also what ended the thread that paces the rig."""
        super().check()
        if self._simulator is not None and self._simulator.error is not None:
            raise self._simulator.error

    def _on_received(self, samples: int) -> None:
        self._flow.acknowledge(samples)
        self._go_on()

    def _go_on(self) -> None:
        if self._holding and self.active and not self._flow.full:
            self._holding = False
            self._publish()

    def _publish(self) -> None:
        self._flow.count_sent()
        self._send()
        if self.limiter.tick % _DIAGNOSTICS_TICKS == 0:
            self.report()

    def _send(self) -> None:
        rig, stamp_ns = self.limiter, self.limiter.stamp_ns
        self.joint_states.publish(stamp_ns, rig.position)
        self.torque_sensors.publish(stamp_ns, rig.torque)
        if rig.tick % _CLOCK_TICKS == 0:
            self._clock_publisher.publish(Clock(clock=to_time(stamp_ns)))

    def _report_timing(self, paced: RealtimeSimulator) -> None:
        with self.limiter.lock:
            stamp_ns, self._told_timing = self.limiter.stamp_ns, self.limiter.tick
            figures = paced.figures()
        self.diagnostics.publish(make_array(stamp_ns, [status_message(figures)]))


def main() -> int:
    """Run the simulator node as a process."""
    return run_node(ArmSimNode)


if __name__ == "__main__":
    sys.exit(main())
