"""``std_msgs/msg/Float64MultiArray`` as the effort controller takes it: joint torques in order.

Effort controllers ignore ``layout``. Its ``data_offset`` holds the number of the command, from 1
on, so that everybody can tell a command of another publisher, or one that is missing.
"""

import struct
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from armimp_common.cdr.layout import NO_LAYOUT, Layout
from armimp_common.cdr.reader import Buffer, CdrReader
from armimp_common.errors import ConfigurationError, MalformedMessageError

_WHAT: Final = "Float64MultiArray"
_ENCAPSULATION: Final = b"\0\1\0\0"
_NUMBERS: Final = tuple(struct.Struct(f"{order}2I").unpack_from for order in "><")
"""Number of dimensions and data offset, by the last bit of the encapsulation."""


class CommandEncoder:
    """Encoder of commands for `n` joints.

    Parameters
    ----------
    n
        Number of joints.

    Raises
    ------
    ConfigurationError
        If `n` is not positive.
    """

    def __init__(self, n: int) -> None:
        _check(n)
        self._pack = _plain(n).pack
        self._n = n

    def encode(self, values: Sequence[float] | NDArray[np.float64], number: int = 0) -> bytes:
        """Encode (n,) joint torques (N·m), with the number of the command or 0 for none.

        Raises
        ------
        MalformedMessageError
            If the number of values is wrong.
        """
        if isinstance(values, np.ndarray):
            values = values.tolist()  # numbers of Python's own are packed in a third of the time
        try:
            return self._pack(_ENCAPSULATION, 0, number, self._n, *values)
        except struct.error:
            raise MalformedMessageError(
                f"{_WHAT} takes {self._n} numbers, not {list(values)}"
            ) from None


def next_number(number: int) -> int:
    """Return the number of the command after that of this number; 0 is none."""
    return number % 0xFFFF_FFFF + 1


def command_number(data: Buffer) -> int:
    """Return the number that a command carries, 0 if it has none."""
    if len(data) < 12:
        return 0
    dimensions, number = _NUMBERS[data[1] & 1](data, 4)
    return 0 if dimensions else int(number)


class CommandDecoder:
    """Decoder of commands for `n` joints; the ``layout`` of the message is ignored.

    Parameters
    ----------
    n
        Number of joints, and so of numbers in every message.

    Raises
    ------
    ConfigurationError
        If `n` is not positive.
    """

    def __init__(self, n: int) -> None:
        _check(n)
        self._n = n
        self._layout = NO_LAYOUT
        self._plain = _plain(n)
        self._expected = (_ENCAPSULATION, 0, n)

    def decode_numbered(self, data: Buffer) -> tuple[int, tuple[float, ...]]:
        """Decode as :meth:`decode` does, and return the number of the command before the values."""
        if len(data) == self._plain.size:
            head, dimensions, number, count, *values = self._plain.unpack(data)
            if (head, dimensions, count) == self._expected:
                return number, tuple(values)
        torques = self.decode(data)
        return command_number(data), torques

    def decode(self, data: Buffer) -> tuple[float, ...]:
        """Decode one message into n torques (N·m), NaN and infinities passed on as they are.

        Raises
        ------
        MalformedMessageError
            On truncated or foreign bytes, or another number of values.
        """
        layout = self._layout
        if len(data) == layout.length:
            items = layout.unpack(data)
            if (items[0] == layout.before and items[-1] == layout.after) or layout.matches(data):
                return layout.values(items)
        layout = self._layout = self._parse(data)
        return layout.values(layout.unpack(data))

    def decode_many(self, messages: Sequence[Buffer]) -> NDArray[np.float64]:
        """Decode many messages into an (n, N) C-contiguous array (N·m).

        Raises
        ------
        MalformedMessageError
            As `decode`, with the index of the message.
        """
        if messages and self._try_layout(messages[0]):
            bulk = self._layout.unpack_many(messages)
            if bulk is not None:
                return bulk[1]
        values = np.empty((self._n, len(messages)), np.float64)
        for index, data in enumerate(messages):
            try:
                values[:, index] = self.decode(data)
            except MalformedMessageError as error:
                raise MalformedMessageError(f"message {index}: {error}") from None
        return values

    def _try_layout(self, data: Buffer) -> bool:
        try:
            if not self._layout.matches(data):
                self._layout = self._parse(data)
        except MalformedMessageError:
            return False
        return True

    def _parse(self, data: Buffer) -> Layout:
        reader = CdrReader(data, _WHAT)
        for _ in range(reader.count(12)):
            reader.string()
            reader.uint32()
            reader.uint32()
        reader.uint32()
        numbers = reader.float64s()
        reader.finish()
        count = (numbers[1] - numbers[0]) // 8
        if count != self._n:
            raise reader.error(f"has {count} values for {self._n} joints")
        return Layout(
            data,
            byte_order=reader.byte_order,
            constants=reader.constants,
            stamp=None,
            numbers=numbers,
            order=range(count),
        )


def _plain(n: int) -> struct.Struct:
    """No dimensions, data offset, n; then padding, since doubles start on a multiple of 8."""
    return struct.Struct(f"<4sIII4x{n}d")


def _check(n: int) -> None:
    if n < 1:
        raise ConfigurationError(f"number of joints is not positive: {n}")
