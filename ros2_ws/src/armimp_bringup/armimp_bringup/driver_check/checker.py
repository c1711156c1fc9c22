"""The course of a check: attach to a driver, record it, push its joints, and restore its state.

Nothing is judged here.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from typing import TypeVar

import numpy as np

from armimp_bringup.config import CheckOptions
from armimp_bringup.driver_check import (
    SENSOR_TOPICS,
    Call,
    Ending,
    Message,
    Moves,
    Push,
    Record,
    measure,
    readings,
)
from armimp_bringup.driver_check.conversation import Conversation, MotionGuard, Step, Torque
from armimp_bringup.graph import GraphContext
from armimp_bringup.terminal import Display, say
from armimp_common import topics
from armimp_common.arrays import FloatArray
from armimp_common.errors import GraphError
from armimp_common.lifecycle import LifecycleManager
from armimp_common.process import stop_on_signals
from armimp_common.realtime import realtime_scheduling
from armimp_common.topics import JOINT_STATES

_PATIENCE, _LONG = 10.0, 60.0
"""Longest waits for a driver to appear, and for a lifecycle transition, s."""
_LISTEN = 0.5  # s, pause in which messages that are under way arrive
_SILENCE = 10.0
"""Without samples for this long, a driver has stopped sending them, s."""
_REST, _HOLD = 200, 400
"""Samples at rest before a push, and those under torque."""
_AGAIN = 200
"""Samples of a push that must have no effect."""
_SILENT = 250
"""Samples that get no command, to test what a driver does without commands."""
_STOPPING = 600
"""Most samples for which torque is still commanded once the emergency stop is called.

They cover the longest wait for its answer, and the samples that are evaluated after the answer.
"""
_SETTLE = 100  # samples of one step of settling, and those evaluated after a push
_LEAVING = 0.3
"""How long a driver may take to notice that a publisher has left, s."""
_STILL = 4e-4
"""An arm that moves less than this during 200 samples has settled, rad."""
_LONGEST_SETTLING = 80  # steps of settling before a push, at most
_ANSWER = 2.0  # s, longest wait for the report of a fault or the answer of a service

_T = TypeVar("_T")


class _GivenUpError(Exception):
    """No torque may be commanded any more."""


def probe(options: CheckOptions, domain_id: int | None) -> Record:
    """Record a driver in a domain.

    Raises
    ------
    GraphError
        If there is none, or it is in use, or fails a transition.
    InterruptionError
        After SIGINT or SIGTERM, with zero torque commanded.
    """
    with GraphContext(domain_id) as graph, stop_on_signals() as stopped:
        node = Conversation(graph, options.joints, options.namespace, stopped)
        try:
            # Garbage collection at the wrong moment would delay commands.
            with realtime_scheduling(0):
                return Checker(node, options).record()
        finally:
            node.close()


class Checker:
    """Leads a driver through the check.

    Parameters
    ----------
    node : the node that talks with the driver
    options : those of the user
    """

    def __init__(self, node: Conversation, options: CheckOptions) -> None:
        self._node, self._options = node, options
        self._joints, self._amount = options.joints, options.torque
        self._guard = MotionGuard(options.joints, options.most_motion)
        self._known: frozenset[str] = frozenset()  # statuses that have the level ERROR anyway

    def record(self) -> Record:
        """Record the driver at rest, then under torque if that is requested and permissible."""
        node, options = self._node, self._options
        self._manager = LifecycleManager(
            node, [options.node], spinner=node.spinner, timeout=_LONG, check=node.check
        )
        with Display() as display:
            display.phase("looking for a driver")
            state = self._find()
        with self._active(state):
            node.wait(lambda: False, _LISTEN)
            # Plain lines, as a display that refreshes itself would disturb the measurement.
            say(f"listening to the driver for {options.duration:g} s")
            first = node.samples
            node.wait(lambda: False, options.duration)
            faults = list(node.errors)
            self._known = frozenset(error.name for error in faults)
            streams = _decoded(node, dict.fromkeys(SENSOR_TOPICS, first))
            trouble = self._trouble(streams)
            if not trouble and faults:
                trouble = f"there was a fault before: {faults[0]}"
            begin: dict[str, int] = {}
            if options.move and not trouble:
                self._begin_to_answer(state)
                begin = {topic: len(kept) for topic, kept in node.kept.items()}
                moves = self.move()
                if not moves.missing:
                    self._leave(state)
            else:
                moves = self._stop_at_rest()
                moves.missing = trouble if options.move else ""
            endpoints, services = node.endpoints(), node.safety_services()
        return Record(
            joints=options.joints,
            endpoints=endpoints,
            streams=streams,
            moving=_decoded(node, begin),
            malformed={topic: kept.count(None) for topic, kept in node.kept.items()},
            services=services,
            lifecycle=state,
            most=options.most_motion,
            faults=[str(error) for error in faults],
            moves=moves,
        )

    # --- at rest ---------------------------------------------------------------------------------

    def _find(self) -> str | None:
        """Wait for a driver; return its state, None if it is no lifecycle node."""
        end = time.monotonic() + _PATIENCE
        while not self._managed(0.2):
            if any(one.role == "publisher" for one in self._node.endpoints()):
                # Its services may be discovered after its topics.
                if self._managed(1.0):
                    break
                return None
            if time.monotonic() > end:
                raise GraphError(
                    f"no driver: neither a node {self._options.node} nor anybody who publishes"
                    f" {' or '.join(SENSOR_TOPICS)}"
                )
        return self._manager.state(self._options.node)

    def _managed(self, patience: float) -> bool:
        try:
            self._manager.wait_for_nodes(patience)
        except GraphError:
            return False
        return True

    @contextmanager
    def _active(self, state: str | None) -> Iterator[None]:
        """Activate the driver, and bring it back to its former state in the end."""
        name, node, manager = self._options.node, self._node, self._manager
        if state == "unconfigured":
            manager.change(name, "configure")
        elif state not in (None, "inactive", "active"):
            raise GraphError(f"node {name} is {state}: it has to be started anew")
        try:
            node.wait(self._complete, 1.0)
            others = {
                end.node
                for end in node.endpoints()
                if end.topic == topics.COMMANDS and end.role == "publisher"
            }
            if others:
                raise GraphError(f"the driver is in use: {', '.join(sorted(others))} commands it")
            node.listen()
            if state in ("unconfigured", "inactive"):
                manager.change(name, "activate")
            try:
                yield
            finally:
                node.torque = None
                if state in ("unconfigured", "inactive"):
                    manager.change(name, "deactivate")
        finally:
            if state == "unconfigured" and manager.state(name) == "inactive":
                manager.change(name, "cleanup")

    def _complete(self) -> bool:
        """Whether all endpoints of a driver are known."""
        roles = {(end.topic, end.role) for end in self._node.endpoints()}
        wanted = {(topic, "publisher") for topic in SENSOR_TOPICS}
        return roles >= {*wanted, (topics.COMMANDS, "subscriber")}

    def _trouble(self, streams: dict[str, list[Message]]) -> str:
        """Return why no torque may be commanded; empty if torque may be."""
        for topic, kept in streams.items():
            values = readings(self._joints, topic, kept)
            if None in self._node.kept[topic] or not kept or values.shape[1] != len(kept):
                return f"{topic} is not sound enough to command torque"
            if not np.all(np.isfinite(values)):
                return f"{topic} is not finite: no torque is commanded"
        return ""

    def _begin_to_answer(self, state: str | None) -> None:
        """Answer every sample from now on, after reactivating the driver if that is possible."""
        node, name = self._node, self._options.node
        again = state in ("unconfigured", "inactive")
        if again:
            self._manager.change(name, "deactivate")
        # Samples that have piled up meanwhile must not be answered.
        node.wait(lambda: False, _LISTEN)
        node.torque = node.zero
        if again:
            self._manager.change(name, "activate")

    def _leave(self, state: str | None) -> None:
        """Stop commanding a driver that stays active, and reset the fault that this causes."""
        if state in (None, "active"):
            self._node.torque = None
            self._node.wait(lambda: False, _LISTEN)
            self._node.call(topics.SIM_RESET_SERVICE, _PATIENCE)

    # --- under torque ----------------------------------------------------------------------------

    def move(self) -> Moves:
        """Push each joint; then test silence, the emergency stop and a second publisher."""
        moves, guard, node = Moves(), self._guard, self._node
        node.guard = guard
        try:
            for joint, name in enumerate(self._joints):
                push = self._watched(moves, f"pushing {name}", partial(self._push, joint))
                moves.pushes.append(push)
            pushed = f"while {self._joints[0]} is pushed"
            moves.stale = self._watched(moves, f"keeping silent {pushed}", self._keep_silent)
            what = f"calling the emergency stop {pushed}"
            moves.stop = self._watched(moves, what, self._stop_under_torque)
            what = "commanding zero torque as a second publisher"
            moves.second = self._watched(moves, what, self._intrude)
        except _GivenUpError as error:
            moves.missing, moves.astray = str(error), bool(guard.objection)
        finally:
            # However this ends, even by Ctrl-C, no commanded torque may remain.
            node.let_go()
            node.guard = None
        if guard.objection:
            # Zero torque may not be enough for a driver that does not do what it is commanded.
            node.call(topics.SIM_STOP_SERVICE, _ANSWER)
        elif moves.missing:
            self._reset()
        moves.moved = guard.largest
        return moves

    def _stop_at_rest(self) -> Moves:
        """Call the emergency stop of a rig at rest, if it has one."""
        if topics.SIM_STOP_SERVICE not in self._node.safety_services():
            return Moves()
        say("calling the emergency stop")
        since = self._node.now()
        stop = self._node.call(topics.SIM_STOP_SERVICE, _ANSWER, since)
        reported = self._time_to_fault(since)
        return Moves(stop=Ending(reported=reported, stop=stop, reset=self._reset()))

    def _watched(self, moves: Moves, what: str, act: Callable[[], tuple[_T, float]]) -> _T:
        """Make a test once the arm has settled.

        `act` returns its result, and until when (monotonic, s) the driver had no reason to stop;
        if it reported a fault before that, nothing more is tested.
        """
        say(what)
        node, seen = self._node, len(self._node.errors)
        self._settle()
        found, until = act()
        for one in node.errors[seen:]:
            if one.name not in self._known and one.when <= until:
                moves.fault, moves.gap = str(one), node.gap
                raise _GivenUpError(f"the driver stopped: {one}")
        return found

    def _push(self, joint: int) -> tuple[Push, float]:
        return self._pushed(joint, _HOLD, (_SETTLE, self._node.zero)), math.inf

    def _pushed(self, joint: int, held: int, *then: Step) -> Push:
        """Push a joint for `held` samples, play the steps that follow, and measure the response."""
        start = self._play([(_REST, self._node.zero), (held, self._torque(joint)), *then])
        end = start + _REST + held
        return self._measured(joint, start, end, end)

    def _measured(self, joint: int, start: int, end: int, after: int) -> Push:
        """Measure a push; the samples at rest before it begin with number `start`.

        `end` is the number of the last sample under torque. Samples between it and number `after`
        are left out.
        """
        angles, torques = (
            np.hstack([self._read(topic, start, end), self._read(topic, after, after + _SETTLE)])
            for topic in SENSOR_TOPICS
        )
        return measure(joint, self._amount, angles, torques, _REST, end - start)

    def _keep_silent(self) -> tuple[Ending, float]:
        """Stop sending commands while torque acts; command torque again; reset."""
        ended = self._pushed(0, _HOLD, (_SILENT, None))
        since = self._node.silent_since
        reported = self._time_to_fault(since)
        # This torque must have no effect, as no reset was granted yet.
        again = self._pushed(0, _AGAIN, (_SETTLE, self._node.zero))
        return Ending(reported=reported, ended=ended, again=again, reset=self._reset()), since

    def _stop_under_torque(self) -> tuple[Ending, float]:
        """Call the emergency stop while torque is still commanded; reset."""
        node, torque = self._node, self._torque(0)
        # Torque is commanded for a limited time, in case the stop does not work.
        start = node.samples
        node.script.extend([(_REST, node.zero), (_HOLD, torque), (_STOPPING, torque)])
        end = start + _REST + _HOLD
        self._wait(lambda: node.samples > end or bool(self._guard.objection))
        self._require_calm()
        since, end = node.now(), node.samples
        stop = node.call(topics.SIM_STOP_SERVICE, _ANSWER, since)
        # Torque has to go with the answer. A fault that is reported later may be another one, such
        # as that of a watchdog, since commands can be delayed.
        after = node.samples
        reported = self._time_to_fault(since)
        self._wait(lambda: not node.script and node.samples >= after + _SETTLE)
        self._require_calm()
        ended = self._measured(0, start, end, after)
        again = self._pushed(0, _AGAIN, (_SETTLE, node.zero))
        reset = self._reset()
        return Ending(reported=reported, ended=ended, again=again, stop=stop, reset=reset), since

    def _intrude(self) -> tuple[Ending, float]:
        """Have a second publisher command zero torque, too; reset."""
        since = self._node.now()
        with self._node.intruder(_ANSWER):
            reported = self._time_to_fault(since)
        # Until the driver knows that the second publisher has left.
        self._node.wait(lambda: False, _LEAVING)
        return Ending(reported=reported, reset=self._reset()), since

    def _reset(self) -> Call:
        return self._node.call(topics.SIM_RESET_SERVICE, _ANSWER)

    def _torque(self, joint: int) -> Torque:
        return tuple(self._amount if i == joint else 0.0 for i in range(len(self._joints)))

    def _settle(self) -> None:
        for _ in range(_LONGEST_SETTLING):
            self._play([(_SETTLE, self._node.zero)])
            last = len(self._node.kept[JOINT_STATES])
            angles = self._read(JOINT_STATES, max(last - 2 * _SETTLE, 0), last)
            if angles.shape[1] == 2 * _SETTLE and np.max(np.ptp(angles, axis=1)) < _STILL:
                return

    def _read(self, topic: str, first: int, end: int) -> FloatArray:
        """Return the readings (n, N) of these samples; all their messages have to be complete."""
        part = self._node.kept[topic][first:end]
        values = readings(self._joints, topic, part)
        if values.shape[1] != len(part):
            raise _GivenUpError(f"{topic} cannot be read")
        return values

    def _play(self, script: Sequence[Step]) -> int:
        """Play a script, and return the number of the first sample that it answers."""
        node = self._node
        self._require_calm()
        start = node.samples
        node.script.extend(script)
        self._wait(lambda: not node.script)
        self._require_calm()
        return start

    def _wait(self, condition: Callable[[], bool]) -> None:
        node, last = self._node, -1
        while not condition():
            if node.samples == last:
                raise GraphError("the driver has stopped sending samples")
            last = node.samples
            node.wait(condition, _SILENCE)

    def _require_calm(self) -> None:
        if self._guard.objection:
            raise _GivenUpError(self._guard.objection)

    def _time_to_fault(self, since: float) -> float | None:
        """Wait for a fault to be reported; return how long after `since` it was, s."""
        node = self._node

        def after() -> list[float]:
            return [
                one.when - since
                for one in list(node.errors)
                if one.when >= since and one.name not in self._known
            ]

        node.wait(lambda: bool(after()), _ANSWER)
        return min(after(), default=None)


def _decoded(node: Conversation, first: dict[str, int]) -> dict[str, list[Message]]:
    """Return the messages of each stream from a number on, without those that can't be decoded."""
    return {
        topic: [one for one in node.kept[topic][number:] if one is not None]
        for topic, number in first.items()
    }
