"""The account of the samples of a trial: what should be there, and what is."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass

from armimp_common import contract


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
    reordered : int
        Messages, without repetitions, that came after one with a later stamp.
    """

    expected: int
    received: int
    lost: int
    duplicated: int = 0
    reordered: int = 0


@dataclass(frozen=True, kw_only=True)
class SampleLedger:
    """Counts of every stream of a trial, by topic of the contract.

    Parameters
    ----------
    streams : mapping of str to StreamCount
        Commands carry no stamp, so they are only counted: neither repetitions nor order show.
    """

    streams: Mapping[str, StreamCount]

    @property
    def lost(self) -> int:
        """Messages missing from all streams together."""
        return sum(count.lost for count in self.streams.values())

    @property
    def clean(self) -> bool:
        """Whether no sample is lost, duplicated or out of order; commands do not matter here."""
        return not any(
            count.lost or count.duplicated or count.reordered
            for topic, count in self.streams.items()
            if topic != contract.COMMANDS
        )

    def to_dict(self) -> dict[str, dict[str, int]]:
        """Return the counts as plain numbers, for JSON."""
        return {topic: asdict(count) for topic, count in self.streams.items()}
