"""What reading a bag may cost, and decompression that keeps to it."""

import math
from pathlib import Path
from typing import BinaryIO, Final

import lz4.frame
import zstandard

from armimp_common.errors import BagError

MESSAGE_COST: Final = 200
"""Bytes of memory that a message takes beside its content, nearly."""
RECORD_COST: Final = 4096
"""Bytes that could be read in the time which a record other than a message takes."""
NODE_COST: Final = 200
"""The same for one byte of YAML."""

# Bags of experiments hold up to twelve times their size, by this account.
_FREE: Final = 128 << 20
_RATIO: Final = 20
_LARGEST: Final = 64 << 20
_LARGEST_TRUSTED: Final = 1 << 30
_PIECE: Final = 1 << 20


class Budget:
    """What is left to be spent on one bag, in bytes of memory or as much work.

    It grows with the bag, so that recordings of any length can be read, but not files that hold
    thousands of times their size.

    Parameters
    ----------
    name : str
        The bag, for messages.
    size : int
        Bytes of all of its files.
    trust : bool
        Whether there is no limit, as the file comes from a friend.

    Attributes
    ----------
    largest : int
        Bytes of the largest chunk or message that is decompressed.
    """

    def __init__(self, name: str, size: int, *, trust: bool = False) -> None:
        self._name = name
        self._left = math.inf if trust else _FREE + _RATIO * size
        self.largest = _LARGEST_TRUSTED if trust else _LARGEST
        self.trust = trust

    def spend(self, cost: int) -> None:
        """Take something from what is left.

        Raises
        ------
        BagError
            If there is not as much.
        """
        self._left -= cost
        if self._left < 0:
            raise self.refusal("holds far more than a bag of its size should")

    def refusal(self, reason: str) -> BagError:
        """Return the error that says why a bag goes beyond the limits."""
        return BagError(f"{self._name}: {reason}; --trust lifts the limits")

    def unzstd(
        self, data: bytes, most: int | None = None, by: zstandard.ZstdDecompressor | None = None
    ) -> bytes:
        """Decompress one frame of zstd, of at most so many bytes, by a given decompressor.

        Raises
        ------
        BagError
            If it holds more than the largest piece may, or than is left.
        zstandard.ZstdError
            If it is damaged, or holds more than `most`.
        """
        most = int(min(self.largest, self._left)) if most is None else most
        # The library would make room for whatever the frame claims to hold.
        self._require(max(most, zstandard.frame_content_size(data)))
        content = (by or zstandard.ZstdDecompressor()).decompress(data, max_output_size=most)
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

    def copy_unzstd(self, source: BinaryIO, target: Path) -> None:
        """Decompress a file of zstd, as far as it goes, into another one.

        Raises
        ------
        BagError
            If it holds more than is left.
        zstandard.ZstdError
            If it is damaged.
        OSError
            If the other one cannot be written.
        """
        with (
            zstandard.ZstdDecompressor().stream_reader(source, closefd=False) as reader,
            target.open("xb") as file,
        ):
            while piece := reader.read(_PIECE):
                self.spend(len(piece))
                file.write(piece)

    def _require(self, size: int) -> None:
        """Refuse a piece that is too large before there is room made for it."""
        if size > min(self.largest, self._left):
            raise self.refusal(f"a piece of it claims to hold {size} bytes")
