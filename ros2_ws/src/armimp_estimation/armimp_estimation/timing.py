"""Timing of a run in real time: as it is kept in bags, judged, and put into the summary."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict

from pydantic import ValidationError, model_validator
from typing_extensions import Self

from armimp_common.errors import DataError
from armimp_common.realtime import LATE_NS, TimingLimits
from armimp_common.status import TimingFigures
from armimp_estimation.json_model import JsonModel, Number, first_complaint
from armimp_estimation.problems import Problem, ProblemCode, problem

RECORD_KEY = "timing"
"""Metadata of a bag: timing up to the end of its trial, as JSON."""


class Timing(JsonModel):
    """What was measured in real time, and what was allowed; durations in s."""

    ticks: int
    late: int
    missed: int
    period_p50: Number
    period_p99: Number
    period_max: Number
    latency_p50: Number
    latency_p99: Number
    latency_max: Number
    max_late_share: float
    max_missed_share: float
    max_latency: float

    @model_validator(mode="after")
    def _check_counts(self) -> Self:
        for name in ("late", "missed"):
            if not 0 <= getattr(self, name) <= self.ticks:
                raise ValueError(f"{name} must lie between 0 and {self.ticks} samples")
        return self

    @classmethod
    def of(cls, figures: TimingFigures, limits: TimingLimits) -> Timing:
        """Figures from the first sample of the run on, and limits of the run."""
        return cls(**asdict(figures), **asdict(limits))

    @property
    def problems(self) -> list[Problem]:
        """What is beyond its limit; comparisons are written so that NaN fails."""
        found = []
        for code, count, limit in (
            (ProblemCode.SAMPLES_LATE, self.late, self.max_late_share),
            (ProblemCode.COMMANDS_LATE, self.missed, self.max_missed_share),
        ):
            share = count / self.ticks if self.ticks else 0.0
            if not share <= limit:
                values = {"percent": 100.0 * share, "limit": 100.0 * limit}
                found.append(
                    problem(code, count=count, ticks=self.ticks, late_ms=LATE_NS / 1e6, **values)
                )
        if not self.latency_p99 <= self.max_latency:
            ms, limit = 1e3 * self.latency_p99, 1e3 * self.max_latency
            found.append(problem(ProblemCode.LATENCY, ms=ms, limit=limit))
        return found

    def begins(self, other: Timing) -> bool:
        """Whether this can be the beginning of the same run, which the other knows more of."""
        limits = ("max_late_share", "max_missed_share", "max_latency")
        return (
            all(getattr(self, name) == getattr(other, name) for name in limits)
            and self.ticks < other.ticks
            and self.late <= other.late
            and self.missed <= other.missed
            # Written so that what was not measured yet contradicts nothing.
            and not self.period_max > other.period_max
            and not self.latency_max > other.latency_max
        )

    @classmethod
    def from_metadata(cls, metadata: Mapping[str, str]) -> Timing | None:
        """That in the metadata of a bag; None if there is none.

        Raises
        ------
        DataError
            If it makes no sense.
        """
        if RECORD_KEY not in metadata:
            return None
        try:
            return cls.model_validate_json(metadata[RECORD_KEY])
        except ValidationError as error:
            raise DataError(f"metadata: {RECORD_KEY}: {first_complaint(error)}") from None


def latest_metadata(metadata: Sequence[Mapping[str, str]]) -> dict[str, str]:
    """Metadata of the first of some bags, with the timing that counts for all of them.

    Of one run it is that of the bag which knows most of it. Of several runs, as where a trial was
    made again, it is that of the run with most problems.

    Raises
    ------
    DataError
        If the timing of one makes no sense.
    """
    known = [one for one in map(Timing.from_metadata, metadata) if one is not None]
    if not known:
        return dict(metadata[0])
    latest = [one for one in known if not any(one.begins(other) for other in known)]
    worst = max(latest, key=lambda one: (len(one.problems), one.ticks))
    return {**metadata[0], RECORD_KEY: worst.model_dump_json()}
