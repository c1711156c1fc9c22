"""Joining the streams of a trial into records, and the account of its samples.

Live node, replay and offline estimate all come here with the decoded streams, so that they get
bit-identical arrays from the same messages.

A sample belongs to the control period that its stamp names. Positions, torque readings and
perturbation of one period carry the same stamp, or nearly; commands carry none, and are counted.
The periods that should be there are counted from the stamps of all streams together, so a sample
that only one stream lost shows as well as one that all of them lost. While a trial runs, the
controller counts what it misses, too (`armimp_control.trial_sequencer`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from pydantic import Field, computed_field

from armimp_common.arrays import BoolArray, FloatArray, IntArray
from armimp_common.errors import DataError
from armimp_common.status import TrialStatus
from armimp_common.topics import (
    COMMANDS,
    DATA_STREAMS,
    JOINT_STATES,
    NS_PER_S,
    PERTURBATION,
    TORQUE_SENSORS,
)
from armimp_estimation.alignment.streams import Stream, Streams
from armimp_estimation.alignment.trial_windows import (
    MOST_TICKS,
    TrialWindow,
    infer_windows,
    judge_stamps,
    require_few_trials,
    sampling_period,
    tick_numbers,
    windows_from_statuses,
)
from armimp_estimation.json_model import JsonModel
from armimp_estimation.problems import Problem, ProblemCode, Severity, problem
from armimp_estimation.record import TrialRecord

_HEALED = frozenset(
    {
        ProblemCode.SAMPLES_MISSING,
        ProblemCode.SAMPLES_MALFORMED,
        ProblemCode.SAMPLES_NOT_FINITE,
        ProblemCode.SAMPLES_CONTRADICTORY,
        ProblemCode.SAMPLES_REPEATED,
        ProblemCode.SAMPLES_REORDERED,
        ProblemCode.SAMPLES_LOST,
        ProblemCode.COMMANDS_MISSING,
    }
)
"""Problems that do not affect the intact parts of a trial."""
_REFUSED = frozenset(
    {
        ProblemCode.TRIAL_SPOILED,
        ProblemCode.STAMPS_DISAGREE,
        ProblemCode.COMMANDS_FOREIGN,
        ProblemCode.PERTURBATIONS_FOREIGN,
        ProblemCode.NOTHING_RECORDED,
        ProblemCode.JOINT_UNKNOWN,
        ProblemCode.NO_PERTURBATION,
    }
)
"""Problems with which no part of a trial may be estimated."""
_ANY_REFUSED = _REFUSED | _HEALED | {ProblemCode.TRIAL_ABORTED}
"""Problems with which a trial may not be estimated as a whole."""

_STILL = 0.02
"""Motion of a joint that nobody perturbs, relative to the perturbed one, that counts as none."""


_LATE = 0.25
"""Periods by which a step between stamps may be too long."""
_APART, _SCATTER = 0.4, 0.15
"""Periods by which stamps of two streams may differ, and to which the difference may vary (rms):
those of two streams that scatter by a tenth each."""
_TOGETHER = 0.01
"""Periods of difference that nobody need know of."""


class StreamCount(JsonModel):
    """The messages of one stream within the span of a trial.

    ``received == expected - lost + duplicated`` always holds.
    """

    expected: int
    """Control periods in the span; 0 of commands that nobody recorded."""
    received: int
    """Messages that arrived, repetitions included."""
    lost: int
    """Periods without a message."""
    duplicated: int = 0
    """Messages whose stamp was already there."""
    contradictory: int = 0
    """Periods with several messages of one stamp and different numbers: none of them is used."""
    reordered: int = 0
    """Messages, without repetitions, that came after one with a later stamp."""
    late: int = 0
    """Samples stamped over a quarter of a period after the whole number of periods that separates
    them from the sample before."""


class StreamStatistics(JsonModel):
    """How many samples of a trial there should be, and how many there are."""

    streams: dict[str, StreamCount] = Field(default_factory=dict)
    """By topic of the contract, see below. Commands carry no stamp, so that neither repetitions nor
    order show."""
    clipped: int = 0
    """Commands that the controller had to limit, by its own account."""
    excluded: int = 0
    """Control periods that no estimate may use: lost, contradictory or not finite on a stream with
    stamps, or under a command that was clipped."""
    stretches: int = 1
    """Runs of at least two periods between those."""

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
        """Whether nobody recorded the commands."""
        commands = self.streams.get(COMMANDS)
        return commands is not None and not commands.expected

    @property
    def span(self) -> int:
        """Control periods that should be there."""
        return max((count.expected for count in self.streams.values()), default=0)

    @property
    def excluded_share(self) -> float:
        """Share of the span that is excluded, from 0 to 1."""
        return self.excluded / self.span if self.span else 0.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Trial:
    """A trial, as far as it was recorded."""

    window: TrialWindow
    """What the trial was meant to be."""
    segments: tuple[TrialRecord, ...]
    """The longest runs of usable periods, in their order. Duplicates are dropped (the first one
    stays, if all say the same) and the order is that of the stamps. Periods are not usable if a
    stream with stamps has no sample of them, one that is not finite, or several that contradict
    each other, nor while the controller clipped its command."""
    statistics: StreamStatistics
    """The account of the samples."""
    problems: tuple[Problem, ...] = ()
    """Problems that were found in the trial."""
    bag: str | None = None
    """Where it is stored, if it is."""
    rtf: float = math.nan
    """Times real time at which it ran; NaN if it was not run live."""

    @property
    def trial(self) -> int:
        """Number of the trial, 1-based."""
        return self.window.trial

    @property
    def joint(self) -> int:
        """The perturbed joint, 0-based, in the order of the records."""
        return self.segments[0].perturbed_joint if self.segments else self.window.joint

    @property
    def record(self) -> TrialRecord | None:
        """The samples, if there is a usable one for every control period."""
        return self.segments[0] if self.segments and not self.statistics.excluded else None

    def refusals(self, *, allow_gaps: bool = False) -> list[Problem]:
        """Return the problems with which the trial must not be estimated.

        Parameters
        ----------
        allow_gaps : bool
            Estimate from the intact parts of a trial that was aborted or lost samples, or had some
            that were repeated, out of order or not finite.
        """
        refused = _REFUSED if allow_gaps and self.segments else _ANY_REFUSED
        return [one for one in self.problems if one.code in refused]

    def judged(self, *, allow_gaps: bool, most_excluded: float) -> list[Problem]:
        """Return all problems of the trial, those that its intact parts do not have as notes.

        Parameters
        ----------
        allow_gaps : bool
            As of :meth:`refusals`.
        most_excluded : float
            Largest share of the samples that may be left out of a valid result, from 0 to 1.
        """
        healed = _HEALED if allow_gaps and self.segments else frozenset()
        found = [
            one.model_copy(update={"severity": Severity.NOTE}) if one.code in healed else one
            for one in self.problems
        ]
        share = self.statistics.excluded_share
        if self.segments and not share <= most_excluded:
            percent, limit = 100.0 * share, 100.0 * most_excluded
            code = ProblemCode.MUCH_EXCLUDED
            found.append(problem(code, trial=self.trial, percent=percent, limit=limit))
        return found

    def intact(self, *, allow_gaps: bool = False) -> tuple[TrialRecord, ...]:
        """Return the parts of the trial that an estimate may use, in their order.

        A trial without gaps has one part; intervals of clipped commands divide it.

        Raises
        ------
        DataError
            If there are none; the message names the bag and the trial.
        """
        if refusals := self.refusals(allow_gaps=allow_gaps):
            where = f"{self.bag}: " if self.bag else ""
            healing = self.segments and not allow_gaps and not self.refusals(allow_gaps=True)
            hint = "; --allow-gaps uses the intact parts" if healing else ""
            raise DataError(where + "; ".join(map(str, refusals)) + hint)
        return self.segments


def assemble_trials(
    streams: Streams, statuses: Sequence[TrialStatus], *, bag: str | None = None
) -> tuple[Trial, ...]:
    """Assemble every trial in a recording, or in what a node has received.

    Parameters
    ----------
    streams : Streams
        Everything that was received.
    statuses : sequence of TrialStatus
        The trial statuses in order. Without any, the trials are inferred from the perturbation,
        as `infer_windows` says.
    bag : str, optional
        Where the messages come from.

    Returns
    -------
    tuple of Trial
        Empty if there are statuses, but none of a perturbation. Trials that were over before
        the first sample are left out.

    Raises
    ------
    DataError
        If a stream is foreign, or the trials cannot be inferred.
    """
    streams.decode()
    period = sampling_period({topic: one.stamps for topic, one in streams.stamped.items()})
    perturbation = streams.stamped[PERTURBATION]
    windows = (
        windows_from_statuses(statuses)
        if statuses
        else infer_windows(perturbation.stamps, perturbation.values, period)
    )
    require_few_trials(len(windows))
    received = perturbation.count
    if (announced := sum(window.ticks for window in windows)) > MOST_TICKS + 2 * received:
        raise DataError(f"trials of {announced} samples are announced, and there are {received}")
    stamped = [one.stamps for one in streams.stamped.values() if one.count]
    began_ns = min((int(stamps.min()) for stamps in stamped), default=0)
    # A latched topic repeats the statuses of trials that were over before the recording.
    return tuple(
        _assemble(window, streams, bag, period)
        for window in windows
        if window.start_ns + window.ticks * period > began_ns
    )


def _assemble(window: TrialWindow, streams: Streams, bag: str | None, period: float) -> Trial:
    """Join the streams of one trial, at a sampling period in ns; other trials may be in them."""
    aligned = {t: AlignedStream(one, window.start_ns, period) for t, one in streams.stamped.items()}
    stamps = _union([one.stamps for one in aligned.values()])
    numbers = tick_numbers(stamps, period)
    if stamps.size:
        start = int(np.searchsorted(stamps, window.start_ns))
        known = start < stamps.size and stamps[start] == window.start_ns
        first = round((int(stamps[0]) - window.start_ns) / period)
        numbers += -numbers[start] if known else first
    for one in aligned.values():
        one.number(stamps, numbers)
    span = _span(window, aligned)
    stamps = stamps[: int(np.searchsorted(numbers, span))]
    for one in aligned.values():
        one.cut(span)

    usable = np.ones(span, np.bool_)
    for one in aligned.values():
        usable &= np.isfinite(one.values).all(axis=0) & ~one.contradicted
    last_ns = int(stamps[-1]) if stamps.size else window.start_ns
    counts = {topic: one.statistics(last_ns) for topic, one in aligned.items()}
    leading = aligned[PERTURBATION]
    counts[COMMANDS], foreign = _count_commands(streams, leading)
    found = [] if window.fault is None else [window.fault]
    found += _judge_offsets(aligned, period)
    if all(one.code is not ProblemCode.STAMPS_DISAGREE for one in found):
        found += _judge_streams(aligned, counts)
        found += _judge_commands(window, leading, counts[COMMANDS], foreign)
        found += judge_stamps({topic: one.stamps for topic, one in aligned.items()}, period)
    for first, last in window.clipped_intervals:
        # A command acts until the next sample, which is the first to show it.
        usable[first : last + 2] = False
    runs = _runs(usable)
    segments: tuple[TrialRecord, ...] = ()
    joint = _joint_index(window, streams.joint_names)
    if joint is None:
        name, known = window.joint_name or window.joint + 1, ", ".join(streams.joint_names)
        found = [problem(ProblemCode.JOINT_UNKNOWN, name=name, known=known)]
    else:
        commands = _commands(streams, leading)
        names = streams.joint_names
        segments = tuple(_record(window, joint, names, aligned, commands, run, bag) for run in runs)
        found += _moved_further(streams, segments)
        if segments and not any(segment.perturbation[joint].any() for segment in segments):
            found.append(problem(ProblemCode.NO_PERTURBATION))
    if 0 < span < window.ticks and window.fault is None:
        code, note = ProblemCode.CUT_SHORT, Severity.NOTE
        found.append(problem(code, severity=note, count=span, planned=window.ticks))
    if not segments and _ANY_REFUSED.isdisjoint(one.code for one in found):
        found.append(problem(ProblemCode.NOTHING_RECORDED))
    return Trial(
        window=window,
        segments=segments,
        statistics=StreamStatistics(
            streams={topic: counts[topic] for topic in DATA_STREAMS},
            clipped=window.clipped,
            excluded=int(span - usable.sum()),
            stretches=len(runs),
        ),
        problems=tuple(one.model_copy(update={"trial": window.trial}) for one in found),
        bag=bag,
    )


def _union(stamps: Sequence[IntArray]) -> IntArray:
    if all(np.array_equal(stamps[0], other) for other in stamps[1:]):
        return stamps[0]
    return np.unique(np.concatenate(stamps))


def _span(window: TrialWindow, aligned: Mapping[str, AlignedStream]) -> int:
    """Number of control periods that should be there."""
    if not all(one.numbers.size for one in aligned.values()):
        # The recording broke off before every stream had a sample of the trial.
        return window.ticks if window.ended and window.fault is None else 0
    span = window.ticks
    if not window.ended or window.fault is not None:
        # Cut while the last period was being recorded: it does not count as lost.
        span = min(span, *(int(one.numbers[-1]) + 1 for one in aligned.values()))
    if window.fault is not None:
        # From the moment of the fault on the perturbation is zero.
        leading = aligned[PERTURBATION]
        order = leading.order[: int(np.searchsorted(leading.numbers, span))]
        active = np.flatnonzero(leading.stream.values[:, order].any(axis=0))
        span = int(leading.numbers[active[-1]]) + 1 if active.size else 0
    return span


def _moved_further(streams: Streams, segments: Sequence[TrialRecord]) -> Iterator[Problem]:
    """Find joints which nobody perturbs, so that no impedance accounts for their motion."""
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


def _joint_index(window: TrialWindow, joint_names: Sequence[str]) -> int | None:
    if window.joint_name:
        names = list(joint_names)
        return names.index(window.joint_name) if window.joint_name in names else None
    return window.joint if window.joint < len(joint_names) else None


def _runs(usable: BoolArray) -> list[tuple[int, int]]:
    """Start and end of each run of at least two true values."""
    edges = np.flatnonzero(np.diff(usable.astype(np.int8), prepend=0, append=0)).tolist()
    return [
        (start, stop)
        for start, stop in zip(edges[::2], edges[1::2], strict=True)
        if stop - start > 1
    ]


def _record(
    window: TrialWindow,
    joint: int,
    joint_names: tuple[str, ...],
    aligned: Mapping[str, AlignedStream],
    commands: FloatArray,
    run: tuple[int, int],
    bag: str | None,
) -> TrialRecord:
    start, stop = run
    leading = aligned[PERTURBATION]
    command = commands[:, start:stop]
    return TrialRecord(
        trial=window.trial,
        perturbed_joint=joint,
        rate=NS_PER_S / leading.period,
        joint_names=joint_names,
        perturbation=leading.values[:, start:stop],
        position=aligned[JOINT_STATES].values[:, start:stop],
        torque=aligned[TORQUE_SENSORS].values[:, start:stop],
        start_ns=int(leading.stamps[np.searchsorted(leading.numbers, start)]),
        seed=window.seed,
        command=command if np.isfinite(command).all() else None,
        bag=bag,
    )


def _commands(streams: Streams, leading: AlignedStream) -> FloatArray:
    """Commands by control period, as far as they can be matched with their perturbations."""
    commands, laid = streams.commands, np.full_like(leading.values, np.nan)
    # A recording may be cut between the two messages of a tick.
    if commands.defect or abs(leading.stream.count - commands.count) > 1:
        return laid
    numbers = commands.stamps
    jumps = (np.diff(numbers) != 1) & ~_begins_anew(numbers) & numbers.any()
    matched = leading.order < (int(jumps.argmax()) + 1 if jumps.any() else commands.count)
    laid[:, leading.numbers[matched]] = commands.values[:, leading.order[matched]]
    return laid


class AlignedStream:
    """One stream from the start of a trial on, by control period."""

    def __init__(self, stream: Stream, start_ns: int, period: float) -> None:
        self.stream, self.start_ns, self.period = stream, start_ns, period
        stamps, order, contradicted = stream.ordered()
        first = int(np.searchsorted(stamps, start_ns - period / 2.0))
        # Of each message that is kept: stamp (ns), place in the stream, number of its period.
        self.stamps, self.order = stamps[first:], order[first:]
        self._contradicted = contradicted[first:]
        self.numbers: IntArray = np.empty(0, np.int64)

    def number(self, stamps: IntArray, numbers: IntArray) -> None:
        """Take the period numbers from those of all stamps, and keep one message for each."""
        self.numbers = numbers[np.searchsorted(stamps, self.stamps)]
        early = int(np.searchsorted(self.numbers, 0))
        self._keep(slice(early, None))
        self._keep(np.diff(self.numbers, prepend=-1) > 0)

    def cut(self, span: int) -> None:
        """Keep what is within so many periods, and lay it out by period."""
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
        """The account of the periods, the last stamp of which is given (ns)."""
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
        """Count periods, and tell when the first begins and the last ends, s."""
        places = np.flatnonzero(ticks)
        return {
            "count": places.size,
            "first": float(places[0] * self.period / NS_PER_S),
            "last": float((places[-1] + 1) * self.period / NS_PER_S),
        }


def _judge_offsets(aligned: Mapping[str, AlignedStream], period: float) -> list[Problem]:
    """Report how far stamps of angles, torques and perturbation of one period are apart."""
    found = []
    one = aligned[JOINT_STATES]
    for topic in (TORQUE_SENSORS, PERTURBATION):
        other = aligned[topic]
        _, mine, its = np.intersect1d(
            one.numbers, other.numbers, assume_unique=True, return_indices=True
        )
        apart = (other.stamps[its] - one.stamps[mine]) / period
        if not apart.any():
            continue
        mean, scatter = float(np.mean(apart)), float(np.std(apart))
        far = abs(mean) > _APART or scatter > _SCATTER
        if far or max(abs(mean), scatter) > _TOGETHER:
            found.append(
                problem(
                    ProblemCode.STAMPS_DISAGREE if far else ProblemCode.STAMPS_APART,
                    severity=Severity.ERROR if far else Severity.NOTE,
                    stream=topic,
                    other=JOINT_STATES,
                    apart_ms=mean * period / 1e6,
                    scatter_ms=scatter * period / 1e6,
                )
            )
    return found


def _judge_streams(
    aligned: Mapping[str, AlignedStream], counts: Mapping[str, StreamCount]
) -> Iterator[Problem]:
    """Report what is missing, or not as it should be, in the streams with stamps."""
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
    """Count commands by their place, as every one goes with one perturbation.

    And those that nobody asked for: whose number is none or not above that before or, where all
    have none, that are more than perturbations in the whole recording.
    """
    span, commands = leading.present.size, streams.commands
    before = int((leading.stream.stamps < leading.start_ns).sum())
    received = min(max(commands.count - before, 0), span)
    numbers = commands.stamps[: before + span]
    if numbers.any():
        # Lost ones leave a step forward; whatever somebody else sends, there is one that is not.
        back = numbers[1:] <= numbers[:-1]
        back[:before] &= ~_begins_anew(numbers)[:before]
        foreign = max(int(back.sum()), int((numbers == 0).sum()))
    else:
        # A recording may end between the two messages of a tick.
        foreign = max(commands.count - leading.stream.count - 1, 0)
    expected = span if received else 0
    return StreamCount(expected=expected, received=received, lost=expected - received), foreign


def _begins_anew(numbers: IntArray) -> BoolArray:
    """Whether each command after the first is that of a controller that counts from 1 again."""
    return np.asarray((numbers[1:] == 1) & (np.append(numbers[2:], 0) == 2))


def _judge_commands(
    window: TrialWindow, leading: AlignedStream, count: StreamCount, foreign: int
) -> Iterator[Problem]:
    """Report problems of the commands; a recording without any has none of these."""
    if not count.received:
        return
    cut = not window.ended or window.fault is not None  # maybe between the messages of a tick
    if foreign:
        yield problem(ProblemCode.COMMANDS_FOREIGN, count=foreign)
    elif count.lost > cut:
        yield problem(ProblemCode.COMMANDS_MISSING, count=count.lost)
    # Messages of other times keep commands from being matched by counting.
    stamps = leading.stream.stamps
    before = stamps[stamps < leading.start_ns]
    back = int((before[1:] <= np.maximum.accumulate(before)[:-1]).sum()) if before.size else 0
    first = int(leading.order.min()) if leading.order.size else before.size
    if strays := max(back, abs(first - before.size)):
        yield problem(ProblemCode.PERTURBATIONS_FOREIGN, count=strays)
