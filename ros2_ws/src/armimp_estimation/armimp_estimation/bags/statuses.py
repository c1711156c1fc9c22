"""Trial statuses from and to serialised ``diagnostic_msgs/msg/DiagnosticStatus``."""

import struct
from collections.abc import Sequence

from armimp_common.cdr import CdrReader
from armimp_common.errors import MalformedMessageError
from armimp_common.status import Phase, TrialStatus


def decode_trial_status(data: bytes) -> TrialStatus:
    """Decode one message of the topic ``imbic_controller/trial``.

    Raises
    ------
    MalformedMessageError
        If the bytes are not such a message.
    """
    reader = CdrReader(data, "DiagnosticStatus")
    reader.uint32()  # the level, one byte, and the padding before the first string
    name = reader.string()
    reader.string()
    reader.string()
    pairs = [(reader.string(), reader.string()) for _ in range(reader.count(8))]
    reader.finish()
    try:
        values = {key.decode(): value.decode() for key, value in pairs}
    except UnicodeDecodeError:
        raise reader.error("has text that is not UTF-8") from None
    if name != TrialStatus.STATUS_NAME.encode():
        raise reader.error(f"is not a trial status: {name.decode(errors='replace')!r}")
    return TrialStatus.from_values(values)


def decode_trial_statuses(messages: Sequence[bytes]) -> tuple[list[TrialStatus], str]:
    """Statuses of a recording, and what is wrong with the first that is damaged, if one is."""
    statuses: list[TrialStatus] = []
    problem = ""
    for message in messages:
        try:
            statuses.append(decode_trial_status(message))
        except MalformedMessageError as error:
            problem = problem or str(error)
    return statuses, problem


def encode_trial_status(status: TrialStatus) -> bytes:
    """Encode a message of the topic ``imbic_controller/trial``, with zeros in the padding.

    The bytes are those which a typed rclpy publisher sends.
    """
    level = 2 if status.phase is Phase.ABORTED else 0 if status.valid else 1
    data = bytearray((level,))
    for text in (TrialStatus.STATUS_NAME, status.sentence, ""):
        _append(data, text)
    values = status.to_values()
    _append_uint32(data, len(values))
    for pair in values.items():
        for text in pair:
            _append(data, text)
    return b"\0\1\0\0" + bytes(data)


def _append(data: bytearray, text: str) -> None:
    encoded = text.encode() + b"\0"
    _append_uint32(data, len(encoded))
    data += encoded


def _append_uint32(data: bytearray, value: int) -> None:
    data += bytes(-len(data) % 4)
    data += struct.pack("<I", value)
