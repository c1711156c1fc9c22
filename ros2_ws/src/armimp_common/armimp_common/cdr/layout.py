"""Where the stamp and the numbers are in messages of one layout, and fast access to them."""

import struct
from collections.abc import Callable, Sequence
from operator import itemgetter
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from armimp_common.cdr.reader import Buffer, Span
from armimp_common.contract import NS_PER_S


class Layout:
    """The layout of one parsed message, to recognise and decode others that share it.

    Parameters
    ----------
    data
        The message which was parsed.
    byte_order
        ``"<"`` or ``">"``.
    constants
        Spans of the bytes which must be equal in a message of the same layout.
    stamp
        Start of the eight bytes of the stamp, or None if the message has none.
    numbers
        Span of the doubles to extract.
    order
        For each value to return, its index among the doubles.

    Attributes
    ----------
    length, mask, constant
        A message `m` has this layout if ``len(m) == length`` and
        ``int.from_bytes(m, "little") & mask == constant``.
    unpack
        Returns the bytes before the stamp, seconds and nanoseconds (where there is a stamp), the
        bytes before the doubles, these, and the bytes behind them.
    head, before, after
        These bytes in the message that was parsed (no `head` where there is no stamp). A message of
        the same `length` with the same ones has this layout, which is sooner found out than by the
        mask. Others may have it, too, as senders leave arbitrary bytes in the padding.
    values
        Picks the values, in order, from what `unpack` returned.
    """

    __slots__ = (
        "_byte_order",
        "_constant_bytes",
        "_constants",
        "_numbers",
        "_order",
        "_stamp",
        "after",
        "before",
        "constant",
        "head",
        "length",
        "mask",
        "unpack",
        "values",
    )

    def __init__(
        self,
        data: Buffer,
        *,
        byte_order: Literal["<", ">"],
        constants: Sequence[Span],
        stamp: int | None,
        numbers: Span,
        order: Sequence[int],
    ) -> None:
        self._byte_order = byte_order
        self._constants = _merged(constants)
        self._constant_bytes = [
            np.frombuffer(bytes(data[start:end]), np.uint8) for start, end in self._constants
        ]
        self._stamp = stamp
        self._numbers = numbers
        self._order = list(order)
        self.length = len(data)
        mask = bytearray(self.length)
        for start, end in self._constants:
            mask[start:end] = b"\xff" * (end - start)
        self.mask = int.from_bytes(mask, "little")
        self.constant = int.from_bytes(data, "little") & self.mask
        count = (numbers[1] - numbers[0]) // 8
        head = "" if stamp is None else f"{stamp}siI"
        skipped = 0 if stamp is None else stamp + 8
        self.unpack: Callable[[Buffer], tuple[Any, ...]] = struct.Struct(
            f"{byte_order}{head}{numbers[0] - skipped}s{count}d{self.length - numbers[1]}s"
        ).unpack
        first = 1 if stamp is None else 4
        self.head = bytes(data[:stamp]) if stamp is not None else b""
        self.before, self.after = bytes(data[skipped : numbers[0]]), bytes(data[numbers[1] :])
        self.values = _picker([first + index for index in self._order])

    def matches(self, data: Buffer) -> bool:
        """Tell whether a message has this layout."""
        return (
            len(data) == self.length and int.from_bytes(data, "little") & self.mask == self.constant
        )

    def unpack_many(
        self, messages: Sequence[Buffer]
    ) -> tuple[NDArray[np.int64], NDArray[np.float64]] | None:
        """Decode many messages at once.

        Returns
        -------
        stamps : (N,) array, or (0,) where the layout has no stamp
            Nanoseconds.
        values : (n, N) C-contiguous array
            The values in order.
        None
            If any of the messages has another layout.
        """
        length = self.length
        if set(map(len, messages)) - {length}:
            return None
        table = np.frombuffer(b"".join(messages), np.uint8).reshape(len(messages), length)
        for (start, end), expected in zip(self._constants, self._constant_bytes, strict=True):
            if not (table[:, start:end] == expected).all():
                return None
        stamps = np.empty(0, np.int64)
        if self._stamp is not None:
            sec = self._column(table, self._stamp, "i4")
            nanosec = self._column(table, self._stamp + 4, "u4")
            stamps = sec.astype(np.int64) * NS_PER_S + nanosec.astype(np.int64)
        values = np.empty((len(self._order), len(messages)), np.float64)
        for row, index in enumerate(self._order):
            values[row] = self._column(table, self._numbers[0] + 8 * index, "f8")
        return stamps, values

    def _column(self, table: NDArray[np.uint8], start: int, kind: str) -> NDArray[Any]:
        dtype = np.dtype(self._byte_order + kind)
        column: NDArray[Any] = np.ndarray(
            (table.shape[0],), dtype, buffer=table.data, offset=start, strides=(table.strides[0],)
        )
        return column


class _NoLayout(Layout):
    """Stands for "nothing seen yet", so that the hot path needs no test for None."""

    __slots__ = ()

    def __init__(self) -> None:
        super().__init__(b"", byte_order="<", constants=(), stamp=None, numbers=(0, 0), order=())
        self.length = -1


def _picker(indices: Sequence[int]) -> Callable[[tuple[Any, ...]], tuple[float, ...]]:
    """Return a function that picks these items of a tuple, as a tuple."""
    first = indices[0] if indices else 0
    end = first + len(indices)
    if list(indices) == list(range(first, end)):
        return itemgetter(slice(first, end))
    # With a single index itemgetter would not return a tuple, hence the slice above for n = 1.
    return itemgetter(*indices)


def _merged(spans: Sequence[Span]) -> list[Span]:
    """Join spans that touch, so that fewer comparisons are needed."""
    merged: list[Span] = []
    for start, end in sorted(spans):
        if merged and start <= merged[-1][1]:
            merged[-1] = (merged[-1][0], max(end, merged[-1][1]))
        else:
            merged.append((start, end))
    return merged


NO_LAYOUT: Final[Layout] = _NoLayout()
