"""What all nodes in the place of the rig share: who may have torque, and how a node loses it.

The simulator, a driver and the bridge to ros2_control differ in where samples come from and where
commands go. Emergency stop, reset, latched faults, the watch over the controller and the way back
through the lifecycle are the same for all of them.
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from typing import Any, Generic, Protocol, TypeVar

from diagnostic_msgs.msg import DiagnosticArray
from pydantic import BaseModel
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from rclpy.publisher import Publisher
from rclpy.subscription import Subscription
from rclpy.timer import Timer
from std_srvs.srv import Trigger

from armimp_common import qos, topics
from armimp_common.errors import ArmimpError, GraphError
from armimp_common.executor import steady_timer
from armimp_common.heartbeat import Heartbeat, HeartbeatMonitor
from armimp_common.lifecycle import ManagedNode, reported
from armimp_common.parameters import declare, guard
from armimp_common.protection import CommandSequence
from armimp_common.pubsub import CommandSubscription, JointStatePublisher, publisher_count
from armimp_common.status import Level, TimingFigures, make_array, make_status, status_message

_STOPPED = "emergency stop"
_LOOK_PERIOD = 0.02
"""How often it is looked whether something has happened (s)."""
_LEFT = "perhaps one who has left before it was known"
_NAMES_PATIENCE, _MOST_NAMES = 0.5, 8
"""How long the name of a publisher is waited for when all is over (s), and how many are told."""


class SafetyLimiter(Protocol):
    """What gives torque to the drives, or denies it.

    Attributes
    ----------
    fault : why there is no torque any more; empty while all is well
    """

    fault: str

    @property
    def applied(self) -> tuple[float, ...]:
        """Torque that the drives apply now (n,), N·m."""
        ...

    def latch(self, reason: str) -> None:
        """Take torque away at once and until :meth:`reset`; the first reason stays."""
        ...

    def reset(self) -> None:
        """Obey again after a fault.

        Raises
        ------
        GraphError
            If torque would come back with a jerk.
        """
        ...


GateT = TypeVar("GateT", bound=SafetyLimiter)


class DriverBase(ManagedNode, ABC, Generic[GateT]):
    """A lifecycle node in the place of the rig; subclasses say where torque goes.

    `on_configure` calls :meth:`open_gate`, `on_activate` sets `active` once commands are obeyed,
    and :meth:`rest` undoes that. What is made in between is given to :meth:`own`.

    Parameters
    ----------
    parameters : declared, with these values as defaults
    busy : why they cannot be changed while the node is active

    Attributes
    ----------
    active : whether commands are obeyed
    gate : None while the node is not configured
    controller : watch over the one who commands
    joint_states, torque_sensors, commands, diagnostics : topics that every rig has, once configured
    told : the fault that was reported last
    """

    def __init__(self, parameters: BaseModel, busy: str, **kwargs: Any) -> None:
        super().__init__(topics.SIM_NODE, **kwargs)
        self.told = ""
        self.active = self._stopped = False
        self.gate: GateT | None = None
        self._owned: list[Publisher | Subscription | Timer] = []
        self._sequence = CommandSequence()
        self._accused = False
        self._commanders = 0
        self._names: list[str] = []
        self._sign = Heartbeat(self, topics.SIM_NODE)
        self.controller = HeartbeatMonitor(self, topics.CONTROLLER_NODE, self._on_controller)
        self.create_service(Trigger, topics.SIM_STOP_SERVICE, self._on_stop)
        self.create_service(Trigger, topics.SIM_RESET_SERVICE, self._on_reset)
        declare(self, type(parameters), parameters)
        guard(self, lambda: busy if self.active else None)

    def open_gate(
        self,
        gate: GateT,
        joints: Sequence[str],
        on_command: Callable[[tuple[float, ...]], None],
        on_malformed: Callable[[ArmimpError], None],
    ) -> None:
        """Make the topics that every rig has; an emergency stop of before still holds."""
        if self._stopped:
            gate.latch(_STOPPED)
        self.gate = gate
        self.joint_states = JointStatePublisher(self, topics.JOINT_STATES, joints, "position")
        self.torque_sensors = JointStatePublisher(self, topics.TORQUE_SENSORS, joints, "effort")
        self.diagnostics = self.create_publisher(
            DiagnosticArray, topics.DIAGNOSTICS, qos.DIAGNOSTICS
        )
        self.commands = CommandSubscription(
            self,
            topics.COMMANDS,
            len(joints),
            on_command,
            on_number=self._on_number,
            on_malformed=on_malformed,
        )
        self.own(self.joint_states.publisher, self.torque_sensors.publisher, self.diagnostics)
        self.own(self.commands.subscription, steady_timer(self, _LOOK_PERIOD, self.look))

    def own(self, *things: Publisher | Subscription | Timer) -> None:
        """Have these destroyed when the node is cleaned up."""
        self._owned += things

    # What a subclass defines; all but the first have a meaning already.

    @abstractmethod
    def rest(self) -> None:
        """Leave no torque behind, and obey no commands any more; harmless if repeated."""

    def torque_was_taken(self) -> None:
        """Tell the drives: called when a fault is latched while the node is active."""

    def obey_again(self) -> None:
        """Undo a fault.

        Raises
        ------
        GraphError
            If torque would come back with a jerk.
        """
        if self.gate is not None:
            self.gate.reset()

    @property
    def alone(self) -> AbstractContextManager[object]:
        """Keeps other threads away from the gate."""
        return nullcontext()

    def stamp_ns(self) -> int:
        """Stamp of reports, ns."""
        return int(self.get_clock().now().nanoseconds)

    def values(self) -> Mapping[str, Any]:
        """Further values for reports."""
        return {}

    def timing(self) -> TimingFigures | None:
        """Timing for reports, in real time."""
        return None

    # One command for one sample, from one publisher.

    def look(self) -> None:
        """See whether somebody else commands, and tell what is new; called every 20 ms."""
        if self.active:
            publishers = publisher_count(self, self.commands.subscription)
            if publishers > 1:
                self.accuse(f"{publishers} publishers")
            elif not publishers:
                self._sequence.restart()
        self._name_publishers()
        self.report_news()

    def accuse(self, reason: str) -> None:
        """Latch a fault of whoever commands, with the names of all who do."""
        gate = self.gate
        if gate is None or gate.fault:
            return
        when = self.stamp_ns() / topics.NS_PER_S
        accusation = f"{topics.COMMANDS}: {reason} at {when:.3f} s"
        self.latch(accusation)
        self._names.clear()
        self._commanders = 0
        self._accused = gate.fault == accusation
        self._name_publishers()
        self.report_news()

    def _name_publishers(self, *, last: bool = False) -> None:
        """Go on with an accusation by the names of those who command, as they become known.

        Torque has gone, and the middleware may learn later whose a publisher is.
        """
        if not self._accused or self.gate is None:
            return
        topic = self.commands.subscription.topic_name
        known = [
            f"{one.node_namespace.rstrip('/')}/{one.node_name}"
            for one in self.get_publishers_info_by_topic(topic)
            if "UNKNOWN" not in one.node_name
        ]
        self._commanders = max(self._commanders, len(known))
        new = known if self._commanders > 1 or not last else [*known, _LEFT]
        with self.alone:
            for name in new:
                if name not in self._names and len(self._names) < _MOST_NAMES:
                    self.gate.fault += ", " if self._names else "; published by "
                    self.gate.fault += name
                    self._names.append(name)

    def _conclude_accusation(self) -> None:
        """Wait a moment for names that are on their way, now that nothing else is waited for."""
        end = time.monotonic() + _NAMES_PATIENCE
        while self._accused and self._commanders < 2 and time.monotonic() < end:
            self._name_publishers()
            time.sleep(_LOOK_PERIOD)
        self._name_publishers(last=True)
        self.report_news()

    def _guard(self) -> dict[str, str]:
        """Tell, for reports, by what a command of somebody else would be noticed."""
        if self._sequence.numbered is None:
            return {}
        by = "numbers and publishers" if self._sequence.numbered else "publishers alone"
        return {"commands_told_apart_by": by}

    def _on_number(self, number: int) -> None:
        if not self.active:
            self._sequence.restart()
        elif reason := self._sequence.check(number):
            self.accuse(reason)

    # Faults: one latch for all of them.

    def latch(self, reason: str) -> None:
        """Take torque away; a node that is not active gives none, and needs no fault."""
        gate = self.gate
        if gate is None or not (self.active or self._stopped):
            return
        with self.alone:
            gate.latch(reason)
            if self.active:
                self.torque_was_taken()

    def report(self) -> None:
        """Publish on ``/diagnostics`` how things are."""
        gate = self.gate
        if gate is None or not self.context.ok():
            return
        with self.alone:
            stamp_ns, fault, figures = self.stamp_ns(), gate.fault, self.timing()
            values = {**self.values(), "applied": gate.applied, **self._guard()}
        self.told = fault
        words = fault or ("running" if self.active else "stopped")
        level = Level.ERROR if fault else Level.OK
        statuses = [make_status(f"{topics.SIM_NODE}: rig", level, words, values)]
        if figures is not None:
            statuses.append(status_message(figures))
        self.diagnostics.publish(make_array(stamp_ns, statuses))

    def report_news(self) -> None:
        """Report a fault that has not been reported yet, or its end."""
        if self.gate is not None and self.gate.fault != self.told:
            self.report()

    def _on_controller(self, controller: HeartbeatMonitor) -> None:
        # The torque of one that died must not outlast it.
        if controller.presence.lost:
            self.latch(controller.sentence)
            self.report_news()

    def _on_stop(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._stopped = True
        self.latch(_STOPPED)
        self.report()
        response.success = True
        response.message = f"no torque until {topics.SIM_RESET_SERVICE} is called"
        return response

    def _on_reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        try:
            with self.alone:
                self.obey_again()
        except GraphError as error:
            response.success, response.message = False, str(error)
            return response
        self._stopped = self._accused = False
        self._sequence.restart()
        self.report()
        response.success, response.message = True, "commands are obeyed"
        return response

    # The way back: no transition leaves torque behind.

    @reported
    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop: no torque acts, and further commands are ignored."""
        self.rest()
        self._conclude_accusation()
        self._sequence.restart()
        return super().on_deactivate(state)

    @reported
    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Forget the rig, so that new parameters can be used; only an emergency stop remains."""
        for thing in self._owned:
            if isinstance(thing, Timer):
                self.destroy_timer(thing)
            elif isinstance(thing, Publisher):
                self.destroy_publisher(thing)
            else:
                self.destroy_subscription(thing)
        self._owned.clear()
        self.gate = None
        self._accused = False
        return TransitionCallbackReturn.SUCCESS

    @reported
    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop for good."""
        self.rest()
        self._conclude_accusation()
        return TransitionCallbackReturn.SUCCESS

    def destroy_node(self) -> None:
        """Leave no torque behind, should the node end while it is active."""
        self.rest()
        super().destroy_node()
