"""Message records of an MCAP file, one by one and many at once."""

import struct
from collections.abc import Iterator, Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

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


class TickRecords:
    """Records of one message of each of some channels, tick after tick.

    Parameters
    ----------
    lengths : tuple of (int, int)
        Number of each channel, and length of its messages, in the order within a tick.
    """

    def __init__(self, lengths: tuple[tuple[int, int], ...]) -> None:
        self.lengths = lengths
        fields: list[Any] = []
        for channel, length in lengths:
            fields += [(f"head {channel}", HEAD), (f"data {channel}", "u1", (length,))]
        tick = np.dtype(fields)
        self._size = tick.itemsize
        self._offsets = {channel: tick.fields[f"head {channel}"][1] for channel, _ in lengths}
        self._pattern = np.zeros((), tick)
        for channel, length in lengths:
            self._pattern[f"head {channel}"] = (MESSAGE, BEYOND_LENGTH + length, channel, 0, 0, 0)

    def encode(
        self, log_times: NDArray[np.int64], messages: Mapping[int, NDArray[np.uint8]]
    ) -> bytes:
        """Encode the messages (N, length) of each channel with their log times (N,), ns."""
        records = np.full(log_times.size, self._pattern)
        for channel, table in messages.items():
            head = records[f"head {channel}"]
            head["log_time"] = head["publish_time"] = log_times
            records[f"data {channel}"] = table
        return records.tobytes()

    def index(self, log_times: NDArray[np.int64], start: int) -> Iterator[tuple[int, list[int]]]:
        """Log time and place of each message in turn, by channel, if the first is at `start`."""
        entries = np.empty((log_times.size, 2), np.int64)
        entries[:, 0] = log_times
        ticks = start + self._size * np.arange(log_times.size)
        for channel, offset in self._offsets.items():
            entries[:, 1] = ticks + offset
            yield channel, entries.ravel().tolist()
