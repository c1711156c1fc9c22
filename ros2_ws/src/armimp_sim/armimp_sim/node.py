"""The simulator node: ROS around :class:`armimp_sim.simulator.SimulatedRig`."""

from __future__ import annotations

import sys
from contextlib import AbstractContextManager, nullcontext
from typing import Any

from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn

from armimp_common import topics
from armimp_common.driver_base import DriverBase
from armimp_common.errors import ArmimpError, GraphError
from armimp_common.executor import run_node, steady_timer
from armimp_common.heartbeat import HeartbeatMonitor, Presence
from armimp_common.lifecycle import reported
from armimp_common.parameters import load, require_unchanged
from armimp_common.pubsub import ClockPublisher, CountSubscription, wait_for_partners
from armimp_common.realtime import Pacer, RealtimeScheduling
from armimp_common.status import make_array, status_message
from armimp_sim.flow_control import FlowControl
from armimp_sim.parameters import SimulatorParameters
from armimp_sim.realtime_simulator import RealtimeSimulator
from armimp_sim.simulator import SimulatedRig

_CLOCK_TICKS = 100
_DIAGNOSTICS_TICKS = 1000
_FAULT_PERIOD = 1.0
"""Wall time between reports of a latched fault (s), since simulated time may stand still."""
_TIMING_TICKS = 100
"""Ticks between two reports of the timing in realtime."""


class ArmSimNode(DriverBase[SimulatedRig]):
    """Publishes samples: one for each command (lockstep), or one each millisecond (realtime)."""

    def __init__(self, **kwargs: Any) -> None:
        self._paced: RealtimeSimulator | None = None
        self._urgency: RealtimeScheduling | None = None
        self._holding = False
        self._told_tick = self._told_timing = 0
        self._backlog = FlowControl()
        super().__init__(SimulatorParameters.preset(), "the simulation is running", **kwargs)
        self._recorder = HeartbeatMonitor(self, topics.ESTIMATOR_NODE, self._on_recorder)

    @reported
    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Build the rig and its topics from the parameters."""
        parameters = self._settings = load(self, SimulatorParameters)
        rig = SimulatedRig(parameters)
        self.open_gate(rig, parameters.joints, self._on_command, self._on_malformed)
        self._clock_publisher = ClockPublisher(self)
        self._backlog = FlowControl()
        self._backlog.silent = self._recorder.presence in (Presence.STALLED, Presence.SILENT)
        self._holding = False
        received = CountSubscription(self, topics.RECEIVED, self._on_received)
        self.own(self._clock_publisher.publisher, received.subscription)
        self.own(steady_timer(self, _FAULT_PERIOD, self._on_fault_timer))
        return TransitionCallbackReturn.SUCCESS

    @reported
    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Send the first sample, once somebody listens and commands."""
        require_unchanged(self)
        wait_for_partners(
            self,
            publishers=[self.joint_states, self.torque_sensors],
            subscriptions=[self.commands],
            monitors=[self.controller, self._recorder],
        )
        self.active = True
        self._holding = False
        assert self.gate is not None
        if self.gate.fault:
            self.report()
        if self._settings.mode == "realtime":
            self._pace(self.gate)
        else:
            self._publish()
        return super().on_activate(state)

    def _pace(self, rig: SimulatedRig) -> None:
        realtime = self._settings.realtime
        pacer = Pacer(topics.PERIOD_NS, spin_ns=round(realtime.spin * topics.NS_PER_S))
        patience = self._settings.watchdog_ticks
        self._paced = RealtimeSimulator(rig, self._send, pacer, watchdog_ticks=patience)
        try:
            self._urgency = RealtimeScheduling(realtime)
        except GraphError:
            self.active, self._paced = False, None
            raise
        self._told_tick = self._told_timing = rig.tick
        self._paced.start()

    @property
    def alone(self) -> AbstractContextManager[object]:
        """Keeps the thread that paces the rig away from it."""
        return nullcontext() if self._paced is None else self._paced.lock

    def stamp_ns(self) -> int:
        """Simulated time, ns."""
        return 0 if self.gate is None else self.gate.stamp_ns

    def values(self) -> dict[str, Any]:
        """The number of the sample."""
        self._told_tick = 0 if self.gate is None else self.gate.tick
        return {"tick": self._told_tick}

    def obey_again(self) -> None:
        """Undo a fault, also in the thread that paces the rig."""
        if self._paced is not None:
            self._paced.reset()
        else:
            super().obey_again()

    def rest(self) -> None:
        """End the thread that paces the rig, and leave the rig without torque."""
        active, self.active = self.active, False
        if self._paced is not None:
            self._paced.stop()
            if self.context.ok():
                self._report_timing(self._paced)
            self._paced = None
        if self._urgency is not None:
            self._urgency.give_back()
            self._urgency = None
        if active and self.gate is not None:
            self.gate.rest()
            self.report()

    def _on_command(self, command: tuple[float, ...]) -> None:
        rig = self.gate
        if not self.active or rig is None:
            return
        if self._paced is not None:
            self._paced.command(command)
            if rig.tick - self._told_timing >= _TIMING_TICKS:
                # Now, since nothing else is due until the next sample.
                self._report_timing(self._paced)
            return
        self._step(rig, command)

    def _step(self, rig: SimulatedRig, command: tuple[float, ...]) -> None:
        """Take the step that a command asks for, in lockstep."""
        if self._holding:
            # The sample which the next command will answer was not even sent.
            if any(command):
                self.accuse("a command that answers no sample")
            return
        rig.step(command)
        if rig.fault:
            self.report_news()
        self._publish_or_hold()

    def _on_malformed(self, error: ArmimpError) -> None:
        rig = self.gate
        if not self.active or rig is None:
            return
        if self._paced is not None:
            self._paced.refuse(f"malformed command: {error}")
            return
        self.latch(f"malformed command: {error}")
        self._step(rig, (0.0,) * rig.position.size)

    def _on_recorder(self, recorder: HeartbeatMonitor) -> None:
        """Wait for a recorder that is silent: it may only be stopped. There is no trial without."""
        self._backlog.silent = recorder.presence in (Presence.STALLED, Presence.SILENT)
        if recorder.presence in (Presence.GONE, Presence.LEFT) and self._backlog.recorded:
            self.latch(f"{recorder.sentence}, and a trial without recorder is of no use")
            self.report_news()
            self._backlog.acknowledge(topics.RECORDER_GONE)
        self._go_on()

    def _on_fault_timer(self) -> None:
        if self.gate is not None and self.gate.fault:
            self.report()

    def look(self) -> None:
        """Tell what has happened in the thread, too, which must not lose time with that."""
        super().look()
        paced, rig = self._paced, self.gate
        if paced is None or rig is None:
            return
        if paced.error is not None:
            raise paced.error
        if rig.tick - self._told_tick >= _DIAGNOSTICS_TICKS:
            self.report()

    def _on_received(self, samples: int) -> None:
        self._backlog.acknowledge(samples)
        self._go_on()

    def _go_on(self) -> None:
        if self._holding and self.active and not self._backlog.full:
            self._holding = False
            self._publish()

    def _publish_or_hold(self) -> None:
        if self._backlog.full:
            self._holding = True
        else:
            self._publish()

    def _publish(self) -> None:
        rig = self.gate
        assert rig is not None
        self._backlog.count_sent()
        self._send()
        if rig.tick % _DIAGNOSTICS_TICKS == 0:
            self.report()

    def _send(self) -> None:
        rig = self.gate
        assert rig is not None
        stamp_ns = rig.stamp_ns
        self.joint_states.publish(stamp_ns, rig.position)
        self.torque_sensors.publish(stamp_ns, rig.torque)
        if rig.tick % _CLOCK_TICKS == 0:
            self._clock_publisher.publish(stamp_ns)

    def _report_timing(self, paced: RealtimeSimulator) -> None:
        rig = self.gate
        assert rig is not None
        with paced.lock:
            stamp_ns, self._told_timing = rig.stamp_ns, rig.tick
            figures = paced.figures()
        self.diagnostics.publish(make_array(stamp_ns, [status_message(figures)]))


def main() -> int:
    """Run the simulator node as a process."""
    return run_node(ArmSimNode)


if __name__ == "__main__":
    sys.exit(main())
