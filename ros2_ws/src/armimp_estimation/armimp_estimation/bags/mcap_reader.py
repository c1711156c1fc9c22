"""Reading of MCAP files from their first record on, whether complete or truncated.

Neither the summary nor the indexes are used: nearly all messages are wanted anyway, and a file
whose writer was killed has no summary. The mcap package parses all records except messages, which
are cut directly out of their chunk.
"""

import struct
import zlib
from io import BytesIO
from typing import BinaryIO, Final

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Metadata, Schema

from armimp_estimation.bags.raw import RECORD_COST, RawMessage, RawMessages, one_line

MAGIC: Final = b"\x89MCAP0\r\n"
METADATA_RECORD: Final = "armimp"
"""Name of the record with the metadata, for files that lost their directory."""
MESSAGE_HEAD: Final = struct.Struct("<BQHIQQ")
"""Head of a message record: opcode, length, channel, sequence, log time, publish time."""
BEYOND_LENGTH: Final = 22
"""Bytes of the head that the length counts."""
MESSAGE: Final = int(Opcode.MESSAGE)
_RECORD_HEAD: Final = struct.Struct("<BQ")
"""Head of every record: opcode and length."""
_USED: Final = frozenset(
    {Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.CHUNK, Opcode.METADATA}
)
_DAMAGE: Final = (
    *(struct.error, ValueError, EOFError, RuntimeError, OverflowError, MemoryError),
    *(McapError, zstandard.ZstdError),
)
"""Errors that parsing can raise on damaged bytes."""


def read_mcap(file: BinaryIO, size: int, into: RawMessages) -> None:
    """Read an MCAP file up to its end, or up to the last complete record before a cut.

    Parameters
    ----------
    file : binary file
        File, positioned at its beginning.
    size : int
        Its length in bytes.
    into : RawMessages
        Receives topics, messages, metadata and a note of the cut.

    Raises
    ------
    BagError
        If a record is damaged, a wanted topic is not CDR, or the file holds more than it may.
    """
    reading = _McapReading(into)
    position = len(file.read(len(MAGIC)))
    while len(head := file.read(_RECORD_HEAD.size)) == _RECORD_HEAD.size:
        opcode, length = _RECORD_HEAD.unpack(head)
        end = position + len(head) + length
        if end > size:
            into.cut = f"is cut within the record at byte {position}"
            return
        if opcode in (Opcode.DATA_END, Opcode.FOOTER):
            return
        if opcode in _USED:
            try:
                reading.record(opcode, head, file.read(length))
            except _DAMAGE as error:
                reason = f"damaged record at byte {position}: {one_line(error)}"
                raise into.refusal(reason) from None
        else:
            file.seek(length, 1)
        position = end
    into.cut = f"ends at byte {size} without the end of the data"


class _McapReading:
    """State of the reading of one file."""

    def __init__(self, into: RawMessages) -> None:
        self._into = into
        self._spend = into.spend
        self._types: dict[int, str] = {}
        # Topic index of each channel whose messages are wanted.
        self._channels: dict[int, int] = {}

    def record(self, opcode: int, head: bytes, content: bytes) -> None:
        if opcode == MESSAGE:
            self._messages(head + content)
            return
        self._spend(RECORD_COST)
        stream = ReadDataStream(BytesIO(content))
        if opcode == Opcode.CHUNK:
            self._messages(self._uncompressed(Chunk.read(stream)))
        elif opcode == Opcode.SCHEMA:
            schema = Schema.read(stream)
            self._types[schema.id] = schema.name
        elif opcode == Opcode.CHANNEL:
            self._channel(Channel.read(stream))
        elif opcode == Opcode.METADATA:
            metadata = Metadata.read(stream)
            if metadata.name == METADATA_RECORD:
                self._into.metadata.update(metadata.metadata)

    def _channel(self, channel: Channel) -> None:
        kind = self._types.get(channel.schema_id, "")
        topic = self._into.topic_index(channel.topic, kind, channel.message_encoding)
        if topic is not None:
            self._channels[channel.id] = topic

    def _uncompressed(self, chunk: Chunk) -> bytes:
        """Return the records of a chunk, decompressed and checked."""
        records, size, compression = chunk.data, chunk.uncompressed_size, chunk.compression
        if compression == "zstd":
            records = self._into.unzstd(records, size)
        elif compression == "lz4":
            records = self._into.unlz4(records, size)
        elif compression:
            raise ValueError(f"unknown compression {compression!r}")
        if len(records) != size:
            raise ValueError(f"chunk of {len(records)} bytes instead of {size}")
        found, expected = zlib.crc32(records), chunk.uncompressed_crc
        if expected not in (0, found):
            raise ValueError(f"checksum of a chunk is {found:#x}, not {expected:#x}")
        return records

    def _messages(self, records: bytes) -> None:
        """Walk record by record through a chunk, or through a message outside of chunks."""
        unpack, head_size = MESSAGE_HEAD.unpack_from, MESSAGE_HEAD.size
        topic_of = self._channels.get
        found: list[RawMessage] = []
        unwanted = 0
        position, end = 0, len(records)
        while position < end:
            if records[position] != MESSAGE:
                position = self._other(records, position)
                continue
            _, length, channel, _, log_time, _ = unpack(records, position)
            after = position + _RECORD_HEAD.size + length
            if after > end or length < BEYOND_LENGTH:
                raise ValueError(f"message of {length} bytes")
            topic = topic_of(channel)
            if topic is None:
                unwanted += 1
            else:
                found.append((topic, log_time, records[position + head_size : after]))
            position = after
        self._spend(RECORD_COST * unwanted)
        self._into.extend(found)

    def _other(self, records: bytes, position: int) -> int:
        opcode, length = _RECORD_HEAD.unpack_from(records, position)
        self._spend(RECORD_COST)
        start = position + _RECORD_HEAD.size
        if start + length > len(records):
            raise ValueError(f"record of {length} bytes in a chunk")
        if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            self.record(opcode, records[position:start], records[start : start + length])
        return int(start + length)
