"""The messages of a bag as they are stored, before anything is made of their content."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np

TopicFilter: TypeAlias = Callable[[str], bool]
"""Tells from the name of a topic whether its messages are wanted."""


def one_line(text: object) -> str:
    """Text, or that of an error, without line breaks, which damaged files bring along."""
    return " ".join(str(text).split()) or type(text).__name__


@dataclass(eq=False)
class RawMessages:
    """Messages gathered from one or more storage files, in recorded order.

    Attributes
    ----------
    topics : list of tuple of str
        Name and message type of each recorded topic, wanted or not; the type is empty where
        the file does not say.
    topic_indices, log_times, payloads : list
        For each message its index in `topics`, its log time (ns) and its bytes.
    metadata : dict of str to str
        Metadata of the recording.
    cut : str
        Where and how the recording ends early; empty if it is whole.
    """

    topics: list[tuple[str, str]] = field(default_factory=list)
    topic_indices: list[int] = field(default_factory=list)
    log_times: list[int] = field(default_factory=list)
    payloads: list[bytes] = field(default_factory=list)
    metadata: dict[str, str] = field(default_factory=dict)
    cut: str = ""

    def topic_index(self, name: str, message_type: str) -> int:
        """Index of a topic in `topics`, which it joins if it is new."""
        entry = (one_line(name), one_line(message_type) if message_type else "")
        if entry not in self.topics:
            self.topics.append(entry)
        return self.topics.index(entry)

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
