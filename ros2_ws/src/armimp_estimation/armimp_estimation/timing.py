"""Timing of a run in real time: as it is kept in bags, judged, and put into the summary."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass

from pydantic import ValidationError

from armimp_common.errors import ConfigurationError, DataError
from armimp_common.jitter import TimingFigures, TimingLimits, judge_timing
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
                figures=TimingFigures(**{n: values[n] for n in TimingFigures.__annotations__}),
                limits=TimingLimits(**{n: values[n] for n in TimingLimits.__annotations__}),
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
    """Metadata of the first of some bags, with the timing of the one that knows most of the run.

    Raises
    ------
    DataError
        If the timing of one makes no sense.
    """
    told = [one[RECORD_KEY] for one in metadata if RECORD_KEY in one]
    if not told:
        return dict(metadata[0])
    latest = max(told, key=lambda text: TimingRecord.from_json(text).figures.ticks)
    return {**metadata[0], RECORD_KEY: latest}
