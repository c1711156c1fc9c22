"""The simulator node: ROS around :class:`armimp_sim.rig.SimulatedRig`."""

from __future__ import annotations

import sys
from contextlib import AbstractContextManager, nullcontext
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from std_srvs.srv import Trigger

from armimp_common import contract, qos
from armimp_common.channels import (
    ClockPublisher,
    CommandSubscription,
    CountSubscription,
    JointStatePublisher,
)
from armimp_common.diagnostics import Level, make_array, make_status
from armimp_common.discovery import wait_for_partners
from armimp_common.errors import ArmimpError, GraphError
from armimp_common.jitter import TIMING_NAME
from armimp_common.lifecycle import reported
from armimp_common.liveliness import Presence, SignOfLife, Watch
from armimp_common.pacing import Pacer
from armimp_common.parameters import declare, guard, load
from armimp_common.spin import run_node
from armimp_common.urgency import Urgency
from armimp_sim.backlog import Backlog
from armimp_sim.paced import PacedRig
from armimp_sim.parameters import SimulatorParameters
from armimp_sim.rig import SimulatedRig

_CLOCK_TICKS = 100
_DIAGNOSTICS_TICKS = 1000
_FAULT_PERIOD = 1.0
"""Wall time between reports of a latched fault (s), since simulated time may stand still."""
_TIMING_TICKS = 100
"""Ticks between two reports of the timing in realtime."""
_LOOK_PERIOD = 0.05
"""Wall time between two looks at the rig in realtime, which may come to a fault by itself (s)."""
_STOPPED = "emergency stop"


class ArmSimNode(LifecycleNode):
    """Publishes samples: one for each command (lockstep), or one each millisecond (realtime)."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(contract.SIM_NODE, **kwargs)
        self.transition_error = ""
        self._active = False
        self._rig: SimulatedRig | None = None
        self._paced: PacedRig | None = None
        self._urgency: Urgency | None = None
        self._stopped = self._holding = self._faulty = False
        self._told = self._timing_told = 0
        self._backlog = Backlog()
        self._sign = SignOfLife(self, contract.SIM_NODE)
        self._controller = Watch(self, contract.CONTROLLER_NODE, self._on_controller)
        self._recorder = Watch(self, contract.ESTIMATOR_NODE, self._on_recorder)
        self.create_service(Trigger, contract.SIM_STOP_SERVICE, self._on_emergency_stop)
        self.create_service(Trigger, contract.SIM_RESET_SERVICE, self._on_reset)
        declare(self, SimulatorParameters, SimulatorParameters.preset())
        guard(self, lambda: "the simulation is running" if self._active else None)

    @reported
    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Build the rig and its topics from the parameters."""
        parameters = self._settings = load(self, SimulatorParameters)
        names = parameters.joints
        self._rig = SimulatedRig(parameters)
        if self._stopped:
            self._rig.latch(_STOPPED)
        self._joint_states = JointStatePublisher(self, contract.JOINT_STATES, names, "position")
        self._torque_sensors = JointStatePublisher(self, contract.TORQUE_SENSORS, names, "effort")
        self._clock_publisher = ClockPublisher(self)
        self._diagnostics = self.create_publisher(
            DiagnosticArray, contract.DIAGNOSTICS, qos.DIAGNOSTICS
        )
        self._commands = CommandSubscription(
            self, contract.COMMANDS, len(names), self._on_command, on_malformed=self._on_malformed
        )
        self._backlog = Backlog()
        self._backlog.silent = self._recorder.presence in (Presence.STALLED, Presence.SILENT)
        self._holding = False
        self._received = CountSubscription(
            self, contract.RECEIVED, self._on_received, on_malformed=self._on_malformed_count
        )
        self._timers = [self.create_timer(_FAULT_PERIOD, self._on_fault_timer)]
        if parameters.mode == "realtime":
            self._timers.append(self.create_timer(_LOOK_PERIOD, self._on_look_timer))
        return TransitionCallbackReturn.SUCCESS

    @reported
    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Send the first sample, once somebody listens and commands."""
        wait_for_partners(
            self,
            publishers=[self._joint_states, self._torque_sensors],
            subscriptions=[self._commands],
            watches=[self._controller, self._recorder],
        )
        self._active = True
        self._holding = False
        assert self._rig is not None
        if self._rig.fault:
            self._report(self._rig)
        if self._settings.mode == "realtime":
            self._pace(self._rig)
        else:
            self._publish()
        return super().on_activate(state)

    @reported
    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop: no torque acts, and further commands are ignored."""
        self._rest()
        return super().on_deactivate(state)

    @reported
    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Forget the rig, so that new parameters can be used; only an emergency stop remains."""
        for timer in self._timers:
            self.destroy_timer(timer)
        for publisher in (
            self._joint_states.publisher,
            self._torque_sensors.publisher,
            self._clock_publisher.publisher,
            self._diagnostics,
        ):
            self.destroy_publisher(publisher)
        self.destroy_subscription(self._commands.subscription)
        self.destroy_subscription(self._received.subscription)
        self._rig = None
        return TransitionCallbackReturn.SUCCESS

    @reported
    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop for good."""
        self._rest()
        return TransitionCallbackReturn.SUCCESS

    def destroy_node(self) -> None:
        """End the thread that paces the rig, should the node end while it is active."""
        self._rest()
        super().destroy_node()

    def _pace(self, rig: SimulatedRig) -> None:
        realtime = self._settings.realtime
        pacer = Pacer(contract.PERIOD_NS, spin_ns=round(realtime.spin * contract.NS_PER_S))
        self._paced = PacedRig(rig, self._send, pacer)
        try:
            self._urgency = Urgency(realtime)
        except GraphError:
            self._active, self._paced = False, None
            raise
        self._told = self._timing_told = rig.tick
        self._paced.start()

    @property
    def _alone(self) -> AbstractContextManager[object]:
        """Keeps the thread that paces the rig away from it."""
        return nullcontext() if self._paced is None else self._paced.lock

    def _rest(self) -> None:
        active, self._active = self._active, False
        if self._paced is not None:
            self._paced.stop()
            if self.context.ok():
                self._report_timing(self._paced)
            self._paced = None
        if self._urgency is not None:
            self._urgency.give_back()
            self._urgency = None
        if active and self._rig is not None:
            self._rig.rest()
            if self.context.ok():
                self._report(self._rig)

    def _on_command(self, command: tuple[float, ...]) -> None:
        rig = self._rig
        if not self._active or rig is None:
            return
        if self._paced is not None:
            self._paced.command(command)
            if rig.tick - self._timing_told >= _TIMING_TICKS:
                # Now, since nothing else is due until the next sample.
                self._report_timing(self._paced)
            return
        sound = not rig.fault
        rig.step(command)
        if sound and rig.fault:
            self._report(rig)
        self._publish_or_hold()

    def _on_malformed(self, error: ArmimpError) -> None:
        rig = self._rig
        if not self._active or rig is None:
            return
        if self._paced is not None:
            self._paced.refuse(f"malformed command: {error}")
            return
        self._fault(f"malformed command: {error}")
        rig.step((0.0,) * rig.position.size)
        self._publish_or_hold()

    def _on_controller(self, controller: Watch) -> None:
        # In lockstep time stands still without commands, and goes on with a controller that is
        # only stalled. The torque of one that died must not outlast it.
        if controller.presence.lost:
            self._fault(controller.sentence)

    def _on_recorder(self, recorder: Watch) -> None:
        """Wait for a recorder that is silent: it may only be stopped. There is no trial without."""
        self._backlog.silent = recorder.presence in (Presence.STALLED, Presence.SILENT)
        if recorder.presence in (Presence.GONE, Presence.LEFT) and self._backlog.recorded:
            self._fault(f"{recorder.sentence}, and a trial without recorder is of no use")
            self._backlog.acknowledge(contract.RECORDER_GONE)
        self._go_on()

    def _on_emergency_stop(
        self, request: Trigger.Request, response: Trigger.Response
    ) -> Trigger.Response:
        self._stopped = True
        self._fault(_STOPPED)
        response.success = True
        response.message = f"no torque until {contract.SIM_RESET_SERVICE} is called"
        return response

    def _on_reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        try:
            if self._paced is not None:
                self._paced.reset()
            elif self._rig is not None:
                self._rig.reset()
        except GraphError as error:
            response.success, response.message = False, str(error)
            return response
        self._stopped = False
        if self._rig is not None:
            self._report(self._rig)
        response.success, response.message = True, "commands are obeyed"
        return response

    def _on_fault_timer(self) -> None:
        if self._rig is not None and self._rig.fault:
            self._report(self._rig)

    def _fault(self, reason: str) -> None:
        """Take torque away and say why; an inactive rig is under no torque and needs no fault."""
        rig = self._rig
        if rig is None or not (self._active or self._stopped):
            return
        sound = not rig.fault
        with self._alone:
            rig.latch(reason)
        if sound:
            self._report(rig)

    def _on_look_timer(self) -> None:
        """Tell what has happened in the thread, which must not lose time with that."""
        paced, rig = self._paced, self._rig
        if paced is None or rig is None:
            return
        if paced.error is not None:
            raise paced.error
        if bool(rig.fault) is not self._faulty or rig.tick - self._told >= _DIAGNOSTICS_TICKS:
            self._report(rig)

    def _on_received(self, samples: int) -> None:
        self._backlog.acknowledge(samples)
        self._go_on()

    def _on_malformed_count(self, error: ArmimpError) -> None:
        self.get_logger().warning(f"{contract.RECEIVED}: {error}")

    def _go_on(self) -> None:
        if self._holding and self._active and not self._backlog.full:
            self._holding = False
            self._publish()

    def _publish_or_hold(self) -> None:
        if self._backlog.full:
            self._holding = True
        else:
            self._publish()

    def _publish(self) -> None:
        rig = self._rig
        assert rig is not None
        self._backlog.count_sent()
        self._send()
        if rig.tick % _DIAGNOSTICS_TICKS == 0:
            self._report(rig)

    def _send(self) -> None:
        rig = self._rig
        assert rig is not None
        stamp_ns = rig.stamp_ns
        self._joint_states.publish(stamp_ns, rig.position)
        self._torque_sensors.publish(stamp_ns, rig.torque)
        if rig.tick % _CLOCK_TICKS == 0:
            self._clock_publisher.publish(stamp_ns)

    def _report(self, rig: SimulatedRig) -> None:
        with self._alone:
            stamp_ns, tick, fault, applied = rig.stamp_ns, rig.tick, rig.fault, rig.applied
        self._faulty, self._told = bool(fault), tick
        status = make_status(
            f"{contract.SIM_NODE}: rig",
            Level.ERROR if fault else Level.OK,
            fault or ("running" if self._active else "stopped"),
            {"tick": tick, "applied": applied},
        )
        self._diagnostics.publish(make_array(stamp_ns, [status]))

    def _report_timing(self, paced: PacedRig) -> None:
        rig = self._rig
        assert rig is not None
        with paced.lock:
            stamp_ns, self._timing_told = rig.stamp_ns, rig.tick
            figures = paced.figures()
        status = make_status(TIMING_NAME, Level.OK, "timing since activation", figures.to_values())
        self._diagnostics.publish(make_array(stamp_ns, [status]))


def main() -> int:
    """Run the simulator node as a process."""
    return run_node(ArmSimNode)


if __name__ == "__main__":
    sys.exit(main())
