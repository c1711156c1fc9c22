"""Reading of the SQLite3 files of rosbag2, all versions of their schema."""

import sqlite3
import tempfile
from contextlib import closing, suppress
from pathlib import Path
from typing import Final
from urllib.parse import quote

from armimp_common.errors import BagError
from armimp_estimation.atomic_write import open_regular
from armimp_estimation.bags.metadata_yaml import parse_custom_data
from armimp_estimation.bags.raw import (
    NODE_COST,
    RECORD_COST,
    RawMessages,
    one_line,
)

# Of a damaged file even the text of an error need not be UTF-8.
_DAMAGE: Final = (sqlite3.Error, UnicodeDecodeError)

# A row takes some ten steps of the virtual machine of SQLite, and at least as many bytes; a tree
# whose branches are one has rows without end.
_STEPS: Final = 10_000
_FREE_STEPS: Final = 10_000_000
_STEPS_PER_BYTE: Final = 4


def read_sqlite(path: Path, *, name: str, into: RawMessages) -> None:
    """Read an SQLite3 storage file, up to the first damaged page.

    Only plain tables are read: views and generated columns are programs of whoever made the file. A
    file whose writer was killed may have its last messages in a write-ahead log beside it; since
    SQLite wants to write then, a copy of both is opened. A rollback journal is ignored:
    the recorders of ROS 2 leave none, and it may name other files that SQLite deletes.

    Parameters
    ----------
    path : Path
        The file.
    name : str
        The file for error messages.
    into : RawMessages
        Takes topics, messages, metadata and a note of the cut.

    Raises
    ------
    BagError
        If the file is not a readable rosbag2 database, or holds more than it may.
    OSError
        If it cannot be copied.
    """
    log = Path(f"{path}-wal")
    files = {path: path.stat().st_size}
    if log.is_file() and log.stat().st_size:
        files[log] = log.stat().st_size
    rest = _part_of_a_page(path) if len(files) == 1 else 0
    if len(files) == 1 and not rest:
        _read(path, "mode=ro&immutable=1", sum(files.values()), name, into)
        return
    with tempfile.TemporaryDirectory() as directory:
        for file, size in files.items():
            # SQLite would fill the rest of the last page with zeros, and messages with it.
            _copy(file, Path(directory) / file.name, size - rest)
        mode = "mode=ro&immutable=1" if rest else "mode=rw"
        _read(Path(directory) / path.name, mode, sum(files.values()), name, into)


def _copy(source: Path, target: Path, size: int) -> None:
    with open_regular(source) as file, target.open("xb") as copy:
        while size > 0 and (piece := file.read(min(size, 1 << 20))):
            copy.write(piece)
            size -= len(piece)


def _part_of_a_page(path: Path) -> int:
    """Bytes after the last complete page; 0 also for a file that is too short for one."""
    with path.open("rb") as file:
        head = file.read(18)
    page = int.from_bytes(head[16:18], "big")
    page = 65_536 if page == 1 else page
    size = path.stat().st_size
    return size % page if 512 <= page <= size else 0


def _read(path: Path, mode: str, size: int, name: str, into: RawMessages) -> None:
    uri = f"file:{quote(str(path.absolute()))}?{mode}"
    steps = iter(range(0, _FREE_STEPS + _STEPS_PER_BYTE * size, _STEPS))
    try:
        with closing(sqlite3.connect(uri, uri=True)) as database:
            database.set_progress_handler(lambda: next(steps, None) is None, _STEPS)
            for table in ("topics", "messages"):
                if not _is_plain(database, table):
                    raise BagError(f"{name}: not a readable SQLite3 bag: no plain table {table}")
            topics = _topics(database, name, into)
            with suppress(*_DAMAGE):
                if _is_plain(database, "metadata"):  # from version 4 of the schema on
                    _metadata(database, into)
            try:
                _messages(database, topics, into)
            except _DAMAGE as error:
                if next(steps, None) is None:
                    raise
                into.cut = f"is cut or damaged: {one_line(error)}"
    except _DAMAGE as error:
        if next(steps, None) is None:
            raise into.refusal("takes longer than a bag of its size should") from None
        raise BagError(f"{name}: not a readable SQLite3 bag: {one_line(error)}") from None


def _is_plain(database: sqlite3.Connection, table: str) -> bool:
    """Tell whether there is such a table whose columns are stored as they are."""
    query = "SELECT 1 FROM sqlite_master WHERE type = 'table' AND name = ? AND sql LIKE ?"
    if database.execute(query, (table, "CREATE TABLE %")).fetchone() is None:
        return False
    hidden = "SELECT max(hidden) FROM pragma_table_xinfo(?)"
    return bool(database.execute(hidden, (table,)).fetchone() == (0,))


def _topics(database: sqlite3.Connection, name: str, into: RawMessages) -> dict[int, int]:
    topics: dict[int, int] = {}
    query = "SELECT id, name, type, serialization_format FROM topics ORDER BY id"
    for identity, topic, message_type, encoding in database.execute(query):
        into.spend(RECORD_COST)
        index = into.topic_index(str(topic), str(message_type))
        if into.wanted(str(topic)):
            if encoding != "cdr":
                raise BagError(f"{name}: topic {topic} is encoded as {encoding!r}, not as cdr")
            topics[identity] = index
    return topics


def _metadata(database: sqlite3.Connection, into: RawMessages) -> None:
    for (text,) in database.execute("SELECT metadata FROM metadata ORDER BY id"):
        into.spend(RECORD_COST + NODE_COST * len(str(text)))
        into.metadata.update(parse_custom_data(str(text)))


def _messages(database: sqlite3.Connection, topics: dict[int, int], into: RawMessages) -> None:
    marks = ",".join("?" * len(topics))
    # In the order of the rows, so that all rows before a damaged page are found.
    query = f"SELECT topic_id, timestamp, data FROM messages WHERE topic_id IN ({marks})"
    for identity, log_time, data in database.execute(query, list(topics)):
        if not isinstance(log_time, int) or not isinstance(data, bytes):
            raise sqlite3.DatabaseError("a row holds no message")
        into.spend(len(data))
        into.extend([(topics[identity], log_time, data)])
