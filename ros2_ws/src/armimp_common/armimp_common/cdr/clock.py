"""``rosgraph_msgs/msg/Clock``: simulated time."""

import struct
from typing import Final

from armimp_common.contract import NS_PER_S
from armimp_common.errors import ConfigurationError

_PACK: Final = struct.Struct("<4siI").pack


def encode_clock(stamp_ns: int) -> bytes:
    """Encode a time (ns), as a typed rclpy publisher would send it.

    Raises
    ------
    ConfigurationError
        If its seconds do not fit 32 bits.
    """
    try:
        return _PACK(b"\0\1\0\0", *divmod(stamp_ns, NS_PER_S))
    except struct.error:
        raise ConfigurationError(f"time does not fit a Clock: {stamp_ns} ns") from None
