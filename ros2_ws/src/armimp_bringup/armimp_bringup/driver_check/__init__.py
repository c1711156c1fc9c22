"""What was recorded of a driver, and what a check found, without ROS."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from armimp_common.status import TimingFigures
from armimp_common.topics import JOINT_STATES, TORQUE_SENSORS, VALUE_FIELD

SENSOR_TOPICS = (JOINT_STATES, TORQUE_SENSORS)
REST, AFTER = 200, 250
"""Samples at rest before a push, and those after it that are looked at."""


class Verdict(str, Enum):
    """How one check ended.

    A check is not made where it does not apply, or was not asked for. It is inconclusive where it
    was asked for and could not be finished, or where the machine may be to blame.
    """

    PASS = "pass"
    FAIL = "fail"
    INCONCLUSIVE = "inconclusive"
    NOT_CHECKED = "not checked"


@dataclass(frozen=True)
class Finding:
    """Outcome of one check."""

    check: str  # such as ``joint_states: rate``
    verdict: Verdict
    figure: str  # what was found, or why nothing could be
    limit: str  # what is asked for


def with_verdict(findings: Iterable[Finding], verdict: Verdict) -> list[str]:
    """Return the names of the checks with this verdict, in their order."""
    return [finding.check for finding in findings if finding.verdict is verdict]


class Message(NamedTuple):
    """One message of a sensor stream; the arrays are as they came, of whatever length."""

    arrival_ns: int  # on the monotonic clock
    stamp_ns: int
    names: tuple[str, ...]
    position: tuple[float, ...]
    effort: tuple[float, ...]


class Endpoint(NamedTuple):
    """A publisher or subscriber, as discovery tells of it."""

    topic: str
    role: Literal["publisher", "subscriber"]
    node: str
    type: str
    reliable: bool = True
    transient: bool = False


class Call(NamedTuple):
    """A call of a service, and what it answered; None if it did not."""

    success: bool | None
    message: str = ""
    seconds: float = 0.0  # until the answer


@dataclass(frozen=True, kw_only=True, eq=False)
class Push:
    """A constant torque on one joint, after :data:`REST` samples of zero torque."""

    joint: int  # from 0
    torque: float  # N·m
    start: int  # number of its first sample in the recording
    off: int  # last sample before the torque should have begun to go, from ``start``
    readings: Mapping[str, NDArray[np.float64]]  # of all the recording, see :func:`readings`
    on: int = REST

    @property
    def position(self) -> NDArray[np.float64]:
        """Angles of the push and of what follows (n, samples), rad."""
        return self.readings[JOINT_STATES][:, self.start : self.start + self.off + AFTER + 1]

    @property
    def effort(self) -> NDArray[np.float64]:
        """Torques of the push and of what follows (n, samples), N·m."""
        return self.readings[TORQUE_SENSORS][:, self.start : self.start + self.off + AFTER + 1]


@dataclass(frozen=True, kw_only=True, eq=False)
class Ending:
    """How torque was taken away, and what the driver said about it."""

    push: Push | None = None  # the torque that was there before; None if the rig was at rest
    again: Push | None = None  # commanded anew before the reset: must not act
    told: float | None = None  # s, from the last command, or the stop, to an ERROR; None: never
    stop: Call | None = None
    reset: Call | None = None


@dataclass(kw_only=True, eq=False)
class Moves:
    """What was done with torque, and how it ended."""

    pushes: list[Push] = field(default_factory=list)  # one for each joint
    released: Push | None = None  # for comparison, ended by a command of zero torque
    held: Push | None = None  # likewise, but longer
    stale: Ending | None = None  # commands that stopped under torque
    stop: Ending | None = None  # the emergency stop
    second: Ending | None = None  # a second publisher of commands
    asked: bool = True  # whether torque was to be commanded
    missing: str = ""  # why the moves, or the rest of them, were not made
    astray: bool = False  # whether that is motion beyond its limit, or which cannot be read
    fault: str = ""  # what the driver said when it stopped under regular commands
    repeated: int = 0  # moves that were made anew, as commands had been held up
    gap: float = 0.0  # s, longest time between two commands of those
    moved: float | None = None  # rad, how far a joint went; None if there was no torque
    timing: TimingFigures | None = None  # as reported before commands stayed away


@dataclass(frozen=True, kw_only=True, eq=False)
class Record:
    """Everything known about a driver."""

    joints: tuple[str, ...]  # that are expected, in the order of commands
    paced: bool  # whether samples come by themselves; else one comes for each command
    endpoints: Sequence[Endpoint]  # without those of the checker
    streams: Mapping[str, Sequence[Message]]  # at rest, by topic
    moving: Mapping[str, Sequence[Message]] = field(default_factory=dict)  # under torque
    malformed: Mapping[str, int] = field(default_factory=dict)  # that could not be decoded
    answered: int = 0  # commands sent in lockstep while the streams were recorded
    services: frozenset[str] = frozenset()  # relative to the namespace
    lifecycle: str | None = None  # how it was found; None if it is no lifecycle node
    most: float = 0.0  # rad, how far a joint was allowed to go
    faults: Sequence[str] = ()  # of level ERROR before anything was commanded
    moves: Moves = field(default_factory=Moves)
    timing: TimingFigures | None = None  # as the driver reports it


def readings(joints: Sequence[str], topic: str, messages: Sequence[Message]) -> NDArray[np.float64]:
    """Return the readings (n, N) of a stream by expected joint, of whole messages only.

    A message is whole if it has the expected joints, in any order, and as many values.
    """
    columns: list[list[float]] = []
    places: dict[tuple[str, ...], list[int]] = {}
    for message in messages:
        values: tuple[float, ...] = getattr(message, VALUE_FIELD[topic])
        if sorted(message.names) != sorted(joints) or len(values) != len(joints):
            continue
        place = places.get(message.names)
        if place is None:
            place = places[message.names] = [message.names.index(joint) for joint in joints]
        columns.append([values[i] for i in place])
    found: NDArray[np.float64] = np.array(columns).reshape(-1, len(joints)).T
    return found
