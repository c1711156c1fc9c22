"""Reading of MCAP files from their first record on, complete or cut.

Neither the summary nor the indexes are used: what is wanted is nearly everything, and a file
whose writer was killed has no summary. All records but messages and chunks are parsed by the
mcap package; messages are cut out of their chunk directly.
"""

import struct
import zlib
from collections.abc import Iterator
from io import BytesIO
from itertools import compress
from typing import BinaryIO, Final, cast

import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Metadata, Schema
from numpy.typing import NDArray

from armimp_common.errors import BagError
from armimp_estimation.bags.budget import MESSAGE_COST, NODE_COST, RECORD_COST, Budget
from armimp_estimation.bags.chunk_layout import ChunkLayouts
from armimp_estimation.bags.mcap_file import MAGIC
from armimp_estimation.bags.message_records import MESSAGE_HEAD
from armimp_estimation.bags.metadata import parse_custom_data
from armimp_estimation.bags.raw import RawMessages, TopicFilter, one_line

RECORD_HEAD: Final = struct.Struct("<BQ")
"""Opcode and length, with which every record begins."""

_COMPRESSIONS: Final = ("", "lz4", "zstd")

DAMAGE: Final = (
    struct.error,
    ValueError,
    EOFError,
    RuntimeError,
    OverflowError,
    MemoryError,
    McapError,
    zstandard.ZstdError,
)
"""What parsing can raise on bytes that are not what they claim to be."""


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
    reader = _McapReading(name, wanted, into)
    position = len(file.read(len(MAGIC)))
    while True:
        head = file.read(RECORD_HEAD.size)
        if len(head) < RECORD_HEAD.size:
            into.cut = f"ends at byte {size} without the end of the data"
            return
        opcode, length = RECORD_HEAD.unpack(head)
        end = position + len(head) + length
        if end > size:
            into.cut = f"is cut within the record at byte {position}"
            return
        if opcode in (Opcode.DATA_END, Opcode.FOOTER):
            return
        if opcode in _USED:
            try:
                reader.record(opcode, file.read(length), position)
            except DAMAGE as error:
                raise BagError(
                    f"{name}: damaged record at byte {position}: {one_line(error)}"
                ) from None
        else:
            file.seek(length, 1)
        position = end


_USED: Final = frozenset(
    {Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.CHUNK, Opcode.METADATA}
)


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
        self._layouts = ChunkLayouts()
        # Topics of the messages of a chunk, by the channels of these.
        self._topics: dict[bytes, list[int | None]] = {}
        # Making one takes longer than the decompression of a chunk.
        self._decompressor = zstandard.ZstdDecompressor()

    def record(self, opcode: int, content: bytes, position: int) -> None:
        if opcode == Opcode.MESSAGE:
            self._messages(RECORD_HEAD.pack(opcode, len(content)) + content)
            return
        self._spend(RECORD_COST)
        if opcode == Opcode.CHUNK:
            records = _chunk_records(content, self._into.budget, self._decompressor)
            if (found := self._layouts.split(records)) is None:
                self._messages(records)
            else:
                self._take(*found)
        elif opcode == Opcode.SCHEMA:
            schema = Schema.read(_stream(content))
            self._types[schema.id] = schema.name
        elif opcode == Opcode.CHANNEL:
            self._channel(Channel.read(_stream(content)))
        elif opcode == Opcode.METADATA:
            self._metadata(Metadata.read(_stream(content)))

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
        lengths: list[int] | None = []
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
            if opcode == 5:
                if after > end or length < 22:
                    raise ValueError(f"message of {length} bytes")
                if lengths is not None:
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
                lengths = None
                position = self._other(records, position)
        if lengths and len(lengths) > 1 and position == end:
            self._layouts.learn(lengths)
        while position < end:
            position = self._other(records, position)
        self._spend(MESSAGE_COST * unwanted)
        self._into.extend(topics, log_times, payloads)

    def _other(self, records: bytes, position: int) -> int:
        opcode, length = RECORD_HEAD.unpack_from(records, position)
        self._spend(MESSAGE_COST)
        start = position + RECORD_HEAD.size
        if start + length > len(records):
            raise ValueError(f"record of {length} bytes in a chunk")
        if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            self.record(opcode, records[start : start + length], position)
        return int(start + length)


def chunk_messages(content: bytes, budget: Budget) -> Iterator[tuple[int, int, bytes]]:
    """Channel, log time (ns) and bytes of the messages of a chunk that holds nothing else.

    Raises
    ------
    BagError
        If the chunk is beyond the budget.
    ValueError, or whatever parsing raises; see `DAMAGE`
        If the chunk is damaged.
    """
    records = _chunk_records(content, budget)
    position = 0
    while position < len(records):
        opcode, length, channel, _, log_time, _ = MESSAGE_HEAD.unpack_from(records, position)
        after = position + RECORD_HEAD.size + length
        if opcode != Opcode.MESSAGE or length < 22 or after > len(records):
            raise ValueError(f"record {opcode} of {length} bytes in a chunk")
        yield channel, log_time, records[position + MESSAGE_HEAD.size : after]
        position = after


_CHUNK_HEAD: Final = struct.Struct("<QQQII")
"""Earliest and latest log time, size and checksum, both uncompressed, length of the next text."""
_SIZE: Final = struct.Struct("<Q")


def _chunk_records(
    content: bytes, budget: Budget, decompressor: zstandard.ZstdDecompressor | None = None
) -> bytes:
    _, _, size, checksum, text = _CHUNK_HEAD.unpack_from(content)
    start = _CHUNK_HEAD.size + text
    compression = content[_CHUNK_HEAD.size : start].decode()
    if compression not in _COMPRESSIONS:
        raise ValueError(f"unknown compression {compression!r}")
    (length,) = _SIZE.unpack_from(content, start)
    start += _SIZE.size
    records = content[start : start + length]
    if compression == "zstd":
        records = budget.unzstd(records, size, decompressor)
    elif compression == "lz4":
        records = budget.unlz4(records, size)
    if len(records) != size:
        raise ValueError(f"chunk of {len(records)} bytes instead of {size}")
    if checksum not in (0, zlib.crc32(records)):
        raise ValueError(f"checksum of a chunk is {zlib.crc32(records):#x}, not {checksum:#x}")
    return records


def _stream(content: bytes) -> ReadDataStream:
    return ReadDataStream(BytesIO(content))
