"""Collection of the messages of the four streams, so that many samples are recorded at once."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from armimp_common.topics import DATA_STREAMS, PERTURBATION, RECEIVED_EVERY

TOGETHER = 50
"""Samples that are recorded at a time; if the process is killed, those still waiting are lost."""
_PATIENCE = 20
"""A perturbation, usually the last message of its sample, waits for the other messages until this
many more perturbations have come."""
_KEPT = 2000
"""Messages of other streams wait for their perturbation until this many more have come, as the
controller may have stalled."""


class StreamSynchronizer:
    """Keeps the messages of the four streams, each in order of arrival, until they are taken out.

    Parameters
    ----------
    sources : mapping of str to callable
        One for each of :data:`armimp_common.topics.DATA_STREAMS`, which returns the messages that
        have come since its last call.
    on_samples : callable, optional
        Called whenever the number of complete samples has passed another multiple of
        :data:`armimp_common.topics.RECEIVED_EVERY`, with that multiple.
    """

    def __init__(
        self,
        sources: Mapping[str, Callable[[], Sequence[bytes]]],
        on_samples: Callable[[int], None] = lambda _: None,
    ) -> None:
        self._sources, self._on_samples = sources, on_samples
        self._waiting: dict[str, list[bytes]] = {topic: [] for topic in DATA_STREAMS}
        self.open()

    def open(self) -> None:
        """Start anew, and discard all messages that have come."""
        self._open = True
        self._fetch()
        for waiting in self._waiting.values():
            waiting.clear()
        self._taken = dict.fromkeys(DATA_STREAMS, 0)
        self._announced = 0

    def close(self) -> None:
        """Fetch for the last time; messages that are waiting can still be taken out."""
        self._fetch()
        self._open = False

    def poll(self) -> None:
        """Fetch new messages, and announce how many samples are complete."""
        self._fetch()
        samples = min(self._counts().values()) // RECEIVED_EVERY * RECEIVED_EVERY
        if self._open and samples > self._announced:
            self._announced = samples
            self._on_samples(samples)

    def take(self, *, incomplete: bool = False) -> dict[str, list[bytes]]:
        """Take out the waiting messages, by topic.

        Parameters
        ----------
        incomplete : bool
            Whether to include messages of samples that are not complete yet.
        """
        self._fetch()
        counts = self._counts()
        most = max(counts.values())
        upto = max(min(counts.values()), counts[PERTURBATION] - _PATIENCE, most - _KEPT)
        if incomplete:
            upto = most
        taken: dict[str, list[bytes]] = {}
        for topic, waiting in self._waiting.items():
            count = max(upto - self._taken[topic], 0)
            taken[topic] = waiting[:count]
            del waiting[:count]
            self._taken[topic] += len(taken[topic])
        return taken

    def _fetch(self) -> None:
        if self._open:
            for topic, fetch in self._sources.items():
                self._waiting[topic].extend(fetch())

    def _counts(self) -> dict[str, int]:
        """Number of messages of each stream so far."""
        return {topic: self._taken[topic] + len(raws) for topic, raws in self._waiting.items()}
