"""The messages of a bag as they are stored, and the limit on the cost of reading them."""

from collections.abc import Iterable
from io import BytesIO
from typing import BinaryIO, Final, TypeAlias

import lz4.frame
import zstandard

from armimp_common.errors import BagError
from armimp_common.topics import TOPICS

RECORD_COST: Final = 200
"""Approximate bytes of memory that a message takes in addition to its content. Other small records,
and a byte of YAML, take the time in which as many bytes could be read."""

# A bag may cost a fixed part plus a multiple of its size; experiments cost up to 12 times theirs.
_FREE: Final = 128 << 20
_RATIO: Final = 20
_LARGEST: Final = 64 << 20
"""Most bytes of one decompressed piece, such as a chunk."""
_PIECE: Final = 1 << 20


RawMessage: TypeAlias = tuple[int, int, bytes]
"""Index of the topic, log time (ns) and bytes of a message."""
_LONGEST: Final = 300
"""Most characters of a line in a message for users."""


def one_line(text: object) -> str:
    """Shorten a text, or that of an error, to one line, whatever a damaged file put into it."""
    line = " ".join(str(text).split()) or type(text).__name__
    return line if len(line) <= _LONGEST else f"{line[:_LONGEST]} ..."


def absolute(topic: str) -> str:
    """Full name of a topic of the contract in the root namespace, in which bags are recorded."""
    return topic if topic.startswith("/") else f"/{topic}"


def namespace_of(name: str, topic: str) -> str | None:
    """Namespace, with its last slash, before a topic in a name; None if it names another topic."""
    if name == topic:
        return ""
    tail = absolute(topic)
    return name[: len(name) - len(tail) + 1] if name.endswith(tail) else None


class RawMessages:
    """Messages of one or more storage files in recorded order, and the budget for reading more.

    The budget, in bytes of memory or equivalent work, grows with `size`, the bytes of all files of
    the bag: recordings of any length can be read, but not files that expand to thousands of times
    their size.
    """

    def __init__(self, name: str, size: int) -> None:
        self.name = name
        """The bag, or the file of it that is being read, for error messages."""
        self._left = _FREE + _RATIO * size
        # Made once, as that takes longer than the decompression of a chunk.
        self._zstd = zstandard.ZstdDecompressor()
        self.topics: dict[tuple[str, str], int] = {}
        """Index of each recorded topic, by its name and message type; the type is empty if the file
        does not state it."""
        self.messages: list[RawMessage] = []
        self.metadata: dict[str, str] = {}
        """Metadata of the recording."""
        self.cut = ""
        """Where and how the recording ends early; empty if it is complete."""

    def spend(self, cost: int) -> None:
        """Charge a cost to the budget.

        Raises
        ------
        BagError
            If it exceeds the rest of the budget.
        """
        self._left -= cost
        if self._left < 0:
            raise self.refusal("holds far more than a bag of its size should")

    def refusal(self, reason: str) -> BagError:
        """Return the error that says why the bag is not read."""
        return BagError(f"{self.name}: {reason}")

    def unzstd(self, data: bytes, most: int | None = None) -> bytes:
        """Decompress one frame of zstd to at most `most` bytes.

        Raises
        ------
        BagError
            If it holds more than one piece may, or than the budget allows.
        zstandard.ZstdError
            If it is damaged, or holds more than `most`.
        """
        most = min(_LARGEST, self._left) if most is None else most
        # The library would allocate whatever size the frame claims.
        self._require(max(most, zstandard.frame_content_size(data)))
        content = self._zstd.decompress(data, max_output_size=most)
        self.spend(len(content))
        return content

    def unlz4(self, data: bytes, most: int) -> bytes:
        """Decompress one frame of lz4, up to `most` bytes.

        Raises
        ------
        BagError
            If `most` is more than one piece may hold, or than the budget allows.
        RuntimeError
            If it is damaged.
        """
        self._require(most)
        content: bytes = lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=most)
        self.spend(len(content))
        return content

    def unzstd_file(self, source: BinaryIO) -> BinaryIO:
        """Decompress a file of zstd, as far as it is complete.

        Raises
        ------
        BagError
            If it holds more than the budget allows.
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
        """Refuse a piece that is too large before memory is allocated for it."""
        if size > min(_LARGEST, self._left):
            raise self.refusal(f"a piece of it claims to hold {size} bytes")

    def topic_index(self, name: str, message_type: str, encoding: str) -> int | None:
        """Return the index of a topic in `topics`, adding it if it is new; None if not wanted.

        Topics of the contract are wanted, under any namespace.

        Raises
        ------
        BagError
            If the topic is wanted, but its messages are not CDR.
        """
        entry = (one_line(name), one_line(message_type) if message_type else "")
        index = self.topics.setdefault(entry, len(self.topics))
        if all(namespace_of(name, topic) is None for topic in TOPICS):
            return None
        if encoding != "cdr":
            raise self.refusal(f"topic {entry[0]} is encoded as {encoding!r}, not as cdr")
        return index

    def extend(self, messages: Iterable[RawMessage]) -> None:
        """Add messages, whose content has been charged already.

        Raises
        ------
        BagError
            If they are more than the budget allows.
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
