"""CDR codecs of streamed messages and of trial statuses: bounds-checked, fast, and without ROS.

Messages of one stream differ only in stamp and numbers. So their layout is parsed once, and each
further message with that layout takes one comparison and one ``struct`` call.

==================  ======================================
count               ``std_msgs/msg/UInt64``
command             ``std_msgs/msg/Float64MultiArray``
samples, τ_Δ        ``sensor_msgs/msg/JointState``
==================  ======================================
"""

from __future__ import annotations

import struct
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from operator import itemgetter
from typing import Any, Final, TypeAlias

import numpy as np

from armimp_common.arrays import FloatArray, IntArray
from armimp_common.errors import ConfigurationError, MalformedMessageError
from armimp_common.status import TrialStatus
from armimp_common.topics import NS_PER_S, TOPICS, ValueField

Buffer: TypeAlias = bytes | bytearray | memoryview
_Numbers: TypeAlias = tuple[int, int]
"""Place of the first number of a sequence of doubles in a message, and their count."""
_Columns: TypeAlias = tuple[IntArray, IntArray, FloatArray]
"""The two head numbers (N,) and the values (n, N) of many messages."""

LITTLE: Final = b"\0\1\0\0"
"""Encapsulation header of plain little-endian CDR."""
_HEADER_SIZE: Final = 4
"""Bytes of the encapsulation header, from whose end CDR counts its alignment."""
_MAX_SURPLUS: Final = 15
"""Bytes tolerated after the last field: senders round sizes up by at most this much."""
_STAMP: Final = struct.Struct("<iI")
_UINT32: Final = struct.Struct("<I")
_COUNT: Final = struct.Struct("<4sQ")
_NUMBERS: Final = struct.Struct("<4x2I")
"""Number of dimensions, and data offset, of a command."""


class _Reader:
    """Parser of plain little-endian CDR (XCDR1), which never reads past the end of a message.

    All methods raise a MalformedMessageError when the bytes are not what they should be. In
    ``constants`` are the spans of everything read through `count` and `string`: what two messages
    must have in common to share a layout. Padding and surplus are not among them, as senders leave
    arbitrary bytes there.
    """

    def __init__(self, data: Buffer, what: str) -> None:
        self._data, self._what, self._position = data, what, _HEADER_SIZE
        if len(data) < _HEADER_SIZE:
            raise self.error(f"has {len(data)} bytes, too few for a header")
        if data[:2] != LITTLE[:2]:
            raise self.error(f"is not plain little-endian CDR: header {bytes(data[:4]).hex()}")
        self.constants = [(0, 2)]

    def error(self, reason: str) -> MalformedMessageError:
        """Return the error that says why this message is not acceptable."""
        return MalformedMessageError(f"{self._what} {reason}")

    def stamp_ns(self) -> int:
        """Read a ``builtin_interfaces/Time`` (ns)."""
        sec, nanosec = _STAMP.unpack_from(self._data, self._take(8, 4))
        return int(sec) * NS_PER_S + int(nanosec)

    def uint32(self) -> int:
        """Read an unsigned number that may differ from message to message."""
        return int(_UINT32.unpack_from(self._data, self._take(4, 4))[0])

    def count(self, item_size: int) -> int:
        """Read the length of a sequence whose items take at least `item_size` bytes each."""
        count = self.uint32()
        start = self._position - 4
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

    def float64s(self) -> _Numbers:
        """Read a sequence of doubles."""
        count = self.count(8)
        return self._take(8 * count, 8) if count else self._position, count

    def finish(self) -> None:
        """Check that no more follows than a few surplus bytes."""
        surplus = len(self._data) - self._position
        if surplus > _MAX_SURPLUS:
            raise self.error(f"has {surplus} bytes too many")

    def _take(self, size: int, alignment: int) -> int:
        """Step over `size` aligned bytes and return where they start."""
        start = self._position + (_HEADER_SIZE - self._position) % alignment
        if start + size > len(self._data):
            raise self.error(f"is truncated: {len(self._data)} bytes, {start + size} needed")
        self._position = start + size
        return start


def decode_count(data: Buffer) -> int:
    """Decode a count.

    Raises
    ------
    MalformedMessageError
        On truncated or foreign bytes.
    """
    if data[:2] != LITTLE[:2] or not 0 <= len(data) - _COUNT.size <= _MAX_SURPLUS:
        raise MalformedMessageError(
            f"UInt64 is not one: {len(data)} bytes {bytes(data[:16]).hex()}"
        )
    return int(_COUNT.unpack_from(data)[1])


def encode_count(count: int) -> bytes:
    """Encode a count of 64 bits."""
    return _COUNT.pack(LITTLE, count)


class _Layout:
    """Places of the numbers in all messages that share the constant bytes of a parsed message.

    The 8 bytes after the header are unpacked as two head numbers: those of a stamp, or the number
    of dimensions and the data offset of a command. ``order`` holds, for each value to return, its
    index among the doubles.
    """

    def __init__(
        self, data: Buffer, parsed: _Reader, numbers: _Numbers, order: Sequence[int]
    ) -> None:
        self._length, self._order = len(data), list(order)
        mask = bytearray(self._length)
        for start, end in parsed.constants:
            mask[start:end] = b"\xff" * (end - start)
        self._masks = np.frombuffer(mask, np.uint8)
        self._mask = int.from_bytes(mask, "little")
        self._constant = int.from_bytes(data, "little") & self._mask
        start, count = numbers
        self._dtype = np.dtype(
            {
                "names": ["first", "second", "values"],
                "formats": ["<i4", "<u4", ("<f8", (count,))],
                "offsets": [4, 8, start],
                "itemsize": self._length,
            }
        )
        self.unpack: Callable[[Buffer], tuple[Any, ...]] = struct.Struct(
            f"<4xiI{start - 12}x{count}d{self._length - start - 8 * count}x"
        ).unpack
        places: list[Any] = [2 + index for index in order]
        if places == list(range(places[0], places[-1] + 1)):  # a single index would give no tuple
            places = [slice(places[0], places[-1] + 1)]
        self.values: Callable[[tuple[Any, ...]], tuple[float, ...]] = itemgetter(*places)

    def matches(self, data: Buffer) -> bool:
        """Tell whether a message has this layout."""
        return (
            len(data) == self._length
            and int.from_bytes(data, "little") & self._mask == self._constant
        )

    def unpack_many(self, messages: Sequence[Buffer]) -> _Columns | None:
        """Unpack head numbers and values of many messages at once; None if the layouts differ."""
        if set(map(len, messages)) - {self._length}:
            return None
        data = b"".join(messages)
        constants = np.frombuffer(data, np.uint8).reshape(-1, self._length) & self._masks
        if (constants != constants[0]).any():  # this layout is that of the first message
            return None
        rows = np.frombuffer(data, self._dtype)
        first, second = rows["first"].astype(np.int64), rows["second"].astype(np.int64)
        return first, second, np.ascontiguousarray(rows["values"][:, self._order].T, np.float64)


class _Decoder(ABC):
    """Base of decoders of a stream, which keep the layout of the last message parsed."""

    def __init__(self, count: int) -> None:
        self._count = count
        self._layout: _Layout | None = None

    @abstractmethod
    def _parse(self, data: Buffer) -> _Layout: ...

    @staticmethod
    @abstractmethod
    def _number(first: Any, second: Any) -> Any:
        """Return stamps (ns) or command numbers from the head numbers of one or many messages."""

    def decode(self, data: Buffer) -> tuple[int, tuple[float, ...]]:
        """Decode one message into its stamp (ns) or command number, and n values.

        NaN and infinities are passed on as they are.

        Raises
        ------
        MalformedMessageError
            On truncated or foreign bytes, a missing, unknown or duplicate joint, or an array
            whose length is not the number of joints.
        """
        layout = self._layout
        if layout is None or not layout.matches(data):
            layout = self._layout = self._parse(data)
        items = layout.unpack(data)
        return self._number(items[0], items[1]), layout.values(items)

    def decode_many(self, messages: Sequence[Buffer]) -> tuple[IntArray, FloatArray]:
        """Decode many messages into stamps or numbers (N,), and C-contiguous values (n, N).

        Raises as `decode`; the message of the error names the index.
        """
        numbers, values = np.zeros(len(messages), np.int64), np.empty((self._count, len(messages)))
        for index, data in enumerate(messages):
            try:
                numbers[index], values[:, index] = self.decode(data)
            except MalformedMessageError as error:
                raise MalformedMessageError(f"message {index}: {error}") from None
            if index == 0 and self._layout and (bulk := self._layout.unpack_many(messages)):
                return self._number(*bulk[:2]), bulk[2]
        return numbers, values


class JointStateEncoder:
    """Encoder of JointState messages that differ in stamp and numbers only.

    The bytes are those that a typed rclpy publisher sends, with zeros in the padding, so that
    equal runs give equal bytes.

    Parameters
    ----------
    names : joint names, in the order of the values to encode
    field : the array that takes the numbers; the two others stay empty

    Raises
    ------
    ConfigurationError
        If a name is empty, duplicate or not encodable.
    """

    def __init__(self, names: Sequence[str], field: ValueField) -> None:
        _check(names)
        count = len(names)
        before = bytearray(_string("") + struct.pack("<I", count))
        for name in names:
            before += _string(name)
        if field == "effort":
            before += bytes(8)
        before += struct.pack("<I", count)
        # The 8 bytes of the stamp stand before these, and count for the alignment.
        before += bytes(-len(before) % 8)
        self._before, self._count = bytes(before), count
        self._after = bytes(8) if field == "position" else b""
        self._pack = struct.Struct(f"<4siI{len(before)}s{count}d{len(self._after)}s").pack

    def encode(self, stamp_ns: int, values: Sequence[float] | FloatArray) -> bytes:
        """Encode (n,) numbers in the order of the names, with a stamp (ns).

        Raises
        ------
        MalformedMessageError
            If the number of values is wrong or the stamp does not fit the message.
        """
        sec, nanosec = divmod(stamp_ns, NS_PER_S)
        if isinstance(values, np.ndarray):
            values = values.tolist()  # Python's own floats are packed in a third of the time
        try:
            return self._pack(LITTLE, sec, nanosec, self._before, *values, self._after)
        except struct.error:
            raise MalformedMessageError(
                f"JointState of {self._count} joints cannot carry stamp {stamp_ns} ns with"
                f" {list(values)}"
            ) from None


class JointStateDecoder(_Decoder):
    """Decoder into stamp (ns) and values in the order of `names`, whatever that of the message.

    Parameters
    ----------
    names : the joints that every message must have; further ones are refused unless `others` is set
    field : the array that carries the numbers; the other arrays may be filled and are ignored
    others : whether messages may have further joints, which are ignored

    Raises
    ------
    ConfigurationError
        If a name is empty, duplicate or not encodable.
    """

    def __init__(self, names: Sequence[str], field: ValueField, *, others: bool = False) -> None:
        _check(names)
        super().__init__(len(names))
        self._names = [name.encode() for name in names]
        self._field, self._others = field, others

    @staticmethod
    def _number(first: Any, second: Any) -> Any:
        return first * NS_PER_S + second

    def _parse(self, data: Buffer) -> _Layout:
        reader, _, names, position, effort = _joint_state(data)
        order = self._order(names, reader)
        numbers = position if self._field == "position" else effort
        if (count := numbers[1]) != len(names):
            raise reader.error(f"has {count} {self._field} values for {len(names)} joints")
        return _Layout(data, reader, numbers, order)

    def _order(self, names: Sequence[bytes], reader: _Reader) -> list[int]:
        index = {name: place for place, name in enumerate(names)}
        if len(index) != len(names):
            raise reader.error(f"has a joint twice: {_joined(names)}")
        for name in self._names:
            if name not in index:
                raise reader.error(f"lacks joint {_joined([name])}; it has {_joined(names)}")
        if len(names) != len(self._names) and not self._others:
            unknown = [name for name in names if name not in self._names]
            raise reader.error(f"has unknown joint {_joined(unknown)}")
        return [index[name] for name in self._names]


def decode_joint_state(
    data: Buffer,
) -> tuple[int, tuple[str, ...], tuple[float, ...], tuple[float, ...]]:
    """Decode any JointState message into its stamp (ns), joint names, positions and efforts.

    Arrays are as sent, of whatever length.

    Raises
    ------
    MalformedMessageError
        If the bytes are not a JointState message.
    """
    reader, stamp_ns, names, *fields = _joint_state(data)
    position, effort = (struct.unpack_from(f"<{count}d", data, start) for start, count in fields)
    return stamp_ns, _texts(reader, names), position, effort


def joint_names_of(data: Buffer) -> tuple[str, ...]:
    """Return the joint names of a JointState message, in its order.

    Raises as `decode_joint_state`.
    """
    return decode_joint_state(data)[1]


def stamp_of(data: Buffer) -> int:
    """Return the stamp (ns) of any message that begins with a ``std_msgs/Header``.

    Raises
    ------
    MalformedMessageError
        If the bytes are too few or not CDR.
    """
    return _Reader(data, "message").stamp_ns()


class CommandEncoder:
    """Encoder of joint torques in order, as the effort controllers of ros2_controllers take them.

    Those ignore the ``layout`` of the message. Its ``data_offset`` holds the number of the command,
    from 1 on, so that subscribers can detect commands of another publisher, and missing ones.

    Parameters
    ----------
    n : number of joints
    """

    def __init__(self, n: int) -> None:
        self._n = n
        # Doubles start on a multiple of 8.
        self._pack = struct.Struct(f"<4sIII4x{n}d").pack

    def encode(self, values: Sequence[float] | FloatArray, number: int = 0) -> bytes:
        """Encode (n,) joint torques (N·m), with the number of the command or 0 for none.

        Raises
        ------
        MalformedMessageError
            If the number of values is wrong.
        """
        if isinstance(values, np.ndarray):
            values = values.tolist()
        try:
            return self._pack(LITTLE, 0, number, self._n, *values)
        except struct.error:
            raise MalformedMessageError(
                f"Float64MultiArray takes {self._n} numbers, not {list(values)}"
            ) from None


def next_number(number: int) -> int:
    """Return the command number after this one; 2³² − 1 wraps to 1, as 0 stands for none."""
    return number % 0xFFFF_FFFF + 1


def command_number(data: Buffer) -> int:
    """Return the number that a command carries, 0 if it has none."""
    if len(data) < _NUMBERS.size or data[:2] != LITTLE[:2]:
        return 0
    dimensions, number = _NUMBERS.unpack_from(data)
    return 0 if dimensions else int(number)


class CommandDecoder(_Decoder):
    """Decoder of commands into their number (0 if they have none) and `n` torques (N·m).

    The ``layout`` of the message is ignored.

    Parameters
    ----------
    n : number of joints, and so of torques in every message
    """

    @staticmethod
    def _number(first: Any, second: Any) -> Any:
        return second * (first == 0)

    def _parse(self, data: Buffer) -> _Layout:
        reader = _Reader(data, "Float64MultiArray")
        for _ in range(reader.count(12)):
            reader.string()
            reader.uint32()
            reader.uint32()
        reader.uint32()
        numbers = reader.float64s()
        reader.finish()
        if (count := numbers[1]) != self._count:
            raise reader.error(f"has {count} values for {self._count} joints")
        return _Layout(data, reader, numbers, range(count))


def decoder_of(
    topic: str, names: Sequence[str], *, others: bool = False
) -> JointStateDecoder | CommandDecoder:
    """Return the decoder of a data stream; for `names` and `others` see JointStateDecoder."""
    field = TOPICS[topic].field
    if field is None:
        return CommandDecoder(len(names))
    return JointStateDecoder(names, field, others=others)


def decode_trial_status(data: bytes) -> TrialStatus:
    """Decode one message of the topic ``imbic_controller/trial``.

    Raises
    ------
    MalformedMessageError
        If the bytes are not such a message.
    """
    reader = _Reader(data, "DiagnosticStatus")
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
    """Decode the statuses of a recording; also return the error of the first damaged one, or ""."""
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

    The bytes are those that a typed rclpy publisher sends.
    """
    values = status.to_values()
    texts = [text for pair in values.items() for text in pair]
    data = bytes((status.level, 0, 0, 0))
    data += b"".join(map(_string, (TrialStatus.STATUS_NAME, status.sentence, "")))
    data += struct.pack("<I", len(values)) + b"".join(map(_string, texts))
    # The last string is not padded, as nothing follows it.
    padding = -(len(texts[-1].encode()) + 1) % 4
    return LITTLE + data[: len(data) - padding]


def _joint_state(data: Buffer) -> tuple[_Reader, int, list[bytes], _Numbers, _Numbers]:
    """Parse a JointState: reader, stamp (ns), joint names, and places of positions and efforts."""
    reader = _Reader(data, "JointState")
    stamp_ns = reader.stamp_ns()
    reader.string()
    names = [reader.string() for _ in range(reader.count(4))]
    position, _, effort = reader.float64s(), reader.float64s(), reader.float64s()
    reader.finish()
    return reader, stamp_ns, names, position, effort


def _texts(reader: _Reader, names: Sequence[bytes]) -> tuple[str, ...]:
    try:
        return tuple(name.decode() for name in names)
    except UnicodeDecodeError:
        raise reader.error(f"has a joint name that is not UTF-8: {_joined(names)}") from None


def _check(names: Sequence[str]) -> None:
    if not names or len(set(names)) != len(names):
        raise ConfigurationError(f"joint names are not distinct: {', '.join(names) or 'none'}")
    for name in names:
        if not name or "\0" in name:
            raise ConfigurationError(f"joint name is not usable: {name!r}")
        _string(name)


def _string(text: str) -> bytes:
    """Encode a string as CDR, padded so that a number of 4 bytes can follow."""
    try:
        data = text.encode() + b"\0"
    except UnicodeEncodeError:
        raise ConfigurationError(f"text cannot be encoded: {text!r}") from None
    return struct.pack("<I", len(data)) + data + bytes(-len(data) % 4)


def _joined(names: Sequence[bytes]) -> str:
    return ", ".join(repr(name.decode(errors="replace")) for name in names) or "none"
