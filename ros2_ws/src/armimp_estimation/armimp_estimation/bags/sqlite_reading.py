"""Reading of the SQLite3 files of rosbag2, all versions of their schema."""

import shutil
import sqlite3
import tempfile
from contextlib import closing
from pathlib import Path
from typing import Final
from urllib.parse import quote

from armimp_common.errors import BagError
from armimp_estimation.bags.metadata import parse_custom_data
from armimp_estimation.bags.raw import RawMessages, TopicFilter, one_line

_SIDECARS: Final = ("-wal", "-journal")

# Of a damaged file even the text of an error need not be UTF-8.
_DAMAGE: Final = (sqlite3.Error, UnicodeDecodeError)


def read_sqlite(path: Path, *, name: str, wanted: TopicFilter, into: RawMessages) -> None:
    """Read an SQLite3 storage file, up to the first damaged page.

    A file whose writer was killed has its last messages in a log beside it, and SQLite wants to
    write when it opens such a file; a copy is opened then.

    Parameters
    ----------
    path : Path
        The file.
    name : str
        The file for error messages.
    wanted : callable
        Tells for a topic name whether its messages are wanted.
    into : RawMessages
        Takes topics, messages, metadata and a note of the cut.

    Raises
    ------
    BagError
        If the file is not a readable rosbag2 database.
    """
    logs = [log for log in (Path(f"{path}{end}") for end in _SIDECARS) if log.exists()]
    if not any(log.stat().st_size for log in logs):
        if rest := _part_of_a_page(path):
            # SQLite would fill the rest of the page with zeros, and messages with it.
            with tempfile.TemporaryDirectory() as directory:
                copy = Path(directory) / path.name
                copy.write_bytes(path.read_bytes()[:-rest])
                read_sqlite(copy, name=name, wanted=wanted, into=into)
            return
        uri = f"file:{quote(str(path.absolute()))}?mode=ro&immutable=1"
        _read(uri, name=name, wanted=wanted, into=into)
        return
    with tempfile.TemporaryDirectory() as directory:
        for file in (path, *logs):
            shutil.copy(file, directory)
        copy = Path(directory) / path.name
        _read(f"file:{quote(str(copy))}?mode=rw", name=name, wanted=wanted, into=into)


def _part_of_a_page(path: Path) -> int:
    """Bytes after the last whole page; 0 for a file that is whole, or too short to be one."""
    with path.open("rb") as file:
        head = file.read(18)
    page = int.from_bytes(head[16:18], "big")
    page = 65_536 if page == 1 else page
    size = path.stat().st_size
    return size % page if 512 <= page <= size else 0


def _read(uri: str, *, name: str, wanted: TopicFilter, into: RawMessages) -> None:
    try:
        with closing(sqlite3.connect(uri, uri=True)) as database:
            topics = _topics(database, name, wanted, into)
            _metadata(database, into)
            try:
                _messages(database, topics, into)
            except _DAMAGE as error:
                into.cut = f"is cut or damaged: {one_line(error)}"
    except _DAMAGE as error:
        raise BagError(f"{name}: not a readable SQLite3 bag: {one_line(error)}") from None


def _topics(
    database: sqlite3.Connection, name: str, wanted: TopicFilter, into: RawMessages
) -> dict[int, int]:
    topics: dict[int, int] = {}
    query = "SELECT id, name, type, serialization_format FROM topics ORDER BY id"
    for identity, topic, message_type, encoding in database.execute(query):
        index = into.topic_index(str(topic), str(message_type))
        if wanted(str(topic)):
            if encoding != "cdr":
                raise BagError(f"{name}: topic {topic} is encoded as {encoding!r}, not as cdr")
            topics[identity] = index
    return topics


def _metadata(database: sqlite3.Connection, into: RawMessages) -> None:
    try:
        rows = database.execute("SELECT metadata FROM metadata ORDER BY id").fetchall()
    except _DAMAGE:
        return  # before version 4 of the schema there was no such table
    for (text,) in rows:
        into.metadata.update(parse_custom_data(str(text)))


def _messages(database: sqlite3.Connection, topics: dict[int, int], into: RawMessages) -> None:
    marks = ",".join("?" * len(topics))
    # In the order of the rows, so that all rows before a damaged page are found.
    query = f"SELECT topic_id, timestamp, data FROM messages WHERE topic_id IN ({marks})"
    for identity, log_time, data in database.execute(query, list(topics)):
        if not isinstance(log_time, int) or not isinstance(data, bytes):
            raise sqlite3.DatabaseError("a row holds no message")
        into.topic_indices.append(topics[identity])
        into.log_times.append(log_time)
        into.payloads.append(data)
