"""What the checker does with torque: pushes, silence, the emergency stop, and how they end."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeAlias, TypeVar

import numpy as np

from armimp_bringup.driver_check.conversation import Conversation, answered
from armimp_bringup.driver_check.guard import MotionGuard
from armimp_bringup.driver_check.samples import Call, Ending, Message, Push
from armimp_bringup.driver_check.stream_rules import values_in_order
from armimp_common import topics
from armimp_common.cdr import JointStateDecoder
from armimp_common.errors import GraphError, MalformedMessageError
from armimp_common.executor import Spinner
from armimp_common.status import TimingFigures
from armimp_common.topics import JOINT_STATES, TORQUE_SENSORS

REST, HOLD, AFTER, LONGER = 200, 400, 250, 400
"""Samples at rest, under torque, after it; and under torque beyond that, for comparison."""
_STOPPING = 600
"""Samples for which torque is commanded on after the call of the emergency stop, at most."""
_SETTLE = 100
_LEAVING = 0.3
"""How long a driver may take to hear that a publisher has left (s)."""
_STILL = 4e-4
"""An arm that moves less than this during 200 samples has settled (rad)."""
_LONGEST_SETTLING = 80
_SILENCE, TOLD = 10.0, 2.0
_REGULAR = 0.004
"""Time between two commands up to which no driver has a reason to stop (s): 5 periods are."""
_ATTEMPTS = 8

_T = TypeVar("_T")
_Step: TypeAlias = "tuple[int, tuple[float, ...] | None]"
"""A number of samples, and the torque that answers each of them."""


class _GivenUpError(Exception):
    """No torque may be commanded any more."""


@dataclass(frozen=True, kw_only=True)
class Mark:
    """Where in the recording a push is, in samples."""

    joint: int
    start: int
    off: int


@dataclass
class Moves:
    """What was done with torque; see `Record` for what the names mean."""

    pushes: list[Mark] = field(default_factory=list)
    released: Mark | None = None
    held: Mark | None = None
    stale_push: Mark | None = None
    again: Mark | None = None
    stop_push: Mark | None = None
    stale: Ending | None = None
    stop: Ending | None = None
    second: Ending | None = None
    broken: str = ""
    stopped: str = ""
    repeated: int = 0
    gap: float = 0.0
    moved: float | None = None
    timing: TimingFigures | None = None


class Mover:
    """Commands torque, and calls the services.

    Parameters
    ----------
    node, spinner : the checker's
    joints : names, in the order of commands
    torque : how much (N·m)
    most : how far a joint may go (rad)
    paced : whether samples come by themselves
    lead : samples that come before the first command, in lockstep
    known : names of the statuses that have the level ERROR anyway
    """

    def __init__(
        self,
        node: Conversation,
        spinner: Spinner,
        *,
        joints: Sequence[str],
        torque: float,
        most: float,
        paced: bool,
        lead: int,
        known: frozenset[str],
    ) -> None:
        self._node, self._spinner, self._joints = node, spinner, tuple(joints)
        self._amount, self._most, self._paced, self._lead = torque, most, paced, lead
        self._known = known
        self._zero = (0.0,) * len(joints)
        self._decoder = JointStateDecoder(joints, "position")

    def move(self) -> Moves:
        """Push each joint, then the first one until it is to let go by itself, and by a stop."""
        moves = Moves()
        guard = self._node.guard = MotionGuard(self._joints, self._most)
        try:
            self._make(moves)
        except _GivenUpError as reason:
            moves.broken = str(reason)
        finally:
            # However this ends, and be it by Ctrl-C: nothing of what was commanded may stay.
            self._node.let_go()
            self._node.guard = None
        if guard.reason:
            # Zero torque may not be enough where a driver does something else than it is told.
            self._node.call(topics.SIM_STOP_SERVICE, self._spinner, TOLD)
        elif moves.broken:
            self._reset()
        moves.moved = guard.largest
        return moves

    def stop(self) -> Ending:
        """Call the emergency stop of a rig at rest."""
        since = time.monotonic()
        return self._call_stop(since)

    def _make(self, moves: Moves) -> None:
        zero, hold = [(AFTER, self._zero)], [(LONGER, self._torque(0)), (AFTER, self._zero)]
        for joint in range(len(self._joints)):
            moves.pushes.append(self._push(moves, joint, zero))
        # Once more: friction makes the first push of a joint unlike those that follow.
        moves.released = self._push(moves, 0, zero)
        moves.held = self._push(moves, 0, hold)
        if self._paced:
            # What samples wait for that are never answered is not the driver's.
            moves.timing = self._node.timing
            self._undisturbed(moves, lambda: self._keep_silent(moves))
        self._undisturbed(moves, lambda: self._stop_under_torque(moves))
        self._undisturbed(moves, lambda: self._intrude(moves))

    def _push(self, moves: Moves, joint: int, then: Sequence[_Step]) -> Mark:
        """Push a joint once the arm has settled; return where in the recording that is."""
        return self._undisturbed(moves, lambda: (self._push_once(joint, then), math.inf))

    def _push_once(self, joint: int, then: Sequence[_Step]) -> Mark:
        self._settle()
        torque = self._torque(joint)
        start = self._play([(REST, self._zero), (HOLD, torque), *then])
        # Of what follows, the same torque still belongs to the push.
        held = sum(count for count, following in then if following == torque)
        return Mark(joint=joint, start=start, off=start + REST + HOLD + held - 1)

    def _keep_silent(self, moves: Moves) -> tuple[None, float]:
        """Stop commanding under torque; command it again; reset."""
        moves.stale_push = self._push_once(0, [(AFTER, None)])
        since = self._node.silent_since
        told = self._told(since)
        # Commands are back, and must not act before the reset.
        start = self._play([(REST, self._zero), (REST, self._torque(0)), (_SETTLE, self._zero)])
        moves.again = Mark(joint=0, start=start, off=start + 2 * REST - 1)
        moves.stale = Ending(push=None, told=told, reset=self._reset())
        return None, since

    def _stop_under_torque(self, moves: Moves) -> tuple[None, float]:
        """Call the emergency stop; in lockstep time stands still until it has answered."""
        node, torque = self._node, self._torque(0)
        self._settle()
        script: list[_Step] = [(REST, self._zero), (HOLD, torque)]
        if self._paced:
            # Torque is commanded on for some time, no longer, should the stop be a bad one.
            start = node.samples
            node.play([*script, (_STOPPING, torque)])
            end = start + REST + HOLD
            self._wait(lambda: node.samples > end or self._over)
        else:
            start = self._play(script)
        self._look()
        since, last = time.monotonic(), node.samples - (1 if self._paced else 2)
        ending = self._call_stop(since, reset=False)
        # The torque is commanded further, and must not act.
        if self._paced:
            self._wait(lambda: not node.playing)
        else:
            self._play([(AFTER, torque)])
        self._play([(_SETTLE, self._zero)])
        moves.stop_push = Mark(joint=0, start=start, off=last)
        moves.stop = replace(ending, reset=self._reset())
        return None, since

    def _intrude(self, moves: Moves) -> tuple[None, float]:
        """Have somebody else command zero torque, too; reset."""
        self._settle()
        since = time.monotonic()
        with self._node.intruder(self._spinner, TOLD):
            told = self._told(since)
        # Until the driver knows that the other one has left.
        self._node.wait(self._spinner, lambda: False, _LEAVING)
        moves.second = Ending(push=None, told=told, reset=self._reset())
        return None, since

    def _call_stop(self, since: float, *, reset: bool = True) -> Ending:
        future = self._node.ask(topics.SIM_STOP_SERVICE)
        call = Call(success=None)
        if future is not None and self._spinner.spin_until(future, TOLD):
            call = answered(future, time.monotonic() - since)
        told = self._told(since)
        return Ending(push=None, told=told, stop=call, reset=self._reset() if reset else None)

    def _undisturbed(self, moves: Moves, act: Callable[[], tuple[_T, float]]) -> _T:
        """Do something, and again if commands were held up meanwhile and the driver stopped.

        `act` returns until when (monotonic, s) the driver had no reason to stop.
        """
        node = self._node
        for _ in range(_ATTEMPTS):
            seen = len(node.errors)
            node.gap, before = 0.0, node.gap
            found, until = act()
            news = [error for error in node.errors[seen:] if error.name not in self._known]
            news = [error for error in news if error.when <= until]
            if not news:
                return found
            # What was told late is the fault of what was done before.
            gap = max(node.gap, before)
            if gap <= _REGULAR or not self._paced:
                moves.stopped = str(news[0])
                raise _GivenUpError(f"the driver stopped: {news[0]}")
            moves.repeated += 1
            moves.gap = max(moves.gap, gap)
            self._play([(_SETTLE, self._zero)])
            if not self._reset().success:
                raise _GivenUpError(f"the driver stopped, and no reset was granted: {news[0]}")
            # Reports that are still on their way are none of the next attempt.
            self._play([(_SETTLE, self._zero)])
        raise _GivenUpError(
            f"commands were held up {_ATTEMPTS} times, by up to {1e3 * moves.gap:.3g} ms"
        )

    def _reset(self) -> Call:
        return self._node.call(topics.SIM_RESET_SERVICE, self._spinner, TOLD)

    def _torque(self, joint: int) -> tuple[float, ...]:
        return tuple(self._amount if i == joint else 0.0 for i in range(len(self._joints)))

    def _settle(self) -> None:
        for _ in range(_LONGEST_SETTLING):
            self._play([(_SETTLE, self._zero)])
            if self._still():
                return

    def _play(self, script: Sequence[_Step]) -> int:
        """Play a script, and return the number of the first sample that it answers."""
        node = self._node
        self._look()
        start = node.samples if self._paced else node.samples - 1
        node.play(script)
        if not self._paced:
            node.answer()
        self._wait(lambda: not node.playing)
        if not self._paced:
            # The last command is answered, too.
            node.wait(self._spinner, lambda: node.samples >= node.answered + self._lead, 1.0)
        self._look()
        return start

    def _wait(self, condition: Callable[[], bool]) -> None:
        node, last = self._node, -1
        while not condition():
            if node.samples == last:
                raise GraphError("the driver has stopped sending samples")
            last = node.samples
            node.wait(self._spinner, condition, _SILENCE)

    @property
    def _over(self) -> bool:
        return self._node.guard is not None and bool(self._node.guard.reason)

    def _look(self) -> None:
        if self._node.guard is not None and self._node.guard.reason:
            raise _GivenUpError(self._node.guard.reason)

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
            return [
                error.when - since
                for error in list(node.errors)
                if error.when >= since and error.name not in self._known
            ]

        node.wait(self._spinner, lambda: bool(after()), TOLD)
        return min(after(), default=None)


def extract(
    moves: Moves, streams: Mapping[str, Sequence[Message]], joints: Sequence[str], torque: float
) -> dict[str, Any]:
    """Return the part of a record that comes from moves."""
    values = [
        values_in_order(joints, topic, streams[topic]) for topic in (JOINT_STATES, TORQUE_SENSORS)
    ]

    def cut(mark: Mark | None) -> Push | None:
        if mark is None:
            return None
        part = slice(mark.start, mark.off + AFTER + 1)
        return Push(
            joint=mark.joint,
            torque=torque,
            position=values[0][:, part],
            effort=values[1][:, part],
            on=REST,
            off=mark.off - mark.start,
        )

    released, held = cut(moves.released), cut(moves.held)
    found: dict[str, Any] = {
        name: getattr(moves, name) for name in ("broken", "stopped", "repeated", "gap", "moved")
    }
    found["second"] = moves.second
    found["pushes"] = [push for push in map(cut, moves.pushes) if push]
    for name, ending, mark in (
        ("stale", moves.stale, moves.stale_push),
        ("stop", moves.stop, moves.stop_push),
    ):
        if ending is not None:
            found[name] = replace(ending, push=cut(mark), released=released, held=held)
    if found.get("stale") is not None:
        found["stale"] = replace(found["stale"], again=cut(moves.again))
    return found
