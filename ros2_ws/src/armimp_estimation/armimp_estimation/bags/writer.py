"""Recording of raw messages into a rosbag2 directory with one MCAP file."""

import errno
import shutil
import struct
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

from armimp_common.errors import BagError, ConfigurationError
from armimp_common.topics import DATA_STREAMS, MESSAGE_TYPES
from armimp_estimation.bags.mcap_writer import McapFile
from armimp_estimation.bags.metadata_yaml import (
    absolute,
    bag_information,
    dump,
    message_definition,
    qos_profiles,
    write_metadata,
)

METADATA_RECORD: Final = "armimp"
"""Name of the MCAP metadata record with the metadata, for files that lost their directory."""

_HEAD_BYTES: Final = 64_000
_MESSAGE_BYTES: Final = 200
_JOINT_BYTES: Final = 40


class BagWriter:
    """Writes the messages of the contract into a new bag.

    A process that is killed loses at most the messages since the last chunk: 50 ms of log time
    or 256 messages, whichever is less. What it leaves behind is opened by `read_bag` as it is, and
    made a finished bag by `armimp_estimation.bags.finishing.finish_bag`.

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
    ConfigurationError
        If a metadata value is not a string.
    """

    def __init__(self, path: Path, *, metadata: Mapping[str, str]) -> None:
        for key, value in metadata.items():
            if not isinstance(key, str) or not isinstance(value, str):
                raise ConfigurationError(f"bag metadata {key!r} is not a string: {value!r}")
        self._path = path
        self._custom = dict(metadata)
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        self._closed = False
        self._failed = False
        _make_directory(path)
        with self._one_line():
            self._file = McapFile(path / storage_name(path))
            try:
                self._file.add_metadata(METADATA_RECORD, self._custom)
                # A killed recording keeps this one; it lists all topics, since players make their
                # publishers from the list.
                write_metadata(path, self._information(MESSAGE_TYPES))
            except OSError:
                self._file.abandon()
                raise

    @property
    def path(self) -> Path:
        """Directory of the bag."""
        return self._path

    def write(self, topic: str, raw: bytes, log_time_ns: int) -> None:
        """Append one message of a topic at a time (ns), as `write_block` does."""
        self.write_block((log_time_ns,), {topic: (raw,)})

    def write_block(
        self, log_times: Sequence[int], messages: Mapping[str, Sequence[bytes]]
    ) -> None:
        """Append messages of several topics for each of some times at once.

        Parameters
        ----------
        log_times : sequence of int
            Times of reception (ns), not negative, in rising order.
        messages : mapping of str to sequence of bytes
            A message (CDR with its encapsulation header) for each of them, by topic of the
            contract, in the order in which those of one time are written.

        Raises
        ------
        BagError
            If they cannot be written: disk full, bag closed, unknown topic, bad time.
        """
        with self._one_line():
            channels = {self._channel(topic): raws for topic, raws in messages.items()}
            try:
                self._file.add_block(log_times, channels)
            except struct.error:
                times = f"{log_times[0]} to {log_times[-1]}"
                raise BagError(f"{self._path}: log times are out of range: {times}") from None

    def add_metadata(self, values: Mapping[str, str]) -> None:
        """Add to the metadata what is known only after recording.

        Raises
        ------
        BagError
            If it cannot be written.
        """
        self._custom.update(values)
        with self._one_line():
            self._file.add_metadata(METADATA_RECORD, values)

    def flush(self) -> None:
        """Hand everything written so far to the operating system.

        Call it from a timer where messages may stop while the process lives on.

        Raises
        ------
        BagError
            If that fails.
        """
        with self._one_line():
            self._file.flush()

    def close(self) -> None:
        """Finish the file and replace the provisional ``metadata.yaml``; harmless if repeated.

        Where there is no room for that, the bag stays unfinished, but readable.

        Raises
        ------
        BagError
            If something could not be written, unless `write` or `flush` has said so before.
        """
        if self._closed:
            return
        reported = self._failed
        problem: BagError | None = None
        try:
            with self._one_line():
                self._file.flush()
        except BagError as error:
            problem = error
            self._file.discard()
        try:
            with self._one_line():
                information = self._information(self._channels)
                self._file.add_metadata("rosbag2", {"serialized_metadata": dump(information)})
                self._file.finish()
                write_metadata(self._path, information)
        except BagError as error:
            problem = problem or error
        finally:
            self._closed = True
            self._file.abandon()
        if problem is not None and not reported:
            raise problem

    def __enter__(self) -> "BagWriter":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _channel(self, topic: str) -> int:
        """Channel of a topic, which is written when there is none."""
        if topic in self._channels:
            return self._channels[topic]
        if (kind := MESSAGE_TYPES.get(topic)) is None:
            raise BagError(f"{self._path}: topic is not part of the contract: {topic!r}")
        text, type_hash = message_definition(kind)
        if kind not in self._schemas:
            self._schemas[kind] = self._file.add_schema(kind, text)
        known = {"offered_qos_profiles": dump(qos_profiles(topic)), "topic_type_hash": type_hash}
        channel = self._file.add_channel(absolute(topic), self._schemas[kind], known)
        self._channels[topic] = channel
        return channel

    def _information(self, topics: Iterable[str]) -> dict[str, Any]:
        """Content of ``metadata.yaml`` with some topics."""
        counts = {t: self._file.counts.get(self._channels.get(t, 0), 0) for t in topics}
        return bag_information(
            storage_name(self._path), counts, self._file.time_range, self._custom
        )

    @contextmanager
    def _one_line(self) -> Iterator[None]:
        """Say in one line why something cannot be written."""
        if self._closed:
            raise BagError(f"{self._path}: cannot be written: the bag is closed")
        try:
            yield
        except (OSError, ValueError) as error:
            self._failed = True
            reason = _reason(error) if isinstance(error, OSError) else "the bag is closed"
            raise BagError(f"{self._path}: cannot be written: {reason}") from None


def storage_name(path: Path) -> str:
    """Name of the MCAP file in the directory of a bag."""
    return f"{path.name}_0.mcap"


def _reason(error: OSError) -> str:
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        return "disk full"
    return error.strerror or "unknown reason"


def require_free_space(path: Path, ticks: int, joints: int) -> None:
    """Check that there is room where a bag will be made for the largest one that it can become.

    Parameters
    ----------
    path : Path
        Directory of the bag.
    ticks, joints : int
        Control periods to record, and number of joints.

    Raises
    ------
    BagError
        If there is too little room, or that cannot be found out.
    """
    needed = _HEAD_BYTES + ticks * len(DATA_STREAMS) * (_MESSAGE_BYTES + _JOINT_BYTES * joints)
    place = path.absolute()
    while not place.exists() and place != place.parent:
        place = place.parent
    try:
        free = shutil.disk_usage(place).free
    except OSError as error:
        raise BagError(f"{path}: free space cannot be found out: {error.strerror}") from None
    if free < needed:
        raise BagError(
            f"{path}: {needed / 1e6:.1f} MB of disk space needed, {free / 1e6:.1f} MB free"
        )


def _make_directory(path: Path) -> None:
    try:
        path.mkdir(parents=True)
    except FileExistsError:
        raise BagError(f"{path}: exists already, nothing is overwritten") from None
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise BagError(f"{path}: cannot be made: {reason}") from None
