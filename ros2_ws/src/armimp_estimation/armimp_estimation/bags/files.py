"""Finding and reading the storage files of whatever is given as a bag."""

import os
import re
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import BinaryIO, Final

import zstandard

from armimp_common.errors import BagError
from armimp_estimation.atomic_write import open_regular, require_text
from armimp_estimation.bags import metadata_yaml
from armimp_estimation.bags.mcap_reader import MAGIC, read_mcap
from armimp_estimation.bags.raw import RawMessages, TopicFilter, one_line
from armimp_estimation.bags.sqlite_reader import read_sqlite

BAGS: Final = "bags"
"""Where the directory of a run has its bags."""
_SQLITE_MAGIC: Final = b"SQLite format 3\0"
_ZSTD_MAGIC: Final = b"\x28\xb5\x2f\xfd"
_ROS1_MAGIC: Final = b"#ROSBAG V"
_SUFFIXES: Final = (".mcap", ".db3", ".mcap.zstd", ".db3.zstd")


def read_storage(path: Path, wanted: TopicFilter, *, trust: bool = False) -> RawMessages:
    """Read all wanted messages of a bag into memory, in the order of their log times.

    Parameters
    ----------
    path : Path
        A rosbag2 directory, with or without its ``metadata.yaml``, or one MCAP or SQLite3 file.
        Compressed chunks, files and messages are decompressed.
    wanted : callable
        Tells for a topic name whether its messages are wanted.
    trust : bool
        Whether the bag may hold any multiple of its size.

    Raises
    ------
    BagError
        If the path is not a readable bag, or beyond the limits.
    """
    custom: dict[str, str] = {}
    try:
        require_text(path)
        if path.name == metadata_yaml.FILE_NAME and path.is_file():
            path = path.parent
        if path.is_dir():
            files, custom = _files_of(path)
        elif path.exists():
            files = [path]
        else:
            raise BagError(f"{path}: does not exist")
        messages = RawMessages(str(path), _size_of(files), wanted, trust=trust)
        for file in files:
            _read_file(file, messages)
        _decompress_messages(messages)
        messages.sort()
    except OSError as error:
        prefix = "cannot be read: " if error.errno else ""  # else the reason is ours
        raise BagError(f"{error.filename or path}: {prefix}{error.strerror}") from None
    except (zstandard.ZstdError, OverflowError, MemoryError) as error:
        raise BagError(f"{path}: damaged: {one_line(error)}") from None
    messages.metadata.update(custom)
    return messages


def _files_of(directory: Path) -> tuple[list[Path], dict[str, str]]:
    description = directory / metadata_yaml.FILE_NAME
    if description.exists():
        files, custom = metadata_yaml.read_metadata(description)
        for file in files:
            if not file.is_file():
                raise BagError(f"{file}: is missing, though listed in {metadata_yaml.FILE_NAME}")
        return files, custom
    entries = sorted(directory.iterdir())
    files = [entry for entry in entries if entry.name.endswith(_SUFFIXES) and entry.is_file()]
    if not files:
        raise BagError(f"{directory}: {_why_no_bag(entries)}")
    return sorted(files, key=_natural), {}


def find_bags(paths: Sequence[Path]) -> list[Path]:
    """Bags behind paths: those of the directory of a run, or of a folder of bags, in their order.

    Whatever is neither stays as it is, for the reader to judge.
    """
    found: list[Path] = []
    for path in paths:
        folder = path / BAGS if (path / BAGS).is_dir() else path
        found += sorted(_bags_in(folder), key=_natural) or [path]
    return found


def require_distinct(bags: Sequence[Path]) -> None:
    """Refuse bags that are one and the same, by another path, link or name of their files.

    Raises
    ------
    BagError
        If there are such ones.
    """
    found: dict[tuple[int, int], Path] = {}
    for bag in bags:
        try:
            for file in bag.iterdir() if bag.is_dir() else (bag,):
                if file == bag or file.name.endswith(_SUFFIXES):
                    status = file.stat()
                    other = found.setdefault((status.st_dev, status.st_ino), bag)
                    if other is not bag:
                        raise BagError(f"{bag}: is the same bag as {other}")
        except OSError:  # as the reader will say
            continue


def _bags_in(folder: Path) -> list[Path]:
    try:
        entries = list(folder.iterdir())
        if _holds_bag(folder):
            return []  # it is one itself
        return [one for one in entries if one.is_dir() and _holds_bag(one)]
    except OSError:  # no directory, or one that cannot be read, as the reader will say
        return []


def _holds_bag(folder: Path) -> bool:
    return any(
        one.name.endswith(_SUFFIXES) or one.name == metadata_yaml.FILE_NAME
        for one in folder.iterdir()
    )


def _why_no_bag(entries: Sequence[Path]) -> str:
    if not entries:
        return "is an empty directory"
    bags = [entry for entry in entries if (entry / metadata_yaml.FILE_NAME).exists()]
    if bags:
        return f"is not a bag but holds {len(bags)}, {bags[0].name} for one"
    return f"is not a bag: it has no {metadata_yaml.FILE_NAME} and no .mcap or .db3 file"


def _natural(path: Path) -> list[tuple[int, str]]:
    # bag_10 comes after bag_9.
    parts = re.split(r"(\d+)", path.name)
    return [(int(part), "") if part.isdecimal() else (0, part) for part in parts]


def _size_of(files: Sequence[Path]) -> int:
    """Bytes of all files, each of which must be another one."""
    found: dict[tuple[int, int], Path] = {}
    size = 0
    for file in files:
        status = file.stat()
        if (other := found.setdefault((status.st_dev, status.st_ino), file)) != file:
            raise BagError(f"{file}: is the same file as {other.name}")
        size += status.st_size
    return size


def _read_file(path: Path, into: RawMessages) -> None:
    with open_regular(path) as file:
        if file.read(len(_ZSTD_MAGIC)) != _ZSTD_MAGIC:
            file.seek(0)
            _read_uncompressed(path, file, str(path), into)
            return
        file.seek(0)
        with tempfile.TemporaryDirectory() as directory:
            copy = Path(directory) / "bag"
            into.copy_unzstd(file, copy)
            with copy.open("rb") as content:
                _read_uncompressed(copy, content, str(path), into)


def _read_uncompressed(path: Path, file: BinaryIO, name: str, into: RawMessages) -> None:
    size = os.fstat(file.fileno()).st_size
    head = file.read(len(_SQLITE_MAGIC))
    file.seek(0)
    if size == 0:
        raise BagError(f"{name}: is empty")
    if head.startswith(MAGIC):
        read_mcap(file, size, name=name, into=into)
    elif head == _SQLITE_MAGIC:
        read_sqlite(path, name=name, into=into)
    elif head.startswith(_ROS1_MAGIC):
        raise BagError(f"{name}: is a ROS 1 bag; convert it with rosbags-convert")
    elif MAGIC.startswith(head) or _SQLITE_MAGIC.startswith(head):
        raise BagError(f"{name}: is cut after {size} bytes, before the first message")
    else:
        raise BagError(f"{name}: is neither an MCAP nor an SQLite3 file")


def _decompress_messages(messages: RawMessages) -> None:
    """Decompress messages that were compressed one by one.

    CDR begins with two bytes that are 0 or 1, so such messages are known by their own first
    bytes, even without the ``metadata.yaml`` that says so.
    """
    if not messages.payloads or not messages.payloads[0].startswith(_ZSTD_MAGIC):
        return
    messages.payloads = [
        messages.unzstd(payload) if payload.startswith(_ZSTD_MAGIC) else payload
        for payload in messages.payloads
    ]
