"""Attaches to a driver, leads it through the check, and returns the recording."""

from __future__ import annotations

import gc
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager

import numpy as np

from armimp_bringup.config import CheckOptions
from armimp_bringup.driver_check import (
    SENSOR_TOPICS,
    Message,
    Moves,
    Record,
    readings,
)
from armimp_bringup.driver_check.conversation import Conversation, Error
from armimp_bringup.driver_check.moves import Mover
from armimp_bringup.graph import GraphContext
from armimp_common import topics
from armimp_common.errors import GraphError
from armimp_common.executor import stop_on_signals
from armimp_common.lifecycle import LifecycleManager
from armimp_common.topics import RATE

_PATIENCE, _LONG = 10.0, 60.0
_LISTEN, _LATER, _SILENCE = 0.5, 0.2, 3.0


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
        # A collection at the wrong moment would keep commands back.
        collecting = gc.isenabled()
        gc.disable()
        try:
            return _Probe(options, node).record()
        finally:
            if collecting:
                gc.enable()
            node.close()


class _Probe:
    def __init__(self, options: CheckOptions, node: Conversation) -> None:
        self._options, self._node = options, node
        self._manager = LifecycleManager(
            node,
            [options.node],
            spin_until=node.spinner.spin_until,
            timeout=_LONG,
            check=node.check,
        )
        self._paced, self._lead = False, 1

    def record(self) -> Record:
        node, options = self._node, self._options
        state = self._find()
        with self._active(state):
            self._paced = self._listen()
            first = self._record_at_rest()
            kept, malformed = node.recorded()
            answers, faults = node.answered, list(node.errors)
            streams = {topic: messages[first:] for topic, messages in kept.items()}
            known = frozenset(error.name for error in faults)
            mover = Mover(node, options, None if self._paced else self._lead, known)
            begin: dict[str, int] = {}
            trouble = self._trouble(streams, malformed, faults)
            if options.move and not trouble:
                self._begin_to_answer(state)
                begin = {topic: node.messages(topic) for topic in kept}
                moves = mover.move()
                if not moves.missing:
                    self._leave(state)
            else:
                stops = topics.SIM_STOP_SERVICE in node.safety_services()
                moves = mover.stop_at_rest() if stops else Moves()
                moves.asked = options.move
                moves.missing = trouble if options.move else "not without --move"
            endpoints, services = node.endpoints(), node.safety_services()
        everything, malformed = node.recorded()
        return Record(
            joints=options.joints,
            paced=self._paced,
            endpoints=endpoints,
            streams=streams,
            moving={topic: everything[topic][first:] for topic, first in begin.items()},
            malformed=malformed,
            answered=answers,
            services=services,
            lifecycle=state,
            most=options.most_motion,
            faults=[str(error) for error in faults],
            moves=moves,
        )

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

    def _listen(self) -> bool:
        """Whether samples come without commands."""
        self._node.wait(lambda: False, _LISTEN)
        return max(self._node.messages(topic) for topic in SENSOR_TOPICS) > 20

    def _record_at_rest(self) -> int:
        """Record, without commands or under zero torque; return the number of the first sample."""
        node, duration = self._node, self._options.duration
        if self._paced:
            first = node.samples
            node.wait(lambda: False, duration)
            return first
        node.play([(round(duration * RATE), node.zero)])
        node.answer()
        last = -1
        while node.playing and node.samples > last:
            last = node.samples
            node.wait(lambda: not node.playing, _SILENCE)
        # The answer to the last command is still to come. Of a driver that was active before, the
        # first sample was missed.
        node.wait(lambda: node.samples > node.answered, 1.0)
        # Those that no command has asked for may still be on their way.
        node.wait(lambda: node.samples > node.answered + 1, _LATER)
        self._lead = node.samples - node.answered
        return 0

    def _begin_to_answer(self, state: str | None) -> None:
        """Answer every sample from now on; if possible also for the driver, from its first one."""
        node, name = self._node, self._options.node
        if not self._paced:
            return
        again = state in ("unconfigured", "inactive")
        if again:
            self._manager.change(name, "deactivate")
        # What piled up meanwhile must not be answered.
        node.wait(lambda: False, _LISTEN)
        node.torque = node.zero
        if again:
            self._manager.change(name, "activate")

    def _leave(self, state: str | None) -> None:
        """Reset a driver that stays active after the silence that begins now, which is a fault."""
        if self._paced and state in (None, "active"):
            self._node.torque = None
            self._node.wait(lambda: False, _LISTEN)
            self._node.call(topics.SIM_RESET_SERVICE, _PATIENCE)

    def _trouble(
        self,
        streams: Mapping[str, Sequence[Message]],
        malformed: Mapping[str, int],
        faults: Sequence[Error],
    ) -> str:
        """Return why no torque may be commanded; empty if nothing speaks against it."""
        for topic, kept in streams.items():
            values = readings(self._options.joints, topic, kept)
            if malformed[topic] or not kept or values.shape[1] != len(kept):
                return f"{topic} is not sound enough to command torque"
            if not np.all(np.isfinite(values)):
                return f"{topic} is not finite: no torque is commanded"
        return f"there was a fault before: {faults[0]}" if faults else ""
