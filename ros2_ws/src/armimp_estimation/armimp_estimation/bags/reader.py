"""Reading of bags, recorded here or elsewhere, from their files to trials and messages."""

import os
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from operator import itemgetter
from pathlib import Path
from typing import BinaryIO, Final

import zstandard
from pydantic import TypeAdapter, ValidationError

from armimp_common import topics
from armimp_common.cdr import decode_trial_statuses, joint_names_of
from armimp_common.errors import BagError, ConfigurationError, DataError, MalformedMessageError
from armimp_estimation.alignment.assemble import Trial, assemble_trials
from armimp_estimation.alignment.streams import decode_streams
from armimp_estimation.atomic_write import open_regular, require_text
from armimp_estimation.bags import metadata_yaml
from armimp_estimation.bags.mcap_reader import MAGIC, read_mcap
from armimp_estimation.bags.raw import RawMessages, namespace_of, one_line
from armimp_estimation.bags.sqlite_reader import read_sqlite

BAGS: Final = "bags"
"""Folder of the bags within the directory of a run."""
_SQLITE_MAGIC: Final = b"SQLite format 3\0"
_ZSTD_MAGIC: Final = b"\x28\xb5\x2f\xfd"
_ROS1_MAGIC: Final = b"#ROSBAG V"
_SUFFIXES: Final = (".mcap", ".db3", ".mcap.zstd", ".db3.zstd")
_MOST_JOINTS: Final = 100
_MOST_STATUSES: Final = 20_000
"""Most statuses that are read. A trial has four, and one more for each fault in it."""

_NEEDED: Final[dict[str, str]] = {
    topics.JOINT_STATES: "joint positions",
    topics.TORQUE_SENSORS: "torque readings",
    topics.PERTURBATION: "perturbation",
}


@dataclass(frozen=True, kw_only=True, eq=False)
class BagContent:
    """Content of a bag."""

    path: Path
    """The bag."""
    metadata: Mapping[str, str]
    """Metadata of the recording; empty for bags recorded elsewhere."""
    joint_names: tuple[str, ...]
    """Order of the joints in the records."""
    trials: tuple[Trial, ...]
    """Trials, at least one; each knows whether it can be used for an estimate."""
    topics: Mapping[str, str]
    """Name in the bag of each topic of the contract that has messages in it."""
    notes: tuple[str, ...]
    """What a user should know about the bag, one line each: a cut, damaged messages."""
    _raw: RawMessages
    _contract_names: Mapping[int, str]

    def messages(self) -> Iterator[tuple[str, int, bytes]]:
        """Topic, time of reception (ns) and bytes of each message of the contract, in order."""
        for index, log_time_ns, payload in self._raw.messages:
            if index in self._contract_names:
                yield self._contract_names[index], log_time_ns, payload


def read_bag(path: Path, *, namespace: str | None = None) -> BagContent:
    """Read a bag with everything that an estimate needs.

    The path may be a rosbag2 directory with or without ``metadata.yaml``, or a single MCAP or
    SQLite3 file, compressed or not, complete or truncated. Topics may be under a namespace, which
    has to be given if the bag holds those of several rigs. Messages may have the joints in any
    order, and those of sensors may have further joints. Without trial statuses, `infer_windows`
    infers the trials from the perturbation.

    Raises
    ------
    BagError
        If the path is not a readable bag, or the bag lacks something; the message is one line that
        names the file. A spoiled trial raises only when something is estimated from it.
    """
    raw = read_storage(path)
    cut = f" (the file {raw.cut})" if raw.cut else ""
    if not raw.messages:
        raise BagError(f"{path}: no messages of an experiment in it{cut}")
    by_index = raw.by_topic()
    recorded = list(raw.topics)
    found = resolve_topics(recorded, bag=str(path), namespace=namespace)
    found = {topic: index for topic, index in found.items() if by_index[index]}
    messages = {topic: by_index[index] for topic, index in found.items()}
    for topic, content in _NEEDED.items():
        if topic not in found:
            raise BagError(f"{path}: has no {content}: no messages of {topic}{cut}")
    announced = messages.get(topics.TRIAL, [])
    if len(announced) > _MOST_STATUSES:
        raise BagError(f"{path}: has {len(announced)} messages of {topics.TRIAL}")
    statuses, defect = decode_trial_statuses(announced)
    try:
        joint_names = _joint_names(raw.metadata, messages[topics.PERTURBATION])
        if len(joint_names) > _MOST_JOINTS:
            raise DataError(f"{len(joint_names)} joints are more than {_MOST_JOINTS}")
        streams = decode_streams(joint_names, messages)
        trials = assemble_trials(streams, statuses, bag=str(path))
    except (DataError, ConfigurationError, MalformedMessageError) as error:
        raise BagError(f"{path}: {one_line(error)}{cut}") from None
    if not trials:
        last = one_line(statuses[-1].sentence)
        raise BagError(f"{path}: no trial in it; the last status is: {last}")
    notes = [f"{path}: {raw.cut}"] if raw.cut else []
    if defect:
        notes.append(f"{path}: damaged messages of {topics.TRIAL}: {one_line(defect)}")
    for topic in (topics.JOINT_STATES, topics.TORQUE_SENSORS):
        # Some message could be decoded, but not necessarily the first one.
        with suppress(MalformedMessageError):
            others = set(joint_names_of(messages[topic][0])).difference(joint_names)
            if others:
                passed_over = f"{path}: {topic} has joints that were passed over"
                listed = one_line(", ".join(sorted(others)))
                notes.append(f"{passed_over}, {listed}: they must not have moved")
    return BagContent(
        path=path,
        metadata=raw.metadata,
        joint_names=joint_names,
        trials=trials,
        topics={topic: recorded[index][0] for topic, index in found.items()},
        notes=tuple(notes),
        _raw=raw,
        _contract_names={index: topic for topic, index in found.items()},
    )


def _joint_names(metadata: Mapping[str, str], perturbation: Sequence[bytes]) -> tuple[str, ...]:
    """Joint order: that of the recording's metadata, or else that of the perturbation messages."""
    with suppress(ValidationError):
        if names := TypeAdapter(tuple[str, ...]).validate_json(metadata.get("joint_names", "[]")):
            return names
    for message in perturbation:
        with suppress(MalformedMessageError):
            return joint_names_of(message)
    return joint_names_of(perturbation[0])  # raises the error that says what is wrong


def resolve_topics(
    recorded: Sequence[tuple[str, str]], *, bag: str, namespace: str | None = None
) -> dict[str, int]:
    """Find the topics of the contract among those of a bag.

    A topic matches if its name ends, after a slash, with that of the contract. If several match,
    the namespace that holds all needed topics is chosen.

    Parameters
    ----------
    recorded : sequence of tuple of str
        Name and message type of each topic of the bag; the type may be empty.
    bag : str
        Name of the bag for error messages.
    namespace : str, optional
        Accept only topics under this namespace.

    Returns
    -------
    dict of str to int
        Index in `recorded` of each topic that was found, by its name in the contract.

    Raises
    ------
    BagError
        If the choice is ambiguous, or a topic has a type other than that of the contract.
    """
    matches = {topic: _candidates(recorded, topic) for topic in topics.TOPICS}
    if namespace is not None:
        rigs = [f"/{namespace.strip('/')}/" if namespace.strip("/") else "/"]
    else:
        rigs = sorted(set.intersection(*(set(matches[topic].values()) for topic in _NEEDED)))
    if len(rigs) > 1:
        names = one_line(", ".join(prefix.rstrip("/") or "/" for prefix in rigs))
        raise BagError(f"{bag}: holds the topics of several rigs, choose a namespace: {names}")
    found: dict[str, int] = {}
    for topic, prefixes in matches.items():
        chosen = [i for i, prefix in prefixes.items() if prefix in (*rigs, "")] if rigs else []
        if not chosen and namespace is None:  # others may be elsewhere, if they are unique
            chosen = list(prefixes)
        if len(chosen) > 1 and (topic in _NEEDED or topic == topics.TRIAL):
            names = one_line(", ".join(sorted({recorded[i][0] for i in chosen})))
            raise BagError(f"{bag}: {topic} is ambiguous: {names}")
        if len(chosen) == 1:
            name, kind = recorded[chosen[0]]
            if kind not in ("", topics.TOPICS[topic].type):
                expected = topics.TOPICS[topic].type
                raise BagError(f"{bag}: topic {name} is of type {kind}, not {expected}")
            found[topic] = chosen[0]
    return found


def _candidates(recorded: Sequence[tuple[str, str]], topic: str) -> dict[int, str]:
    """Prefixes of topics with the right name; only of those with the right type, if any has it."""
    prefixes = {i: namespace_of(name, topic) for i, (name, _) in enumerate(recorded)}
    named = {i: prefix for i, prefix in prefixes.items() if prefix is not None}
    typed = {i: named[i] for i in named if recorded[i][1] == topics.TOPICS[topic].type}
    return typed or named


def read_storage(path: Path) -> RawMessages:
    """Read all messages of a bag under names of the contract, in the order of log times.

    Raises BagError if the path is not a readable bag, or reading the bag exceeds the limits.
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
        messages = RawMessages(str(path), sum(file.stat().st_size for file in files))
        for file in files:
            messages.name = str(file)
            _read_file(file, messages)
        messages.name = str(path)
        _decompress_messages(messages)
        messages.messages.sort(key=itemgetter(1))  # stable for messages with equal times
    except OSError as error:
        prefix = "cannot be read: " if error.errno else ""  # without errno, we raised it
        raise BagError(f"{error.filename or path}: {prefix}{error.strerror}") from None
    except (zstandard.ZstdError, MemoryError) as error:
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
        none = f"no {metadata_yaml.FILE_NAME} and no .mcap or .db3 file"
        raise BagError(f"{directory}: is not a bag: it has {none}")
    return sorted(files, key=_natural), {}


def find_bags(paths: Sequence[Path]) -> list[Path]:
    """Replace each path to the directory of a run, or to a folder of bags, by its bags in order.

    Other paths stay as they are, for the reader to judge.

    Raises
    ------
    BagError
        If two bags are the same, reached by different paths, links or names of their files.
    """
    found: list[Path] = []
    for path in paths:
        folder = path / BAGS if (path / BAGS).is_dir() else path
        bags: list[Path] = []
        with suppress(OSError):  # no readable directory, which the reader will report
            if not _holds_bag(folder):
                bags = [one for one in folder.iterdir() if one.is_dir() and _holds_bag(one)]
        found += sorted(bags, key=_natural) or [path]
    known: dict[tuple[int, int], Path] = {}
    for bag in found:
        with suppress(OSError):  # the reader will report it
            for file in bag.iterdir() if bag.is_dir() else (bag,):
                if file == bag or file.name.endswith(_SUFFIXES):
                    status = file.stat()
                    other = known.setdefault((status.st_dev, status.st_ino), bag)
                    if other is not bag:
                        raise BagError(f"{bag}: is the same as {other}")
    return found


def _holds_bag(folder: Path) -> bool:
    return any(
        one.name.endswith(_SUFFIXES) or one.name == metadata_yaml.FILE_NAME
        for one in folder.iterdir()
    )


def _natural(path: Path) -> list[tuple[int, str]]:
    # bag_10 comes after bag_9.
    parts = re.split(r"(\d+)", path.name)
    return [(int(part), "") if part.isdecimal() else (0, part) for part in parts]


def _read_file(path: Path, into: RawMessages) -> None:
    with open_regular(path) as file:
        compressed = file.read(len(_ZSTD_MAGIC)) == _ZSTD_MAGIC
        file.seek(0)
        _read_uncompressed(path, into.unzstd_file(file) if compressed else file, into)


def _read_uncompressed(path: Path, file: BinaryIO, into: RawMessages) -> None:
    size = file.seek(0, os.SEEK_END)
    file.seek(0)
    head = file.read(len(_SQLITE_MAGIC))
    file.seek(0)
    if size == 0:
        raise into.refusal("is empty")
    if head.startswith(MAGIC):
        read_mcap(file, size, into)
    elif head == _SQLITE_MAGIC:
        read_sqlite(file, Path(f"{path}-wal"), into)
    elif head.startswith(_ROS1_MAGIC):
        raise into.refusal("is a ROS 1 bag; convert it with rosbags-convert")
    elif MAGIC.startswith(head) or _SQLITE_MAGIC.startswith(head):
        raise into.refusal(f"is cut after {size} bytes, before the first message")
    else:
        raise into.refusal("is neither an MCAP nor an SQLite3 file")


def _decompress_messages(messages: RawMessages) -> None:
    """Decompress messages that were compressed one by one.

    The first two bytes of CDR are 0 or 1, so the first bytes of a compressed message identify it
    even without a ``metadata.yaml`` that declares the compression.
    """
    if messages.messages and messages.messages[0][2].startswith(_ZSTD_MAGIC):
        messages.messages = [
            (topic, time, messages.unzstd(raw) if raw.startswith(_ZSTD_MAGIC) else raw)
            for topic, time, raw in messages.messages
        ]
