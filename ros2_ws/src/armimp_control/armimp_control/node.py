"""The controller node: ROS around :class:`armimp_control.trial_sequencer.TrialSequencer`."""

from __future__ import annotations

import sys
import time
from contextlib import ExitStack
from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.duration import Duration
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from rclpy.publisher import Publisher

from armimp_common import topics
from armimp_common.errors import ArmimpError, GraphError, MalformedMessageError
from armimp_common.executor import run_node, steady_timer
from armimp_common.heartbeat import HeartbeatMonitor
from armimp_common.lifecycle import ManagedNode
from armimp_common.parameters import ParameterSet
from armimp_common.protection import first_bad
from armimp_common.pubsub import (
    CommandPublisher,
    JointStatePublisher,
    create_publisher,
    subscribe,
    subscribe_counts,
    subscribe_decoded,
    wait_for_partners,
)
from armimp_common.realtime import realtime_scheduling
from armimp_common.status import (
    LIMITER_STATUS,
    Cause,
    Level,
    Phase,
    StoppingDecision,
    TrialStatus,
    make_array,
    make_status,
    status_message,
    values_of,
)
from armimp_control.parameters import ControllerParameters
from armimp_control.safety_limiter import COMMAND_LIMITS
from armimp_control.trial_sequencer import (
    Reading,
    SamplePairs,
    TrialSequencer,
    Watchdog,
)

_WATCHDOG_PERIODS = {"lockstep": 0.02, "realtime": topics.PERIOD}
"""Time between two checks of the watchdog (s); during a ramp to zero, one period in any mode."""
_DIAGNOSTICS_TICKS = 1000
_STOPPED = "emergency stop"
_UNCHECKED = 0.05
"""Largest age of the last check of the other nodes when torque is commanded (s)."""
_FAREWELL = Duration(seconds=0.2)
"""How long to wait for the last command and status to arrive before this process ends."""
_NO_SAMPLE = "no sensor sample arrived any more"
_NO_DECISION = "the estimator does not say whether the trial is over"


class ImbicControllerNode(ManagedNode):
    """Answers each sample with one command and one perturbation message."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(topics.CONTROLLER_NODE, **kwargs)
        self._active = self._lockstep = False
        self._sequencer: TrialSequencer | None = None
        self._partners = [
            HeartbeatMonitor(self, topics.SIM_NODE, self._on_rig),
            HeartbeatMonitor(self, topics.ESTIMATOR_NODE, self._on_recorder),
        ]
        self._supervisor = HeartbeatMonitor(self, topics.SUPERVISOR_NODE, self._on_supervisor)
        self._recorded = False
        self._fault = ""
        self._scheduling = ExitStack()
        self._reported_clips = 0
        self._stamp_ns = 0
        self._diagnostics: Publisher | None = None
        self.offer_trigger(topics.CONTROLLER_STOP_SERVICE, self._on_emergency_stop)
        self.offer_trigger(topics.CONTROLLER_RESET_SERVICE, self._on_reset)
        subscribe_counts(self, topics.RECEIVED, self._on_received)
        subscribe(self, topics.STOPPING, self._on_decision)
        self._declared = ParameterSet(
            self,
            ControllerParameters,
            locked=lambda: "a trial is running" if self._active else None,
        )

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Check the parameters and the stability of the loop; create the topics."""
        parameters = self._settings = self._declared.load()
        names = parameters.joints
        for warning in self._prepare().warnings:
            self.get_logger().warning(warning)
        self._commands = CommandPublisher(self, topics.COMMANDS, len(names))
        self._perturbation = JointStatePublisher(self, topics.PERTURBATION, names)
        self._trial = create_publisher(self, topics.TRIAL)
        self._diagnostics = create_publisher(self, topics.DIAGNOSTICS)
        self._sensors = [
            subscribe_decoded(
                self, topic, names, partial(self._on_reading, kind), self._on_malformed
            )
            for kind, topic in enumerate((topics.JOINT_STATES, topics.TORQUE_SENSORS))
        ]
        period = _WATCHDOG_PERIODS[parameters.mode]
        self._timer = steady_timer(self, period, self._on_watchdog, autostart=False)
        self._ramp = steady_timer(self, topics.PERIOD, self._on_watchdog, autostart=False)
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Wait for the other nodes, then answer samples; refused while a fault is latched."""
        self._declared.require_unchanged()
        if self._fault:
            raise GraphError(
                f"a fault is latched: {self._fault}; call {topics.CONTROLLER_RESET_SERVICE} first"
            )
        wait_for_partners(
            self,
            publishers=[self._commands],
            subscriptions=self._sensors,
            monitors=self._partners,
        )
        if self._sequencer is None:
            self._prepare()
        self._watchdog = Watchdog(self._settings.safety, slowest_tick=self._settings.slowest_tick)
        self._lockstep = self._settings.mode == "lockstep"
        if not self._lockstep:
            self._scheduling.enter_context(realtime_scheduling(self._settings.realtime.priority))
        self._active = True
        self._timer.reset()
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Take torque away; the next activation starts a new experiment."""
        self._rest("the controller was deactivated")
        self._sequencer = None
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Forget everything, so that new parameters can be used."""
        self._diagnostics = None
        self._sequencer = None
        return TransitionCallbackReturn.SUCCESS

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Take torque away for good."""
        if self._active:
            self._rest("the controller was shut down")
        return TransitionCallbackReturn.SUCCESS

    def destroy_node(self) -> None:
        """Take torque away, should the node end while it is active."""
        if self._active and self.context.ok():
            self._rest("the controller was ended")
        super().destroy_node()

    def _prepare(self) -> TrialSequencer:
        self._sequencer = TrialSequencer(self._settings, self._announce)
        self._pairs = SamplePairs()
        self._held: tuple[int, Reading, Reading] | None = None
        self._garbled = ""
        self._reported_clips = 0
        return self._sequencer

    @property
    def _running(self) -> TrialSequencer | None:
        """The sequencer while the node is active."""
        return self._sequencer if self._active else None

    def _rest(self, reason: str) -> None:
        """Leave the rig with zero torque, and announce the reason."""
        sequencer = self._sequencer
        self._active = self._lockstep = False
        self._timer.cancel()
        self._ramp.cancel()
        self._scheduling.close()
        if sequencer is not None and not sequencer.at_rest:
            self._abort(sequencer, Cause.NODE_ENDED, reason)
        # Once the publishers are gone, what was lost on its way is not sent again.
        for publisher in (self._commands.publisher, self._trial):
            publisher.wait_for_all_acked(_FAREWELL)

    def _abort(self, sequencer: TrialSequencer, cause: Cause, reason: str) -> None:
        sequencer.abort(cause, reason)
        self._commands.publish(sequencer.command)

    def _take_away(self, cause: Cause, reason: str) -> None:
        """End a running experiment with zero torque, for a reason outside of this node."""
        sequencer = self._running
        if sequencer is not None and not sequencer.at_rest:
            self._abort(sequencer, cause, reason)

    def _announce(self, status: TrialStatus) -> None:
        self._trial.publish(status_message(status))
        if status.phase is Phase.ABORTED:
            self._held = None  # answered by the command that ends the experiment
            # While inactive, the node was told to end the experiment, which is no fault.
            if self._active:
                self._latch(status.reason)

    # Samples.

    def _on_reading(self, kind: int, stamp_ns: int, values: Reading) -> None:
        other = self._pairs.other(kind, stamp_ns, values)
        if other is not None:
            theta, tau_h = (other, values) if kind else (values, other)
            self._answer(stamp_ns, theta, tau_h)
        elif (bad := first_bad(values)) is not None and (
            self._sequencer is not None and not self._sequencer.at_rest
        ):
            # A fault at once, as the other reading of the sample may never come.
            what = "torque reading" if kind else "position"
            self._refuse(f"{what} of joint {bad + 1} is not finite: {values[bad]}")

    def _on_malformed(self, error: ArmimpError) -> None:
        self._refuse(f"malformed sensor message: {error}")

    def _refuse(self, reason: str) -> None:
        """End the experiment with zero torque, because of a message that cannot be used."""
        if (sequencer := self._running) is not None:
            self._garbled = reason
            self._abort(sequencer, Cause.MALFORMED, reason)

    def _answer(self, stamp_ns: int, theta: Reading, tau_h: Reading) -> None:
        sequencer = self._sequencer
        if not self._active or sequencer is None:
            return
        now = time.monotonic()
        if not self._lockstep and self._watchdog.expired(now):
            # The sample came before the timer's check, as after a stall of this process.
            self._on_watchdog()
        self._watchdog.feed(now)
        self._stamp_ns, self._garbled = stamp_ns, ""
        held, self._held = self._held, None
        if held is not None:
            self._command(sequencer, *held)  # nobody waits for a decision any more
        elif self._lockstep and sequencer.awaits_decision:
            # Held, so that a trial ends at the same sample however fast the machine is.
            self._held = (stamp_ns, theta, tau_h)
            return
        self._command(sequencer, stamp_ns, theta, tau_h)

    def _command(
        self, sequencer: TrialSequencer, stamp_ns: int, theta: Reading, tau_h: Reading
    ) -> None:
        sequencer.answer(stamp_ns, theta, tau_h)
        if time.monotonic() - self._supervisor.checked > _UNCHECKED:
            before = sequencer.at_rest
            for monitor in (*self._partners, self._supervisor):
                monitor.check()
            if sequencer.at_rest and not before:
                return  # another node was lost, which has ended the experiment
        self._commands.publish(sequencer.command)
        self._perturbation.publish(stamp_ns, sequencer.tau_delta)
        if sequencer.tick % _DIAGNOSTICS_TICKS == 0:
            self._report()

    def _on_watchdog(self) -> None:
        sequencer, now = self._sequencer, time.monotonic()
        if sequencer is None or not self._watchdog.expired(now):
            # Not cancelled without need, as in real time this runs every millisecond.
            if not self._ramp.is_canceled():
                self._ramp.cancel()
            return
        if self._lockstep and self._ramp.is_canceled():
            self._ramp.reset()
        if not sequencer.finished:
            if self._held is None:
                sequencer.stop(Cause.SAMPLES_STOPPED, _NO_SAMPLE)
            else:
                sequencer.stop(Cause.DECISION_MISSING, _NO_DECISION)
        sequencer.controller.continue_ramp(self._watchdog.ticks_due(now))
        self._commands.publish(sequencer.command)
        if sequencer.at_rest:
            self._timer.cancel()
            self._ramp.cancel()

    # The other nodes.

    def _on_rig(self, monitor: HeartbeatMonitor) -> None:
        # In lockstep time stands still with a stalled simulator; a rig goes on. Before the first
        # sample there is no torque to take away from a rig that is only slow to start.
        begun = self._sequencer is not None and self._sequencer.tick > 0
        if monitor.presence.lost or (monitor.presence.silent and not self._lockstep and begun):
            self._take_away(Cause.NODE_LOST, monitor.sentence)

    def _on_supervisor(self, monitor: HeartbeatMonitor) -> None:
        # Its silence alone is no danger: the other nodes still watch one another.
        if monitor.presence.gone:
            self._take_away(Cause.NODE_LOST, monitor.sentence)

    def _on_recorder(self, monitor: HeartbeatMonitor) -> None:
        # In lockstep the simulator waits for a recorder that is only stopped; a rig cannot wait.
        if monitor.presence.gone or (monitor.presence.silent and not self._lockstep):
            self._take_away(Cause.NODE_LOST, monitor.sentence)

    def _on_received(self, samples: int) -> None:
        """Note whether there is a recorder; without one, a trial is of no use."""
        recorded, self._recorded = self._recorded, samples != topics.RECORDER_GONE
        if recorded and not self._recorded:
            self._take_away(Cause.NOT_RECORDED, "nothing is recorded any more")

    def _on_decision(self, message: DiagnosticStatus) -> None:
        """Take the estimator's decision whether the trial has lasted long enough."""
        sequencer = self._running
        if sequencer is None:
            return
        if not self._settings.sequence.may_end_early:
            self.get_logger().warning(f"{topics.STOPPING}: refused, as nobody asked for it")
            return
        if (publishers := self.count_publishers(topics.STOPPING)) > 1:
            self._take_away(Cause.STRANGER, f"{topics.STOPPING} has {publishers} publishers")
            return
        try:
            sequencer.decide(StoppingDecision.from_values(values_of(message)))
        except MalformedMessageError as error:
            self.get_logger().warning(str(error))
        if self._held is not None and not sequencer.awaits_decision:
            held, self._held = self._held, None
            self._command(sequencer, *held)

    # The latch.

    def _latch(self, reason: str) -> None:
        """Remember the first fault, until it is reset."""
        self._fault = self._fault or reason
        self._report()

    def _on_emergency_stop(self) -> tuple[bool, str]:
        """Zero torque at once, in whatever state the node is."""
        self._take_away(Cause.EMERGENCY_STOP, _STOPPED)
        self._latch(_STOPPED)
        return True, f"no torque until {topics.CONTROLLER_RESET_SERVICE} is called"

    def _on_reset(self) -> tuple[bool, str]:
        """Forget the fault; an experiment that it ended stays over."""
        if refusal := self._reset_refusal():
            return False, f"not reset: {refusal}"
        if not self._fault:
            return True, "there was no fault"
        fault, self._fault = self._fault, ""
        self._report()
        return True, f"reset: {fault}; the next activation begins a new experiment"

    def _reset_refusal(self) -> str:
        """Say why the fault must not be forgotten now; empty if it may."""
        sequencer = self._running
        if sequencer is None:
            return ""  # no samples are taken now; the first one will be checked
        if not sequencer.finished:
            return "a trial is running"
        if self._watchdog.expired(time.monotonic()):
            return f"the cause persists: {_NO_SAMPLE}"
        persisting = self._garbled or sequencer.controller.present_fault
        return f"the cause persists: {persisting}" if persisting else ""

    def _report(self) -> None:
        """Publish the state of the safety limiter on ``/diagnostics``."""
        sequencer = self._sequencer
        if self._diagnostics is None:
            return
        clipped = {} if sequencer is None else sequencer.controller.clipped
        before, self._reported_clips = self._reported_clips, sum(clipped.values())
        level = Level.WARN if self._reported_clips > before else Level.OK
        status = make_status(
            LIMITER_STATUS,
            Level.ERROR if self._fault else level,
            self._fault or ("commands were clipped" if level is Level.WARN else "no fault"),
            {
                "fault": self._fault,
                "tick": 0 if sequencer is None else sequencer.tick,
                **{f"clipped_{one}": clipped.get(one, 0) for one in COMMAND_LIMITS},
            },
        )
        self._diagnostics.publish(make_array(self._stamp_ns, [status]))


def main() -> int:
    """Run the controller node as a process."""
    return run_node(ImbicControllerNode)


if __name__ == "__main__":
    sys.exit(main())
