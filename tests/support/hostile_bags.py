"""Files made to harm whoever reads them.

Every attack takes an empty directory and returns the arguments of ``armimp``. Files that must stay
untouched are in ``witness`` beside that directory. All files but the links are below 10 MB.
"""

import os
import resource
import signal
import sqlite3
import struct
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor
from contextlib import closing, suppress
from dataclasses import dataclass
from functools import partial
from io import BytesIO
from itertools import count, islice, pairwise
from multiprocessing import get_context
from pathlib import Path
from typing import Final, TypeAlias, TypeVar

import lz4.frame
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.records import Channel, Chunk, Header, McapRecord, Schema

from armimp_common.cdr import JointStateEncoder, encode_trial_status
from armimp_common.topics import DATA_STREAMS, PERIOD_NS, TOPICS, TRIAL
from armimp_estimation.bags.mcap_reader import MAGIC
from armimp_estimation.bags.writer import HEAD as OUR_HEAD
from support.command import Told, call
from support.places import contents
from support.streams import trial_status
from support.synthetic_bags import Message, recorded_arm, synthetic_recording

T = TypeVar("T")
Arguments: TypeAlias = tuple[str, ...]
Attack: TypeAlias = Callable[[Path], Arguments]

WITNESS: Final = "witness"
_TOPICS: Final = (*DATA_STREAMS, TRIAL)
_GIB: Final = 1 << 30

ATTACKS: dict[str, Attack] = {}


def attack(function: Attack) -> Attack:
    ATTACKS[function.__name__.replace("_", " ")] = function
    return function


def records(*parts: McapRecord) -> bytes:
    builder = RecordBuilder()
    for part in parts:
        part.write(builder)
    data: bytes = builder.end()
    return data


def channel(number: int, name: str) -> Channel:
    return Channel(number, name, "cdr", {}, number)


def message(number: int, log_time_ns: int, payload: bytes) -> bytes:
    """A message record as `records` would write it, in a tenth of the time."""
    return endless(len(payload), number, log_time_ns) + payload


def endless(length: int, number: int = 1, log_time_ns: int = 1) -> bytes:
    """Head of a message record whose payload is to have so many bytes."""
    return struct.pack("<BQHIQQ", 5, 22 + length, number, 0, log_time_ns, log_time_ns)


def chunk(compression: str, size: int, data: bytes) -> bytes:
    return records(Chunk(compression, data, 0, 0, 0, size))


CONTRACT: Final = records(
    *(Schema(k, b"", "ros2msg", TOPICS[topic].type) for k, topic in enumerate(_TOPICS, 1)),
    *(channel(k, "/" + topic) for k, topic in enumerate(_TOPICS, 1)),
)
HEAD: Final = MAGIC + records(Header("ros2", "strange")) + CONTRACT
"""Beginning of a file, with schema and channel of each topic of the contract, from 1 on."""


def records_of(messages: Iterable[Message]) -> Iterable[bytes]:
    return (message(_TOPICS.index(topic) + 1, t, raw) for topic, t, raw in messages)


def untold(ticks: int) -> Iterable[Message]:
    """Messages of so many ticks without any status."""
    names = ("joint_1", "joint_2")
    messages = synthetic_recording(joint_names=names, ticks=ticks, start_ns=0).messages
    return (one for one in messages if one[0] != TRIAL)


def repeated(piece: bytes, times: int, prefix: bytes = b"") -> bytes:
    """A zstd frame of a large piece many times over, which does not state its content size."""
    out = BytesIO()
    with zstandard.ZstdCompressor(level=1).stream_writer(out, closefd=False) as writer:
        writer.write(prefix)
        for _ in range(times):
            writer.write(piece)
    return out.getvalue()


def mcap(directory: Path, *parts: bytes, name: str = "bag.mcap") -> Arguments:
    file = directory / name
    file.write_bytes(b"".join(parts))
    return "estimate", str(file)


def zstd_chunk(content: bytes) -> bytes:
    return chunk("zstd", len(content), zstandard.compress(content, level=1))


def zstd_chunks(records: Iterable[bytes]) -> bytes:
    """Chunks of 10,000 records each."""
    found = []
    records = iter(records)
    while content := b"".join(islice(records, 10_000)):
        found.append(zstd_chunk(content))
    return b"".join(found)


def statuses(number: int, spacing_ns: int, ticks: int, first_ns: int = 0) -> bytes:
    """Statuses of trials that begin at regular intervals."""

    def status(i: int) -> bytes:
        start_ns = first_ns + i * spacing_ns
        values = {"trial": 1 + i, "trials": 10**6, "joint_name": "joint_1"}
        return encode_trial_status(trial_status(start_ns=start_ns, ticks=ticks, **values))

    return zstd_chunks(message(5, i, status(i)) for i in range(number))


def sound() -> bytes:
    return zstd_chunk(b"".join(records_of(recorded_arm(1800).messages)))


def three_hundred_thousand_joints() -> Iterable[bytes]:
    names = tuple(f"j{i}" for i in range(300_000))
    values = [float(i == 0) for i in range(len(names))]
    for number, field in ((1, "position"), (2, "effort"), (3, "effort")):
        encoder = JointStateEncoder(names, field)  # type: ignore[arg-type]
        for i in range(4):
            yield zstd_chunk(message(number, i, encoder.encode(i * PERIOD_NS, values)))


_X: Final = message(1, 1, b"x")
_GIBIBYTE: Final = _GIB - len(message(1, 1, b""))
_LATE: Final = 60 * PERIOD_NS
MCAP: Final[dict[str, Callable[[], bytes]]] = {
    # Compression
    "zstd chunks of a gibibyte": lambda: (
        3 * chunk("zstd", _GIB, repeated(bytes(1 << 20), _GIBIBYTE >> 20, endless(_GIBIBYTE)))
    ),
    "zstd frame that claims four gibibytes": lambda: b"".join(
        chunk("zstd", size, b"\x28\xb5\x2f\xfd\xe0" + struct.pack("<Q", 4 * _GIB) + b"\1\0\0")
        for size in (4 * _GIB, _GIB)
    ),
    "lz4 chunk bomb": lambda: chunk("lz4", 1000, lz4.frame.compress(bytes(_GIB // 4))),
    "compressed messages": lambda: (
        1000 * message(1, 1, zstandard.compress(bytes(64 << 20), level=1))
    ),
    # Counts and names
    "topic with a name of five million letters": lambda: (
        records(channel(1, "/" + "a" * 5_000_000 + "/joint_states")) + _X
    ),
    "thirty thousand statuses": lambda: sound() + statuses(30_000, 10**9, 10),
    "trials that overlap": lambda: (
        zstd_chunks(records_of(untold(50_000))) + statuses(900, 1, 100_000, _LATE)
    ),
    "trials of ten million samples": lambda: sound() + statuses(900, 10**6, 10_000_000),
    "three hundred thousand joints in messages": lambda: b"".join(three_hundred_thousand_joints()),
}
"""Contents that follow the head of a file; they may define its channels anew."""


def with_content(make: Callable[[], bytes], directory: Path) -> Arguments:
    return mcap(directory, HEAD, make())


ATTACKS |= {name: partial(with_content, make) for name, make in MCAP.items()}


@attack
def compressed_file_of_zeros(directory: Path) -> Arguments:
    return mcap(directory, repeated(bytes(1 << 20), 1 << 10), name="bag.mcap.zstd")


_SCHEMA: Final = """
CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT);
CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB);
"""


def database(directory: Path, script: str) -> Arguments:
    file = directory / "bag.db3"
    with closing(sqlite3.connect(file)) as connection:
        connection.executescript(script)
        rows = [(i, "/" + t, TOPICS[t].type, "cdr") for i, t in enumerate(_TOPICS, 1)]
        connection.executemany("INSERT INTO topics VALUES (?, ?, ?, ?)", rows)
        connection.commit()
    return "estimate", str(file)


_COUNTING: Final = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n)"
_TOPICS_TABLE: Final = _SCHEMA.strip().splitlines()[0]


@attack
def recursive_view_of_messages(directory: Path) -> Arguments:
    view = f"AS {_COUNTING} SELECT 1 AS topic_id, i AS timestamp, x'00' AS data FROM n"
    return database(directory, f"{_TOPICS_TABLE} CREATE VIEW messages {view};")


def interior_page(child: int, cells: int) -> bytes:
    """An interior B-tree page of a table whose cells all point to the same child."""
    size = 4096
    page = bytearray(size)
    page[:12] = struct.pack(">BHHHBI", 5, 0, cells, size - 12 * cells, 0, child)
    for i in range(cells):
        where = size - 12 * (i + 1)
        page[where : where + 12] = (struct.pack(">I", child) + b"\x81" * 7 + b"\x01")[:12]
        struct.pack_into(">H", page, 12 + 2 * i, where)
    return bytes(page)


@attack
def tree_whose_branches_are_one(directory: Path) -> Arguments:
    arguments = database(directory, _SCHEMA + "INSERT INTO messages VALUES (1, 9, 1, x'00');")
    file = Path(arguments[1])
    with closing(sqlite3.connect(file)) as connection:
        (root,) = connection.execute(
            "SELECT rootpage FROM sqlite_master WHERE name = 'messages'"
        ).fetchone()
    data = bytearray(file.read_bytes())
    leaf = data[4096 * (root - 1) : 4096 * root]
    depth, pages = 6, len(data) // 4096
    numbers = [root, *range(pages + 1, pages + depth + 1)]
    for number, child in pairwise(numbers):
        data[4096 * (number - 1) : 4096 * number] = interior_page(child, 250)
    data += leaf
    struct.pack_into(">I", data, 28, len(data) // 4096)
    file.write_bytes(data)
    return arguments


@attack
def journal_that_has_another_file_deleted(directory: Path) -> Arguments:
    rows = f"{_COUNTING} INSERT INTO messages SELECT i, 1, i, zeroblob(100) FROM n LIMIT 100;"
    arguments = database(directory, _SCHEMA + rows)
    file = Path(arguments[1])
    content = file.read_bytes()
    target = bytes(directory.parent / WITNESS / "canary")
    pages = len(content) // 4096
    magic = bytes.fromhex("d9d505f920a163d7")
    journal = magic + struct.pack(">IIIII", 1, 0, pages, 512, 4096)
    journal = journal.ljust(512, b"\0")
    page = content[4096 * (pages - 1) :]
    total = sum(page[i] for i in range(4096 - 200, 0, -200)) & 0xFFFFFFFF
    journal += struct.pack(">I", pages) + page + struct.pack(">I", total)
    name_sum = sum(struct.unpack(f"{len(target)}b", target)) & 0xFFFFFFFF
    journal += (
        struct.pack(">I", 262145) + target + struct.pack(">II", len(target), name_sum) + magic
    )
    Path(f"{file}-journal").write_bytes(journal)
    return arguments


def _hole(path: Path) -> None:
    """Make a sparse file of a tebibyte."""
    path.touch()
    os.truncate(path, 1 << 40)


KINDS: Final[dict[str, Callable[[Path], object]]] = {
    "a pipe": os.mkfifo,
    "a device": lambda path: path.symlink_to("/dev/zero"),
    "a hole": _hole,
}


def configured(file: Path) -> Arguments:
    return "run", "--config", str(file), "--out", str(file.parent / "out")


def finished(directory: Path) -> Arguments:
    """A bag whose metadata are good."""
    (directory / "metadata.yaml").write_text(
        "rosbag2_bagfile_information: {storage_identifier: mcap, message_count: 0,"
        " relative_file_paths: [bag.mcap]}\n"
    )
    return "estimate", str(directory)


PLACES: Final[dict[str, tuple[str, Attack]]] = {
    "metadata": ("metadata.yaml", lambda directory: ("estimate", str(directory))),
    "storage": ("bag.mcap", finished),
    "log": ("bag.db3-wal", partial(database, script=_SCHEMA)),
    "configuration": ("config.yaml", lambda directory: configured(directory / "config.yaml")),
}
"""Files by their role: name, and what returns the arguments of a command that reads it."""


def in_place(make: Callable[[Path], object], place: str, directory: Path) -> Arguments:
    name, attack_on = PLACES[place]
    arguments = attack_on(directory)
    make(directory / name)
    return arguments


ATTACKS |= {
    f"{kind} as {place}": partial(in_place, make, place)
    for place in PLACES
    for kind, make in KINDS.items()
}


def unfinished(directory: Path, *content: bytes) -> Path:
    """A bag as a killed recorder leaves it; its reader finishes it."""
    bag = directory / "bag"
    bag.mkdir()
    (bag / "bag_0.mcap").write_bytes(b"".join((OUR_HEAD, CONTRACT, *content)))
    return bag


@attack
def unfinished_bag_of_large_chunks(directory: Path) -> Arguments:
    content = endless(30 << 20) + bytes(30 << 20)
    return "estimate", str(unfinished(directory, zstd_chunk(content) * 200))


@attack
def link_to_an_unfinished_bag_elsewhere(directory: Path) -> Arguments:
    bag = unfinished(directory.parent / WITNESS, sound())
    run = directory / "bags"
    run.mkdir()
    (run / "trial_1_joint_1").symlink_to(bag)
    return "estimate", str(directory)


@attack
def links_in_a_circle(directory: Path) -> Arguments:
    (directory / "bags").mkdir()
    for i in range(100):
        (directory / "bags" / f"trial_{i}").symlink_to(directory)
    (directory / "bags" / "bags").symlink_to("bags")
    return "estimate", str(directory)


@attack
def storage_that_is_cut_while_it_is_read(directory: Path) -> Arguments:
    return mcap(directory, HEAD, *(sound() for _ in range(20)))


def _cut(file: str) -> None:
    """Truncate and rewrite a file until this process is killed."""
    content = Path(file).read_bytes()
    for turn in count():
        with suppress(OSError):
            os.truncate(file, turn * 7919 % len(content))
            Path(file).write_bytes(content)


_KILLED_AFTER: Final = 240
"""Wall time after which a reader is killed (s)."""
_ADDRESS_SPACE: Final = 8 << 30
"""Limit of a reader's address space (bytes), so that a failure spares the machine."""
_SERVER: Final = get_context("forkserver")
"""Forks processes that have everything imported, and whose peak memory counts anew."""
_SERVER.set_forkserver_preload(
    [
        __name__,
        *(f"armimp_bringup.{module}" for module in ("offline_estimate", "orchestrator")),
        *(f"armimp_bringup.{module}" for module in ("presentation", "terminal")),
    ]
)


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """How a command read the file of an attack: processor time in s, peak memory in bytes."""

    told: Told
    seconds: float
    memory: float
    untouched: bool


def _written(name: str, directory: Path) -> Arguments:
    return ATTACKS[name](directory)


def _read(arguments: Arguments, directory: Path) -> tuple[Told, float, float]:
    os.chdir(directory)
    signal.alarm(_KILLED_AFTER)
    resource.setrlimit(resource.RLIMIT_AS, (_ADDRESS_SPACE, _ADDRESS_SPACE))
    told = call(*arguments)
    usage = resource.getrusage(resource.RUSAGE_SELF)
    return told, usage.ru_utime + usage.ru_stime, usage.ru_maxrss * 1024.0


def _alone(work: Callable[..., T], *arguments: object) -> T:
    with ProcessPoolExecutor(1, _SERVER) as process:
        return process.submit(work, *arguments).result()


def tried(name: str, directory: Path) -> Outcome:
    """Let the command read the file of an attack in an empty directory, and measure."""
    inside = directory / "inside"
    inside.mkdir(parents=True)
    (directory / WITNESS).mkdir()
    for name_of_file in ("canary", ".canary"):
        (directory / WITNESS / name_of_file).write_bytes(b"ten years of work")
    arguments = _alone(_written, name, inside)
    before = contents(directory / WITNESS)
    cutter = _SERVER.Process(target=_cut, args=arguments[1:2])
    if "cut while it is read" in name:
        cutter.start()
    try:
        told, seconds, memory = _alone(_read, arguments, directory)
    finally:
        if cutter.is_alive():
            cutter.kill()
            cutter.join()
    untouched = contents(directory / WITNESS) == before
    return Outcome(told=told, seconds=seconds, memory=memory, untouched=untouched)
