"""Attaches to a driver, leads it through the check, and returns the recording."""

from __future__ import annotations

import gc
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from armimp_bringup.driver_check.conversation import Conversation, Error
from armimp_bringup.driver_check.interruption import InterruptibleSpinner
from armimp_bringup.driver_check.moves import Mover, Moves, extract
from armimp_bringup.driver_check.samples import SENSOR_TOPICS, Message, Record
from armimp_bringup.driver_check.stream_rules import values_in_order
from armimp_bringup.driver_check.witness import Witness
from armimp_bringup.graph import GraphContext
from armimp_common import topics
from armimp_common.errors import GraphError
from armimp_common.executor import Spinner, stop_on_signals
from armimp_common.lifecycle import LifecycleManager
from armimp_common.process import waited_ns
from armimp_common.topics import NS_PER_S, PERIOD_NS

_PATIENCE, _LONG = 10.0, 60.0
_LISTEN, _LATER, _SILENCE = 0.5, 0.2, 3.0


@dataclass(frozen=True, kw_only=True)
class CheckOptions:
    """What a user asks of a check.

    Attributes
    ----------
    joints : names, in the order of commands
    node : name of the driver
    duration : time of the recording (s); in lockstep it counts in samples of 1 ms
    move : whether torque may be commanded
    torque : how much (N·m)
    most : how far torque may move a joint (rad)
    namespace : of the driver
    """

    joints: tuple[str, ...]
    node: str = topics.SIM_NODE
    duration: float = 5.0
    move: bool = False
    torque: float = 1.0
    most: float = 0.3
    namespace: str = ""


def probe(options: CheckOptions, domain_id: int | None) -> Record:
    """Record a driver in a domain.

    Raises
    ------
    GraphError
        If there is none, or it is in use, or fails a transition.
    InterruptionError
        After SIGINT or SIGTERM, with zero torque commanded.
    """
    with GraphContext(domain_id) as graph:
        node = Conversation(graph, options.joints, options.namespace)
        # A collection at the wrong moment would keep commands back.
        collecting = gc.isenabled()
        gc.disable()
        witness = Witness()
        try:
            with (
                stop_on_signals() as stopped,
                InterruptibleSpinner([node], context=graph.context, stopped=stopped) as spinner,
            ):
                return _Probe(options, node, spinner, witness).record()
        finally:
            witness.close()
            if collecting:
                gc.enable()
            node.destroy_node()


class _Probe:
    def __init__(
        self, options: CheckOptions, node: Conversation, spinner: Spinner, witness: Witness
    ) -> None:
        self._options, self._node, self._spinner = options, node, spinner
        self._witness = witness
        self._zero = (0.0,) * len(options.joints)
        self._paced, self._lead = False, 1

    def record(self) -> Record:
        node, options = self._node, self._options
        manager = LifecycleManager(
            node, [options.node], spin_until=self._spinner.spin_until, timeout=_LONG
        )
        state = self._find(manager)
        with self._active(manager, state):
            self._paced = self._listen()
            before = waited_ns(node.process)
            first = self._record_at_rest()
            after = waited_ns(node.process)
            kept, malformed = node.recorded()
            answers, faults = node.answered, list(node.errors)
            streams = {topic: messages[first:] for topic, messages in kept.items()}
            trouble = self._trouble(streams, malformed, faults)
            mover = Mover(
                node,
                self._spinner,
                joints=options.joints,
                torque=options.torque,
                most=options.most,
                paced=self._paced,
                lead=self._lead,
                known=frozenset(error.name for error in faults),
            )
            moves, begin = Moves(), {}
            if options.move and not trouble:
                self._begin_to_answer(manager, state)
                begin = {topic: node.messages(topic) for topic in kept}
                moves = mover.move()
                if not moves.broken:
                    self._leave(state)
            elif topics.SIM_STOP_SERVICE in node.safety_services():
                moves = Moves(stop=mover.stop())
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
            skipped=trouble if options.move else "not without --move",
            troubled=options.move and bool(trouble),
            most=options.most,
            faults=[str(error) for error in faults],
            stalls=self._witness.stalls(),
            waited=None if before is None or after is None else (after - before) / NS_PER_S,
            timing=moves.timing or node.timing,
            **extract(moves, everything, options.joints, options.torque),
        )

    def _find(self, manager: LifecycleManager) -> str | None:
        """Wait for a driver; return its state, None if it is no lifecycle node."""
        node = self._node

        def publishing() -> bool:
            return any(end.role == "publisher" for end in node.endpoints())

        end = time.monotonic() + _PATIENCE
        while True:
            try:
                manager.wait_for_nodes(0.2)
            except GraphError:
                if publishing():
                    # Its services may be discovered after its topics.
                    node.wait(self._spinner, lambda: False, 1.0)
                    try:
                        manager.wait_for_nodes(0.0)
                    except GraphError:
                        return None
                elif time.monotonic() > end:
                    raise GraphError(
                        f"no driver: neither a node {self._options.node} nor anybody who publishes"
                        f" {' or '.join(SENSOR_TOPICS)}"
                    ) from None
                else:
                    continue
            return manager.state(self._options.node)

    @contextmanager
    def _active(self, manager: LifecycleManager, state: str | None) -> Iterator[None]:
        """Have the driver active, and bring it back to where it was."""
        name = self._options.node
        if state == "unconfigured":
            manager.configure(name)
        elif state not in (None, "inactive", "active"):
            raise GraphError(f"node {name} is {state}: it has to be started anew")
        try:
            node = self._node
            node.wait(self._spinner, self._complete, 1.0)
            others = {
                end.node
                for end in node.endpoints()
                if end.topic == topics.COMMANDS and end.role == "publisher"
            }
            if others:
                raise GraphError(f"the driver is in use: {', '.join(sorted(others))} commands it")
            node.listen()
            if state in ("unconfigured", "inactive"):
                manager.activate(name)
            try:
                yield
            finally:
                node.torque = None
                if state in ("unconfigured", "inactive"):
                    manager.deactivate(name)
        finally:
            if state == "unconfigured" and manager.state(name) == "inactive":
                manager.cleanup(name)

    def _complete(self) -> bool:
        """Whether all endpoints of a driver are known."""
        roles = {(end.topic, end.role) for end in self._node.endpoints()}
        wanted = {(topic, "publisher") for topic in SENSOR_TOPICS}
        return roles >= {*wanted, (topics.COMMANDS, "subscriber")}

    def _listen(self) -> bool:
        """Whether samples come without commands."""
        node = self._node
        node.wait(self._spinner, lambda: False, _LISTEN)
        return max(node.messages(topic) for topic in SENSOR_TOPICS) > 20

    def _record_at_rest(self) -> int:
        """Record, without commands or under zero torque; return the number of the first sample."""
        node, duration = self._node, self._options.duration
        if self._paced:
            first = node.samples
            node.wait(self._spinner, lambda: False, duration)
            return first
        node.play([(round(duration * NS_PER_S / PERIOD_NS), self._zero)])
        node.answer()
        last = -1
        while node.playing and node.samples > last:
            last = node.samples
            node.wait(self._spinner, lambda: not node.playing, _SILENCE)
        # The answer to the last command is still to come. Of a driver that was active before, the
        # first sample was missed.
        node.wait(self._spinner, lambda: node.samples > node.answered, 1.0)
        # Those that no command has asked for may still be on their way.
        node.wait(self._spinner, lambda: node.samples > node.answered + 1, _LATER)
        self._lead = node.samples - node.answered
        return 0

    def _begin_to_answer(self, manager: LifecycleManager, state: str | None) -> None:
        """Answer every sample from now on; if possible also for the driver, from its first one."""
        node, name = self._node, self._options.node
        if not self._paced:
            return
        again = state in ("unconfigured", "inactive")
        if again:
            manager.deactivate(name)
        # What piled up meanwhile must not be answered.
        node.wait(self._spinner, lambda: False, _LISTEN)
        node.torque = self._zero
        if again:
            manager.activate(name)

    def _leave(self, state: str | None) -> None:
        """Have a driver that stays active forget the silence which begins now, as for a fault."""
        if self._paced and state in (None, "active"):
            self._node.torque = None
            self._node.wait(self._spinner, lambda: False, _LISTEN)
            self._node.call(topics.SIM_RESET_SERVICE, self._spinner, _PATIENCE)

    def _trouble(
        self,
        streams: dict[str, list[Message]],
        malformed: dict[str, int],
        faults: Sequence[Error],
    ) -> str:
        """Return why it would not be wise to command torque."""
        for topic, kept in streams.items():
            values = values_in_order(self._options.joints, topic, kept)
            if malformed[topic] or not kept or values.shape[1] != len(kept):
                return f"{topic} is not sound enough to command torque"
            if not np.all(np.isfinite(values)):
                return f"{topic} is not finite: no torque is commanded"
        return f"there is a fault at rest: {faults[0]}" if faults else ""
