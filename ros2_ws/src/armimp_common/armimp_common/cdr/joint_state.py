"""``sensor_msgs/msg/JointState`` whose numbers are in one of its arrays."""

import struct
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from armimp_common.cdr.layout import NO_LAYOUT, Layout
from armimp_common.cdr.reader import HEADER_SIZE, Buffer, CdrReader
from armimp_common.contract import NS_PER_S, ValueField
from armimp_common.errors import ConfigurationError, MalformedMessageError

_WHAT: Final = "JointState"

_FIELDS: Final[tuple[ValueField, ...]] = ("position", "effort")


class JointStateEncoder:
    """Encoder of messages that differ in stamp and numbers only.

    The bytes are those which a typed rclpy publisher sends, with zeros in the padding, so that
    equal runs give equal bytes.

    Parameters
    ----------
    names
        Joint names, in the order of the values to encode.
    field
        The array that takes the numbers; the two others stay empty.
    frame_id
        ``header.frame_id``.

    Raises
    ------
    ConfigurationError
        If a name is empty, doubled or not encodable, or the field is not known.
    """

    def __init__(self, names: Sequence[str], field: ValueField, frame_id: str = "") -> None:
        _check(names, field)
        count = len(names)
        before = bytearray(_string(frame_id))
        # Eight bytes that count for alignment, the stamp, stand before.
        _pad(before, 4)
        before += struct.pack("<I", count)
        for name in names:
            before += _string(name)
            _pad(before, 4)
        if field == "effort":
            before += bytes(8)
        before += struct.pack("<I", count)
        _pad(before, 8)
        after = bytes(8) if field == "position" else b""
        self._pack = struct.Struct(f"<4siI{len(before)}s{count}d{len(after)}s").pack
        self._before = bytes(before)
        self._after = after
        self._count = count

    def encode(self, stamp_ns: int, values: Sequence[float] | NDArray[np.float64]) -> bytes:
        """Encode one message.

        Parameters
        ----------
        stamp_ns
            Header stamp (ns).
        values
            (n,) numbers in the order of the names.

        Raises
        ------
        MalformedMessageError
            If the number of values is wrong or the stamp does not fit the message.
        """
        sec, nanosec = divmod(stamp_ns, NS_PER_S)
        if isinstance(values, np.ndarray):
            values = values.tolist()  # numbers of Python's own are packed in a third of the time
        try:
            return self._pack(b"\0\1\0\0", sec, nanosec, self._before, *values, self._after)
        except struct.error:
            if len(values) != self._count:
                raise MalformedMessageError(
                    f"{_WHAT} takes {self._count} values, not {len(values)}"
                ) from None
            raise MalformedMessageError(
                f"{_WHAT} cannot carry stamp {stamp_ns} ns with {list(values)}"
            ) from None


class JointStateDecoder:
    """Decoder that returns the values in the order of `names`, whatever order they came in.

    Parameters
    ----------
    names
        The joints that every message must have, no more and no less.
    field
        The array that carries the numbers; others may be filled and are ignored.
    others
        Whether messages may have further joints, which are ignored.

    Raises
    ------
    ConfigurationError
        If a name is empty, doubled or not encodable, or the field is not known.
    """

    def __init__(self, names: Sequence[str], field: ValueField, *, others: bool = False) -> None:
        _check(names, field)
        self._others = others
        self._names = [name.encode() for name in names]
        self._field: ValueField = field
        self._layout = NO_LAYOUT

    def decode(self, data: Buffer) -> tuple[int, tuple[float, ...]]:
        """Decode one message; the numbers are passed on as they are, NaN and infinities too.

        Returns
        -------
        stamp_ns : int
            Header stamp (ns).
        values : tuple of n floats
            Numbers in the order of the names.

        Raises
        ------
        MalformedMessageError
            On truncated or foreign bytes, a missing, unknown or doubled joint, or an array
            whose length is not the number of joints.
        """
        layout = self._layout
        if len(data) == layout.length:
            items = layout.unpack(data)
            if (
                items[0] == layout.head and items[3] == layout.before and items[-1] == layout.after
            ) or layout.matches(data):
                return items[1] * NS_PER_S + items[2], layout.values(items)
        layout = self._layout = self._parse(data)
        items = layout.unpack(data)
        return items[1] * NS_PER_S + items[2], layout.values(items)

    def decode_many(
        self, messages: Sequence[Buffer]
    ) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Decode many messages, at once if all of them have the same layout.

        Returns
        -------
        stamps : (N,) array
            Header stamps (ns).
        values : (n, N) C-contiguous array
            Numbers in the order of the names.

        Raises
        ------
        MalformedMessageError
            As `decode`, with the index of the message.
        """
        if messages and self._try_layout(messages[0]):
            bulk = self._layout.unpack_many(messages)
            if bulk is not None:
                return bulk
        stamps = np.empty(len(messages), np.int64)
        values = np.empty((len(self._names), len(messages)), np.float64)
        for index, data in enumerate(messages):
            try:
                stamps[index], values[:, index] = self.decode(data)
            except MalformedMessageError as error:
                raise MalformedMessageError(f"message {index}: {error}") from None
        return stamps, values

    def _try_layout(self, data: Buffer) -> bool:
        try:
            if not self._layout.matches(data):
                self._layout = self._parse(data)
        except MalformedMessageError:
            return False
        return True

    def _parse(self, data: Buffer) -> Layout:
        reader = CdrReader(data, _WHAT)
        reader.stamp_ns()
        reader.string()
        names = [reader.string() for _ in range(reader.count(4))]
        position = reader.float64s()
        reader.float64s()
        effort = reader.float64s()
        reader.finish()
        order = self._order(names, reader)
        numbers = position if self._field == "position" else effort
        count = (numbers[1] - numbers[0]) // 8
        if count != len(names):
            raise reader.error(f"has {count} {self._field} values for {len(names)} joints")
        return Layout(
            data,
            byte_order=reader.byte_order,
            constants=reader.constants,
            stamp=HEADER_SIZE,
            numbers=numbers,
            order=order,
        )

    def _order(self, names: Sequence[bytes], reader: CdrReader) -> list[int]:
        if list(names) == self._names:
            return list(range(len(names)))
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


def joint_names_of(data: Buffer) -> tuple[str, ...]:
    """Return the joint names in the order in which a JointState message has them.

    Raises
    ------
    MalformedMessageError
        If the bytes are not a JointState message.
    """
    reader = CdrReader(data, _WHAT)
    reader.stamp_ns()
    reader.string()
    names = [reader.string() for _ in range(reader.count(4))]
    for _ in range(3):
        reader.float64s()
    reader.finish()
    try:
        return tuple(name.decode() for name in names)
    except UnicodeDecodeError:
        raise reader.error(f"has a joint name that is not UTF-8: {_joined(names)}") from None


def stamp_of(data: Buffer) -> int:
    """Return the stamp (ns) of any message that begins with a ``std_msgs/Header``.

    Raises
    ------
    MalformedMessageError
        If the bytes are too few or not CDR.
    """
    return CdrReader(data, "message").stamp_ns()


def _check(names: Sequence[str], field: ValueField) -> None:
    if field not in _FIELDS:
        raise ConfigurationError(f"field is not one of {', '.join(_FIELDS)}: {field!r}")
    if not names or len(set(names)) != len(names):
        raise ConfigurationError(f"joint names are not distinct: {', '.join(names) or 'none'}")
    for name in names:
        if not name or "\0" in name:
            raise ConfigurationError(f"joint name is not usable: {name!r}")
        _string(name)


def _string(text: str) -> bytes:
    try:
        data = text.encode() + b"\0"
    except UnicodeEncodeError:
        raise ConfigurationError(f"text cannot be encoded: {text!r}") from None
    return struct.pack("<I", len(data)) + data


def _pad(data: bytearray, alignment: int) -> None:
    data += bytes(-len(data) % alignment)


def _joined(names: Sequence[bytes]) -> str:
    return ", ".join(repr(name.decode(errors="replace")) for name in names) or "none"
