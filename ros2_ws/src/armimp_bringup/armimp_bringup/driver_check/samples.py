"""What was recorded of a driver, without ROS: messages, endpoints, and answers to torque."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from armimp_bringup.driver_check.witness import Stalls, stalls
from armimp_common.status import TimingFigures
from armimp_common.topics import JOINT_STATES, TORQUE_SENSORS

SENSOR_TOPICS = (JOINT_STATES, TORQUE_SENSORS)


@dataclass(frozen=True, kw_only=True)
class Message:
    """One message of a sensor stream.

    Attributes
    ----------
    arrival_ns : monotonic wall time of its arrival (ns)
    stamp_ns : its stamp (ns)
    names : joints in the order of the message
    position, effort : arrays as they came, of whatever length
    """

    arrival_ns: int
    stamp_ns: int
    names: tuple[str, ...]
    position: tuple[float, ...]
    effort: tuple[float, ...]


@dataclass(frozen=True, kw_only=True)
class Endpoint:
    """A publisher or subscriber, as discovery tells of it.

    Attributes
    ----------
    topic : name of the contract
    role : ``publisher`` or ``subscriber``
    node : full name of its node
    type : message type
    reliable : whether it is reliable
    transient : whether its durability is transient local
    depth : its history depth; None where discovery does not tell
    """

    topic: str
    role: Literal["publisher", "subscriber"]
    node: str
    type: str
    reliable: bool = True
    transient: bool = False
    depth: int | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Push:
    """Samples around a constant torque on one joint.

    Attributes
    ----------
    joint : which, from 0
    torque : how much (N·m)
    position, effort : (n, N) readings in the order of the expected joints (rad, N·m)
    on : sample that was answered by the first command with the torque
    off : last sample before the torque should have begun to go
    """

    joint: int
    torque: float
    position: NDArray[np.float64]
    effort: NDArray[np.float64]
    on: int
    off: int


@dataclass(frozen=True, kw_only=True)
class Call:
    """A call of a service.

    Attributes
    ----------
    success : what it answered; None if it did not answer
    message : its words
    seconds : until the answer (s)
    """

    success: bool | None
    message: str = ""
    seconds: float = 0.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Ending:
    """How torque was taken away, and what the driver said about it.

    Attributes
    ----------
    push : the torque that was there before; None if the rig was at rest
    released, held : for comparison, the same ended by a command of zero torque, and held for longer
    told : seconds from the last command, or the stop, to an ERROR on /diagnostics; None: never
    stop : the call of the emergency stop, if it was that
    again : torque that was commanded anew before the reset, which must not act; None: not tried
    reset : the call of the reset afterwards
    """

    push: Push | None
    released: Push | None = None
    held: Push | None = None
    again: Push | None = None
    told: float | None = None
    stop: Call | None = None
    reset: Call | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Record:
    """Everything known about a driver.

    Attributes
    ----------
    joints : names that are expected, in the order of commands
    paced : whether samples come by themselves; else one comes for each command
    endpoints : who publishes and listens, without the checker itself
    streams : messages by topic
    moving : messages by topic that came while torque was commanded
    malformed : messages that could not be decoded, by topic
    answered : commands sent in lockstep while the streams were recorded
    services : names of the services that are there, relative to the namespace
    lifecycle : state in which the driver was found; None if it is no lifecycle node
    skipped : why tests with commands were not asked for, or could not begin
    troubled : what was wrong at rest, so that no torque was commanded in spite of having been asked
    broken : why they were given up after they had begun
    stopped : what the driver said when it stopped though commands came as they should
    repeated : pushes that were made anew, as commands had been held up
    gap : longest time between two commands of those (s)
    moved : how far a joint went from where it was (rad); None if there was no torque
    most : how far it was allowed to go (rad)
    faults : statuses of level ERROR on /diagnostics before anything was commanded
    stalls : when this process was held up
    waited : how long the driver's process waited for a processor during the recording (s), None
        where that cannot be told
    pushes : one for each joint
    stale : commands that stopped under torque
    stop : the emergency stop
    second : a second publisher of commands
    timing : what the driver reports of its own timing
    """

    joints: tuple[str, ...]
    paced: bool
    endpoints: Sequence[Endpoint]
    streams: Mapping[str, Sequence[Message]]
    moving: Mapping[str, Sequence[Message]] = field(default_factory=dict)
    malformed: Mapping[str, int] = field(default_factory=dict)
    answered: int = 0
    services: frozenset[str] = frozenset()
    lifecycle: str | None = None
    skipped: str = ""
    troubled: bool = False
    broken: str = ""
    stopped: str = ""
    repeated: int = 0
    gap: float = 0.0
    moved: float | None = None
    most: float = 0.0
    faults: Sequence[str] = ()
    stalls: Stalls = field(default_factory=stalls)
    waited: float | None = None
    pushes: Sequence[Push] = ()
    stale: Ending | None = None
    stop: Ending | None = None
    second: Ending | None = None
    timing: TimingFigures | None = None
