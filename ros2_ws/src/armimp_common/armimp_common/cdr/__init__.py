"""Fast, bounds-checked encoding and decoding of the streamed messages, without ROS.

Messages of one stream differ only in their stamp and their numbers, so a layout is parsed once
and then reused with one comparison and one ``struct`` call.
"""

from armimp_common.cdr.clock import encode_clock
from armimp_common.cdr.command import CommandDecoder, CommandEncoder, command_number, next_number
from armimp_common.cdr.count import decode_count, encode_count
from armimp_common.cdr.joint_state import (
    JointStateDecoder,
    JointStateEncoder,
    joint_names_of,
    stamp_of,
)
from armimp_common.cdr.reader import Buffer

__all__ = [
    "Buffer",
    "CommandDecoder",
    "CommandEncoder",
    "JointStateDecoder",
    "JointStateEncoder",
    "command_number",
    "decode_count",
    "encode_clock",
    "encode_count",
    "joint_names_of",
    "next_number",
    "stamp_of",
]
