"""Messages of some ticks at once: what recording them one by one would find out many times over."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armimp_common.contract import (
    COMMANDS,
    DATA_STREAMS,
    JOINT_STATES,
    NS_PER_S,
    PERTURBATION,
    TORQUE_SENSORS,
)

ORDER = (JOINT_STATES, TORQUE_SENSORS, PERTURBATION, COMMANDS)
"""Messages of a tick in the order in which they are recorded."""

_STAMPED = (JOINT_STATES, TORQUE_SENSORS, PERTURBATION)
_LITTLE_ENDIAN = (0, 1)
_STAMP = slice(4, 12)
"""Where a message that begins with a ``std_msgs/Header`` has its stamp."""


@dataclass(frozen=True, kw_only=True, eq=False)
class TickBlock:
    """The four messages of each of some ticks, which came as they should.

    Attributes
    ----------
    stamps : ndarray, shape (N,)
        Stamps of the ticks (ns), rising and none of them negative.
    messages : mapping of str to list of bytes
        N of each stream, by topic of the contract.
    tables : mapping of str to ndarray, shape (N, length)
        The bytes of the same messages, in the order of :data:`ORDER`.
    """

    stamps: NDArray[np.int64]
    messages: Mapping[str, list[bytes]]
    tables: Mapping[str, NDArray[np.uint8]]

    @property
    def ticks(self) -> int:
        """Number of ticks N."""
        return self.stamps.size

    def first(self, ticks: int) -> TickBlock:
        """The first ticks of the block; all of them if it has no more."""
        if ticks >= self.ticks:
            return self
        return TickBlock(
            stamps=self.stamps[:ticks],
            messages={topic: raws[:ticks] for topic, raws in self.messages.items()},
            tables={topic: table[:ticks] for topic, table in self.tables.items()},
        )


def block_of(messages: Mapping[str, Sequence[bytes]]) -> TickBlock | None:
    """Make a block of equally many messages of the four streams.

    Returns
    -------
    TickBlock or None
        None if they are not the messages of ticks one after the other, or those of a stream are
        not of equal length: then each has to be looked at for itself.
    """
    count = len(messages[PERTURBATION])
    if not count or any(len(messages[topic]) != count for topic in DATA_STREAMS):
        return None
    tables: dict[str, NDArray[np.uint8]] = {}
    for topic in ORDER:
        raws = messages[topic]
        length = len(raws[0])
        if length < _STAMP.stop or set(map(len, raws)) != {length}:
            return None
        tables[topic] = np.frombuffer(b"".join(raws), np.uint8).reshape(count, length)
    stamps = _stamps(tables[PERTURBATION])
    if stamps is None or stamps[0] < 0 or not (stamps[1:] > stamps[:-1]).all():
        return None
    leading = tables[PERTURBATION][:, _STAMP]
    for topic in _STAMPED:
        head = tables[topic][:, : _STAMP.stop]
        if not ((head[:, :2] == _LITTLE_ENDIAN).all() and (head[:, _STAMP] == leading).all()):
            return None
    return TickBlock(
        stamps=stamps,
        messages={topic: list(messages[topic]) for topic in DATA_STREAMS},
        tables=tables,
    )


def _stamps(table: NDArray[np.uint8]) -> NDArray[np.int64] | None:
    """Stamps (ns) of messages whose byte order is little endian."""
    parts = np.ascontiguousarray(table[:, _STAMP]).view("<i4")
    seconds, nanoseconds = parts[:, 0].astype(np.int64), parts[:, 1].view("<u4")
    stamps: NDArray[np.int64] = seconds * NS_PER_S + nanoseconds.astype(np.int64)
    return stamps
