"""Finishing of bags whose recorder was killed, so that every reader of bags opens them."""

import fcntl
import tempfile
from pathlib import Path

from armimp_common.errors import BagError
from armimp_estimation.atomic_write import open_regular
from armimp_estimation.bags.files import BAGS, read_storage
from armimp_estimation.bags.metadata_yaml import FILE_NAME, absolute, is_provisional, read_metadata
from armimp_estimation.bags.raw import RawMessages
from armimp_estimation.bags.topics import contract_topic
from armimp_estimation.bags.writer import HEAD, BagWriter, storage_name


def finish_bag(path: Path, *, trust: bool = False) -> str:
    """Finish a bag which a killed `BagWriter` left behind; any other is left alone.

    Its messages are written into a new bag, which takes the place of the storage file at once and
    then that of ``metadata.yaml``. A bag that is still being recorded is known by its lock, one
    that is complete by its metadata. A bag behind a link stays as it is, since that may lead
    anywhere. With `trust` the bag may hold any multiple of its size.

    Returns
    -------
    str
        What was done, or why it could not be, in one line; empty if there was nothing to do.
    """
    if path.is_symlink() or path.parent.is_symlink() or not is_provisional(path / FILE_NAME):
        return ""
    unfinished = f"{path}: its recorder did not finish it"
    try:
        files, _ = read_metadata(path / FILE_NAME)
        with open_regular(files[0]) as file:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if files[0].name != storage_name(path) or file.read(len(HEAD)) != HEAD:
                return ""
            messages = read_storage(path, lambda _: True, trust=trust)
            try:
                if not _write_anew(path, messages):
                    return ""
            except (BagError, OSError) as error:
                return f"{unfinished}, and it cannot be finished now: {error}"
    except (BagError, OSError):
        return ""  # It is being recorded, or whoever reads it will say what is wrong.
    return f"{unfinished}: finished now, with {len(messages.payloads)} messages"


def finish_bags(directory: Path) -> list[str]:
    """Finish the bags below ``bags/`` of a result; return a line for each of them."""
    bags = sorted((directory / BAGS).glob("*/" + FILE_NAME))
    return [note for bag in bags if (note := finish_bag(bag.parent, trust=True))]


def _write_anew(path: Path, messages: RawMessages) -> bool:
    """Replace the files of a bag by new ones; return false if another recorder made it."""
    names = [contract_topic(name) or "" for name, _ in messages.topics]
    if [absolute(name) for name in names] != [name for name, _ in messages.topics]:
        return False
    with tempfile.TemporaryDirectory(prefix=".finishing.", dir=path) as work:
        copy = Path(work) / path.name
        with BagWriter(copy, metadata=messages.metadata) as writer:
            for topic, log_time_ns, payload in messages:
                writer.write(names[topic], payload, log_time_ns)
        for name in (storage_name(path), FILE_NAME):
            (copy / name).replace(path / name)
    return True
