"""Reading of MCAP files from their first record on, complete or cut.

Neither the summary nor the indexes are used: what is wanted is nearly everything, and a file
whose writer was killed has no summary. All records but messages and chunks are parsed by the
mcap package; messages are cut out of their chunk directly.
"""

import struct
import zlib
from collections.abc import Sequence
from io import BytesIO
from itertools import compress
from typing import BinaryIO, Final, TypeAlias, cast

import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Metadata, Schema
from numpy.typing import NDArray

from armimp_common.errors import BagError
from armimp_estimation.bags.mcap_writer import BEYOND_LENGTH, MAGIC, MESSAGE, MESSAGE_HEAD
from armimp_estimation.bags.metadata_yaml import parse_custom_data
from armimp_estimation.bags.raw import (
    MESSAGE_COST,
    NODE_COST,
    RECORD_COST,
    RawMessages,
    TopicFilter,
    one_line,
)

Messages: TypeAlias = tuple[NDArray[np.uint16], list[int], tuple[bytes, ...]]

_RECORD_HEAD: Final = struct.Struct("<BQ")
"""Opcode and length, with which every record begins."""
_CHUNK_HEAD: Final = struct.Struct("<QQQII")
"""Earliest and latest log time, size and checksum, both uncompressed, length of the next text."""
_SIZE: Final = struct.Struct("<Q")
_HEADS: Final = np.dtype(
    [
        *(("opcode", "u1"), ("length", "<u8"), ("channel", "<u2")),
        *(("sequence", "<u4"), ("log_time", "<u8"), ("publish_time", "<u8")),
    ]
)
"""Heads of messages, as an array."""
_USED: Final = frozenset(
    {Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.CHUNK, Opcode.METADATA}
)
_DAMAGE: Final = (
    *(struct.error, ValueError, EOFError, RuntimeError, OverflowError, MemoryError),
    *(McapError, zstandard.ZstdError),
)
"""What parsing can raise on bytes that are not what they claim to be."""
_MOST_LAYOUTS, _LONGEST_LAYOUT = 10, 10_000
"""Layouts of chunks that are remembered, and messages in each of them: 300 bytes for one."""


def read_mcap(
    file: BinaryIO, size: int, *, name: str, wanted: TopicFilter, into: RawMessages
) -> None:
    """Read an MCAP file up to its end, or up to the last complete record before a cut.

    Parameters
    ----------
    file : binary file
        At its beginning.
    size : int
        Its length in bytes.
    name : str
        The file for error messages.
    wanted : callable
        Tells for a topic name whether its messages are wanted.
    into : RawMessages
        Takes topics, messages, metadata and a note of the cut.

    Raises
    ------
    BagError
        If a record is damaged, a wanted topic is not CDR, or the file holds more than `into` has
        a budget for.
    """
    reading = _McapReading(name, wanted, into)
    position = len(file.read(len(MAGIC)))
    while True:
        head = file.read(_RECORD_HEAD.size)
        if len(head) < _RECORD_HEAD.size:
            into.cut = f"ends at byte {size} without the end of the data"
            return
        opcode, length = _RECORD_HEAD.unpack(head)
        end = position + len(head) + length
        if end > size:
            into.cut = f"is cut within the record at byte {position}"
            return
        if opcode in (Opcode.DATA_END, Opcode.FOOTER):
            return
        if opcode in _USED:
            try:
                reading.record(opcode, file.read(length))
            except _DAMAGE as error:
                raise BagError(
                    f"{name}: damaged record at byte {position}: {one_line(error)}"
                ) from None
        else:
            file.seek(length, 1)
        position = end


class _McapReading:
    """State of the reading of one file."""

    def __init__(self, name: str, wanted: TopicFilter, into: RawMessages) -> None:
        self._name = name
        self._wanted = wanted
        self._into = into
        self._spend = into.budget.spend
        self._types: dict[int, str] = {}
        # Index of the topic of each channel whose messages are wanted.
        self._channels: dict[int, int] = {}
        self._layouts: dict[int, _ChunkLayout] = {}
        """Of the chunks walked through so far, by their size."""
        # Topics of the messages of a chunk, by the channels of these.
        self._topics: dict[bytes, list[int | None]] = {}
        # Making one takes longer than the decompression of a chunk.
        self._decompressor = zstandard.ZstdDecompressor()

    def record(self, opcode: int, content: bytes) -> None:
        if opcode == MESSAGE:
            self._messages(_RECORD_HEAD.pack(opcode, len(content)) + content)
            return
        self._spend(RECORD_COST)
        stream = ReadDataStream(BytesIO(content))
        if opcode == Opcode.CHUNK:
            records = self._uncompressed(content)
            layout = self._layouts.get(len(records))
            found = None if layout is None else layout.split(records)
            if found is None:
                self._messages(records)
            else:
                self._take(*found)
        elif opcode == Opcode.SCHEMA:
            schema = Schema.read(stream)
            self._types[schema.id] = schema.name
        elif opcode == Opcode.CHANNEL:
            self._channel(Channel.read(stream))
        elif opcode == Opcode.METADATA:
            self._metadata(Metadata.read(stream))

    def _channel(self, channel: Channel) -> None:
        topic = self._into.topic_index(channel.topic, self._types.get(channel.schema_id, ""))
        if self._wanted(channel.topic):
            if channel.message_encoding != "cdr":
                raise BagError(
                    f"{self._name}: topic {channel.topic} is encoded as "
                    f"{channel.message_encoding!r}, not as cdr"
                )
            self._channels[channel.id] = topic
            self._topics.clear()

    def _metadata(self, metadata: Metadata) -> None:
        if metadata.name == "rosbag2":
            text = metadata.metadata.get("serialized_metadata", "")
            self._spend(NODE_COST * len(text))
            self._into.metadata = {**parse_custom_data(text), **self._into.metadata}
        elif metadata.name == "armimp":
            self._into.metadata.update(metadata.metadata)

    def _uncompressed(self, content: bytes) -> bytes:
        """Records of a chunk."""
        _, _, size, checksum, text = _CHUNK_HEAD.unpack_from(content)
        start = _CHUNK_HEAD.size + text
        compression = content[_CHUNK_HEAD.size : start].decode()
        (length,) = _SIZE.unpack_from(content, start)
        start += _SIZE.size
        records = content[start : start + length]
        if compression == "zstd":
            records = self._into.budget.unzstd(records, size, self._decompressor)
        elif compression == "lz4":
            records = self._into.budget.unlz4(records, size)
        elif compression:
            raise ValueError(f"unknown compression {compression!r}")
        if len(records) != size:
            raise ValueError(f"chunk of {len(records)} bytes instead of {size}")
        if checksum not in (0, zlib.crc32(records)):
            raise ValueError(f"checksum of a chunk is {zlib.crc32(records):#x}, not {checksum:#x}")
        return records

    def _take(
        self, channels: NDArray[np.uint16], log_times: list[int], payloads: tuple[bytes, ...]
    ) -> None:
        """Take over the messages of a chunk, without those that are not wanted."""
        key = channels.tobytes()
        if (topics := self._topics.get(key)) is None:
            topics = self._topics[key] = [self._channels.get(one) for one in channels.tolist()]
        if None in topics:
            wanted = [topic is not None for topic in topics]
            self._spend(MESSAGE_COST * wanted.count(False))
            self._into.extend(
                [topic for topic in topics if topic is not None],
                compress(log_times, wanted),
                compress(payloads, wanted),
            )
        else:
            self._into.extend(cast(list[int], topics), log_times, payloads)

    def _messages(self, records: bytes) -> None:
        """Walk through a chunk, or what stands outside of chunks, record by record."""
        lengths: list[int] = []
        unpack = MESSAGE_HEAD.unpack_from
        head_size = MESSAGE_HEAD.size
        topic_of = self._channels.get
        topics: list[int] = []
        log_times: list[int] = []
        payloads: list[bytes] = []
        unwanted = 0
        position, end = 0, len(records)
        # A record shorter than the head of a message cannot be one: left for the loop below.
        while position + head_size <= end:
            opcode, length, channel, _, log_time, _ = unpack(records, position)
            after = position + 9 + length
            if opcode == MESSAGE:
                if after > end or length < BEYOND_LENGTH:
                    raise ValueError(f"message of {length} bytes")
                lengths.append(length)
                topic = topic_of(channel)
                if topic is None:
                    unwanted += 1
                else:
                    topics.append(topic)
                    log_times.append(log_time)
                    payloads.append(records[position + head_size : after])
                position = after
            else:
                position = self._other(records, position)
        if 1 < len(lengths) <= _LONGEST_LAYOUT and sum(lengths) + 9 * len(lengths) == end:
            if len(self._layouts) >= _MOST_LAYOUTS:
                self._layouts.clear()
            self._layouts[end] = _ChunkLayout(lengths)
        while position < end:
            position = self._other(records, position)
        self._spend(MESSAGE_COST * unwanted)
        self._into.extend(topics, log_times, payloads)

    def _other(self, records: bytes, position: int) -> int:
        opcode, length = _RECORD_HEAD.unpack_from(records, position)
        self._spend(MESSAGE_COST)
        start = position + _RECORD_HEAD.size
        if start + length > len(records):
            raise ValueError(f"record of {length} bytes in a chunk")
        if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            self.record(opcode, records[start : start + length])
        return int(start + length)


class _ChunkLayout:
    """The places of messages in chunks of nothing else, whose lengths come in the same order.

    A recorder of regular streams writes few kinds of chunks. Walking from record to record, where
    each has to be looked at before the next is found, takes longer than everything else in reading
    a bag; so it is done once for each kind, and what it found is checked at once in all others.
    """

    def __init__(self, lengths: Sequence[int]) -> None:
        self._lengths = np.array(lengths, np.uint64)
        sizes = np.array(lengths, np.int64) + _RECORD_HEAD.size
        starts = np.cumsum(sizes) - sizes
        self._heads = (starts[:, None] + np.arange(MESSAGE_HEAD.size)).ravel()
        self._payloads = struct.Struct(
            "".join(f"{MESSAGE_HEAD.size}x{length - BEYOND_LENGTH}s" for length in lengths)
        ).unpack

    def split(self, records: bytes) -> Messages | None:
        """Channels, log times (ns) and contents of a chunk; None if it has another layout."""
        heads = np.frombuffer(records, np.uint8)[self._heads].view(_HEADS)
        # If each record is of the length that was expected, the next one is where it was expected.
        if not ((heads["opcode"] == MESSAGE) & (heads["length"] == self._lengths)).all():
            return None
        return heads["channel"].copy(), heads["log_time"].tolist(), self._payloads(records)
