"""A cursor over one CDR message which never reads past the end."""

import struct
from typing import Final, Literal, TypeAlias

from armimp_common.contract import NS_PER_S
from armimp_common.errors import MalformedMessageError

Buffer: TypeAlias = bytes | bytearray | memoryview
Span: TypeAlias = tuple[int, int]
"""Start and end of some bytes of a message, counted from its first byte."""

HEADER_SIZE: Final = 4
"""Bytes of the encapsulation header, from whose end CDR counts its alignment."""

MAX_SURPLUS: Final = 15
"""Bytes tolerated after the last field: senders round sizes up by at most this much."""

_BYTE_ORDERS: Final[dict[bytes, Literal["<", ">"]]] = {b"\x00\x00": ">", b"\x00\x01": "<"}


class CdrReader:
    """Parser of plain CDR (XCDR1), little and big endian, that records what carries meaning.

    Parameters
    ----------
    data
        The whole message, encapsulation header included.
    what
        Name of the message type, for error messages.

    Attributes
    ----------
    byte_order
        ``"<"`` or ``">"``, as ``struct`` writes it.
    constants
        Spans of everything read through `count` and `string`: what two messages must have in
        common to share a layout. Padding and surplus are not among them, as senders leave
        arbitrary bytes there.

    Raises
    ------
    MalformedMessageError
        From every method, when the bytes are not what they should be.
    """

    def __init__(self, data: Buffer, what: str) -> None:
        self._data = data
        self._what = what
        self._position = HEADER_SIZE
        if len(data) < HEADER_SIZE:
            raise self.error(f"has {len(data)} bytes, too few for a header")
        byte_order = _BYTE_ORDERS.get(bytes(data[:2]))
        if byte_order is None:
            raise self.error(f"is not plain CDR: header {bytes(data[:4]).hex()}")
        self.byte_order: Literal["<", ">"] = byte_order
        self.constants: list[Span] = [(0, 2)]
        self._int32 = struct.Struct(byte_order + "i")
        self._uint32 = struct.Struct(byte_order + "I")

    def error(self, reason: str) -> MalformedMessageError:
        """Return the error that says why this message is not acceptable."""
        return MalformedMessageError(f"{self._what} {reason}")

    def stamp_ns(self) -> int:
        """Read a ``builtin_interfaces/Time`` (ns)."""
        sec = int(self._int32.unpack_from(self._data, self._take(4, 4))[0])
        nanosec = int(self._uint32.unpack_from(self._data, self._take(4, 4))[0])
        return sec * NS_PER_S + nanosec

    def uint32(self) -> int:
        """Read an unsigned number that may differ from message to message."""
        return int(self._uint32.unpack_from(self._data, self._take(4, 4))[0])

    def count(self, item_size: int) -> int:
        """Read the length of a sequence whose items take at least `item_size` bytes each."""
        start = self._take(4, 4)
        count = int(self._uint32.unpack_from(self._data, start)[0])
        if count * item_size > len(self._data) - self._position:
            raise self.error(f"is truncated: {count} items announced at byte {start}")
        self.constants.append((start, start + 4))
        return count

    def string(self) -> bytes:
        """Read a string, without its terminator."""
        size = self.count(1)
        if size == 0:
            return b""
        start = self._take(size, 1)
        text = bytes(self._data[start : start + size])
        if text[-1] != 0:
            raise self.error(f"has an unterminated string at byte {start}")
        self.constants.append((start, start + size))
        return text[:-1]

    def float64s(self) -> Span:
        """Read a sequence of doubles and return the bytes of its numbers."""
        count = self.count(8)
        if count == 0:
            return self._position, self._position
        start = self._take(8 * count, 8)
        return start, self._position

    def finish(self) -> None:
        """Check that nothing but a little surplus follows."""
        surplus = len(self._data) - self._position
        if surplus > MAX_SURPLUS:
            raise self.error(f"has {surplus} bytes too many")

    def _take(self, size: int, alignment: int) -> int:
        """Step over `size` aligned bytes and return where they start."""
        start = self._position + (HEADER_SIZE - self._position) % alignment
        if start + size > len(self._data):
            raise self.error(f"is truncated: {len(self._data)} bytes, {start + size} needed")
        self._position = start + size
        return start
