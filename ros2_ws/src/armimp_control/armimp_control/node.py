"""The controller node: ROS around :class:`armimp_control.experiment.Experiment`."""

from __future__ import annotations

import sys
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.duration import Duration
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from rclpy.publisher import Publisher
from std_srvs.srv import Trigger

from armimp_common import qos, topics
from armimp_common.errors import ArmimpError, GraphError, MalformedMessageError
from armimp_common.executor import run_node, steady_timer
from armimp_common.heartbeat import Heartbeat, HeartbeatMonitor, Presence
from armimp_common.lifecycle import ManagedNode, reported
from armimp_common.parameters import declare, guard, load, require_unchanged
from armimp_common.pubsub import (
    CommandPublisher,
    CountSubscription,
    JointStatePublisher,
    JointStateSubscription,
    wait_for_partners,
)
from armimp_common.realtime import RealtimeScheduling
from armimp_common.status import (
    LIMITER_STATUS,
    Level,
    Phase,
    StoppingDecision,
    TrialStatus,
    make_array,
    make_status,
    status_message,
    values_of,
)
from armimp_control.experiment import Experiment
from armimp_control.pairs import Reading, SamplePairs, first_bad
from armimp_control.parameters import PERIOD, ControllerParameters
from armimp_control.safety import Limit
from armimp_control.watchdog import Watchdog

_WATCHDOG_PERIODS = {"lockstep": 0.02, "realtime": PERIOD}
"""How often the watchdog looks (s); on the way down to zero once a period in any mode."""
_DIAGNOSTICS_TICKS = 1000
_STOPPED = "emergency stop"
_FAREWELL = Duration(seconds=0.5)
"""How long the last command and status may take to arrive before this process ends."""
_NO_SAMPLE = "no sensor sample arrived any more"
_NO_JUDGEMENT = "the estimator does not say whether the trial is over"


class ImbicControllerNode(ManagedNode):
    """Answers each sample with one command and one perturbation message."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(topics.CONTROLLER_NODE, **kwargs)
        self._active = self._lockstep = False
        self._experiment: Experiment | None = None
        self._sign = Heartbeat(self, topics.CONTROLLER_NODE)
        self._watches = [
            HeartbeatMonitor(self, topics.SIM_NODE, self._on_presence),
            HeartbeatMonitor(self, topics.SUPERVISOR_NODE, self._on_supervisor_presence),
            HeartbeatMonitor(self, topics.ESTIMATOR_NODE, self._on_recorder_presence),
        ]
        self._recorded = False
        self._fault = ""
        self._urgency: RealtimeScheduling | None = None
        self._clips_told = 0
        self._stamp_ns = 0
        self._diagnostics: Publisher | None = None
        self.create_service(Trigger, topics.CONTROLLER_STOP_SERVICE, self._on_emergency_stop)
        self.create_service(Trigger, topics.CONTROLLER_RESET_SERVICE, self._on_reset)
        CountSubscription(self, topics.RECEIVED, self._on_received)
        self.create_subscription(DiagnosticStatus, topics.STOPPING, self._on_judgement, qos.LATCHED)
        declare(self, ControllerParameters)
        guard(self, lambda: "a trial is running" if self._active else None)

    @reported
    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Check the parameters and the stability of the loop; make the topics."""
        parameters = self._settings = load(self, ControllerParameters)
        names = parameters.joints
        for warning in self._prepare().margins.warnings:
            self.get_logger().warning(warning)
        self._commands = CommandPublisher(self, topics.COMMANDS, len(names))
        self._perturbation = JointStatePublisher(self, topics.PERTURBATION, names, "effort")
        self._trial = self.create_publisher(DiagnosticStatus, topics.TRIAL, qos.LATCHED)
        self._diagnostics = self.create_publisher(
            DiagnosticArray, topics.DIAGNOSTICS, qos.DIAGNOSTICS
        )
        self._joint_states = JointStateSubscription(
            self,
            topics.JOINT_STATES,
            names,
            "position",
            self._on_position,
            on_malformed=self._on_malformed,
        )
        self._torque_sensors = JointStateSubscription(
            self,
            topics.TORQUE_SENSORS,
            names,
            "effort",
            self._on_torque,
            on_malformed=self._on_malformed,
        )
        period = _WATCHDOG_PERIODS[parameters.mode]
        self._timer = steady_timer(self, period, self._on_watchdog, autostart=False)
        self._ramp = steady_timer(self, PERIOD, self._on_watchdog, autostart=False)
        return TransitionCallbackReturn.SUCCESS

    @reported
    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Wait for the other end, then answer samples; refused while a fault is latched."""
        require_unchanged(self)
        if self._fault:
            raise GraphError(
                f"a fault is latched: {self._fault}; call {topics.CONTROLLER_RESET_SERVICE} first"
            )
        wait_for_partners(
            self,
            publishers=[self._commands],
            subscriptions=[self._joint_states, self._torque_sensors],
            monitors=[watch for watch in self._watches if watch.name != topics.SUPERVISOR_NODE],
        )
        if self._experiment is None:
            self._prepare()
        self._watchdog = Watchdog(
            self._settings.safety_config(),
            slowest_tick=self._settings.patience_per_tick,
            period=PERIOD,
        )
        if self._settings.mode == "realtime":
            self._urgency = RealtimeScheduling(self._settings.realtime)
        self._active = True
        self._lockstep = self._settings.mode == "lockstep"
        self._timer.reset()
        return super().on_activate(state)

    @reported
    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Take torque away; the next activation starts a new experiment."""
        self._stop("the controller was deactivated")
        self._experiment = None
        return super().on_deactivate(state)

    @reported
    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Forget everything, so that new parameters can be used."""
        self.destroy_timer(self._timer)
        self.destroy_timer(self._ramp)
        for channel in (self._joint_states, self._torque_sensors):
            self.destroy_subscription(channel.subscription)
        for publisher in (
            self._commands.publisher,
            self._perturbation.publisher,
            self._trial,
            *([] if self._diagnostics is None else [self._diagnostics]),
        ):
            self.destroy_publisher(publisher)
        self._diagnostics = None
        self._experiment = None
        return TransitionCallbackReturn.SUCCESS

    @reported
    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Take torque away for good."""
        if self._active:
            self._stop("the controller was shut down")
        return TransitionCallbackReturn.SUCCESS

    def destroy_node(self) -> None:
        """Take torque away, should the node end while it is active."""
        if self._active and self.context.ok():
            self._stop("the controller was ended")
            # What is lost on its way now is not sent again, once the publishers are gone.
            for publisher in (self._commands.publisher, self._trial):
                publisher.wait_for_all_acked(_FAREWELL)
        super().destroy_node()

    def _prepare(self) -> Experiment:
        self._experiment = Experiment(self._settings, self._announce)
        self._pairs = SamplePairs()
        self._held: tuple[int, Reading, Reading] | None = None
        self._garbled = ""
        self._clips_told = 0
        return self._experiment

    def _stop(self, reason: str) -> None:
        """Leave the plant with zero torque and the world with an explanation."""
        self._active = self._lockstep = False
        self._timer.cancel()
        self._ramp.cancel()
        if self._urgency is not None:
            self._urgency.give_back()
            self._urgency = None
        if self._experiment is not None and not self._experiment.at_rest:
            self._experiment.abort(reason)
            self._commands.publish(self._experiment.command)

    def _announce(self, status: TrialStatus) -> None:
        self._trial.publish(status_message(status))
        if status.phase is Phase.ABORTED:
            self._held = None  # answered by the command that ends the experiment
        # Without being active: the node was told to end the experiment, which is no fault.
        if status.phase is Phase.ABORTED and self._active:
            self._latch(status.reason)

    def _on_position(self, stamp_ns: int, theta: Reading) -> None:
        tau_h = self._pairs.with_position(stamp_ns, theta)
        if tau_h is not None:
            self._answer(stamp_ns, theta, tau_h)
        elif (bad := first_bad(theta)) is not None:
            self._refuse_reading("position", bad, theta)

    def _on_torque(self, stamp_ns: int, tau_h: Reading) -> None:
        theta = self._pairs.with_torque(stamp_ns, tau_h)
        if theta is not None:
            self._answer(stamp_ns, theta, tau_h)
        elif (bad := first_bad(tau_h)) is not None:
            self._refuse_reading("torque reading", bad, tau_h)

    def _refuse_reading(self, what: str, bad: int, values: Reading) -> None:
        """Nonsense is a fault already while its partner is still to come, which may be never."""
        if self._experiment is not None and not self._experiment.at_rest:
            self._refuse(f"{what} of joint {bad + 1} is not finite: {values[bad]}")

    def _answer(self, stamp_ns: int, theta: Reading, tau_h: Reading) -> None:
        experiment = self._experiment
        if not self._active or experiment is None:
            return
        now = time.monotonic()
        if not self._lockstep and self._watchdog.expired(now):
            # The sample came before the timer, as after a stall of this process.
            self._on_watchdog()
        self._watchdog.feed(now)
        self._stamp_ns, self._garbled = stamp_ns, ""
        held, self._held = self._held, None
        if held is not None:
            self._command(experiment, *held)  # whoever sends the next sample does not wait
        elif self._lockstep and experiment.awaits_judgement:
            # So that a trial ends at the same sample however fast the machine is.
            self._held = (stamp_ns, theta, tau_h)
            return
        self._command(experiment, stamp_ns, theta, tau_h)

    def _command(
        self,
        experiment: Experiment,
        stamp_ns: int,
        theta: Reading,
        tau_h: Reading,
    ) -> None:
        experiment.answer(stamp_ns, theta, tau_h)
        self._commands.publish(experiment.command)
        self._perturbation.publish(stamp_ns, experiment.tau_delta)
        if experiment.tick % _DIAGNOSTICS_TICKS == 0:
            self._report()

    def _on_malformed(self, error: ArmimpError) -> None:
        self._refuse(f"malformed sensor message: {error}")

    def _refuse(self, reason: str) -> None:
        """End the experiment with zero torque because of a message that can not be used."""
        experiment = self._experiment
        if not self._active or experiment is None:
            return
        self._garbled = reason
        experiment.abort(self._garbled)
        self._commands.publish(experiment.command)

    def _on_presence(self, watch: HeartbeatMonitor) -> None:
        # In lockstep time stands still with a simulator that is stalled; a rig goes on. Before
        # the first sample there is no torque to take away from one that is only slow to start.
        begun = self._experiment is not None and self._experiment.tick > 0
        if watch.presence.lost or (watch.presence.mute and not self._lockstep and begun):
            self._take_away(watch.sentence)

    def _on_supervisor_presence(self, watch: HeartbeatMonitor) -> None:
        # Silence alone is no danger: the other nodes still watch one another.
        if watch.presence in (Presence.GONE, Presence.LEFT):
            self._take_away(watch.sentence)

    def _on_recorder_presence(self, watch: HeartbeatMonitor) -> None:
        # In lockstep the simulator waits for a recorder which is only stopped; a rig cannot wait.
        waits = self._lockstep and watch.presence in (Presence.STALLED, Presence.SILENT)
        if watch.presence.mute and not waits:
            self._take_away(watch.sentence)

    def _on_received(self, samples: int) -> None:
        """Hear from the recorder; without one a trial is of no use to anybody."""
        recorded, self._recorded = self._recorded, samples != topics.RECORDER_GONE
        if recorded and not self._recorded:
            self._take_away("nothing is recorded any more")

    def _on_judgement(self, message: DiagnosticStatus) -> None:
        """Hear from the estimator how good the trial is already."""
        experiment = self._experiment
        if not self._active or experiment is None:
            return
        if not self._settings.sequence.may_end_early:
            self.get_logger().warning(f"{topics.STOPPING}: refused, as nobody asked for it")
            return
        if (publishers := self.count_publishers(topics.STOPPING)) > 1:
            self._take_away(f"{topics.STOPPING} has {publishers} publishers")
            return
        try:
            experiment.judge(StoppingDecision.from_values(values_of(message)))
        except MalformedMessageError as error:
            self.get_logger().warning(str(error))
        if self._held is not None and not experiment.awaits_judgement:
            held, self._held = self._held, None
            self._command(experiment, *held)

    def _take_away(self, reason: str) -> None:
        """End a running experiment with zero torque, for a reason outside of this node."""
        experiment = self._experiment
        if not self._active or experiment is None or (experiment.finished and experiment.at_rest):
            return
        experiment.abort(reason)
        self._commands.publish(experiment.command)

    def _on_watchdog(self) -> None:
        experiment, now = self._experiment, time.monotonic()
        if experiment is None or not self._watchdog.expired(now):
            # Not for nothing: in real time this is asked every millisecond.
            if not self._ramp.is_canceled():
                self._ramp.cancel()
            return
        if self._lockstep and self._ramp.is_canceled():
            self._ramp.reset()
        if not experiment.finished:
            experiment.stop(_NO_SAMPLE if self._held is None else _NO_JUDGEMENT)
        experiment.fall(self._watchdog.ticks_due(now))
        self._commands.publish(experiment.command)
        if experiment.at_rest:
            self._timer.cancel()
            self._ramp.cancel()

    def _latch(self, reason: str) -> None:
        """Remember the first fault, until it is reset."""
        self._fault = self._fault or reason
        self._report()

    def _on_emergency_stop(
        self, request: Trigger.Request, response: Trigger.Response
    ) -> Trigger.Response:
        """Zero torque at once, in whatever state the node is."""
        experiment = self._experiment
        if self._active and experiment is not None and not experiment.at_rest:
            experiment.abort(_STOPPED)
            self._commands.publish(experiment.command)
        self._latch(_STOPPED)
        response.success = True
        response.message = f"no torque until {topics.CONTROLLER_RESET_SERVICE} is called"
        return response

    def _on_reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Forget the fault; an experiment that it ended stays over."""
        refusal = self._reset_refusal()
        response.success = not refusal
        if refusal:
            response.message = f"not reset: {refusal}"
        elif self._fault:
            response.message = f"reset: {self._fault}; the next activation begins a new experiment"
            self._fault = ""
            self._report()
        else:
            response.message = "there was no fault"
        return response

    def _reset_refusal(self) -> str:
        """Why the fault must not be forgotten now; empty if it may."""
        experiment = self._experiment
        if not self._active or experiment is None:
            return ""  # nothing is heard of the rig; the gate will look at the first sample
        if not experiment.finished:
            return "a trial is running"
        if self._watchdog.expired(time.monotonic()):
            return f"the cause persists: {_NO_SAMPLE}"
        persisting = self._garbled or experiment.present_fault
        return f"the cause persists: {persisting}" if persisting else ""

    def _report(self) -> None:
        """Publish what the gate does on ``/diagnostics``."""
        experiment = self._experiment
        if self._diagnostics is None:
            return
        clips = {} if experiment is None else experiment.clips
        told, self._clips_told = self._clips_told, sum(clips.values())
        level = Level.WARN if self._clips_told > told else Level.OK
        status = make_status(
            LIMITER_STATUS,
            Level.ERROR if self._fault else level,
            self._fault or ("commands were clipped" if level is Level.WARN else "no fault"),
            {
                "fault": self._fault,
                "tick": 0 if experiment is None else experiment.tick,
                **{f"clipped_{limit.value}": clips.get(limit, 0) for limit in Limit},
            },
        )
        self._diagnostics.publish(make_array(self._stamp_ns, [status]))


def main() -> int:
    """Run the controller node as a process."""
    return run_node(ImbicControllerNode)


if __name__ == "__main__":
    sys.exit(main())
