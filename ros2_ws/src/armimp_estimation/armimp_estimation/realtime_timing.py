"""Timing of a run in real time: as it is kept in bags, judged, and put into the summary."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields

from pydantic import ValidationError

from armimp_common.errors import ConfigurationError, DataError
from armimp_common.realtime import TimingLimits, judge_timing
from armimp_common.status import TimingFigures
from armimp_estimation.json_model import first_complaint
from armimp_estimation.results import TimingSummary

RECORD_KEY = "timing"
"""Metadata of a bag: timing up to the end of its trial, as JSON."""


@dataclass(frozen=True, kw_only=True)
class TimingRecord:
    """What was measured, and what was allowed.

    Parameters
    ----------
    figures : TimingFigures
        From the first sample of the run on.
    limits : TimingLimits
        Limits of the run.
    """

    figures: TimingFigures
    limits: TimingLimits

    @property
    def problems(self) -> list[str]:
        """What is beyond its limit, in words."""
        return judge_timing(self.figures, self.limits)

    @property
    def summary(self) -> TimingSummary:
        """The same for ``summary.json``."""
        return TimingSummary.model_validate({**asdict(self.figures), **asdict(self.limits)})

    def begins(self, other: TimingRecord) -> bool:
        """Whether this can be the beginning of the same run, which the other knows more of."""
        mine, later = self.figures, other.figures
        return (
            self.limits == other.limits
            and mine.ticks < later.ticks
            and mine.late <= later.late
            and mine.missed <= later.missed
            # Written so that what was not measured yet contradicts nothing.
            and not mine.period_max > later.period_max
            and not mine.latency_max > later.latency_max
        )

    def to_json(self) -> str:
        """Return the record as JSON; what is not a number is null."""
        return self.summary.model_dump_json()

    @classmethod
    def of(cls, summary: TimingSummary) -> TimingRecord:
        """Rebuild the record behind a summary.

        Raises
        ------
        DataError
            If it contradicts itself.
        """
        values = summary.model_dump()
        try:
            return cls(
                figures=TimingFigures(
                    **{one.name: values[one.name] for one in fields(TimingFigures)}
                ),
                limits=TimingLimits(**{one.name: values[one.name] for one in fields(TimingLimits)}),
            )
        except ConfigurationError as error:
            raise DataError(str(error)) from None

    @classmethod
    def from_json(cls, text: str) -> TimingRecord:
        """Rebuild a record from the metadata of a bag.

        Raises
        ------
        DataError
            If it makes no sense.
        """
        try:
            return cls.of(TimingSummary.model_validate(json.loads(text)))
        except ValidationError as error:
            reason = first_complaint(error)
        except (ValueError, RecursionError):
            reason = f"not JSON: {text[:60]!r}"
        except DataError as error:
            reason = str(error)
        raise DataError(f"metadata: {RECORD_KEY}: {reason}")


def latest_metadata(metadata: Sequence[Mapping[str, str]]) -> dict[str, str]:
    """Metadata of the first of some bags, with the timing that counts for all of them.

    Of one run it is that of the bag which knows most of it. Of several runs, as where a trial was
    made again, it is that of the run with most problems.

    Raises
    ------
    DataError
        If the timing of one makes no sense.
    """
    told = [TimingRecord.from_json(one[RECORD_KEY]) for one in metadata if RECORD_KEY in one]
    if not told:
        return dict(metadata[0])
    whole = [one for one in told if not any(one.begins(other) for other in told)]
    worst = max(whole, key=lambda one: (len(one.problems), one.figures.ticks))
    return {**metadata[0], RECORD_KEY: worst.to_json()}
