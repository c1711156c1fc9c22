"""Messages that have come and wait to be recorded, as many ticks at once are cheaper than one."""

from __future__ import annotations

from collections.abc import Callable

from armimp_common.cdr import stamp_of
from armimp_common.contract import DATA_STREAMS, PERTURBATION
from armimp_common.errors import MalformedMessageError

TOGETHER = 50
"""Samples that are recorded at a time; those that wait for it are lost if the process is killed."""
_PATIENCE = 20
"""Samples for which messages wait for others of the same sample."""


class Inbox:
    """The messages of the four streams, each in the order in which they came."""

    def __init__(self) -> None:
        self._waiting: dict[str, list[bytes]] = {topic: [] for topic in DATA_STREAMS}
        self._taken = dict.fromkeys(DATA_STREAMS, 0)

    def receiver(self, topic: str) -> Callable[[bytes], None]:
        """What takes the messages of a topic of the contract."""
        return self._waiting[topic].append

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

    def clear(self) -> None:
        """Forget everything, as if nothing had come."""
        for topic, waiting in self._waiting.items():
            waiting.clear()
            self._taken[topic] = 0

    def _counts(self) -> list[int]:
        """Number of messages so far, of each stream."""
        return [self._taken[topic] + len(waiting) for topic, waiting in self._waiting.items()]
