"""Collecting the messages of the four streams, so that many samples are recorded at once."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from armimp_common.topics import DATA_STREAMS, PERTURBATION, RECEIVED_EVERY

TOGETHER = 50
"""Samples that are recorded at a time; those that still wait are lost if the process is killed."""
_PATIENCE = 20
"""A perturbation waits for the other messages of its sample until this many more have come."""
_KEPT = 2000
"""Messages of the other streams wait for their perturbation until this many more have come: it may
be late, since its callback has to wait for its turn while the others are fetched."""

FETCHED = tuple(topic for topic in DATA_STREAMS if topic != PERTURBATION)
"""Streams that are fetched. The perturbation, mostly the last message of its sample, leads."""


class StreamSynchronizer:
    """Keeps the messages of the four streams, each in its order, until they are taken out.

    Those of the perturbation are handed in one by one. The others are fetched with every tenth of
    them, and before anything is taken out.

    Parameters
    ----------
    sources : mapping of str to callable
        For each of :data:`FETCHED`: gives the messages that have come since it was called last.
    on_samples : callable, optional
        Called with the number of samples of which all messages have come, whenever it has passed
        another multiple of :data:`armimp_common.topics.RECEIVED_EVERY`; with that multiple.
    on_behind : callable, optional
        Called when others than the perturbation are still to come, for which one must :meth:`poll`.
    """

    def __init__(
        self,
        sources: Mapping[str, Callable[[], Sequence[bytes]]],
        on_samples: Callable[[int], None] = lambda _: None,
        on_behind: Callable[[], None] = lambda: None,
    ) -> None:
        self._on_samples, self._on_behind = on_samples, on_behind
        self._waiting: dict[str, list[bytes]] = {topic: [] for topic in DATA_STREAMS}
        self._sources = {topic: sources[topic] for topic in FETCHED}
        self.open()

    def open(self) -> None:
        """Begin anew, as if nothing had come."""
        self._fetch()
        for waiting in self._waiting.values():
            waiting.clear()
        self._taken = dict.fromkeys(DATA_STREAMS, 0)
        self._leading = self._announced = 0
        self._open, self._behind = True, False

    def close(self) -> None:
        """Take no more messages than have come; what waits can still be taken out."""
        if self._open:
            self._fetch()
        self._open = False

    def receive(self, message: bytes) -> None:
        """Take a message of the perturbation."""
        if self._open:
            self._waiting[PERTURBATION].append(message)
            self._leading += 1
            if self._behind or self._leading % RECEIVED_EVERY == 0:
                self.poll()

    def poll(self) -> bool:
        """Fetch what has come, and announce how many samples are complete.

        Returns
        -------
        bool
            Whether there is more to come, so that one should poll again.
        """
        if not self._open:
            return False
        self._fetch()
        samples = self.samples // RECEIVED_EVERY * RECEIVED_EVERY
        was_behind = self._behind
        self._behind = samples < self._leading // RECEIVED_EVERY * RECEIVED_EVERY
        if self._behind and not was_behind:
            self._on_behind()
        if samples > self._announced:
            self._announced = samples
            self._on_samples(samples)
        return self._behind

    def _fetch(self) -> None:
        for topic, fetch in self._sources.items():
            self._waiting[topic].extend(fetch())

    @property
    def samples(self) -> int:
        """Number of samples so far of which all messages have come, of those that were fetched."""
        return min(self._counts())

    def take(self, *, incomplete: bool = False) -> dict[str, list[bytes]]:
        """Take out what waits, by topic.

        Parameters
        ----------
        incomplete : bool
            Whether to take messages, too, that others of the same sample may still follow.
        """
        if self._open:
            self._fetch()
        counts = self._counts()
        upto = max(min(counts), self._leading - _PATIENCE, max(counts) - _KEPT)
        if incomplete:
            upto = max(counts)
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
