"""Data of a driver check, without ROS: the record of a driver, and the findings about it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from typing import Literal, NamedTuple

import numpy as np

from armimp_common.arrays import FloatArray
from armimp_common.topics import JOINT_STATES, TORQUE_SENSORS, VALUE_FIELD

SENSOR_TOPICS = (JOINT_STATES, TORQUE_SENSORS)
_BASELINE = 50
"""Samples at rest that a push is compared with."""
_GOING = 60
"""Samples after a push until its torque has gone: 5 periods, 50 ms, and 5 periods more."""
_SIGMAS = 5.0


class Outcome(str, Enum):
    """How one check ended.

    A check is not made if it does not apply, or was not requested. It is inconclusive if it was
    requested but could not be finished, or if this machine may be the cause of what was found.
    """

    PASS = "pass"
    FAIL = "fail"
    INCONCLUSIVE = "inconclusive"
    NOT_CHECKED = "not checked"


@dataclass(frozen=True)
class Finding:
    """Outcome of one check."""

    check: str  # such as ``joint_states: rate``
    outcome: Outcome
    figure: str  # what was found, or why nothing could be found
    limit: str  # what is required


class Message(NamedTuple):
    """One message of a sensor stream; the arrays are as received, of whatever length."""

    arrival_ns: int  # on the monotonic clock
    stamp_ns: int
    names: tuple[str, ...]
    position: tuple[float, ...]
    effort: tuple[float, ...]


class Endpoint(NamedTuple):
    """A publisher or subscriber, as discovery reports it."""

    topic: str
    role: Literal["publisher", "subscriber"]
    node: str
    type: str
    reliable: bool = True
    transient: bool = False


class Call(NamedTuple):
    """A service call and its answer; `success` is None if there was no answer."""

    success: bool | None
    message: str = ""
    seconds: float = 0.0  # until the answer


class Push(NamedTuple):
    """Response to a constant torque on one joint; see :func:`measure`."""

    joint: int  # from 0
    torque: float  # N·m
    moved: FloatArray  # mean change of each angle in the second half of the push (n,), rad
    still: FloatArray  # largest change of each angle that counts as noise (n,), rad
    delay: int | None  # samples until the torque reading responded; None if it did not
    change: float = 0.0  # by how much the torque reading then changed, N·m
    back: float = 0.0  # how far the joint returned after the push, rad


class Ending(NamedTuple):
    """Response of a driver to a fault."""

    reported: float | None = None  # s, from the last command, or the stop, to an ERROR; None: never
    ended: Push | None = None  # the push that the fault ended
    again: Push | None = None  # a push commanded before the reset, which must have no effect
    stop: Call | None = None
    reset: Call = Call(success=None)


@dataclass(kw_only=True, eq=False)
class Moves:
    """Tests under torque, and how they ended."""

    pushes: list[Push] = field(default_factory=list)  # one for each joint
    stale: Ending | None = None  # commands that stopped under torque
    stop: Ending | None = None  # the emergency stop
    second: Ending | None = None  # a second publisher of commands
    missing: str = ""  # why the tests that were requested, or the rest of them, were not made
    astray: bool = False  # whether the reason is motion beyond its limit, or unreadable angles
    fault: str = ""  # message of the driver when it stopped although commands came
    gap: float = 0.0  # s, longest time between two commands
    moved: float | None = None  # rad, how far a joint went; None if there was no torque


@dataclass(frozen=True, kw_only=True, eq=False)
class Record:
    """Everything known about a driver."""

    joints: tuple[str, ...]  # expected names, in the order of commands
    endpoints: Sequence[Endpoint]  # without those of the checker
    streams: Mapping[str, Sequence[Message]]  # at rest, by topic
    moving: Mapping[str, Sequence[Message]] = field(default_factory=dict)  # under torque
    malformed: Mapping[str, int] = field(default_factory=dict)  # messages that cannot be decoded
    services: frozenset[str] = frozenset()  # relative to the namespace
    lifecycle: str | None = None  # state when found; None if it is no lifecycle node
    most: float = 0.0  # rad, how far a joint was allowed to go
    faults: Sequence[str] = ()  # of level ERROR before anything was commanded
    moves: Moves = field(default_factory=Moves)


def readings(joints: Sequence[str], topic: str, messages: Sequence[Message | None]) -> FloatArray:
    """Return the readings (n, N) of a stream in the order of the expected joints.

    Only complete messages count: with the expected joints, in any order, and as many values.
    """
    columns: list[list[float]] = []
    for message in messages:
        if message is None or sorted(message.names) != sorted(joints):
            continue
        values: tuple[float, ...] = getattr(message, VALUE_FIELD[topic])
        if len(values) == len(joints):
            columns.append([values[message.names.index(joint)] for joint in joints])
    found: FloatArray = np.array(columns).reshape(-1, len(joints)).T
    return found


def measure(
    joint: int, torque: float, angles: FloatArray, torques: FloatArray, begin: int, end: int
) -> Push:
    """Measure the response to a constant torque on one joint.

    Parameters
    ----------
    joint, torque : index from 0; N·m
    angles, torques : (n, N) readings at rest, under the torque and after it, rad and N·m
    begin, end : index of the last sample at rest, which the first command of the torque answers,
        and of the last sample under the torque
    """
    before = slice(max(begin - _BASELINE, 0), begin + 1)
    own = angles[joint]
    later = angles[:, (begin + end) // 2 : end]
    answer = torques[joint] - np.mean(torques[joint, before])
    seen = np.flatnonzero(np.abs(answer[begin + 1 : end]) > _noise(torques, before)[joint])
    delay = int(seen[0]) + 1 if seen.size else None
    first = begin + (delay or 0)
    return Push(
        joint=joint,
        torque=torque,
        moved=np.mean(later, axis=1) - np.mean(angles[:, before], axis=1),
        still=_noise(angles, before),
        delay=delay,
        change=float(np.mean(answer[first : first + 3])) if seen.size else 0.0,
        back=float(np.mean(own[end - _BASELINE : end]) - np.mean(own[end + _GOING :])),
    )


def _noise(values: FloatArray, rest: slice) -> FloatArray:
    """Return what change (n,) of readings (n, N) may be noise: 5 sigma at rest, or 1.5 counts."""
    changes = np.abs(np.diff(np.sort(values, axis=1), axis=1))
    count = np.array([np.min(row[row > 1e-9], initial=np.inf) for row in changes])
    # Unquantised readings have steps of any size; those due to noise are below five sigma anyway.
    count = np.where(np.isfinite(count), count, 0.0)
    noise: FloatArray = np.maximum(_SIGMAS * np.std(values[:, rest], axis=1), 1.5 * count)
    return noise
