"""The messages of a bag as they are stored, and what it may cost to read them."""

from collections.abc import Iterable
from io import BytesIO
from typing import BinaryIO, Final, TypeAlias

import lz4.frame
import zstandard

from armimp_common.errors import BagError
from armimp_common.topics import MESSAGE_TYPES

RECORD_COST: Final = 200
"""Bytes of memory that a message takes beside its content, nearly; as many could be read in the
time that another small record takes, or one byte of YAML."""

# Bags of experiments hold up to twelve times their size, by this account.
_FREE: Final = 128 << 20
_RATIO: Final = 20
_LARGEST: Final = 64 << 20
_PIECE: Final = 1 << 20


RawMessage: TypeAlias = tuple[int, int, bytes]
"""Index of the topic, log time (ns) and bytes of a message."""
_LONGEST: Final = 300


def one_line(text: object) -> str:
    """Return a text, or that of an error, as a short line, whatever a damaged file holds."""
    line = " ".join(str(text).split()) or type(text).__name__
    return line if len(line) <= _LONGEST else f"{line[:_LONGEST]} ..."


def absolute(topic: str) -> str:
    """Full name of a topic of the contract in the root namespace, where bags are recorded."""
    return topic if topic.startswith("/") else f"/{topic}"


def namespace_of(name: str, topic: str) -> str | None:
    """What stands before a topic of the contract; None if the name is not that of the topic."""
    if name == topic:
        return ""
    tail = absolute(topic)
    return name[: len(name) - len(tail) + 1] if name.endswith(tail) else None


class RawMessages:
    """Messages of one or more storage files in recorded order, and what more of them may cost.

    The cost, in bytes of memory or as much work, may grow with the bag, so that recordings of any
    length can be read, but not files that hold thousands of times their size. Given are the name of
    the bag and the bytes of all of its files.
    """

    def __init__(self, name: str, size: int) -> None:
        self.name = name
        """The bag, or the file of it that is being read, for errors."""
        self._left = _FREE + _RATIO * size
        # Making one takes longer than the decompression of a chunk.
        self._zstd = zstandard.ZstdDecompressor()
        self._indices: dict[tuple[str, str], int] = {}
        self.topics: list[tuple[str, str]] = []
        """Name and message type of each recorded topic; the type is empty where the file does not
        say."""
        self.messages: list[RawMessage] = []
        self.metadata: dict[str, str] = {}
        """Metadata of the recording."""
        self.cut = ""
        """Where and how the recording ends early; empty if it is complete."""

    def spend(self, cost: int) -> None:
        """Charge a cost.

        Raises
        ------
        BagError
            If it exceeds what is left.
        """
        self._left -= cost
        if self._left < 0:
            raise self.refusal("holds far more than a bag of its size should")

    def refusal(self, reason: str) -> BagError:
        """Return the error that says why the bag is not read."""
        return BagError(f"{self.name}: {reason}")

    def unzstd(self, data: bytes, most: int | None = None) -> bytes:
        """Decompress one frame of zstd, of at most so many bytes.

        Raises
        ------
        BagError
            If it holds more than the largest piece may, or than is left.
        zstandard.ZstdError
            If it is damaged, or holds more than `most`.
        """
        most = min(_LARGEST, self._left) if most is None else most
        # The library would make room for whatever the frame claims to hold.
        self._require(max(most, zstandard.frame_content_size(data)))
        content = self._zstd.decompress(data, max_output_size=most)
        self.spend(len(content))
        return content

    def unlz4(self, data: bytes, most: int) -> bytes:
        """Decompress one frame of lz4 up to so many bytes.

        Raises
        ------
        BagError
            If that is more than is left.
        RuntimeError
            If it is damaged.
        """
        self._require(most)
        content: bytes = lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=most)
        self.spend(len(content))
        return content

    def unzstd_file(self, source: BinaryIO) -> BinaryIO:
        """Decompress a file of zstd, as far as it goes.

        Raises
        ------
        BagError
            If it holds more than is left.
        zstandard.ZstdError
            If it is damaged.
        """
        content = BytesIO()
        with zstandard.ZstdDecompressor().stream_reader(source) as reader:
            while piece := reader.read(_PIECE):
                self.spend(len(piece))
                content.write(piece)
        content.seek(0)
        return content

    def _require(self, size: int) -> None:
        """Refuse a piece that is too large before there is room made for it."""
        if size > min(_LARGEST, self._left):
            raise self.refusal(f"a piece of it claims to hold {size} bytes")

    def topic_index(self, name: str, message_type: str, encoding: str) -> int | None:
        """Index of a topic in `topics`, which it joins if it is new; None if nobody wants it.

        Wanted are those whose name is that of a topic of the contract, under any namespace.

        Raises
        ------
        BagError
            If it is wanted, but its messages are not CDR.
        """
        entry = (one_line(name), one_line(message_type) if message_type else "")
        if (index := self._indices.setdefault(entry, len(self.topics))) == len(self.topics):
            self.topics.append(entry)
        if all(namespace_of(name, topic) is None for topic in MESSAGE_TYPES):
            return None
        if encoding != "cdr":
            raise self.refusal(f"topic {entry[0]} is encoded as {encoding!r}, not as cdr")
        return index

    def extend(self, messages: Iterable[RawMessage]) -> None:
        """Add messages, whose content has been charged.

        Raises
        ------
        BagError
            If they are more than may be.
        """
        before = len(self.messages)
        self.messages += messages
        self.spend(RECORD_COST * (len(self.messages) - before))

    def by_topic(self) -> dict[int, list[bytes]]:
        """Messages of each topic, in recorded order."""
        found: dict[int, list[bytes]] = {index: [] for index in range(len(self.topics))}
        for index, _, payload in self.messages:
            found[index].append(payload)
        return found
