"""The account of the samples of a trial: what should be there, and what is."""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass

from armimp_common import topics


@dataclass(frozen=True, kw_only=True)
class StreamCount:
    """The messages of one stream within the span of a trial.

    ``received == expected - lost + duplicated`` always holds.

    Parameters
    ----------
    expected : int
        Control periods in the span.
    received : int
        Messages that arrived, repetitions included.
    lost : int
        Periods without a message.
    duplicated : int
        Messages whose stamp was already there.
    contradictory : int
        Periods with several messages of one stamp and different numbers: none of them is used.
    reordered : int
        Messages, without repetitions, that came after one with a later stamp.
    late : int
        Samples that were taken late: stamped over a quarter of a period after the whole number of
        periods that separates them from the sample before.
    """

    expected: int
    received: int
    lost: int
    duplicated: int = 0
    contradictory: int = 0
    reordered: int = 0
    late: int = 0


@dataclass(frozen=True, kw_only=True)
class StreamStatistics:
    """Counts of every stream of a trial, by topic of the contract.

    Parameters
    ----------
    streams : mapping of str to StreamCount
        Commands carry no stamp, so they are only counted: neither repetitions nor order show.
    clipped : int
        Commands that the controller had to limit, by its own account.
    excluded : int
        Control periods that no estimate may use: lost, contradictory or not finite on a stream
        with stamps, or under a command that was clipped or faulty.
    stretches : int
        Runs of at least two periods between those.
    """

    streams: Mapping[str, StreamCount]
    clipped: int = 0
    excluded: int = 0
    stretches: int = 0

    @property
    def lost(self) -> int:
        """Messages missing from all streams together."""
        return self.total("lost")

    @property
    def span(self) -> int:
        """Control periods that should be there."""
        return max((count.expected for count in self.streams.values()), default=0)

    @property
    def excluded_share(self) -> float:
        """Share of the span that is excluded, from 0 to 1."""
        return self.excluded / self.span if self.span else 0.0

    def total(self, kind: str) -> int:
        """Sum of one of the counts over all streams."""
        return sum(int(getattr(count, kind)) for count in self.streams.values())

    @property
    def clean(self) -> bool:
        """Whether no sample is lost, duplicated or out of order; commands do not matter here."""
        return not any(
            count.lost or count.duplicated or count.reordered
            for topic, count in self.streams.items()
            if topic != topics.COMMANDS
        )

    def to_dict(self) -> dict[str, dict[str, int]]:
        """Return the counts as plain numbers, for JSON."""
        return {topic: asdict(count) for topic, count in self.streams.items()}

    def to_json(self) -> str:
        """Return the whole account as JSON, as it is stored in a bag."""
        rest = {"clipped": self.clipped, "excluded": self.excluded, "stretches": self.stretches}
        return json.dumps({"streams": self.to_dict(), **rest})
