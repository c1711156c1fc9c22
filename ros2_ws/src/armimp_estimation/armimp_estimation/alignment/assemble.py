"""Joining the streams of a trial into a record, with an account of every sample.

The bag reader and the live estimator node both come here with raw messages in order of arrival,
so that both get bit-identical arrays from the same messages.

A sample belongs to the control period that its stamp names. Positions, torque readings and
perturbation of one period carry exactly the same stamp. The periods that should be there are
counted from the stamps of all streams together, so a sample that only one stream lost shows as
well as one that all of them lost.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armimp_common import topics
from armimp_common.errors import DataError
from armimp_common.status import TrialStatus
from armimp_common.topics import NS_PER_S, PERIOD_NS
from armimp_estimation.alignment.aligned_stream import AlignedStream
from armimp_estimation.alignment.stream_statistics import StreamCount, StreamStatistics
from armimp_estimation.alignment.trial_problems import TrialProblems, find_problems
from armimp_estimation.alignment.trial_streams import TrialStreams, decode_streams
from armimp_estimation.alignment.trial_windows import (
    MOST_TICKS,
    TrialWindow,
    infer_windows,
    require_few_trials,
    tick_numbers,
    windows_from_statuses,
)
from armimp_estimation.problems import Problem
from armimp_estimation.record import TrialRecord
from armimp_estimation.sampling import judge_stamps, sampling_period


@dataclass(frozen=True, kw_only=True, eq=False)
class AssembledTrial:
    """A trial, or what could be had of it.

    Parameters
    ----------
    window : TrialWindow
        What the trial was meant to be.
    record : TrialRecord or None
        The samples, if there is a usable one for every control period. Duplicates are dropped
        (the first one stays, if all say the same) and the order is that of the stamps.
    segments : tuple of TrialRecord
        The longest runs of usable periods, in their order; the record is the only one where
        there is a record. Periods are not usable if a stream with stamps has no sample of them,
        one that is not finite, or several that contradict each other, nor while the controller
        clipped its command.
    ledger : StreamStatistics
        The account of the samples.
    problem : str
        Why the trial should not be estimated; empty if nothing speaks against it.
    fault : str
        The part of the problem that remains when only the intact parts are used.
    source : str
        Where the trial comes from, for messages.
    period : float
        Sampling period, ns.
    findings : tuple of Problem
        What is wrong with the stamps.
    """

    window: TrialWindow
    record: TrialRecord | None
    segments: tuple[TrialRecord, ...]
    ledger: StreamStatistics
    problem: str
    fault: str = ""
    source: str = ""
    period: float = PERIOD_NS
    findings: tuple[Problem, ...] = ()

    @property
    def trial(self) -> int:
        """Number of the trial, 1-based."""
        return self.window.trial

    @property
    def shortfall(self) -> int:
        """Planned samples that are not there because the recording, or the trial, ended early."""
        return self.window.ticks - self.ledger.streams[topics.PERTURBATION].expected

    @property
    def note(self) -> str:
        """What a user should know of a trial that is estimated all the same; mostly empty."""
        if not self.shortfall:
            return ""
        ticks = self.window.ticks
        return f"trial {self.trial} is cut short: {ticks - self.shortfall} of {ticks} samples"

    def require(self) -> TrialRecord:
        """Return the record of a trial without a problem or an interval that is excluded.

        Raises
        ------
        DataError
            If there is a problem; the message names the source and the trial.
        """
        if self.problem or self.record is None:
            raise self._refusal(self.problem or "has intervals that are excluded")
        return self.record

    def intact(self, *, allow_gaps: bool = False) -> tuple[TrialRecord, ...]:
        """Return the parts of the trial that an estimate may use, in their order.

        A trial without gaps has one part, its record; intervals of clipped commands divide it.

        Parameters
        ----------
        allow_gaps : bool
            Also take the parts of a trial that was aborted or lost samples, or had some that were
            repeated, out of order or not finite.

        Raises
        ------
        DataError
            If there are none; the message names the source and the trial.
        """
        if self.problem and not allow_gaps:
            healed = "; --allow-gaps uses the intact parts"
            hint = healed if self.segments and not self.fault else ""
            raise self._refusal(self.problem + hint)
        if self.fault or not self.segments:
            raise self._refusal(self.fault or self.problem or "no usable samples")
        return self.segments

    def _refusal(self, reason: str) -> DataError:
        where = f"{self.source}: " if self.source else ""
        return DataError(f"{where}trial {self.trial}: {reason}")


def assemble_trials(
    joint_names: Sequence[str],
    messages: Mapping[str, Sequence[bytes]],
    statuses: Sequence[TrialStatus],
    *,
    source: str = "",
    streams: TrialStreams | None = None,
) -> tuple[AssembledTrial, ...]:
    """Assemble every trial in a recording, or in what a node has received.

    Parameters
    ----------
    joint_names : sequence of str
        Order of the joints in the records.
    messages : mapping of str to sequence of bytes
        By topic of the contract, the serialised messages in order of arrival. All streams must
        begin with the same control period.
    statuses : sequence of TrialStatus
        The trial statuses in order. Without any, the trials are inferred from the perturbation,
        as `infer_windows` says.
    source : str
        Where the messages come from, for the messages of errors.
    streams : TrialStreams, optional
        The same messages decoded already, if they are.

    Returns
    -------
    tuple of AssembledTrial
        Empty if there are statuses, but none of a perturbation. Trials that were over before
        the first sample are left out.

    Raises
    ------
    DataError
        If a stream is missing or foreign, or the trials cannot be inferred.
    """
    if streams is None:
        streams = decode_streams(joint_names, messages)
    period = sampling_period({topic: one.stamps for topic, one in streams.stamped.items()})
    if statuses:
        windows = windows_from_statuses(statuses)
    else:
        perturbation = streams.stamped[topics.PERTURBATION]
        windows = infer_windows(perturbation.stamps, perturbation.values, period)
    require_few_trials(len(windows))
    received = streams.stamped[topics.PERTURBATION].stamps.size
    if (announced := sum(window.ticks for window in windows)) > MOST_TICKS + 2 * received:
        raise DataError(f"trials of {announced} samples are announced, and there are {received}")
    # The controller, which tells of its trials, works at the rate of the contract.
    planned = NS_PER_S / PERIOD_NS if statuses else None
    began_ns = min(int(stream.stamps.min()) for stream in streams.stamped.values())
    trials: list[AssembledTrial] = []
    used = 0
    for window in windows:
        # A latched topic repeats the statuses of trials that were over before the recording.
        if window.start_ns + window.ticks * period > began_ns:
            trials.append(
                assemble_trial(window, streams, source=source, period=period, planned=planned)
            )
            used += sum(segment.samples for segment in trials[-1].segments)
            if used > received:
                raise DataError(f"trial {window.trial} overlaps with others: they share samples")
    return tuple(trials)


def assemble_trial(
    window: TrialWindow,
    streams: TrialStreams,
    *,
    source: str = "",
    period: float = PERIOD_NS,
    planned: float | None = None,
) -> AssembledTrial:
    """Join the streams of one trial.

    Parameters
    ----------
    window : TrialWindow
        When the trial took place.
    streams : TrialStreams
        Everything that was received; other trials may be in it, too.
    source : str
        Where it comes from, for messages.
    period : float
        Sampling period, ns.
    planned : float or None
        Sampling rate of the recording, Hz, if it is known beforehand.
    """
    kept = {
        topic: AlignedStream(stream, window.start_ns, period)
        for topic, stream in streams.stamped.items()
    }
    stamps = _union([one.stamps for one in kept.values()])
    numbers = tick_numbers(stamps, period)
    if stamps.size:
        numbers += int(np.floor((stamps[0] - window.start_ns) / period + 0.5))
    for one in kept.values():
        one.number(stamps, numbers)
    span = _span(window, kept)
    inside = int(np.searchsorted(numbers, span))
    last_ns = int(stamps[inside - 1]) if inside else window.start_ns

    usable = np.ones(span, np.bool_)
    for one in kept.values():
        usable &= one.finite(span) & ~one.contradicted(span)
    counts = {topic: one.count(span, last_ns) for topic, one in kept.items()}
    problems = find_problems(window, kept, counts, stamps[:inside], numbers[:inside], usable)
    for first, last in window.clipped_intervals:
        # A command acts until the next sample, which is the first to show it.
        usable[first : last + 2] = False
    runs = _runs(usable)
    counts[topics.COMMANDS], wrong = _count_commands(streams, kept[topics.PERTURBATION], span)
    problems = problems.and_commands(
        wrong, counts[topics.COMMANDS], cut=not window.ended or bool(window.fault)
    )
    if counts[topics.COMMANDS].received and (strays := _displaced(kept[topics.PERTURBATION])):
        problems = problems.and_also(
            f"{strays} of {topics.PERTURBATION} out of turn outside the trial, so that commands"
            " cannot be matched: somebody else published"
        )
    ledger = StreamStatistics(
        streams={topic: counts[topic] for topic in topics.DATA_STREAMS if topic in counts},
        clipped=window.clipped,
        excluded=int(span - usable.sum()),
        stretches=len(runs),
    )
    segments: tuple[TrialRecord, ...] = ()
    inside_stamps = {topic: one.stamps[: one.inside(span)] for topic, one in kept.items()}
    findings = judge_stamps(inside_stamps, period, trial=window.trial, planned=planned)
    joint = _joint_index(window, streams.joint_names)
    if joint is None:
        known = ", ".join(streams.joint_names)
        name = window.joint_name or f"joint {window.joint + 1}"
        unknown = f"perturbed joint is not among the joints {known}: {name}"
        problems = TrialProblems(all=unknown, lasting=unknown)
    else:
        segments = tuple(_record(window, joint, streams, kept, start, stop) for start, stop in runs)
        if segments and not any(segment.perturbation[joint].any() for segment in segments):
            problems = problems.and_also("the perturbation is zero throughout")
    whole = bool(segments) and bool(usable.all())
    return AssembledTrial(
        window=window,
        record=segments[0] if whole else None,
        segments=segments,
        ledger=ledger,
        problem=problems.all,
        fault=problems.lasting,
        source=source,
        period=period,
        findings=tuple(findings),
    )


def _union(stamps: Sequence[NDArray[np.int64]]) -> NDArray[np.int64]:
    if all(np.array_equal(stamps[0], other) for other in stamps[1:]):
        return stamps[0]
    return np.unique(np.concatenate(stamps))


def _span(window: TrialWindow, kept: Mapping[str, AlignedStream]) -> int:
    """Number of control periods that should be there."""
    if not all(one.numbers.size for one in kept.values()):
        # The recording broke off before every stream had a sample of the trial.
        return window.ticks if window.ended and not window.fault else 0
    span = window.ticks
    if not window.ended or window.fault:
        # Cut while the last period was being recorded: it does not count as lost.
        span = min(span, *(int(one.numbers[-1]) + 1 for one in kept.values()))
    if window.fault:
        # From the moment of the fault on the perturbation is zero.
        perturbation = kept[topics.PERTURBATION]
        inside = perturbation.inside(span)
        values = perturbation.stream.values[:, perturbation.order[:inside]]
        active = np.flatnonzero(values.any(axis=0))
        span = int(perturbation.numbers[active[-1]]) + 1 if active.size else 0
    return span


def _count_commands(
    streams: TrialStreams, perturbation: AlignedStream, span: int
) -> tuple[StreamCount, int]:
    """Count commands by their place, as every one goes with one perturbation.

    Returns
    -------
    StreamCount
    int
        Those that nobody asked for: whose number is none or not above that before or, where
        all have none, that are more than perturbations in the whole recording.
    """
    stamps = streams.stamped[topics.PERTURBATION].stamps
    before = int((stamps < perturbation.start_ns).sum())
    received = min(max(streams.commands - before, 0), span)
    numbers = streams.command_numbers[: before + span]
    if numbers.any():
        # Lost ones leave a step forward; whatever somebody else sends, there is one that is not.
        back = numbers[1:] <= numbers[:-1]
        # A controller that began anew before the trial counts from 1 again.
        anew = (numbers[1:-1] == 1) & (numbers[2:] == 2)
        back[:-1] &= ~anew | (np.arange(1, back.size) >= before)
        wrong = max(int(back.sum()), int((numbers == 0).sum()))
    else:
        # A recording may end between the two messages of a tick.
        wrong = max(streams.commands - stamps.size - 1, 0)
    return StreamCount(expected=span, received=received, lost=span - received), wrong


def _displaced(perturbation: AlignedStream) -> int:
    """How many messages of other times keep commands from being matched by counting."""
    stamps = perturbation.stream.stamps
    before = stamps[stamps < perturbation.start_ns]
    back = int((before[1:] <= np.maximum.accumulate(before)[:-1]).sum()) if before.size else 0
    first = int(perturbation.order.min()) if perturbation.order.size else before.size
    return max(back, abs(first - before.size))


def _joint_index(window: TrialWindow, joint_names: Sequence[str]) -> int | None:
    if window.joint_name:
        names = list(joint_names)
        return names.index(window.joint_name) if window.joint_name in names else None
    return window.joint if window.joint < len(joint_names) else None


def _runs(usable: NDArray[np.bool_]) -> list[tuple[int, int]]:
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
    streams: TrialStreams,
    kept: Mapping[str, AlignedStream],
    start: int,
    stop: int,
) -> TrialRecord:
    return TrialRecord(
        trial=window.trial,
        perturbed_joint=joint,
        rate=NS_PER_S / kept[topics.PERTURBATION].period,
        joint_names=streams.joint_names,
        perturbation=kept[topics.PERTURBATION].values(start, stop),
        position=kept[topics.JOINT_STATES].values(start, stop),
        torque=kept[topics.TORQUE_SENSORS].values(start, stop),
        start_ns=kept[topics.PERTURBATION].stamp(start),
        seed=window.seed,
        command=_commands(streams, kept[topics.PERTURBATION].chosen(start, stop)),
    )


def _commands(streams: TrialStreams, ordinals: NDArray[np.intp]) -> NDArray[np.float64] | None:
    """Commands that went with the perturbations of these ordinal numbers; None if in doubt."""
    values = streams.command_values
    perturbations = streams.stamped[topics.PERTURBATION].stamps.size
    # A recording may be cut between the two messages of a tick.
    if values is None or abs(perturbations - values.shape[1]) > 1:
        return None
    if ordinals.max() >= values.shape[1]:
        return None
    numbers = streams.command_numbers
    if numbers.any() and np.any(np.diff(numbers[: ordinals.max() + 1]) != 1):
        return None
    command = np.ascontiguousarray(values[:, ordinals])
    return command if np.isfinite(command).all() else None
