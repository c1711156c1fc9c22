"""Message records of an MCAP file, one by one and many at once."""

import struct
from collections.abc import Iterator, Mapping, Sequence
from itertools import repeat
from typing import Any, Final

import numpy as np

from armimp_common.errors import BagError

MESSAGE_HEAD: Final = struct.Struct("<BQHIQQ")
"""Head of a message record: opcode, length, channel, sequence, log time, publish time."""

HEAD: Final = np.dtype(
    [
        ("opcode", "u1"),
        ("length", "<u8"),
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("log_time", "<u8"),
        ("publish_time", "<u8"),
    ]
)
"""The same for arrays."""

MESSAGE: Final = 5
"""Opcode of a message record."""

BEYOND_LENGTH: Final = 22
"""Bytes of the head that the length counts."""

_SAME: Final = 15
"""Bytes of the head before the times, which all messages of a stream share."""


class TickRecords:
    """Records of one message of each of some channels, tick after tick.

    Parameters
    ----------
    lengths : tuple of (int, int)
        Number of each channel, and length of its messages, in the order within a tick.
    """

    def __init__(self, lengths: tuple[tuple[int, int], ...]) -> None:
        self.lengths = lengths
        self._heads: list[bytes] = []
        self._offsets: list[int] = []
        layout, size = "<", 0
        for channel, length in lengths:
            head = MESSAGE_HEAD.pack(MESSAGE, BEYOND_LENGTH + length, channel, 0, 0, 0)
            self._heads.append(head[:_SAME])
            self._offsets.append(size)
            layout += f"{_SAME}sQQ{length}s"
            size += MESSAGE_HEAD.size + length
        self._pack, self._size = struct.Struct(layout).pack, size

    def encode(self, log_times: Sequence[int], messages: Mapping[int, Sequence[bytes]]) -> bytes:
        """Encode as many messages of each channel as there are log times (ns).

        Raises
        ------
        BagError
            If a message has another length.
        """
        columns: list[Any] = []
        for head, (channel, length) in zip(self._heads, self.lengths, strict=True):
            if set(map(len, messages[channel])) != {length}:
                raise BagError(f"messages of channel {channel} are not all of {length} bytes")
            columns += [repeat(head), log_times, log_times, messages[channel]]
        pack = self._pack
        return b"".join([pack(*row) for row in zip(*columns, strict=False)])

    def index(self, log_times: Sequence[int], start: int) -> Iterator[tuple[int, bytes]]:
        """Index entries of each channel, if the first record is at `start` in its chunk."""
        entries = [0] * (2 * len(log_times))
        entries[::2] = log_times
        pack = struct.Struct(f"<{len(entries)}Q").pack
        stop = start + self._size * len(log_times)
        for offset, (channel, _) in zip(self._offsets, self.lengths, strict=True):
            entries[1::2] = range(start + offset, stop, self._size)
            yield channel, pack(*entries)
