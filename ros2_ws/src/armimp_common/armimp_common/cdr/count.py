"""``std_msgs/msg/UInt64``: a number that counts something."""

import struct
from typing import Final

from armimp_common.cdr.reader import MAX_SURPLUS, Buffer
from armimp_common.errors import ConfigurationError, MalformedMessageError

_HEADS: Final = {b"\0\1": struct.Struct("<4xQ"), b"\0\0": struct.Struct(">4xQ")}
_PACK: Final = struct.Struct("<4sQ").pack
_SIZE: Final = 12


def encode_count(count: int) -> bytes:
    """Encode a count, as a typed rclpy publisher would send it.

    Raises
    ------
    ConfigurationError
        If it is not from 0 to 2⁶⁴ − 1.
    """
    try:
        return _PACK(b"\0\1\0\0", count)
    except struct.error:
        raise ConfigurationError(f"count does not fit a UInt64: {count}") from None


def decode_count(data: Buffer) -> int:
    """Decode a count.

    Raises
    ------
    MalformedMessageError
        On truncated or foreign bytes.
    """
    layout = _HEADS.get(bytes(data[:2]))
    if layout is None or not _SIZE <= len(data) <= _SIZE + MAX_SURPLUS:
        raise MalformedMessageError(f"UInt64 is {len(data)} bytes of something else")
    return int(layout.unpack_from(data)[0])
