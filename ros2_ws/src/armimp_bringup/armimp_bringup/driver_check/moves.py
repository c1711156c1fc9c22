"""What the checker does with torque: pushes, silence, the emergency stop, and how they end."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import TypeVar

import numpy as np

from armimp_bringup.config import CheckOptions
from armimp_bringup.driver_check import Call, Ending, Moves, Push, measure
from armimp_bringup.driver_check.conversation import Conversation, MotionGuard, Step, Torque
from armimp_common import topics
from armimp_common.cdr import JointStateDecoder
from armimp_common.errors import GraphError, MalformedMessageError
from armimp_common.topics import JOINT_STATES, TORQUE_SENSORS, VALUE_FIELD

REST, HOLD = 200, 400
"""Samples at rest before a push, and those under torque."""
_AGAIN = 200
"""Samples of a push that must not act."""
_SILENT = 250
"""Samples for which commands stay away."""
_STOPPING = 600
"""Samples for which torque is commanded on after the call of the emergency stop, at most."""
_SETTLE = 100
_LEAVING = 0.3
"""How long a driver may take to hear that a publisher has left, s."""
_STILL = 4e-4
"""An arm that moves less than this during 200 samples has settled, rad."""
_LONGEST_SETTLING = 80
_SILENCE, TOLD = 10.0, 2.0

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
        self._decoders = {
            topic: JointStateDecoder(options.joints, VALUE_FIELD[topic])
            for topic in (JOINT_STATES, TORQUE_SENSORS)
        }
        self._moves = Moves()
        self._guard = MotionGuard(options.joints, options.most_motion)

    def move(self) -> Moves:
        """Push each joint; then see how silence, a stop and a second publisher end a push."""
        moves, guard = self._moves, self._guard
        self._node.guard = guard
        try:
            for joint in range(len(self._joints)):
                moves.pushes.append(self._watched(partial(self._push, joint)))
            if self._paced:
                moves.stale = self._watched(self._keep_silent)
            moves.stop = self._watched(self._stop_under_torque)
            moves.second = self._watched(self._intrude)
        except (_GivenUpError, MalformedMessageError) as error:
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

    def _push(self, joint: int) -> tuple[Push, float]:
        """Push a joint once the arm has settled."""
        self._settle()
        script = [(REST, self._node.zero), (HOLD, self._torque(joint))]
        start = self._play([*script, (_SETTLE, self._node.zero)])
        return self._measured(joint, start, HOLD), math.inf

    def _measured(self, joint: int, start: int, held: int) -> Push:
        """See what a push has done that began, at rest, with this sample."""
        angles, torques = (
            decoder.decode_many(self._node.raw(topic, start, start + REST + held + _SETTLE))[1]
            for topic, decoder in self._decoders.items()
        )
        return measure(joint, self._amount, angles, torques, REST, REST + held)

    def _push_in_vain(self) -> Push:
        """Command torque that must not act, as no reset was granted yet."""
        zero = self._node.zero
        start = self._play([(REST, zero), (_AGAIN, self._torque(0)), (_SETTLE, zero)])
        return self._measured(0, start, _AGAIN)

    def _keep_silent(self) -> tuple[Ending, float]:
        """Stop commanding under torque; command it again; reset."""
        self._settle()
        start = self._play([(REST, self._node.zero), (HOLD, self._torque(0)), (_SILENT, None)])
        since = self._node.silent_since
        told, ended = self._told(since), self._measured(0, start, HOLD)
        again = self._push_in_vain()
        return Ending(told=told, ended=ended, again=again, reset=self._reset()), since

    def _stop_under_torque(self) -> tuple[Ending, float]:
        """Call the emergency stop; in lockstep time stands still until it has answered."""
        node, torque = self._node, self._torque(0)
        self._settle()
        script: list[Step] = [(REST, node.zero), (HOLD, torque)]
        if self._paced:
            # Torque is commanded on for some time, no longer, should the stop be a bad one.
            end = node.samples + REST + HOLD
            node.play([*script, (_STOPPING, torque)])
            self._wait(lambda: node.samples > end or bool(self._guard.objection))
        else:
            self._play(script)
        self._require_calm()
        since = node.now()
        stop, told = self._call_stop(since)
        if self._paced:
            self._wait(lambda: not node.playing)
        again = self._push_in_vain()
        return Ending(told=told, again=again, stop=stop, reset=self._reset()), since

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

    def _watched(self, act: Callable[[], tuple[_T, float]]) -> _T:
        """Do something, and give up if the driver stopped in it without a reason.

        `act` returns until when (monotonic, s) the driver had none.
        """
        node, moves, seen = self._node, self._moves, len(self._node.errors)
        found, until = act()
        for one in node.errors[seen:]:
            if one.name not in self._known and one.when <= until:
                moves.fault, moves.gap = str(one), node.gap
                raise _GivenUpError(f"the driver stopped: {one}")
        return found

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
        last = self._node.messages(JOINT_STATES)
        recent = self._node.raw(JOINT_STATES, max(last - 2 * _SETTLE, 0), last)
        angles = self._decoders[JOINT_STATES].decode_many(recent)[1]
        return len(recent) == 2 * _SETTLE and float(np.max(np.ptp(angles, axis=1))) < _STILL

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
