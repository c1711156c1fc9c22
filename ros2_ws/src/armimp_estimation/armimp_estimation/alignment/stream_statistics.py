"""Counts of the samples of a trial, stream by stream: lost, repeated, or out of order.

Each stream with stamps is aligned by control period. Commands have no stamps and are counted.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from typing import Any

import numpy as np
from pydantic import Field, computed_field

from armimp_common.arrays import BoolArray, IntArray
from armimp_common.topics import COMMANDS, JOINT_STATES, NS_PER_S, PERTURBATION, TORQUE_SENSORS
from armimp_estimation.alignment.streams import Stream, Streams
from armimp_estimation.alignment.trial_windows import TrialWindow, judge_stamps
from armimp_estimation.json_model import JsonModel
from armimp_estimation.problems import Problem, ProblemCode, Severity, problem
from armimp_estimation.record import TrialRecord

_STILL = 0.02
"""Largest motion of a never perturbed joint that is neglected, relative to the perturbed one's."""
_LATE = 0.25
"""Periods by which a step between stamps may be too long."""
_APART, _SCATTER = 0.4, 0.15
"""Largest mean difference between stamps of two streams, and largest scatter of it (rms), periods:
two streams that scatter by a tenth of a period each differ by 0.14."""
_TOGETHER = 0.01
"""Difference between stamps that is not reported, periods."""


class StreamCount(JsonModel):
    """The messages of one stream within the span of a trial.

    ``received == expected - lost + duplicated`` always holds.
    """

    expected: int
    """Control periods in the span; 0 for commands that were not recorded."""
    received: int
    """Messages that arrived, repetitions included."""
    lost: int
    """Periods without a message."""
    duplicated: int = 0
    """Messages with the stamp of an earlier message."""
    contradictory: int = 0
    """Periods with several messages of one stamp but different values: none of them is used."""
    reordered: int = 0
    """Messages, without repetitions, that arrived after one with a later stamp."""
    late: int = 0
    """Samples stamped over a quarter of a period after the whole number of periods that separates
    them from the sample before."""


class StreamStatistics(JsonModel):
    """Expected and received samples of a trial."""

    streams: dict[str, StreamCount] = Field(default_factory=dict)
    """Counts by topic of the contract, see below. As commands carry no stamp, their repetitions and
    order cannot be seen."""
    clipped: int = 0
    """Commands that the controller reports to have clipped."""
    excluded: int = 0
    """Control periods that no estimate may use: lost, contradictory or not finite on a stream with
    stamps, or under a command that was clipped."""
    stretches: int = 1
    """Runs of at least two usable periods."""

    def total(self, kind: str) -> int:
        """Sum of one of the counts over all streams."""
        return sum(int(getattr(count, kind)) for count in self.streams.values())

    @computed_field  # type: ignore[prop-decorator]
    @property
    def lost(self) -> int:
        """Messages missing from all streams together."""
        return self.total("lost")

    @property
    def without_commands(self) -> bool:
        """Whether the commands were not recorded."""
        commands = self.streams.get(COMMANDS)
        return commands is not None and not commands.expected

    @property
    def span(self) -> int:
        """Number of control periods that are expected."""
        return max((count.expected for count in self.streams.values()), default=0)

    @property
    def excluded_share(self) -> float:
        """Share of the span that is excluded, from 0 to 1."""
        return self.excluded / self.span if self.span else 0.0


class AlignedStream:
    """One stream from the start of a trial on, aligned by control period."""

    def __init__(self, stream: Stream, start_ns: int, period: float) -> None:
        self.stream, self.start_ns, self.period = stream, start_ns, period
        stamps, order, contradicted = stream.ordered()
        first = int(np.searchsorted(stamps, start_ns - period / 2.0))
        # Stamp (ns), index in the stream, and period number of each message that is kept.
        self.stamps, self.order = stamps[first:], order[first:]
        self._contradicted = contradicted[first:]
        self.numbers: IntArray = np.empty(0, np.int64)

    def number(self, stamps: IntArray, numbers: IntArray) -> None:
        """Look up each message's period in the `numbers` of `stamps`; keep one for each period."""
        self.numbers = numbers[np.searchsorted(stamps, self.stamps)]
        self._keep((self.numbers >= 0) & (np.diff(self.numbers, prepend=-1) > 0))

    def cut(self, span: int) -> None:
        """Keep the messages of the first `span` periods, and arrange them by period."""
        self._keep(slice(int(np.searchsorted(self.numbers, span))))
        self.values = np.full((len(self.stream.values), span), np.nan)
        self.values[:, self.numbers] = self.stream.values[:, self.order]
        self.present, self.contradicted = np.zeros(span, np.bool_), np.zeros(span, np.bool_)
        self.present[self.numbers] = True
        self.contradicted[self.numbers] = self._contradicted

    def _keep(self, chosen: slice | BoolArray) -> None:
        self.stamps, self.order = self.stamps[chosen], self.order[chosen]
        self._contradicted, self.numbers = self._contradicted[chosen], self.numbers[chosen]

    def statistics(self, last_ns: int) -> StreamCount:
        """Count the messages up to the last stamp of the trial (ns)."""
        span, distinct = self.present.size, self.numbers.size
        stamps = self.stream.stamps
        first_ns = self.stamps[0] if distinct else self.start_ns
        received = int(((stamps >= first_ns) & (stamps <= last_ns)).sum())
        arrived = stamps[np.sort(self.order)]
        steps = np.diff(self.stamps) - self.period * np.diff(self.numbers)
        return StreamCount(
            expected=span,
            received=received,
            lost=span - distinct,
            duplicated=received - distinct,
            contradictory=int(self._contradicted.sum()),
            reordered=int((arrived[1:] < np.maximum.accumulate(arrived)[:-1]).sum()),
            late=int((steps > _LATE * self.period).sum()),
        )

    def when(self, ticks: BoolArray) -> dict[str, Any]:
        """Count the periods of a mask, and tell when the first begins and the last ends, s."""
        places = np.flatnonzero(ticks)
        return {
            "count": places.size,
            "first": float(places[0] * self.period / NS_PER_S),
            "last": float((places[-1] + 1) * self.period / NS_PER_S),
        }


def account_for(
    window: TrialWindow, streams: Streams, aligned: Mapping[str, AlignedStream], last_ns: int
) -> tuple[dict[str, StreamCount], list[Problem]]:
    """Count the messages of a trial, and find what is wrong with them.

    `aligned` are the streams with stamps, by topic; `last_ns` is the last stamp of the trial in any
    of them.
    """
    leading = aligned[PERTURBATION]
    counts = {topic: one.statistics(last_ns) for topic, one in aligned.items()}
    counts[COMMANDS], foreign = _count_commands(streams, leading)
    found = list(_judge_offsets(aligned))
    if all(one.code is not ProblemCode.STAMPS_DISAGREE for one in found):
        found += _judge_streams(aligned, counts)
        found += _judge_commands(window, leading, counts[COMMANDS], foreign)
        stamps = {topic: one.stamps for topic, one in aligned.items()}
        found += judge_stamps(stamps, leading.period)
    return counts, found


def _judge_offsets(aligned: Mapping[str, AlignedStream]) -> Iterator[Problem]:
    """Report differences between the stamps of angles, torques and perturbation of one period."""
    one = aligned[JOINT_STATES]
    for topic in (TORQUE_SENSORS, PERTURBATION):
        other = aligned[topic]
        _, mine, its = np.intersect1d(
            one.numbers, other.numbers, assume_unique=True, return_indices=True
        )
        apart = (other.stamps[its] - one.stamps[mine]) / one.period
        if not apart.any():
            continue
        mean, scatter = float(np.mean(apart)), float(np.std(apart))
        far = abs(mean) > _APART or scatter > _SCATTER
        if far or max(abs(mean), scatter) > _TOGETHER:
            yield problem(
                ProblemCode.STAMPS_DISAGREE if far else ProblemCode.STAMPS_APART,
                severity=Severity.ERROR if far else Severity.NOTE,
                stream=topic,
                other=JOINT_STATES,
                apart_ms=mean * one.period / 1e6,
                scatter_ms=scatter * one.period / 1e6,
            )


def _judge_streams(
    aligned: Mapping[str, AlignedStream], counts: Mapping[str, StreamCount]
) -> Iterator[Problem]:
    """Report missing and faulty samples in the streams with stamps."""
    missing: dict[bytes, list[str]] = {}
    for topic, one in aligned.items():
        missing.setdefault(one.present.tobytes(), []).append(topic)
    for topics in missing.values():
        one = aligned[topics[0]]
        if not one.present.all():
            where = one.when(~one.present)
            yield problem(ProblemCode.SAMPLES_MISSING, stream=", ".join(topics), **where)
    for topic, one in aligned.items():
        count, stream = counts[topic], one.stream
        if stream.malformed and count.lost:
            yield problem(
                ProblemCode.SAMPLES_MALFORMED,
                stream=topic,
                count=stream.malformed,
                reason=stream.defect,
            )
        spoiled = one.present & ~np.isfinite(one.values).all(axis=0)
        for code, ticks in (
            (ProblemCode.SAMPLES_NOT_FINITE, spoiled),
            (ProblemCode.SAMPLES_CONTRADICTORY, one.contradicted),
        ):
            if ticks.any():
                yield problem(code, stream=topic, **one.when(ticks))
        for code, number in (
            (ProblemCode.SAMPLES_REPEATED, count.duplicated),
            (ProblemCode.SAMPLES_REORDERED, count.reordered),
        ):
            if number:
                yield problem(code, stream=topic, count=number)


def _count_commands(streams: Streams, leading: AlignedStream) -> tuple[StreamCount, int]:
    """Count commands by their order, as each belongs to one perturbation; also count foreign ones.

    A command is foreign if it has no number, or one that is not above the previous. If no command
    has a number, those in excess of the perturbations of the whole recording are foreign.
    """
    span, commands = leading.present.size, streams.commands
    before = int((leading.stream.stamps < leading.start_ns).sum())
    received = min(max(commands.count - before, 0), span)
    numbers = commands.stamps[: before + span]
    if numbers.any():
        # Lost commands leave a step forward; those of another sender leave a step back, too.
        back = numbers[1:] <= numbers[:-1]
        back[:before] &= ~begins_anew(numbers)[:before]
        foreign = max(int(back.sum()), int((numbers == 0).sum()))
    else:
        # A recording may end between the two messages of a tick.
        foreign = max(commands.count - leading.stream.count - 1, 0)
    expected = span if received else 0
    return StreamCount(expected=expected, received=received, lost=expected - received), foreign


def begins_anew(numbers: IntArray) -> BoolArray:
    """Mask, (N - 1,), of all commands but the first: where a controller counts from 1 again."""
    return np.asarray((numbers[1:] == 1) & (np.append(numbers[2:], 0) == 2))


def _judge_commands(
    window: TrialWindow, leading: AlignedStream, count: StreamCount, foreign: int
) -> Iterator[Problem]:
    """Report problems of the commands; there are none if no command was recorded."""
    if not count.received:
        return
    cut = not window.ended or window.fault is not None  # the last command may be missing
    if foreign:
        yield problem(ProblemCode.COMMANDS_FOREIGN, count=foreign)
    elif count.lost > cut:
        yield problem(ProblemCode.COMMANDS_MISSING, count=count.lost)
    # Perturbations with stamps of other times make it impossible to match commands by counting.
    stamps = leading.stream.stamps
    before = stamps[stamps < leading.start_ns]
    back = int((before[1:] <= np.maximum.accumulate(before)[:-1]).sum()) if before.size else 0
    first = int(leading.order.min()) if leading.order.size else before.size
    if strays := max(back, abs(first - before.size)):
        yield problem(ProblemCode.PERTURBATIONS_FOREIGN, count=strays)


def moved_further(streams: Streams, segments: Sequence[TrialRecord]) -> Iterator[Problem]:
    """Report joints that moved but are never perturbed, so no impedance explains their motion."""
    others = sorted(streams[JOINT_STATES].further.items())
    for (name, further), record in product(others, segments):
        k, last_ns = record.perturbed_joint, record.start_ns + NS_PER_S * record.duration
        within = (further.stamps >= record.start_ns) & (further.stamps < last_ns)
        moved = float(np.std(further.values[0, within])) if within.any() else 0.0
        own = float(np.std(record.position[k]))
        if 0.0 < _STILL * own < moved:
            yield problem(
                ProblemCode.FURTHER_JOINT_MOVED,
                name=name,
                perturbed=record.joint_names[k],
                percent=100.0 * moved / own,
                limit=100.0 * _STILL,
            )
