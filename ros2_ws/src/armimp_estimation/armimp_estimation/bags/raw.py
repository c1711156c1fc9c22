"""The messages of a bag as they are stored, before anything is made of their content."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from typing import Final, TypeAlias

import numpy as np

from armimp_estimation.bags.budget import MESSAGE_COST, Budget

TopicFilter: TypeAlias = Callable[[str], bool]
"""Tells from the name of a topic whether its messages are wanted."""


_LONGEST: Final = 300


def one_line(text: object) -> str:
    """Text, or that of an error, as a short line: damaged files bring along what they like."""
    line = " ".join(str(text).split()) or type(text).__name__
    return line if len(line) <= _LONGEST else f"{line[:_LONGEST]} ..."


@dataclass(eq=False)
class RawMessages:
    """Messages gathered from one or more storage files, in recorded order.

    Attributes
    ----------
    budget : Budget
        What reading may still cost.
    topics : list of tuple of str
        Name and message type of each recorded topic, wanted or not; the type is empty where
        the file does not say.
    topic_indices, log_times, payloads : list
        For each message its index in `topics`, its log time (ns) and its bytes.
    metadata : dict of str to str
        Metadata of the recording.
    cut : str
        Where and how the recording ends early; empty if it is complete.
    """

    budget: Budget
    topics: list[tuple[str, str]] = field(default_factory=list)
    topic_indices: list[int] = field(default_factory=list)
    log_times: list[int] = field(default_factory=list)
    payloads: list[bytes] = field(default_factory=list)
    metadata: dict[str, str] = field(default_factory=dict)
    cut: str = ""
    _indices: dict[tuple[str, str], int] = field(default_factory=dict)

    def topic_index(self, name: str, message_type: str) -> int:
        """Index of a topic in `topics`, which it joins if it is new."""
        entry = (one_line(name), one_line(message_type) if message_type else "")
        if (index := self._indices.setdefault(entry, len(self.topics))) == len(self.topics):
            self.topics.append(entry)
        return index

    def extend(
        self, topic_indices: Iterable[int], log_times: Iterable[int], payloads: Iterable[bytes]
    ) -> None:
        """Add messages, whose content is paid for.

        Raises
        ------
        BagError
            If they are beyond the budget.
        """
        before = len(self.payloads)
        self.topic_indices += topic_indices
        self.log_times += log_times
        self.payloads += payloads
        self.budget.spend(MESSAGE_COST * (len(self.payloads) - before))

    def sort(self) -> None:
        """Bring the messages into the order of their log times, keeping that of equal ones.

        Raises
        ------
        OverflowError
            If a log time does not fit 64 bits.
        """
        times = np.array(self.log_times, np.int64)
        if (np.diff(times) >= 0).all():
            return
        order = np.argsort(times, kind="stable").tolist()
        self.topic_indices = [self.topic_indices[i] for i in order]
        self.log_times = [self.log_times[i] for i in order]
        self.payloads = [self.payloads[i] for i in order]

    def by_topic(self) -> dict[int, list[bytes]]:
        """Messages of each topic that has any, in recorded order."""
        payloads = self.payloads
        indices = np.array(self.topic_indices, np.int64)
        return {
            int(index): [payloads[i] for i in np.flatnonzero(indices == index).tolist()]
            for index in np.unique(indices)
        }

    def __iter__(self) -> Iterator[tuple[int, int, bytes]]:
        """Topic index, log time (ns) and bytes of each message in recorded order."""
        return zip(self.topic_indices, self.log_times, self.payloads, strict=True)
