"""Base of all nodes that take the place of the rig: when torque may act, and how it is removed.

The simulator, a driver and the bridge to ros2_control differ in where samples come from and where
commands go. Emergency stop, reset, latched faults, supervision of the controller, and the lifecycle
transitions that end an experiment are the same for all of them.
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, Generic, TypeVar

from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from rclpy.subscription import Subscription

from armimp_common import topics
from armimp_common.errors import ArmimpError, GraphError
from armimp_common.executor import steady_timer
from armimp_common.heartbeat import HeartbeatMonitor
from armimp_common.lifecycle import ManagedNode
from armimp_common.parameters import ParameterSet
from armimp_common.protection import CommandSequence, Protection, TorqueLatch
from armimp_common.pubsub import (
    JointStatePublisher,
    RawPublisher,
    create_publisher,
    subscribe_decoded,
    wait_for_partners,
)
from armimp_common.realtime import TimingMeter
from armimp_common.schema import ModelT
from armimp_common.status import Level, TimingFigures, make_array, make_status, status_message

_STOPPED = "emergency stop"
_CHECK_PERIOD = 0.02
"""Time between two checks for faults and for other publishers of commands (s)."""
_REPORT_PERIOD = 1.0
"""Wall time between two regular reports (s)."""
_DRIFT_NS = 20
"""How much the clock of the stamps may lose against that of this host in one period (ns)."""
_LEFT = "perhaps one that left before its name was known"
_NAMES_PATIENCE, _MOST_NAMES = 0.5, 8
"""How long to wait at the end for names of publishers (s), and how many are reported at most."""


MOST_UNDER_WAY = 45
"""Samples that may be under way to the recorder.

If the recorder is killed they are lost, and so is what it has not yet written, at most 50 ms of
samples: together less than 100 ms. Their messages, four for each, also fit the receive buffer of a
socket: the kernel charges 1.3 KiB for one, and grants at least 416 KiB by default. The transport
loses what does not fit, and a writer that waits repairs that only with its next heartbeat.
"""


class FlowControl:
    """Flow control in lockstep: the rig waits for a recorder that falls behind.

    A recorder reports how many samples it has received since it began: 0 announces it, and
    :data:`armimp_common.topics.RECORDER_GONE` says that it has ended. Without a recorder nothing
    waits. Since nothing else limits the pace in lockstep, a recorder on a loaded machine would
    otherwise lose samples once the queues are full.

    Attributes
    ----------
    recorded : whether a recorder has announced itself and has not ended
    silent : whether the heartbeat of the recorder is missing, so that the next sample has to wait
    """

    def __init__(self) -> None:
        self._sent = self._under_way = self._received = 0
        self.recorded = self.silent = False

    def count_sent(self) -> None:
        """Count one more sample as under way."""
        self._sent += 1
        self._under_way += 1

    def acknowledge(self, received: int) -> None:
        """Take a count of received samples from the recorder."""
        if received == topics.RECORDER_GONE:
            self.recorded = False
            return
        if received == 0 or not self.recorded:
            self._under_way, self._sent = 0, max(self._sent, received)
        elif self._received <= received <= self._sent:
            # It may also have received samples that were sent before its 0 arrived.
            self._under_way = max(self._under_way - (received - self._received), 0)
        else:
            return  # from another publisher: no count falls, or exceeds what was sent
        self.recorded = True
        self._received = received

    @property
    def full(self) -> bool:
        """Whether the next sample has to wait."""
        return self.recorded and (self.silent or self._under_way >= MOST_UNDER_WAY)


LimiterT = TypeVar("LimiterT", bound=TorqueLatch)


class DriverBase(ManagedNode, ABC, Generic[LimiterT, ModelT]):
    """A lifecycle node in the place of the rig; subclasses define where torque goes.

    Commands arrive at :meth:`on_command`. `on_configure` of a subclass calls :meth:`set_up`, its
    `on_activate` sets `active` once commands are obeyed, and :meth:`rest` undoes that.

    Parameters
    ----------
    parameters : default values of the declared parameters
    busy : why parameters cannot be changed while the node is active

    Attributes
    ----------
    active : whether commands are obeyed
    declared : the declared parameters
    configured : whether the rig is known and its topics exist
    limiter : decides which torque acts, once configured
    controller : monitor of the controller's heartbeat
    joint_states, torque_sensors, commands, diagnostics : topics that every rig has, once configured
    reported_fault : the fault that was reported last
    """

    def __init__(self, parameters: ModelT, busy: str, **kwargs: Any) -> None:
        super().__init__(topics.SIM_NODE, **kwargs)
        self.reported_fault = ""
        self.active = self.configured = self._stopped = False
        self.limiter: LimiterT
        self._sequence = CommandSequence()
        self._commanders = 0
        self._names: list[str] | None = None  # of publishers of commands, if they are accused
        self.controller = HeartbeatMonitor(self, topics.CONTROLLER_NODE, self._on_controller)
        self.offer_trigger(topics.SIM_STOP_SERVICE, self._on_stop)
        self.offer_trigger(topics.SIM_RESET_SERVICE, self._on_reset)
        self.declared = ParameterSet(
            self, type(parameters), parameters, locked=lambda: busy if self.active else None
        )

    def set_up(self, limiter: LimiterT, joints: Sequence[str]) -> None:
        """Create the topics that every rig has; an earlier emergency stop remains in force."""
        if self._stopped:
            limiter.latch(_STOPPED)
        self.limiter = limiter
        self.joint_states = JointStatePublisher(self, topics.JOINT_STATES, joints)
        self.torque_sensors = JointStatePublisher(self, topics.TORQUE_SENSORS, joints)
        self.diagnostics = create_publisher(self, topics.DIAGNOSTICS)
        self.commands = subscribe_decoded(
            self, topics.COMMANDS, joints, self._on_numbered, self.on_malformed
        )
        steady_timer(self, _CHECK_PERIOD, self.check)
        steady_timer(self, _REPORT_PERIOD, self.report_regularly)
        self.configured = True

    # Hooks of subclasses; all but the first two have a default.

    @abstractmethod
    def on_command(self, command: tuple[float, ...]) -> None:
        """Take a command (n,), N·m."""

    @abstractmethod
    def rest(self) -> None:
        """Remove all torque and obey no further commands; calling it again is harmless."""

    def on_malformed(self, error: ArmimpError) -> None:
        """Take a message that is no valid command: latch a fault."""
        self.latch(f"malformed command: {error}")

    def torque_was_taken(self) -> None:
        """Tell the drives that torque was removed; called when an active node latches a fault."""

    def obey_again(self) -> None:
        """Clear a fault, so that commands are obeyed again.

        Raises
        ------
        GraphError
            If torque would come back with a jump.
        """
        if self.configured:
            with self.limiter.lock:
                self.limiter.reset()

    def stamp_ns(self) -> int:
        """Stamp of reports, ns."""
        return int(self.get_clock().now().nanoseconds)

    def values(self) -> Mapping[str, Any]:
        """Further key-values for reports on ``/diagnostics``."""
        return {}

    def timing(self) -> TimingFigures | None:
        """Timing figures for reports; None where there is no real time."""
        return None

    # One command for one sample, from one publisher.

    def check(self) -> None:
        """Check for other publishers of commands, and report news of faults; called every 20 ms."""
        if self.active:
            publishers = self.commands.get_publisher_count()
            if publishers > 1:
                self.accuse(f"{publishers} publishers")
            elif not publishers:
                self._sequence.restart()
        self._name_publishers()
        self.report_news()

    def accuse(self, reason: str) -> None:
        """Latch a fault in the stream of commands, with the names of all their publishers."""
        if not self.configured or self.limiter.fault:
            return
        when = self.stamp_ns() / topics.NS_PER_S
        accusation = f"{topics.COMMANDS}: {reason} at {when:.3f} s"
        self.latch(accusation)
        self._commanders = 0
        self._names = [] if self.limiter.fault == accusation else None
        self._name_publishers()
        self.report_news()

    def _name_publishers(self, *, last: bool = False) -> None:
        """Note the names of all publishers of commands after an accusation, as they become known.

        Torque is gone already; the middleware may learn only later which node owns a publisher.
        """
        if self._names is None:
            return
        known = [
            f"{one.node_namespace.rstrip('/')}/{one.node_name}"
            for one in self.get_publishers_info_by_topic(self.commands.topic_name)
            if "UNKNOWN" not in one.node_name
        ]
        self._commanders = max(self._commanders, len(known))
        new = known if self._commanders > 1 or not last else [*known, _LEFT]
        self._names = list(dict.fromkeys([*self._names, *new]))[:_MOST_NAMES]

    def _conclude_accusation(self) -> None:
        """Wait a moment for names of publishers yet to be discovered: nothing else is due now."""
        end = time.monotonic() + _NAMES_PATIENCE
        while self._names is not None and self._commanders < 2 and time.monotonic() < end:
            self._name_publishers()
            time.sleep(_CHECK_PERIOD)
        self._name_publishers(last=True)
        self.report_news()

    def _on_numbered(self, number: int, command: tuple[float, ...]) -> None:
        if not self.active:
            self._sequence.restart()
        elif reason := self._sequence.check(number):
            self.accuse(reason)
        self.on_command(command)

    # Faults: one latch for all of them.

    def latch(self, reason: str) -> None:
        """Latch a fault and remove torque; without effect in a node that cannot apply torque."""
        if not self.configured or not (self.active or self._stopped):
            return
        with self.limiter.lock:
            self.limiter.latch(reason)
            if self.active:
                self.torque_was_taken()

    @property
    def fault(self) -> str:
        """Why torque was taken away, with the publishers of commands if they are accused of it."""
        return self.limiter.fault + (
            f"; published by {', '.join(self._names)}" if self._names else ""
        )

    def report(self) -> None:
        """Publish the state of the rig on ``/diagnostics``."""
        if not self.configured or not self.context.ok():
            return
        with self.limiter.lock:
            stamp_ns, fault, figures = self.stamp_ns(), self.fault, self.timing()
            values = {**self.values(), "applied": self.limiter.applied}
        if self._sequence.numbered is not None:
            by = "numbers and publishers" if self._sequence.numbered else "publishers alone"
            values["commands_told_apart_by"] = by
        self.reported_fault = fault
        words = fault or ("running" if self.active else "stopped")
        level = Level.ERROR if fault else Level.OK
        statuses = [make_status(f"{topics.SIM_NODE}: rig", level, words, values)]
        if figures is not None:
            statuses.append(status_message(figures))
        self.diagnostics.publish(make_array(stamp_ns, statuses))

    def report_regularly(self) -> None:
        """Publish the state of the rig; called every second."""
        self.report()

    def report_news(self) -> None:
        """Report a fault that has not been reported yet, or that one was cleared."""
        if self.configured and self.fault != self.reported_fault:
            self.report()

    def _on_controller(self, controller: HeartbeatMonitor) -> None:
        # The torque that a controller commanded must not outlast its death.
        if controller.presence.lost:
            self.latch(controller.sentence)
            self.report_news()

    def _on_stop(self) -> tuple[bool, str]:
        self._stopped = True
        self.latch(_STOPPED)
        self.report()
        return True, f"no torque until {topics.SIM_RESET_SERVICE} is called"

    def _on_reset(self) -> tuple[bool, str]:
        try:
            self.obey_again()
        except GraphError as error:
            return False, str(error)
        self._stopped, self._names = False, None
        self._sequence.restart()
        self.report()
        return True, "commands are obeyed"

    # Transitions that end an experiment: none of them leaves torque behind.

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop: no torque acts, and further commands are ignored."""
        self.rest()
        self._conclude_accusation()
        self._sequence.restart()
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Forget the rig, so that new parameters can be used; an emergency stop stays in force."""
        self.configured, self._names = False, None
        return TransitionCallbackReturn.SUCCESS

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop for good."""
        self.rest()
        self._conclude_accusation()
        return TransitionCallbackReturn.SUCCESS

    def destroy_node(self) -> None:
        """Remove all torque, in case the node ends while it is active."""
        self.rest()
        super().destroy_node()


class ProtectedDriver(DriverBase[Protection, ModelT], ABC, Generic[ModelT]):
    """A driver whose commands pass its own :class:`Protection` before the drives get them.

    `on_activate` calls :meth:`wait_for_controller`; each sample goes through :meth:`check_sample`
    and :meth:`publish_sample`.
    """

    @abstractmethod
    def drive(self, torque: Sequence[float]) -> None:
        """Send torques of the joints (n,), N·m, to the drives."""

    def wait_for_controller(
        self,
        publishers: Sequence[RawPublisher] = (),
        subscriptions: Sequence[Subscription] = (),
    ) -> None:
        """Wait for the controller, and for the peers of further publishers and subscriptions.

        Raises
        ------
        GraphError
            If one of them does not appear.
        """
        wait_for_partners(
            self,
            publishers=[self.joint_states, self.torque_sensors, *publishers],
            subscriptions=[self.commands, *subscriptions],
            monitors=[self.controller],
        )
        self._meter = TimingMeter()
        self._stamp_ns = 0
        self._begin_ns: int | None = None

    def obey_again(self) -> None:
        """Clear a fault, and estimate anew when samples are due, as stamps may have jumped."""
        super().obey_again()
        self._begin_ns = None

    def check_sample(self, angles: Sequence[float], periods: int) -> None:
        """Check the angles (n,), rad, of a sample that ends `periods` periods; 0 in lockstep.

        Latencies of commands count from this call.
        """
        with self.limiter.lock:
            self.limiter.sample(angles, time.monotonic_ns())
            for _ in range(periods):
                if self.limiter.period():
                    self._meter.missed()
            # Only torque that the driver itself changes is sent here; commands go out as they come.
            if periods and self.limiter.fault:
                self.drive(self.limiter.applied)

    def publish_sample(
        self, stamp_ns: int, angles: Sequence[float], torques: Sequence[float]
    ) -> None:
        """Publish a sample: stamp, ns; angles (n,), rad; torques on the arm (n,), N·m."""
        now_ns = time.monotonic_ns()
        self.joint_states.publish(stamp_ns, angles)
        self.torque_sensors.publish(stamp_ns, torques)
        # The first sample may itself be late, so the earliest one so far tells when others are due.
        begin_ns = now_ns - stamp_ns
        if self._begin_ns is not None:
            drift_ns = _DRIFT_NS * (stamp_ns - self._stamp_ns) // topics.PERIOD_NS
            begin_ns = min(self._begin_ns + drift_ns, begin_ns)
        self._begin_ns, self._stamp_ns = begin_ns, stamp_ns
        self._meter.sent(begin_ns + stamp_ns, now_ns)

    def on_command(self, command: tuple[float, ...]) -> None:
        """Pass a command (n,), N·m, on to the drives, as far as the protection allows."""
        if not self.active:
            return
        now_ns = time.monotonic_ns()
        with self.limiter.lock:
            self.limiter.command(command)
            if (sent_ns := self.limiter.watch.answered_ns) is not None:
                self._meter.answered(now_ns - sent_ns)
            self.drive(self.limiter.applied)

    def torque_was_taken(self) -> None:
        """Send the drives the torque that remains."""
        self.drive(self.limiter.applied)

    def timing(self) -> TimingFigures | None:
        """Return the timing of samples and commands while the node is active, else None."""
        return self._meter.figures() if self.active else None
