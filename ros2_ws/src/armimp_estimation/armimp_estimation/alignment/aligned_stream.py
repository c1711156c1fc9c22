"""The messages of one stream that belong to a trial, in order and without repetitions."""

import numpy as np
from numpy.typing import NDArray

from armimp_estimation.alignment.stream_statistics import StreamCount
from armimp_estimation.alignment.trial_streams import Stream

_LATE = 0.25
"""Periods by which a step between stamps may be too long."""


class AlignedStream:
    """The messages of one stream from the start of the trial on, without repetitions.

    Attributes
    ----------
    stream : Stream
        All messages.
    start_ns : int
        Stamp of the first sample of the trial.
    period : float
        Sampling period, ns.
    order : ndarray
        Index into them of each kept one, in the order of the stamps.
    stamps, numbers : ndarray
        Stamp and number of the control period of each kept one.
    """

    def __init__(self, stream: Stream, start_ns: int, period: float) -> None:
        self.stream = stream
        self.start_ns = start_ns
        self.period = period
        stamps, order, contradicted = stream.ordered
        self._orderly = stamps is stream.stamps
        first = int(np.searchsorted(stamps, start_ns))
        self.stamps: NDArray[np.int64] = stamps[first:]
        self.order: NDArray[np.intp] = order[first:]
        self._contradicted = contradicted[first:]
        self.numbers: NDArray[np.int64] = np.empty(0, np.int64)

    def number(self, stamps: NDArray[np.int64], numbers: NDArray[np.int64]) -> None:
        """Take the period numbers from those of all stamps, and keep one message for each."""
        self.numbers = numbers[np.searchsorted(stamps, self.stamps)]
        single = np.diff(self.numbers, prepend=-1) > 0
        if not single.all():
            self.stamps, self.order = self.stamps[single], self.order[single]
            self._contradicted = self._contradicted[single]
            self.numbers = self.numbers[single]
            self._orderly = False

    def inside(self, span: int) -> int:
        """How many of the kept messages are within the span."""
        return int(np.searchsorted(self.numbers, span))

    def count(self, span: int, last_ns: int) -> StreamCount:
        """Make up the account of the periods before `span`, the last stamp of which is given."""
        distinct = self.inside(span)
        received, reordered = distinct, 0
        if not self._orderly:
            stamps = self.stream.stamps
            received = int(((stamps >= self.start_ns) & (stamps <= last_ns)).sum())
            arrived = stamps[np.sort(self.order[:distinct])]
            reordered = int((arrived[1:] < np.maximum.accumulate(arrived)[:-1]).sum())
        steps = np.diff(self.stamps[:distinct]) - self.period * np.diff(self.numbers[:distinct])
        return StreamCount(
            expected=span,
            received=received,
            lost=span - distinct,
            duplicated=received - distinct,
            contradictory=int(self._contradicted[:distinct].sum()),
            reordered=reordered,
            late=int((steps > _LATE * self.period).sum()),
        )

    def present(self, span: int) -> NDArray[np.bool_]:
        """Whether each period of the span has a sample, finite or not."""
        found = np.zeros(span, np.bool_)
        found[self.numbers[: self.inside(span)]] = True
        return found

    def finite(self, span: int) -> NDArray[np.bool_]:
        """Whether each period of the span has a sample, and one that is finite."""
        inside = self.inside(span)
        values = self.stream.values[:, self.order[:inside]]
        finite = np.zeros(span, np.bool_)
        finite[self.numbers[:inside]] = np.isfinite(values).all(axis=0)
        return finite

    def contradicted(self, span: int) -> NDArray[np.bool_]:
        """Whether each period of the span has samples that contradict each other."""
        inside = self.inside(span)
        found = np.zeros(span, np.bool_)
        found[self.numbers[:inside]] = self._contradicted[:inside]
        return found

    def values(self, start: int, stop: int) -> NDArray[np.float64]:
        """(n, stop - start) values of a run of periods, all of which are there."""
        return np.ascontiguousarray(self.stream.values[:, self.chosen(start, stop)])

    def chosen(self, start: int, stop: int) -> NDArray[np.intp]:
        """Ordinal numbers, in the stream, of the messages of a run of periods."""
        first = int(np.searchsorted(self.numbers, start))
        return self.order[first : first + stop - start]

    def stamp(self, number: int) -> int:
        """Stamp (ns) of the sample of a period, which is there."""
        return int(self.stamps[np.searchsorted(self.numbers, number)])
