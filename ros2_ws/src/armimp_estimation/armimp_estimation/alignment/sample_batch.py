"""Messages of some ticks at once: what recording them one by one would find out many times over.

Plain Python on purpose. Once in fifty ticks nothing of numpy is in the processor's caches, and a
few of its operations take longer than a loop of the interpreter, which is.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from operator import itemgetter, lt

from armimp_common.topics import (
    COMMANDS,
    DATA_STREAMS,
    JOINT_STATES,
    NS_PER_S,
    PERTURBATION,
    TORQUE_SENSORS,
)

ORDER = (JOINT_STATES, TORQUE_SENSORS, PERTURBATION, COMMANDS)
"""Messages of a tick in the order in which they are recorded."""

_HEAD = struct.Struct("<4siI")
"""Beginning of a message with a ``std_msgs/Header``: encapsulation and stamp."""
_LITTLE_ENDIAN = b"\0\1\0\0"
_head_of = itemgetter(slice(_HEAD.size))


@dataclass(frozen=True, kw_only=True, eq=False)
class SampleBatch:
    """The four messages of each of some ticks, which came as they should.

    Attributes
    ----------
    stamps : list of int
        Stamps of the ticks (ns), rising and none of them negative.
    messages : mapping of str to list of bytes
        As many of each stream, by topic of the contract in the order of :data:`ORDER`; those of a
        stream are of equal length.
    """

    stamps: list[int]
    messages: Mapping[str, list[bytes]]

    @property
    def ticks(self) -> int:
        """Number of ticks."""
        return len(self.stamps)

    def first(self, ticks: int) -> SampleBatch:
        """The first ticks of the block; all of them if it has no more."""
        if ticks >= self.ticks:
            return self
        return SampleBatch(
            stamps=self.stamps[:ticks],
            messages={topic: raws[:ticks] for topic, raws in self.messages.items()},
        )


def block_of(messages: Mapping[str, Sequence[bytes]]) -> SampleBatch | None:
    """Make a block of equally many messages of the four streams.

    Returns
    -------
    SampleBatch or None
        None if they are not the messages of ticks one after the other, or those of a stream are
        not of equal length: then each has to be looked at for itself.
    """
    count = len(messages[PERTURBATION])
    if not count:
        return None
    for topic in DATA_STREAMS:
        raws = messages[topic]
        if len(raws) != count or len(set(map(len, raws))) != 1:
            return None
    heads, states, sensors = (
        list(map(_head_of, messages[topic]))
        for topic in (PERTURBATION, JOINT_STATES, TORQUE_SENSORS)
    )
    if len(heads[0]) != _HEAD.size or not heads == states == sensors:
        return None
    stamps: list[int] = []
    for head, seconds, nanoseconds in _HEAD.iter_unpack(b"".join(heads)):
        if head != _LITTLE_ENDIAN:
            return None
        stamps.append(seconds * NS_PER_S + nanoseconds)
    if stamps[0] < 0 or not all(map(lt, stamps, stamps[1:])):
        return None
    return SampleBatch(stamps=stamps, messages={topic: list(messages[topic]) for topic in ORDER})
