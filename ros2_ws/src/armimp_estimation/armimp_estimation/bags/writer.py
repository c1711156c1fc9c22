"""Recording of raw messages into a rosbag2 directory with one MCAP file.

The writer of the mcap package spends about 5 µs on every message and writes a chunk only when it is
full. Here, messages are packed directly, and chunks are also closed by count and by time, so that a
killed process loses little. The mcap package encodes all other records.
"""

from __future__ import annotations

import fcntl
import shutil
import struct
import tempfile
import zlib
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import cache
from itertools import repeat
from pathlib import Path
from typing import Final

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
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
)

from armimp_common.errors import BagError, DataError
from armimp_common.topics import DATA_STREAMS, RECORDED, TOPICS
from armimp_estimation.atomic_write import open_regular, reason_of
from armimp_estimation.bags.mcap_reader import (
    BEYOND_LENGTH,
    MAGIC,
    MESSAGE,
    MESSAGE_HEAD,
    METADATA_RECORD,
)
from armimp_estimation.bags.metadata_yaml import (
    FILE_NAME,
    dump,
    message_definitions,
    qos_profiles,
    write_metadata,
)
from armimp_estimation.bags.raw import RawMessages, absolute
from armimp_estimation.bags.reader import BAGS, read_storage

FLUSH_INTERVAL_NS: Final = 50_000_000
"""A chunk is closed when it spans this much log time (ns)."""
FLUSH_MESSAGES: Final = 256
"""A chunk is closed at this many messages: 64 ticks of four streams, whatever the log times."""

_HEAD_BYTES: Final = 64_000
_MESSAGE_BYTES: Final = 200
_JOINT_BYTES: Final = 40
"""Bounds on the disk space of a bag: per bag, per message, and per joint of a message, bytes."""
_COMPRESSION: Final = "zstd"
_INDEX_HEAD: Final = struct.Struct("<BQHI")
"""Head of a message index: opcode, length (counting 6 bytes of it), channel, bytes of entries."""
_ENTRY: Final = struct.Struct("<QQ")
"""Entry of a message index: log time and offset in the chunk."""
# On these streams, level 1 compresses as well as level 3 in less than half of the time.
_LEVEL: Final = 1


def _encoded(*records: McapRecord) -> bytes:
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    data: bytes = builder.end()
    return data


HEAD: Final = MAGIC + _encoded(Header(profile="ros2", library="armimp"))
"""First bytes of all files that :class:`BagWriter` writes."""


@cache
def _row(lengths: tuple[int, ...]) -> struct.Struct:
    """Format of consecutive message records with contents of these lengths."""
    head = MESSAGE_HEAD.format[1:]
    return struct.Struct("<" + "".join(f"{head}{length}s" for length in lengths))


@cache
def definitions() -> tuple[list[Schema], dict[str, Channel]]:
    """Schemas, and channels by topic, with which each file begins."""
    schemas: dict[str, Schema] = {}
    channels: dict[str, Channel] = {}
    for number, topic in enumerate(RECORDED, 1):
        kind = TOPICS[topic].type
        definition = message_definitions()[kind]
        data = definition["text"].encode()
        schema = Schema(id=len(schemas) + 1, name=kind, encoding="ros2msg", data=data)
        channels[topic] = Channel(
            id=number,
            topic=absolute(topic),
            message_encoding="cdr",
            schema_id=schemas.setdefault(kind, schema).id,
            metadata={
                "offered_qos_profiles": dump(qos_profiles(topic)),
                "topic_type_hash": definition["hash"],
            },
        )
    return list(schemas.values()), channels


class BagWriter:
    """Writes the messages of an experiment into a new bag.

    A process that is killed loses at most the messages since the last chunk: 50 ms of log time
    or 256 messages, whichever is less. `read_bag` opens the unfinished bag as it is, and
    `finish_bag` finishes it.

    The file is locked as long as it is open, which distinguishes it from one whose writer was
    killed. A failed write is undone, so that the file always ends with a complete record, unless
    the process dies within a system call.

    Parameters
    ----------
    path : Path
        Directory of the bag, which must not exist; parent directories are made.
    metadata : mapping of str to str
        Stored as ``custom_data`` of ``metadata.yaml`` and as MCAP metadata record ``armimp``.

    Raises
    ------
    BagError
        If the path exists or cannot be written.
    """

    def __init__(self, path: Path, *, metadata: Mapping[str, str]) -> None:
        self._path = path
        self._custom: dict[str, str] = {}
        self._schemas, self._channels = definitions()
        self._chunks: list[ChunkIndex] = []
        self._metadata: list[MetadataIndex] = []
        self._counts = {channel.id: 0 for channel in self._channels.values()}
        """Number of flushed messages of each channel."""
        self._chunk = bytearray()
        self._pending = 0
        self._start_ns = self._end_ns = 0
        # Log time and offset of each message of the chunk, by channel, in the form of the file.
        self._index: defaultdict[int, bytearray] = defaultdict(bytearray)
        self._compress = zstandard.ZstdCompressor(level=_LEVEL).compress
        self._position = 0
        self._closed = False
        with self._one_line():
            path.mkdir(parents=True)
            self._file = (path / storage_name(path)).open("xb", buffering=0)
            try:
                with suppress(OSError):  # not every file system has locks
                    fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                self._append(HEAD + _encoded(*self._schemas, *self._channels.values()))
                self.add_metadata(metadata)
            except (BagError, OSError):
                self._file.close()
                raise

    def write(self, topic: str, raw: bytes, log_time_ns: int) -> None:
        """Append one message of a topic with its log time (ns), as `write_block` does."""
        self.write_block((log_time_ns,), {topic: (raw,)})

    def write_block(
        self, log_times: Sequence[int], messages: Mapping[str, Sequence[bytes]]
    ) -> None:
        """Append a block of messages: one of each topic for each log time.

        Parameters
        ----------
        log_times : sequence of int
            Times of reception (ns), not negative, in rising order.
        messages : mapping of str to sequence of bytes
            Messages (CDR with encapsulation header), one for each time, by topic of
            :data:`armimp_common.topics.RECORDED`. Topics are in the order in which messages of one
            time are written; all messages of a topic have one length.

        Raises
        ------
        BagError
            If they cannot be written: disk full, bag closed, unknown topic, bad time.
        """
        with self._one_line():
            lengths = tuple(len(raws[0]) for raws in messages.values())
            channels = [self._channel(topic) for topic in messages]
            row = _row(lengths)
            columns: list[Iterable[int | bytes]] = []
            for channel, raws, length in zip(channels, messages.values(), lengths, strict=True):
                fixed = (MESSAGE, BEYOND_LENGTH + length, channel, 0)
                columns += *map(repeat, fixed), log_times, log_times, raws
            block = b"".join(map(row.pack, *columns))
            # An impossible time has raised by now, while nothing has changed yet.
            begin = len(self._chunk)
            for channel, length in zip(channels, lengths, strict=True):
                begins = range(begin, begin + row.size * len(log_times), row.size)
                self._index[channel] += b"".join(map(_ENTRY.pack, log_times, begins))
                begin += MESSAGE_HEAD.size + length
            first_ns, last_ns = log_times[0], log_times[-1]
            if not self._chunk:
                self._start_ns, self._end_ns = first_ns, last_ns
            self._start_ns, self._end_ns = min(self._start_ns, first_ns), max(self._end_ns, last_ns)
            self._chunk += block
            count = len(log_times) * len(channels)
            self._pending += count
            # With another block like this, a kill must not lose more than the limits allow.
            if (
                2 * last_ns - first_ns >= self._start_ns + FLUSH_INTERVAL_NS
                or self._pending + count > FLUSH_MESSAGES
            ):
                self._flush()

    def add_metadata(self, values: Mapping[str, str]) -> None:
        """Add entries to the metadata, such as those known only after recording.

        Raises
        ------
        BagError
            If it cannot be written.
        """
        with self._one_line():
            record = _encoded(Metadata(name=METADATA_RECORD, metadata=dict(values)))
            entry = MetadataIndex(offset=self._position, length=len(record), name=METADATA_RECORD)
            self._append(record)
            self._metadata.append(entry)
            self._custom.update(values)

    def flush(self) -> None:
        """Hand all messages so far to the operating system, where they survive a kill.

        If that fails, they are kept for another attempt. Call this from a timer if messages may
        stop while the process goes on.

        Raises
        ------
        BagError
            If they cannot be written.
        """
        with self._one_line():
            self._flush()

    def close(self) -> None:
        """Finish the file and write ``metadata.yaml``; further calls do nothing.

        Without disk space for that, the bag remains unfinished, but readable.

        Raises
        ------
        BagError
            If something could not be written.
        """
        if self._closed:
            return
        try:
            with self._one_line():
                self._flush()
                counts = {
                    topic: self._counts[channel.id] for topic, channel in self._channels.items()
                }
                self._append_summary()
                # Last, since a bag with metadata.yaml counts as finished.
                name = storage_name(self._path)
                write_metadata(self._path, name, counts, self._time_range, self._custom)
        finally:
            self._closed = True
            self._file.close()

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _channel(self, topic: str) -> int:
        if (channel := self._channels.get(topic)) is None:
            raise BagError(f"{self._path}: topic is not recorded: {topic!r}")
        return channel.id

    def _flush(self) -> None:
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
        self._append(output)
        self._chunks.append(chunk)
        for channel, entries in self._index.items():
            self._counts[channel] += len(entries) // _ENTRY.size
        self._chunk.clear()
        self._pending = 0
        self._index.clear()

    @property
    def _time_range(self) -> tuple[int, int]:
        """Earliest and latest log time of flushed messages (ns); zeros if there are none."""
        return (
            min((chunk.message_start_time for chunk in self._chunks), default=0),
            max((chunk.message_end_time for chunk in self._chunks), default=0),
        )

    def _append_summary(self) -> None:
        first_ns, last_ns = self._time_range
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
        summary: Iterable[McapRecord] = (
            *(*self._schemas, *self._channels.values(), statistics),
            *(*self._chunks, *self._metadata),
        )
        start = self._position + len(end)
        footer = Footer(summary_start=start, summary_offset_start=0, summary_crc=0)
        self._append(end + _encoded(*summary, footer) + MAGIC)

    def _append(self, data: bytes | bytearray) -> None:
        view = memoryview(data)
        start = self._position
        try:
            while view:
                written = self._file.write(view)
                self._position += written
                view = view[written:]
        except OSError:
            # Nothing may follow an incomplete record.
            try:
                self._file.truncate(start)
                self._file.seek(start)
            except OSError:
                self._file.close()
            self._position = start
            raise

    @contextmanager
    def _one_line(self) -> Iterator[None]:
        """Turn errors of writing into BagErrors of one line."""
        reason: object = "the bag is closed"
        try:
            if not self._closed:
                yield
                return
        except FileExistsError:
            raise BagError(f"{self._path}: exists already, nothing is overwritten") from None
        except DataError as error:
            raise BagError(str(error)) from None
        except OSError as error:
            reason = reason_of(error)
        except (ValueError, struct.error) as error:
            reason = error
        raise BagError(f"{self._path}: cannot be written: {reason}")


def storage_name(path: Path) -> str:
    """Name of the MCAP file in the directory of a bag."""
    return f"{path.name}_0.mcap"


def require_free_space(path: Path, ticks: int, joints: int) -> None:
    """Check that there is disk space for the largest bag that a recording can become.

    Parameters
    ----------
    path : Path
        Directory of the bag, which need not exist.
    ticks, joints : int
        Control periods to record, and number of joints.

    Raises
    ------
    BagError
        If there is too little space, or the free space cannot be determined.
    """
    needed = _HEAD_BYTES + ticks * len(DATA_STREAMS) * (_MESSAGE_BYTES + _JOINT_BYTES * joints)
    whole = path.absolute()
    try:
        free = shutil.disk_usage(next(one for one in (whole, *whole.parents) if one.exists())).free
    except OSError as error:
        raise BagError(f"{path}: free space cannot be determined: {error.strerror}") from None
    if free < needed:
        raise BagError(
            f"{path}: {needed / 1e6:.1f} MB of disk space needed, {free / 1e6:.1f} MB free"
        )


def finish_bag(path: Path) -> str:
    """Finish a bag that a killed `BagWriter` left behind; any other is left alone.

    Its messages are written into a new bag, whose storage file replaces the old one atomically,
    before ``metadata.yaml`` is added. A bag that is still being recorded is recognised by its lock,
    a complete one by its metadata. A bag behind a link stays as it is, since the link may lead
    anywhere. Returns one line that says what was done or why it failed; empty if it was left alone.
    """
    if path.is_symlink() or path.parent.is_symlink() or (path / FILE_NAME).exists():
        return ""
    unfinished = f"{path}: its recorder did not finish it"
    try:
        with open_regular(path / storage_name(path)) as file:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if file.read(len(HEAD)) != HEAD:
                return ""
            messages = read_storage(path)
            try:
                _write_anew(path, messages)
            except (BagError, OSError) as error:
                return f"{unfinished}, and it cannot be finished now: {error}"
    except (BagError, OSError):
        return ""  # it is being recorded, or reading it will report what is wrong
    return f"{unfinished}: finished now, with {len(messages.messages)} messages"


def finish_bags(directory: Path) -> list[str]:
    """Finish the bags below ``bags/`` of a result; return a line for each unfinished one."""
    return [note for bag in sorted((directory / BAGS).glob("*")) if (note := finish_bag(bag))]


def _write_anew(path: Path, messages: RawMessages) -> None:
    """Replace the storage file of a bag by a finished one with the same messages."""
    names = {absolute(topic): topic for topic in RECORDED}
    recorded = [names.get(name, name) for name, _ in messages.topics]
    with tempfile.TemporaryDirectory(prefix=".finishing.", dir=path) as work:
        copy = Path(work) / path.name
        with BagWriter(copy, metadata=messages.metadata) as writer:
            for index, log_time_ns, payload in messages.messages:
                writer.write(recorded[index], payload, log_time_ns)
        for file in (storage_name(path), FILE_NAME):
            (copy / file).replace(path / file)
