"""Bags that tests write and read, as made by our recorder and by others."""

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

from mcap.writer import CompressionType, IndexType
from mcap.writer import Writer as McapWriter
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from armimp_common.errors import BagError
from armimp_common.topics import TOPICS
from armimp_estimation.bags.metadata_yaml import message_definitions
from armimp_estimation.bags.raw import absolute
from armimp_estimation.bags.reader import BagContent, read_storage, resolve_topics
from armimp_estimation.bags.writer import BagWriter
from armimp_estimation.record import TrialRecord
from support.synthetic_bags import Message

STORE = get_typestore(Stores.ROS2_JAZZY)


def write_bag(path: Path, messages: Iterable[Message], metadata: Mapping[str, str]) -> Path:
    """Write a bag as our recorder does."""
    with BagWriter(path, metadata=metadata) as writer:
        write_all(writer, messages)
    return path


def write_all(writer: BagWriter, messages: Iterable[Message]) -> None:
    for topic, log_time_ns, raw in messages:
        writer.write(topic, raw, log_time_ns)


def typed(messages: Iterable[Message], prefix: str = "") -> Iterator[tuple[str, str, int, bytes]]:
    """Yield messages of the contract in a namespace, with full name and type of their topic."""
    for topic, time, raw in messages:
        kind = TOPICS[topic].type if topic in TOPICS else "std_msgs/msg/String"
        yield prefix + absolute(topic), kind, time, raw


def write_foreign(
    path: Path,
    messages: Iterable[tuple[str, str, int, bytes]],
    *,
    storage: StoragePlugin = StoragePlugin.MCAP,
    mode: CompressionMode = CompressionMode.NONE,
    version: int = 9,
    metadata: Mapping[str, str] | None = None,
) -> Path:
    """Write messages (topic name, type, time in ns, bytes) as ``ros2 bag record`` does."""
    writer = Writer(path, version=9 if version == 9 else 8, storage_plugin=storage)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        for key, value in (metadata or {}).items():
            writer.set_custom_data(key, value)
        connections = {}
        for name, kind, time, raw in messages:
            if name not in connections:
                connections[name] = writer.add_connection(name, kind, typestore=STORE)
            writer.write(connections[name], time, raw)
    return path


def write_mcap(
    path: Path,
    messages: Iterable[Message],
    *,
    compression: CompressionType = CompressionType.NONE,
    chunking: bool = True,
    encoding: str = "cdr",
) -> Path:
    """Write a bare MCAP file without any index, in chunks of about 3000 bytes."""
    with path.open("wb") as file:
        writer = McapWriter(
            file,
            chunk_size=3000,
            compression=compression,
            use_chunking=chunking,
            index_types=IndexType.NONE,
            use_statistics=False,
        )
        writer.start("ros2")
        channels: dict[str, int] = {}
        for topic, log_time_ns, raw in messages:
            if topic not in channels:
                text = message_definitions()[kind := TOPICS[topic].type]["text"]
                schema = writer.register_schema(kind, "ros2msg", text.encode())
                channels[topic] = writer.register_channel(absolute(topic), encoding, schema)
            writer.add_message(channels[topic], log_time_ns, raw, log_time_ns)
        writer.finish()
    return path


def iterate_messages(path: Path, *, namespace: str | None = None) -> Iterator[Message]:
    """Iterate over the messages of the contract in a bag, which need not hold a trial."""
    raw = read_storage(path)
    if not raw.messages:
        raise BagError(f"{path}: no messages")
    found = resolve_topics(list(raw.topics), bag=str(path), namespace=namespace)
    names = {index: topic for topic, index in found.items()}
    return (
        (names[index], time, payload) for index, time, payload in raw.messages if index in names
    )


def readable(path: Path) -> list[Message]:
    """The messages of the contract in a bag; none if it is refused."""
    try:
        return list(iterate_messages(path))
    except BagError:
        return []


def records_of(content: BagContent) -> list[TrialRecord]:
    """Return the records of all trials; raise for the first that must not be estimated."""
    return [record for trial in content.trials for record in trial.intact()]


def assert_other_readers_open(bag: Path) -> int:
    """Check that rosbags finds our messages, as many as the bag says; return their number."""
    with AnyReader([bag]) as reader:
        read = [(time, data) for _, time, data in reader.messages()]
        assert reader.message_count == len(read)
    assert read == [(time, data) for _, time, data in iterate_messages(bag)]
    return len(read)
