"""Reading of the SQLite3 files of rosbag2, with all versions of its schema."""

import os
import shutil
import sqlite3
import tempfile
from contextlib import closing
from pathlib import Path
from typing import BinaryIO, Final

from armimp_estimation.atomic_write import open_regular
from armimp_estimation.bags.raw import RECORD_COST, RawMessages, one_line

# With a damaged file, not even the text of an error need be UTF-8.
_DAMAGE: Final = (sqlite3.Error, UnicodeDecodeError)

# A row takes some ten steps of SQLite's virtual machine, and at least as many bytes. In a damaged
# tree, a branch may lead back to itself, so that rows never end.
_STEPS: Final = 10_000
_FREE_STEPS: Final = 10_000_000
_STEPS_PER_BYTE: Final = 4


def read_sqlite(file: BinaryIO, log: Path, into: RawMessages) -> None:
    """Read an SQLite3 storage file, up to the first damaged page.

    Only plain tables are read, as views and generated columns are programs from an unknown author.
    SQLite opens a copy, since it writes to a file whose killed writer left its last messages in a
    write-ahead log. A rollback journal is ignored: the recorders of ROS 2 leave none, and it may
    name other files, which SQLite would delete.

    Parameters
    ----------
    file : binary file
        File, positioned at its beginning.
    log : Path
        Path of its write-ahead log, which need not exist.
    into : RawMessages
        Receives topics, messages and a note of the cut.

    Raises
    ------
    BagError
        If the file is not a readable rosbag2 database, or holds more than it may.
    OSError
        If it cannot be copied.
    """
    with tempfile.TemporaryDirectory() as directory:
        path = Path(directory) / "bag.db3"
        with path.open("xb") as copy:
            shutil.copyfileobj(file, copy)
        if log.is_file():
            with open_regular(log) as source, Path(f"{path}-wal").open("xb") as copy:
                into.spend(os.fstat(source.fileno()).st_size)
                shutil.copyfileobj(source, copy)
        _read(path, into)


def _read(path: Path, into: RawMessages) -> None:
    steps = iter(range(0, _FREE_STEPS + _STEPS_PER_BYTE * path.stat().st_size, _STEPS))
    try:
        with closing(sqlite3.connect(path)) as database:
            database.set_progress_handler(lambda: next(steps, None) is None, _STEPS)
            for table in ("topics", "messages"):
                if not _is_plain(database, table):
                    raise into.refusal(f"not a readable SQLite3 bag: no plain table {table}")
            topics = _topics(database, into)
            try:
                _messages(database, topics, into)
            except _DAMAGE as error:
                into.cut = f"is cut or damaged: {one_line(error)}"
    except _DAMAGE as error:
        raise into.refusal(f"not a readable SQLite3 bag: {one_line(error)}") from None


def _is_plain(database: sqlite3.Connection, table: str) -> bool:
    """Tell whether a table of this name exists and has stored columns only."""
    query = "SELECT 1 FROM sqlite_master WHERE type = 'table' AND name = ? AND sql LIKE ?"
    if database.execute(query, (table, "CREATE TABLE %")).fetchone() is None:
        return False
    hidden = "SELECT max(hidden) FROM pragma_table_xinfo(?)"
    return bool(database.execute(hidden, (table,)).fetchone() == (0,))


def _topics(database: sqlite3.Connection, into: RawMessages) -> dict[int, int]:
    topics: dict[int, int] = {}
    query = "SELECT id, name, type, serialization_format FROM topics ORDER BY id"
    for identity, topic, message_type, encoding in database.execute(query):
        into.spend(RECORD_COST)
        if (index := into.topic_index(str(topic), str(message_type), encoding)) is not None:
            topics[identity] = index
    return topics


def _messages(database: sqlite3.Connection, topics: dict[int, int], into: RawMessages) -> None:
    marks = ",".join("?" * len(topics))
    # Unsorted, so that all rows before a damaged page are found.
    query = f"SELECT topic_id, timestamp, data FROM messages WHERE topic_id IN ({marks})"
    for identity, log_time, data in database.execute(query, list(topics)):
        if not isinstance(log_time, int) or not isinstance(data, bytes):
            raise sqlite3.DatabaseError("a row holds no message")
        into.spend(len(data))
        into.extend([(topics[identity], log_time, data)])
