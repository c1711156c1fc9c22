"""Writing of an MCAP file in small chunks that reach the operating system in bounded time.

The writer of the mcap package spends about 5 µs on every message and hands on its chunks when
they are full. Here messages are packed directly, and chunks are closed by count and by time as
well, so that a killed process loses little. All other records are those of the mcap package.
"""

from __future__ import annotations

import fcntl
import struct
import zlib
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Final, Protocol

import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
)

MAGIC: Final = b"\x89MCAP0\r\n"

MESSAGE_HEAD: Final = struct.Struct("<BQHIQQ")
"""Head of a message record: opcode, length, channel, sequence, log time, publish time."""
BEYOND_LENGTH: Final = 22
"""Bytes of it that the length counts."""
MESSAGE: Final = int(Opcode.MESSAGE)

FLUSH_INTERVAL_NS: Final = 50_000_000
"""A chunk is closed when it spans this much log time (ns)."""
FLUSH_MESSAGES: Final = 256
"""A chunk is closed at this many messages: 64 ticks of four streams, whatever the log times."""
FLUSH_BYTES: Final = 1 << 18
"""A chunk is closed when its messages take more bytes than this."""

_COMPRESSION: Final = "zstd"
_INDEX_HEAD: Final = struct.Struct("<BQHI")
"""Head of a message index: opcode, length (of which 6 bytes here), channel, bytes of entries."""
_ENTRY: Final = struct.Struct("<QQ")
"""Entry of a message index: log time and offset in the chunk."""
# Level 1: on these streams it compresses as well as level 3 in less than half of the time.
_LEVEL: Final = 1


class _Record(Protocol):
    def write(self, stream: RecordBuilder) -> None: ...


def _encoded(*records: _Record) -> bytes:
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    data: bytes = builder.end()
    return data


HEAD: Final = MAGIC + _encoded(Header(profile="ros2", library="armimp"))
"""First bytes of all files that are written here."""


class McapFile:
    """An MCAP file open for writing.

    The file is locked as long as it is open, by which others can tell that it is being written
    from one whose writer was killed. What cannot be written leaves no trace in the file, so that
    it always ends with a complete record, unless the process dies within a system call.

    Parameters
    ----------
    path : Path
        The file, which must not exist.

    Raises
    ------
    OSError
        From every method, if the file cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self._file = path.open("xb", buffering=0)
        with suppress(OSError):  # Not every file system has locks.
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        self._position = 0
        self._compress = zstandard.ZstdCompressor(level=_LEVEL).compress
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._chunks: list[ChunkIndex] = []
        self._metadata: list[MetadataIndex] = []
        self.counts: dict[int, int] = {}
        """Number of messages of each channel that were flushed."""
        self.time_range = (0, 0)
        """Earliest and latest log time (ns) of these; zeros if there are none."""
        self._chunk = bytearray()
        self._pending = 0
        self._start_ns = self._end_ns = 0
        # Log time and offset of each message of the chunk, by channel, as they are written.
        self._index: defaultdict[int, bytearray] = defaultdict(bytearray)
        try:
            self._write(HEAD)
        except OSError:
            self._file.close()
            raise

    def add_schema(self, name: str, definition: str) -> int:
        """Write the definition of a message type and return its number."""
        schema = Schema(
            id=len(self._schemas) + 1, name=name, encoding="ros2msg", data=definition.encode()
        )
        self._write(_encoded(schema))
        self._schemas.append(schema)
        return schema.id

    def add_channel(self, topic: str, schema: int, metadata: Mapping[str, str]) -> int:
        """Write a channel for CDR messages of a topic and return its number."""
        channel = Channel(
            id=len(self._channels) + 1,
            topic=topic,
            message_encoding="cdr",
            schema_id=schema,
            metadata=dict(metadata),
        )
        self._write(_encoded(channel))
        self._channels.append(channel)
        self.counts[channel.id] = 0
        return channel.id

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write a metadata record."""
        record = _encoded(Metadata(name=name, metadata=dict(values)))
        entry = MetadataIndex(offset=self._position, length=len(record), name=name)
        self._write(record)
        self._metadata.append(entry)

    def add_block(self, log_times: Sequence[int], channels: Mapping[int, Sequence[bytes]]) -> None:
        """Append messages of several channels for each of some times, and flush as is due.

        Parameters
        ----------
        log_times : sequence of int
            Not negative, in rising order (ns).
        channels : mapping of int to sequence of bytes
            As many messages of each channel, in the order in which those of one time are appended.

        Raises
        ------
        struct.error
            If a log time is negative or beyond 64 bits; nothing is appended then.
        """
        head, entry, offset = MESSAGE_HEAD.pack, _ENTRY.pack, len(self._chunk)
        records: list[bytes] = []
        index: list[tuple[int, bytes]] = []
        for number, time_ns in enumerate(log_times):
            for channel, raws in channels.items():
                raw = raws[number]
                records += (
                    head(MESSAGE, BEYOND_LENGTH + len(raw), channel, 0, *[time_ns] * 2),
                    raw,
                )
                index.append((channel, entry(time_ns, offset)))
                offset += MESSAGE_HEAD.size + len(raw)
        first_ns, last_ns = log_times[0], log_times[-1]
        if not self._chunk:
            self._start_ns, self._end_ns = first_ns, last_ns
        self._start_ns, self._end_ns = min(self._start_ns, first_ns), max(self._end_ns, last_ns)
        self._chunk += b"".join(records)
        for channel, place in index:
            self._index[channel] += place
        self._pending += len(index)
        # Another block like this must not lead beyond what may be lost.
        if (
            2 * last_ns - first_ns >= self._start_ns + FLUSH_INTERVAL_NS
            or self._pending + len(index) > FLUSH_MESSAGES
            or len(self._chunk) > FLUSH_BYTES
        ):
            self.flush()

    def flush(self) -> None:
        """Hand everything added so far to the operating system, where a kill cannot reach it.

        What cannot be written is kept for another attempt.
        """
        if not self._pending:
            return
        compressed = self._compress(self._chunk)
        output = bytearray(
            _encoded(
                Chunk(
                    compression=_COMPRESSION,
                    data=compressed,
                    message_start_time=self._start_ns,
                    message_end_time=self._end_ns,
                    uncompressed_crc=zlib.crc32(self._chunk),
                    uncompressed_size=len(self._chunk),
                )
            )
        )
        length = len(output)
        offsets: dict[int, int] = {}
        for channel, entries in sorted(self._index.items()):
            offsets[channel] = self._position + len(output)
            output += _INDEX_HEAD.pack(
                Opcode.MESSAGE_INDEX, 6 + len(entries), channel, len(entries)
            )
            output += entries
        chunk = ChunkIndex(
            chunk_start_offset=self._position,
            chunk_length=length,
            compression=_COMPRESSION,
            compressed_size=len(compressed),
            uncompressed_size=len(self._chunk),
            message_start_time=self._start_ns,
            message_end_time=self._end_ns,
            message_index_offsets=offsets,
            message_index_length=len(output) - length,
        )
        self._write(output)
        self._chunks.append(chunk)
        for channel, entries in self._index.items():
            self.counts[channel] += len(entries) // _ENTRY.size
        first_ns, last_ns = self.time_range
        first_ns = min(first_ns, self._start_ns) if len(self._chunks) > 1 else self._start_ns
        self.time_range = first_ns, max(last_ns, self._end_ns)
        self.discard()

    def discard(self) -> None:
        """Forget the messages that were not flushed yet, for want of room."""
        self._chunk.clear()
        self._pending = 0
        self._index.clear()

    def finish(self) -> None:
        """Write the summary and close the file."""
        try:
            self.flush()
            first_ns, last_ns = self.time_range
            statistics = Statistics(
                attachment_count=0,
                channel_count=len(self._channels),
                channel_message_counts=dict(self.counts),
                chunk_count=len(self._chunks),
                message_count=sum(self.counts.values()),
                message_start_time=first_ns,
                message_end_time=last_ns,
                metadata_count=len(self._metadata),
                schema_count=len(self._schemas),
            )
            end = _encoded(DataEnd(data_section_crc=0))
            summary: Iterable[_Record] = (
                *(*self._schemas, *self._channels, statistics),
                *(*self._chunks, *self._metadata),
            )
            start = self._position + len(end)
            footer = Footer(summary_start=start, summary_offset_start=0, summary_crc=0)
            self._write(end + _encoded(*summary, footer) + MAGIC)
        finally:
            self.abandon()

    def abandon(self) -> None:
        """Close the file as it is, without a summary."""
        self._file.close()

    def _write(self, data: bytes | bytearray) -> None:
        view = memoryview(data)
        start = self._position
        try:
            while view:
                written = self._file.write(view)
                self._position += written
                view = view[written:]
        except OSError:
            # Nothing may follow a record that is cut.
            try:
                self._file.truncate(start)
                self._file.seek(start)
            except OSError:
                self._file.close()
            self._position = start
            raise
