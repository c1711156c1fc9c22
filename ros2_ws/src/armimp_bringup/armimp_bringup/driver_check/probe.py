"""Attaches to a driver, leads it through the check, and returns the recording."""

from __future__ import annotations

import gc
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any, TypeAlias

import numpy as np

from armimp_bringup.driver_check.conversation import Conversation, answered
from armimp_bringup.driver_check.samples import SENSOR_TOPICS, Call, Ending, Message, Push, Record
from armimp_bringup.driver_check.stream_rules import values_in_order
from armimp_bringup.graph import GraphContext
from armimp_common import contract
from armimp_common.cdr import JointStateDecoder
from armimp_common.contract import JOINT_STATES, NS_PER_S, PERIOD_NS, TORQUE_SENSORS
from armimp_common.errors import GraphError, MalformedMessageError
from armimp_common.lifecycle import LifecycleManager
from armimp_common.spin import Spinner

_REST, _HOLD, _AFTER, _LONGER = 200, 400, 250, 400
"""Samples at rest, under torque, after it; and under torque beyond that, for comparison."""
_SETTLE = 100
_STILL = 4e-4
"""An arm that moves less than this during 200 samples has settled (rad)."""
_LONGEST_SETTLING = 80
_FOREVER = 10**9
_PATIENCE, _LONG = 10.0, 60.0
_LISTEN = 0.5
_TOLD = 2.0


_Step: TypeAlias = "tuple[int, tuple[float, ...] | None]"
"""A number of samples, and the torque that answers each of them."""


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
    """

    joints: tuple[str, ...]
    node: str = contract.SIM_NODE
    duration: float = 5.0
    move: bool = False
    torque: float = 1.0


def probe(options: CheckOptions, domain_id: int | None) -> Record:
    """Record a driver in a domain.

    Raises
    ------
    GraphError
        If there is none, or it is in use, or fails a transition.
    """
    with GraphContext(domain_id) as graph:
        node = Conversation(graph, options.joints)
        # A collection at the wrong moment would keep commands back.
        collecting = gc.isenabled()
        gc.disable()
        try:
            with Spinner([node], context=graph.context) as spinner:
                return _Probe(options, node, spinner).record()
        finally:
            if collecting:
                gc.enable()
            node.destroy_node()


class _Probe:
    def __init__(self, options: CheckOptions, node: Conversation, spinner: Spinner) -> None:
        self._options, self._node, self._spinner = options, node, spinner
        self._zero = (0.0,) * len(options.joints)
        self._decoder = JointStateDecoder(options.joints, "position")
        self._paced, self._lead = False, 1

    def record(self) -> Record:
        node, options = self._node, self._options
        manager = LifecycleManager(
            node, [options.node], spin_until=self._spinner.spin_until, timeout=_LONG
        )
        state = self._find(manager)
        with self._active(manager, state):
            self._paced = self._listen()
            first = self._record_at_rest()
            kept, malformed = node.recorded()
            answers = node.answered
            streams = {topic: messages[first:] for topic, messages in kept.items()}
            skipped = self._reason_not_to_move(streams, malformed)
            moves = _Moves()
            if not skipped:
                self._begin_to_answer(manager, state)
                moves = self._move()
            elif not options.move and contract.SIM_STOP_SERVICE in node.safety_services():
                moves = _Moves(stop=self._stop())
            endpoints, services = node.endpoints(), node.safety_services()
        return Record(
            joints=options.joints,
            paced=self._paced,
            endpoints=endpoints,
            streams=streams,
            malformed=malformed,
            answered=answers,
            services=services,
            lifecycle=state,
            timing=node.timing,
            **{"skipped": skipped, **self._extract(moves)},
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
                if end.topic == contract.COMMANDS and end.role == "publisher"
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
        return roles >= {*wanted, (contract.COMMANDS, "subscriber")}

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
        node.wait(self._spinner, lambda: not node.playing, 10.0 * duration + _PATIENCE)
        # The answer to the last command is still to come. Of a driver that was active before, the
        # first sample was missed.
        node.wait(self._spinner, lambda: node.samples > node.answered, 1.0)
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

    def _reason_not_to_move(
        self, streams: dict[str, list[Message]], malformed: dict[str, int]
    ) -> str:
        if not self._options.move:
            return "not without --move"
        for topic, kept in streams.items():
            values = values_in_order(self._options.joints, topic, kept)
            if malformed[topic] or not kept or values.shape[1] != len(kept):
                return f"{topic} is not sound enough to command torque"
            if not np.all(np.isfinite(values)):
                return f"{topic} is not finite: no torque is commanded"
        return ""

    def _move(self) -> _Moves:
        """Push each joint, then the first one until it is to let go by itself, and by a stop."""
        node, zero = self._node, self._zero
        moves = _Moves()
        for joint in range(len(self._options.joints)):
            moves.pushes.append(self._push(joint, [(_AFTER, zero)]))
        # Once more: friction makes the first push of a joint unlike those that follow.
        moves.released = self._push(0, [(_AFTER, zero)])
        moves.held = self._push(0, [(_LONGER, self._torque(0)), (_AFTER, zero)])
        if node.errors:
            # Whatever it was, what follows would be judged for a driver without torque.
            moves.trouble = f"the driver stopped while it was pushed: {node.errors[0][1]}"
            node.call(contract.SIM_RESET_SERVICE, self._spinner, _TOLD)
            return moves
        if self._paced:
            moves.stale_push = self._push(0, [(_AFTER, None)])
            told = self._told(node.silent_since)
            self._play([(_SETTLE, zero)])
            reset = node.call(contract.SIM_RESET_SERVICE, self._spinner, _TOLD)
            moves.stale = Ending(push=None, told=told, reset=reset)
        moves.stop = self._stop(moves)
        return moves

    def _torque(self, joint: int) -> tuple[float, ...]:
        return tuple(
            self._options.torque if i == joint else 0.0 for i in range(len(self._options.joints))
        )

    def _push(self, joint: int, then: Sequence[_Step]) -> _Mark:
        """Push a joint once the arm has settled; return where in the recording that is."""
        self._settle()
        torque = self._torque(joint)
        start = self._play([(_REST, self._zero), (_HOLD, torque), *then])
        # Of what follows, the same torque still belongs to the push.
        held = sum(count for count, following in then if following == torque)
        return _Mark(joint=joint, start=start, off=start + _REST + _HOLD + held - 1)

    def _settle(self) -> None:
        for _ in range(_LONGEST_SETTLING):
            self._play([(_SETTLE, self._zero)])
            if self._still():
                return

    def _play(self, script: Sequence[_Step]) -> int:
        """Play a script, and return the number of the first sample that it answers."""
        node = self._node
        start = node.samples if self._paced else node.samples - 1
        node.play(script)
        if not self._paced:
            node.answer()
        if not node.wait(self._spinner, lambda: not node.playing, _LONG):
            raise GraphError("the driver has stopped sending samples")
        if not self._paced:
            # The last command is answered, too.
            node.wait(self._spinner, lambda: node.samples >= node.answered + self._lead, 1.0)
        return start

    def _still(self) -> bool:
        try:
            recent = [
                self._decoder.decode(data)[1]
                for data in self._node.recent(JOINT_STATES, 2 * _SETTLE, 10)
            ]
        except MalformedMessageError:
            return False
        return len(recent) >= 20 and float(np.max(np.ptp(np.array(recent), axis=0))) < _STILL

    def _told(self, since: float) -> float | None:
        node = self._node

        def after() -> list[float]:
            return [when - since for when, _ in list(node.errors) if when >= since]

        node.wait(self._spinner, lambda: bool(after()), _TOLD)
        return min(after(), default=None)

    def _stop(self, moves: _Moves | None = None) -> Ending:
        """Call the emergency stop; in lockstep time stands still until it has answered."""
        node, torque, start = self._node, self._torque(0), 0
        if moves is not None:
            self._settle()
            script = [(_REST, self._zero), (_HOLD, torque)]
            if self._paced:
                start = node.samples
                node.play([*script, (_FOREVER, torque)])
                node.wait(self._spinner, lambda: node.samples > start + _REST + _HOLD, _LONG)
            else:
                start = self._play(script)
        since, last = time.monotonic(), node.samples - (1 if self._paced else 2)
        future = node.ask(contract.SIM_STOP_SERVICE)
        call = Call(success=None)
        if future is not None and self._spinner.spin_until(future, _TOLD):
            call = answered(future, time.monotonic() - since)
        told = self._told(since)
        if moves is not None:
            # The torque is commanded further, and must not act.
            if self._paced:
                node.drop()
            else:
                self._play([(_AFTER, torque)])
            self._play([(_SETTLE, self._zero)])
            moves.stop_push = _Mark(joint=0, start=start, off=last)
        reset = node.call(contract.SIM_RESET_SERVICE, self._spinner, _TOLD)
        return Ending(push=None, told=told, stop=call, reset=reset)

    def _extract(self, moves: _Moves) -> dict[str, Any]:
        """Return the part of the record that comes from moves."""
        streams, _ = self._node.recorded()
        values = [
            values_in_order(self._options.joints, topic, streams[topic])
            for topic in (JOINT_STATES, TORQUE_SENSORS)
        ]

        def cut(mark: _Mark | None) -> Push | None:
            if mark is None:
                return None
            part = slice(mark.start, mark.off + _AFTER + 1)
            return Push(
                joint=mark.joint,
                torque=self._options.torque,
                position=values[0][:, part],
                effort=values[1][:, part],
                on=_REST,
                off=mark.off - mark.start,
            )

        if moves.trouble:
            return {"skipped": moves.trouble}
        released, held = cut(moves.released), cut(moves.held)
        found: dict[str, Any] = {"pushes": [push for push in map(cut, moves.pushes) if push]}
        for name, ending, mark in (
            ("stale", moves.stale, moves.stale_push),
            ("stop", moves.stop, moves.stop_push),
        ):
            if ending is not None:
                found[name] = replace(ending, push=cut(mark), released=released, held=held)
        return found


@dataclass(frozen=True, kw_only=True)
class _Mark:
    """Where in the recording a push is, in samples."""

    joint: int
    start: int
    off: int


@dataclass
class _Moves:
    """What was done with torque."""

    pushes: list[_Mark] = field(default_factory=list)
    released: _Mark | None = None
    held: _Mark | None = None
    trouble: str = ""
    stale_push: _Mark | None = None
    stop_push: _Mark | None = None
    stale: Ending | None = None
    stop: Ending | None = None
