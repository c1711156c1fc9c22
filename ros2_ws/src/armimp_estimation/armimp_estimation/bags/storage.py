"""Finding and reading the storage files of whatever is given as a bag."""

import re
import tempfile
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, Final

import zstandard

from armimp_common.errors import BagError
from armimp_estimation.bags import metadata
from armimp_estimation.bags.mcap_file import MAGIC
from armimp_estimation.bags.mcap_reading import read_mcap
from armimp_estimation.bags.raw import RawMessages, TopicFilter, one_line
from armimp_estimation.bags.sqlite_reading import read_sqlite

_SQLITE_MAGIC: Final = b"SQLite format 3\0"
_ZSTD_MAGIC: Final = b"\x28\xb5\x2f\xfd"
_ROS1_MAGIC: Final = b"#ROSBAG V"
_SUFFIXES: Final = (".mcap", ".db3", ".mcap.zstd", ".db3.zstd")


def read_storage(path: Path, wanted: TopicFilter) -> RawMessages:
    """Read all wanted messages of a bag into memory, in the order of their log times.

    Parameters
    ----------
    path : Path
        A rosbag2 directory, with or without its ``metadata.yaml``, or one MCAP or SQLite3 file.
        Compressed chunks, files and messages are decompressed.
    wanted : callable
        Tells for a topic name whether its messages are wanted.

    Raises
    ------
    BagError
        If the path is not a readable bag.
    """
    messages = RawMessages()
    custom: dict[str, str] = {}
    try:
        if path.name == metadata.FILE_NAME and path.is_file():
            path = path.parent
        if path.is_dir():
            files, custom = _files_of(path)
        elif path.exists():
            files = [path]
        else:
            raise BagError(f"{path}: does not exist")
        for file in files:
            _read_file(file, wanted, messages)
        _decompress_messages(messages)
        messages.sort()
    except OSError as error:
        raise BagError(f"{error.filename or path}: cannot be read: {error.strerror}") from None
    except (zstandard.ZstdError, OverflowError, MemoryError) as error:
        raise BagError(f"{path}: damaged: {one_line(error)}") from None
    messages.metadata.update(custom)
    return messages


def _files_of(directory: Path) -> tuple[list[Path], dict[str, str]]:
    description = directory / metadata.FILE_NAME
    if description.exists():
        files, custom = metadata.read_metadata(description)
        for file in files:
            if not file.is_file():
                raise BagError(f"{file}: is missing, though listed in {metadata.FILE_NAME}")
        return files, custom
    entries = sorted(directory.iterdir())
    files = [entry for entry in entries if entry.name.endswith(_SUFFIXES) and entry.is_file()]
    if not files:
        raise BagError(f"{directory}: {_why_no_bag(entries)}")
    return sorted(files, key=_natural), {}


def _why_no_bag(entries: Sequence[Path]) -> str:
    if not entries:
        return "is an empty directory"
    bags = [entry for entry in entries if (entry / metadata.FILE_NAME).exists()]
    if bags:
        return f"is not a bag but holds {len(bags)}, {bags[0].name} for one"
    return f"is not a bag: it has no {metadata.FILE_NAME} and no .mcap or .db3 file"


def _natural(path: Path) -> list[tuple[int, str]]:
    # bag_10 comes after bag_9.
    parts = re.split(r"(\d+)", path.name)
    return [(int(part), "") if part.isdecimal() else (0, part) for part in parts]


def _read_file(path: Path, wanted: TopicFilter, into: RawMessages) -> None:
    if not path.is_file():
        raise BagError(f"{path}: is not a regular file")
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(len(_SQLITE_MAGIC))
        file.seek(0)
        if head.startswith(_ZSTD_MAGIC):
            # Of a truncated file this returns what can be had.
            content = zstandard.ZstdDecompressor().stream_reader(file).read()
            _read_decompressed(path, content, wanted, into)
            return
        _read_uncompressed(path, file, size, head, wanted, into)


def _read_decompressed(path: Path, content: bytes, wanted: TopicFilter, into: RawMessages) -> None:
    head = content[: len(_SQLITE_MAGIC)]
    if not head.startswith(_SQLITE_MAGIC):
        _read_uncompressed(path, BytesIO(content), len(content), head, wanted, into)
        return
    with tempfile.TemporaryDirectory() as directory:
        copy = Path(directory) / "bag.db3"
        copy.write_bytes(content)
        read_sqlite(copy, name=str(path), wanted=wanted, into=into)


def _read_uncompressed(
    path: Path, file: BinaryIO, size: int, head: bytes, wanted: TopicFilter, into: RawMessages
) -> None:
    if size == 0:
        raise BagError(f"{path}: is empty")
    if head.startswith(MAGIC):
        read_mcap(file, size, name=str(path), wanted=wanted, into=into)
    elif head == _SQLITE_MAGIC:
        read_sqlite(path, name=str(path), wanted=wanted, into=into)
    elif head.startswith(_ROS1_MAGIC):
        raise BagError(f"{path}: is a ROS 1 bag; convert it with rosbags-convert")
    elif MAGIC.startswith(head) or _SQLITE_MAGIC.startswith(head):
        raise BagError(f"{path}: is cut after {size} bytes, before the first message")
    else:
        raise BagError(f"{path}: is neither an MCAP nor an SQLite3 file")


def _decompress_messages(messages: RawMessages) -> None:
    """Decompress messages that were compressed one by one.

    CDR begins with two bytes that are 0 or 1, so such messages are known by their own first
    bytes, even without the ``metadata.yaml`` that says so.
    """
    if not messages.payloads or not messages.payloads[0].startswith(_ZSTD_MAGIC):
        return
    decompress = zstandard.ZstdDecompressor().decompressobj
    messages.payloads = [
        decompress().decompress(payload) if payload.startswith(_ZSTD_MAGIC) else payload
        for payload in messages.payloads
    ]
