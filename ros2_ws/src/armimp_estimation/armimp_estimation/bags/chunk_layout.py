"""Where the messages are in chunks whose records have the same lengths in the same order.

A recorder of regular streams writes few kinds of chunks. Walking from record to record, where each
has to be looked at before the next is found, takes longer than everything else in reading a bag; so
it is done once for each kind, and what it found is checked at once in all others.
"""

import struct
from collections.abc import Sequence
from typing import Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from armimp_estimation.bags.message_records import BEYOND_LENGTH, HEAD, MESSAGE, MESSAGE_HEAD

Split: TypeAlias = tuple[NDArray[np.uint16], list[int], tuple[bytes, ...]]

_KINDS: Final = 32
"""Layouts of one size that are remembered; a recording with more has no regular streams."""

_MOST_MESSAGES: Final = 100_000
"""Messages of all layouts that are remembered, each of which takes 300 bytes."""


class ChunkLayout:
    """The layout of a chunk that holds nothing but messages.

    Parameters
    ----------
    lengths : sequence of int
        Length field of each message record, in their order.
    """

    def __init__(self, lengths: Sequence[int]) -> None:
        self._lengths = np.array(lengths, np.uint64)
        sizes = np.array(lengths, np.int64) + (MESSAGE_HEAD.size - BEYOND_LENGTH)
        starts = np.cumsum(sizes) - sizes
        self.size = int(sizes.sum())
        self._heads = (starts[:, None] + np.arange(MESSAGE_HEAD.size)).ravel()
        self._payloads = struct.Struct(
            "".join(f"{MESSAGE_HEAD.size}x{length - BEYOND_LENGTH}s" for length in lengths)
        ).unpack

    def split(self, records: bytes) -> Split | None:
        """Take a chunk of this size apart.

        Returns
        -------
        channels : ndarray, shape (N,)
            Of each message.
        log_times : list of int
            Times of the messages (ns).
        payloads : tuple of bytes
        None
            If the chunk has another layout.
        """
        heads = np.frombuffer(records, np.uint8)[self._heads].view(HEAD)
        # If each record is of the length that was expected, the next one is where it was expected.
        if not ((heads["opcode"] == MESSAGE) & (heads["length"] == self._lengths)).all():
            return None
        return heads["channel"].copy(), heads["log_time"].tolist(), self._payloads(records)


class ChunkLayouts:
    """The layouts that were met so far."""

    def __init__(self) -> None:
        self._by_size: dict[int, list[ChunkLayout]] = {}
        self._left = _MOST_MESSAGES

    def split(self, records: bytes) -> Split | None:
        """Take a chunk apart as `ChunkLayout.split`; None if its layout is not known."""
        for layout in self._by_size.get(len(records), ()):
            if (found := layout.split(records)) is not None:
                return found
        return None

    def learn(self, lengths: Sequence[int]) -> None:
        """Remember the layout of a chunk that was walked through."""
        if len(lengths) > self._left:
            return
        layout = ChunkLayout(lengths)
        kinds = self._by_size.setdefault(layout.size, [])
        if len(kinds) < _KINDS:
            kinds.append(layout)
            self._left -= len(lengths)
