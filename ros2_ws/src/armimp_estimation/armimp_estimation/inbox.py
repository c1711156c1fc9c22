"""Messages that have come and wait to be recorded, as many ticks at once are cheaper than one."""

from __future__ import annotations

from collections.abc import Callable

from armimp_common.cdr import stamp_of
from armimp_common.contract import DATA_STREAMS, PERTURBATION, RECEIVED_EVERY
from armimp_common.errors import MalformedMessageError

TOGETHER = 50
"""Samples that are recorded at a time; those that wait for it are lost if the process is killed."""
_PATIENCE = 20
"""Samples for which messages wait for others of the same sample."""


class Inbox:
    """The messages of the four streams, each in the order in which they came.

    Parameters
    ----------
    on_samples : callable, optional
        Called with the number of samples of which all messages have come, whenever it has passed
        another multiple of :data:`armimp_common.contract.RECEIVED_EVERY`; with that multiple.
    """

    def __init__(self, on_samples: Callable[[int], None] = lambda _: None) -> None:
        self._on_samples = on_samples
        self._waiting: dict[str, list[bytes]] = {topic: [] for topic in DATA_STREAMS}
        self.open()

    def open(self) -> None:
        """Begin anew, as if nothing had come."""
        for waiting in self._waiting.values():
            waiting.clear()
        self._taken = dict.fromkeys(DATA_STREAMS, 0)
        self._leading = self._told = 0
        self._open, self._behind = True, False

    def close(self) -> None:
        """Take no more messages; what waits can still be taken out."""
        self._open = False

    def receiver(self, topic: str) -> Callable[[bytes], None]:
        """What takes the messages of a topic of the contract."""
        receive = self._waiting[topic].append

        def on_message(message: bytes) -> None:
            if self._open:
                receive(message)
                if self._behind:
                    self._take_stock()

        def on_leading(message: bytes) -> None:
            if self._open:
                receive(message)
                self._leading += 1
                if self._leading % RECEIVED_EVERY == 0:
                    self._take_stock()

        # The perturbation is mostly the last message of its sample.
        return on_leading if topic == PERTURBATION else on_message

    def _take_stock(self) -> None:
        samples = self.samples // RECEIVED_EVERY * RECEIVED_EVERY
        # Another stream is the last, then, as after a halt of the process.
        self._behind = samples < self._leading // RECEIVED_EVERY * RECEIVED_EVERY
        if samples > self._told:
            self._told = samples
            self._on_samples(samples)

    @property
    def samples(self) -> int:
        """Number of samples so far of which all messages have come."""
        return min(self._counts())

    @property
    def newest_ns(self) -> int | None:
        """Stamp of the last perturbation that waits (ns); None without one, or if it has none."""
        waiting = self._waiting[PERTURBATION]
        try:
            return stamp_of(waiting[-1]) if waiting else None
        except MalformedMessageError:
            return None

    def take(self, *, incomplete: bool = False) -> dict[str, list[bytes]]:
        """Take out what waits, by topic.

        Parameters
        ----------
        incomplete : bool
            Whether to take messages, too, that others of the same sample may still follow.
        """
        counts = self._counts()
        upto = max(counts) if incomplete else max(min(counts), max(counts) - _PATIENCE)
        taken: dict[str, list[bytes]] = {}
        for topic, waiting in self._waiting.items():
            count = max(upto - self._taken[topic], 0)
            taken[topic] = waiting[:count]
            del waiting[:count]
            self._taken[topic] += len(taken[topic])
        return taken

    def _counts(self) -> list[int]:
        """Number of messages so far, of each stream."""
        return [self._taken[topic] + len(waiting) for topic, waiting in self._waiting.items()]
