"""Finishing of bags whose recorder was killed, so that every reader of bags opens them."""

import fcntl
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Header, Metadata, Schema

from armimp_common.errors import BagError
from armimp_estimation.atomic_write import open_regular
from armimp_estimation.bags.budget import MESSAGE_COST, RECORD_COST, Budget
from armimp_estimation.bags.mcap_file import LIBRARY, MAGIC, McapFile
from armimp_estimation.bags.mcap_reading import DAMAGE, RECORD_HEAD, chunk_messages
from armimp_estimation.bags.metadata import (
    FILE_NAME,
    BagSummary,
    bag_information,
    dump,
    is_provisional,
    read_metadata,
    write_metadata,
)
from armimp_estimation.bags.topics import contract_topic
from armimp_estimation.bags.writer import why_not_written


def finish_bag(path: Path, *, trust: bool = False) -> str:
    """Finish a bag which a killed `BagWriter` left behind; any other is left alone.

    A finished copy takes the place of the storage file at once, then ``metadata.yaml`` is
    replaced. All complete chunks are kept, byte for byte. A bag that is still being recorded is
    known by its lock, one that is complete by its metadata. A bag behind a link stays as it is,
    since that may lead anywhere.

    Parameters
    ----------
    path : Path
        Directory of the bag, or anything else that may be given as one.
    trust : bool
        Whether the bag may hold any multiple of its size.

    Returns
    -------
    str
        What was done, or why it could not be, in one line; empty if there was nothing to do.
    """
    if path.is_symlink() or path.parent.is_symlink() or not is_provisional(path / FILE_NAME):
        return ""
    try:
        files, custom = read_metadata(path / FILE_NAME)
        with open_regular(files[0]) as file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                return ""
            if _library(file) != LIBRARY:
                return ""
            budget = Budget(str(path), os.fstat(file.fileno()).st_size, trust=trust)
            count = _finish(path, file, files[0].name, custom, budget)
    except OSError as error:
        return (
            f"{path}: its recorder did not finish it, and it cannot be finished now: "
            f"{why_not_written(error)}"
        )
    except (BagError, *DAMAGE):
        return ""  # Whoever reads it will say what is wrong.
    return f"{path}: its recorder did not finish it: finished now, with {count} messages"


def finish_bags(directory: Path) -> list[str]:
    """Finish what a recorder that was killed left in a directory of results.

    Parameters
    ----------
    directory : Path
        The directory above ``bags/``.

    Returns
    -------
    list of str
        As of `finish_bag`, for each bag that needed it.
    """
    bags = sorted((directory / "bags").glob("*/" + FILE_NAME))
    return [note for bag in bags if (note := finish_bag(bag.parent, trust=True))]


def _finish(path: Path, source: BinaryIO, name: str, custom: dict[str, str], budget: Budget) -> int:
    work = Path(tempfile.mkdtemp(prefix=".finishing.", dir=path))
    try:
        copy = McapFile(work / name, library=LIBRARY)
        try:
            topics = _copy(source, copy, budget)
            first_ns, last_ns = copy.time_range
            information = bag_information(
                BagSummary(
                    file_name=name,
                    topics={
                        full: (topic, copy.counts[channel])
                        for full, (topic, channel) in topics.items()
                    },
                    start_ns=first_ns,
                    duration_ns=last_ns - first_ns,
                    custom=custom,
                )
            )
            copy.add_metadata("rosbag2", {"serialized_metadata": dump(information)})
            copy.finish()
        finally:
            copy.abandon()
        (work / name).replace(path / name)
        write_metadata(path, information)
    finally:
        with suppress(OSError):
            shutil.rmtree(work)
    return sum(copy.counts.values())


def _copy(source: BinaryIO, copy: McapFile, budget: Budget) -> dict[str, tuple[str, int]]:
    """Copy all complete records; return topic of the contract and channel of each topic."""
    topics: dict[str, tuple[str, int]] = {}
    for opcode, content in _complete_records(source):
        budget.spend(RECORD_COST)
        stream = ReadDataStream(BytesIO(content))
        if opcode == Opcode.SCHEMA:
            schema = Schema.read(stream)
            copy.add_schema(schema.name, schema.data.decode())
        elif opcode == Opcode.CHANNEL:
            channel = Channel.read(stream)
            topic = contract_topic(channel.topic)
            if topic is None:
                raise ValueError(f"topic is not part of the contract: {channel.topic!r}")
            number = copy.add_channel(channel.topic, channel.schema_id, channel.metadata)
            topics[channel.topic] = (topic, number)
        elif opcode == Opcode.METADATA:
            metadata = Metadata.read(stream)
            if metadata.name != "rosbag2":
                copy.add_metadata(metadata.name, metadata.metadata)
        elif opcode == Opcode.CHUNK:
            for number, log_time_ns, payload in chunk_messages(content, budget):
                budget.spend(MESSAGE_COST)
                copy.append(number, log_time_ns, payload)
            copy.flush()
    return topics


def _complete_records(source: BinaryIO) -> Iterator[tuple[int, bytes]]:
    source.seek(len(MAGIC))
    while len(head := source.read(RECORD_HEAD.size)) == RECORD_HEAD.size:
        opcode, length = RECORD_HEAD.unpack(head)
        if opcode == Opcode.DATA_END or length > os.fstat(source.fileno()).st_size:
            return
        content = source.read(length)
        if len(content) < length:
            return
        yield opcode, content


def _library(source: BinaryIO) -> str:
    for opcode, content in _complete_records(source):
        if opcode == Opcode.HEADER:
            return str(Header.read(ReadDataStream(BytesIO(content))).library)
        break
    return ""
