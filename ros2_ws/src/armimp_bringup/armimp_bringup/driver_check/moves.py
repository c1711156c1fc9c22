"""What the checker does with torque: pushes, silence, the emergency stop, and how they end."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from armimp_bringup.config import CheckOptions
from armimp_bringup.driver_check import AFTER, REST, Call, Ending, Moves, Push
from armimp_bringup.driver_check.conversation import Conversation, MotionGuard, Step, Torque
from armimp_common import topics
from armimp_common.cdr import JointStateDecoder
from armimp_common.errors import GraphError, MalformedMessageError
from armimp_common.topics import JOINT_STATES

HOLD, LONGER = 400, 400
"""Samples under torque, and beyond that, for comparison."""
_STOPPING = 600
"""Samples for which torque is commanded on after the call of the emergency stop, at most."""
_SETTLE = 100
_LEAVING = 0.3
"""How long a driver may take to hear that a publisher has left, s."""
_STILL = 4e-4
"""An arm that moves less than this during 200 samples has settled, rad."""
_LONGEST_SETTLING = 80
_SILENCE, TOLD = 10.0, 2.0
_REGULAR = 0.004
"""Time between two commands up to which no driver has a reason to stop, s: 5 periods are."""
_ATTEMPTS = 8

_T = TypeVar("_T")


class _GivenUpError(Exception):
    """No torque may be commanded any more."""


class Mover:
    """Commands torque, and calls the services.

    Parameters
    ----------
    node : the checker's
    options : what the user asks for
    lead : samples that come before the first command in lockstep; None where they come by
        themselves
    known : names of the statuses that have the level ERROR anyway
    """

    def __init__(
        self, node: Conversation, options: CheckOptions, lead: int | None, known: frozenset[str]
    ) -> None:
        self._node, self._joints, self._amount = node, options.joints, options.torque
        self._paced, self._lead, self._known = lead is None, lead or 0, known
        self._decoder = JointStateDecoder(options.joints, "position")
        self._moves = Moves()
        self._guard = MotionGuard(options.joints, options.most_motion)
        self.readings: dict[str, NDArray[np.float64]] = {}  # filled in when all is over

    def move(self) -> Moves:
        """Push each joint; then see how silence, a stop and a second publisher end a push."""
        moves, guard = self._moves, self._guard
        self._node.guard = guard
        try:
            self._make()
        except _GivenUpError as error:
            moves.missing, moves.astray = str(error), bool(guard.objection)
        finally:
            # However this ends, even by Ctrl-C, no torque that was commanded may stay.
            self._node.let_go()
            self._node.guard = None
        if guard.objection:
            # Zero torque may not be enough where a driver does something else than it is told.
            self._node.call(topics.SIM_STOP_SERVICE, TOLD)
        elif moves.missing:
            self._reset()
        moves.moved = guard.largest
        return moves

    def stop_at_rest(self) -> Moves:
        """Call the emergency stop of a rig at rest."""
        stop, told = self._call_stop(self._node.now())
        return Moves(stop=Ending(told=told, stop=stop, reset=self._reset()))

    def _make(self) -> None:
        moves, zero = self._moves, self._node.zero
        release: list[Step] = [(AFTER, zero)]
        for joint in range(len(self._joints)):
            moves.pushes.append(self._push(joint, release))
        # Once more: friction makes the first push of a joint unlike those that follow.
        moves.released = self._push(0, release)
        moves.held = self._push(0, [(LONGER, self._torque(0)), *release])
        if self._paced:
            # What samples wait for that are never answered is not the driver's.
            moves.timing = self._node.timing
            moves.stale = self._undisturbed(self._keep_silent)
        moves.stop = self._undisturbed(self._stop_under_torque)
        moves.second = self._undisturbed(self._intrude)

    def _push(self, joint: int, then: Sequence[Step]) -> Push:
        """Push a joint once the arm has settled."""
        return self._undisturbed(lambda: (self._push_once(joint, then), math.inf))

    def _push_once(self, joint: int, then: Sequence[Step]) -> Push:
        self._settle()
        torque = self._torque(joint)
        start = self._play([(REST, self._node.zero), (HOLD, torque), *then])
        # Of what follows, the same torque still belongs to the push.
        held = sum(count for count, following in then if following == torque)
        return self._pushed(joint, start, REST + HOLD + held - 1)

    def _pushed(self, joint: int, start: int, off: int) -> Push:
        return Push(joint=joint, torque=self._amount, start=start, off=off, readings=self.readings)

    def _keep_silent(self) -> tuple[Ending, float]:
        """Stop commanding under torque; command it again; reset."""
        zero = self._node.zero
        push = self._push_once(0, [(AFTER, None)])
        since = self._node.silent_since
        told = self._told(since)
        # Commands are back, and must not act before the reset.
        start = self._play([(REST, zero), (REST, self._torque(0)), (_SETTLE, zero)])
        again = self._pushed(0, start, 2 * REST - 1)
        return Ending(push=push, again=again, told=told, reset=self._reset()), since

    def _stop_under_torque(self) -> tuple[Ending, float]:
        """Call the emergency stop; in lockstep time stands still until it has answered."""
        node, torque = self._node, self._torque(0)
        self._settle()
        script: list[Step] = [(REST, node.zero), (HOLD, torque)]
        if self._paced:
            # Torque is commanded on for some time, no longer, should the stop be a bad one.
            start = node.samples
            node.play([*script, (_STOPPING, torque)])
            end = start + REST + HOLD
            self._wait(lambda: node.samples > end or bool(self._guard.objection))
        else:
            start = self._play(script)
        self._require_calm()
        since, last = node.now(), node.samples - (1 if self._paced else 2)
        stop, told = self._call_stop(since)
        # The torque is commanded further, and must not act.
        if self._paced:
            self._wait(lambda: not node.playing)
        else:
            self._play([(AFTER, torque)])
        self._play([(_SETTLE, node.zero)])
        push = self._pushed(0, start, last - start)
        return Ending(push=push, told=told, stop=stop, reset=self._reset()), since

    def _intrude(self) -> tuple[Ending, float]:
        """Have somebody else command zero torque, too; reset."""
        self._settle()
        since = self._node.now()
        with self._node.intruder(TOLD):
            told = self._told(since)
        # Until the driver knows that the other one has left.
        self._node.wait(lambda: False, _LEAVING)
        return Ending(told=told, reset=self._reset()), since

    def _call_stop(self, since: float) -> tuple[Call, float | None]:
        call = self._node.call(topics.SIM_STOP_SERVICE, TOLD, since)
        return call, self._told(since)

    def _undisturbed(self, act: Callable[[], tuple[_T, float]]) -> _T:
        """Do something, and again if commands were held up meanwhile and the driver stopped.

        `act` returns until when (monotonic, s) the driver had no reason to stop.
        """
        node, moves = self._node, self._moves
        for _ in range(_ATTEMPTS):
            seen = len(node.errors)
            node.gap, before = 0.0, node.gap
            found, until = act()
            news = [one for one in node.errors[seen:] if one.name not in self._known]
            news = [one for one in news if one.when <= until]
            if not news:
                return found
            # What was told late is the fault of what was done before.
            gap, fault = max(node.gap, before), str(news[0])
            if gap <= _REGULAR or not self._paced:
                moves.fault = fault
                raise _GivenUpError(f"the driver stopped: {fault}")
            moves.repeated += 1
            moves.gap = max(moves.gap, gap)
            self._play([(_SETTLE, node.zero)])
            if not self._reset().success:
                raise _GivenUpError(f"the driver stopped, and no reset was granted: {fault}")
            # Reports that are still on their way are none of the next attempt.
            self._play([(_SETTLE, node.zero)])
        raise _GivenUpError(
            f"commands were held up {_ATTEMPTS} times, by up to {1e3 * moves.gap:.3g} ms"
        )

    def _reset(self) -> Call:
        return self._node.call(topics.SIM_RESET_SERVICE, TOLD)

    def _torque(self, joint: int) -> Torque:
        return tuple(self._amount if i == joint else 0.0 for i in range(len(self._joints)))

    def _settle(self) -> None:
        for _ in range(_LONGEST_SETTLING):
            self._play([(_SETTLE, self._node.zero)])
            if self._still():
                return

    def _play(self, script: Sequence[Step]) -> int:
        """Play a script, and return the number of the first sample that it answers."""
        node = self._node
        self._require_calm()
        start = node.samples if self._paced else node.samples - 1
        node.play(script)
        if not self._paced:
            node.answer()
        self._wait(lambda: not node.playing)
        if not self._paced:
            # The last command is answered, too.
            node.wait(lambda: node.samples >= node.answered + self._lead, 1.0)
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
        """Return how long after a moment the driver reported a fault, s."""
        node = self._node

        def after() -> list[float]:
            return [
                one.when - since
                for one in list(node.errors)
                if one.when >= since and one.name not in self._known
            ]

        node.wait(lambda: bool(after()), TOLD)
        return min(after(), default=None)
