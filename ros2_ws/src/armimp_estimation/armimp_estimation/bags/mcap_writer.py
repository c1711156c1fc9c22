"""Writing of an MCAP file in small chunks that reach the operating system in bounded time.

The writer of the mcap package spends about 5 µs on every message and hands on its chunks when
they are full. Here messages are packed directly, and chunks are closed by count and by time as
well, so that a killed process loses little. All other records are those of the mcap package.
"""

from __future__ import annotations

import fcntl
import struct
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import lru_cache
from itertools import repeat
from pathlib import Path
from typing import Any, Final, Protocol

import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
)

from armimp_common.errors import BagError

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

_COMPRESSION: Final = b"zstd"
_CHUNK_HEAD: Final = struct.Struct(f"<BQQQQII{len(_COMPRESSION)}sQ")
"""Head of a chunk record: opcode, length, first and last time, size and checksum of what it holds
without compression; compression, and size with it."""
_INDEX_HEAD: Final = struct.Struct("<BQHI")
"""Head of a message index: opcode, length (of which 6 bytes here), channel, bytes of entries."""
_ENTRY_BYTES: Final = 16
"""Of an entry of a message index: log time and offset in the chunk, 64 bits each."""
_SAME: Final = 15
"""Bytes of the head before the times, which all messages of a stream share."""

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
        self._compress: Callable[[bytearray], bytes] = zstandard.ZstdCompressor(
            level=_LEVEL
        ).compress
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._chunks: list[ChunkIndex] = []
        self._metadata: list[MetadataIndex] = []
        self._counts: dict[int, int] = {}
        self._first_ns: int | None = None
        self._last_ns = 0
        self._chunk = bytearray()
        self._pending = 0
        self._deadline_ns = 0
        self._start_ns = self._end_ns = 0
        # Log time and offset of each message of the chunk, by channel, as they are written.
        self._index: dict[int, bytearray] = {}
        try:
            self._write(HEAD)
        except OSError:
            self._file.close()
            raise

    @property
    def counts(self) -> Mapping[int, int]:
        """Number of messages of each channel."""
        return self._counts

    @property
    def time_range(self) -> tuple[int, int]:
        """Earliest and latest log time (ns) of what was flushed; zeros if nothing was."""
        return self._first_ns or 0, self._last_ns

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
        self._counts[channel.id] = 0
        self._index[channel.id] = bytearray()
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
            As many messages of each channel, in the order in which those of one time are appended;
            those of a channel are of equal length.

        Raises
        ------
        BagError
            If they are not; nothing is appended then.
        struct.error
            If a log time is negative or beyond 64 bits; nothing is appended then either.
        """
        ticks = _ticks_of(*((channel, len(raws[0])) for channel, raws in channels.items()))
        records = ticks.encode(log_times, channels)
        start = len(self._chunk)
        first_ns, last_ns = log_times[0], log_times[-1]
        self._span(first_ns, last_ns)
        self._chunk += records
        for channel, entries in ticks.index(log_times, start):
            self._index[channel] += entries
        added = len(channels) * len(log_times)
        self._pending += added
        # Another block like this must not lead beyond what may be lost.
        if (
            2 * last_ns - first_ns >= self._deadline_ns
            or self._pending + added > FLUSH_MESSAGES
            or len(self._chunk) > FLUSH_BYTES
        ):
            self.flush()

    def _span(self, first_ns: int, last_ns: int) -> None:
        """Take account of the log times of messages that are about to be appended."""
        if not self._chunk:
            self._deadline_ns = first_ns + FLUSH_INTERVAL_NS
            self._start_ns, self._end_ns = first_ns, last_ns
        else:
            self._start_ns = min(self._start_ns, first_ns)
            self._end_ns = max(self._end_ns, last_ns)

    def flush(self) -> None:
        """Hand everything added so far to the operating system, where a kill cannot reach it.

        What cannot be written is kept for another attempt.
        """
        if not self._pending:
            return
        compressed = self._compress(self._chunk)
        output = bytearray(
            _CHUNK_HEAD.pack(
                Opcode.CHUNK,
                _CHUNK_HEAD.size - 9 + len(compressed),
                self._start_ns,
                self._end_ns,
                len(self._chunk),
                zlib.crc32(self._chunk),
                len(_COMPRESSION),
                _COMPRESSION,
                len(compressed),
            )
        )
        output += compressed
        length = len(output)
        offsets: dict[int, int] = {}
        for channel, entries in self._index.items():
            if entries:
                offsets[channel] = self._position + len(output)
                output += _INDEX_HEAD.pack(
                    Opcode.MESSAGE_INDEX, 6 + len(entries), channel, len(entries)
                )
                output += entries
        chunk = ChunkIndex(
            chunk_start_offset=self._position,
            chunk_length=length,
            compression=_COMPRESSION.decode(),
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
            self._counts[channel] += len(entries) // _ENTRY_BYTES
        first_ns = self._start_ns if self._first_ns is None else self._first_ns
        self._first_ns = min(first_ns, self._start_ns)
        self._last_ns = max(self._last_ns, self._end_ns)
        self.discard()

    def discard(self) -> None:
        """Forget the messages that were not flushed yet, for want of room."""
        self._chunk.clear()
        self._pending = 0
        for entries in self._index.values():
            entries.clear()

    def finish(self) -> None:
        """Write the summary and close the file."""
        try:
            self.flush()
            first_ns, last_ns = self.time_range
            statistics = Statistics(
                attachment_count=0,
                channel_count=len(self._channels),
                channel_message_counts=dict(self._counts),
                chunk_count=len(self._chunks),
                message_count=sum(self._counts.values()),
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


@lru_cache(maxsize=64)
def _ticks_of(*lengths: tuple[int, int]) -> _TickRecords:
    return _TickRecords(lengths)


class _TickRecords:
    """Message records of some channels, one of each, tick after tick.

    `lengths` has the number of each channel and the length of its messages, in the order within a
    tick.
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
        """Encode as many messages of each channel as there are log times (ns)."""
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
