"""Joining the streams of a trial into records.

The live node, replay and offline estimation all pass their decoded streams through this module, so
they get bit-identical arrays from the same messages.

A sample belongs to the control period that its stamp names. Positions, torque readings and
perturbation of one period carry equal or nearly equal stamps; commands carry none and are counted.
The expected periods are counted from the stamps of all streams together, so a sample that only one
stream lost is detected as well as one that all of them lost. While a trial runs, the controller
also counts the samples that it misses (`armimp_control.trial_sequencer`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from armimp_common.arrays import FloatArray, IntArray
from armimp_common.errors import DataError
from armimp_common.status import TrialStatus
from armimp_common.topics import DATA_STREAMS, JOINT_STATES, NS_PER_S, PERTURBATION, TORQUE_SENSORS
from armimp_estimation.alignment.stream_statistics import (
    AlignedStream,
    StreamStatistics,
    account_for,
    begins_anew,
    moved_further,
)
from armimp_estimation.alignment.streams import Stream, Streams
from armimp_estimation.alignment.trial_windows import (
    MOST_TICKS,
    TrialWindow,
    infer_windows,
    require_few_trials,
    sampling_period,
    tick_numbers,
    windows_from_statuses,
)
from armimp_estimation.problems import Problem, ProblemCode, Severity, problem
from armimp_estimation.record import TrialRecord

MOST_EXCLUDED = 0.05
"""Largest share of the samples of a trial that may be left out of a valid result."""
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


@dataclass(frozen=True, kw_only=True, eq=False)
class Trial:
    """A trial, as far as it was recorded."""

    window: TrialWindow
    """What the trial was meant to be."""
    segments: tuple[TrialRecord, ...]
    """All runs of at least two usable periods, in order. Samples are sorted by stamp, and
    duplicates are dropped (if equal, the first one stays). A period is not usable if a stream with
    stamps has no sample of it, one that is not finite, or several that contradict each other, or
    if the controller clipped its command or the one before."""
    statistics: StreamStatistics
    """The counts of the samples."""
    problems: tuple[Problem, ...] = ()
    """Problems that were found in the trial."""
    bag: str | None = None
    """Bag in which it is stored, if any."""
    rtf: float = math.nan
    """Speed relative to real time; NaN if it was not run live."""
    allow_gaps: bool = False
    """Whether its intact parts may be used although it was aborted or lost samples, or has samples
    that are repeated, out of order or not finite."""

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
        """The samples as one record, if every control period has a usable one."""
        return self.segments[0] if self.segments and not self.statistics.excluded else None

    @property
    def refusals(self) -> list[Problem]:
        """Problems because of which nothing may be estimated from the trial."""
        refused = _REFUSED if self.allow_gaps and self.segments else _ANY_REFUSED
        return [one for one in self.problems if one.code in refused]

    @property
    def judged(self) -> list[Problem]:
        """All problems; those that spare the intact parts are notes if these may be used.

        If more than :data:`MOST_EXCLUDED` of the samples are left out, that is another problem.
        """
        healed = _HEALED if self.allow_gaps and self.segments else frozenset()
        found = [
            one.model_copy(update={"severity": Severity.NOTE}) if one.code in healed else one
            for one in self.problems
        ]
        share = self.statistics.excluded_share
        if self.segments and not share <= MOST_EXCLUDED:
            percent, limit = 100.0 * share, 100.0 * MOST_EXCLUDED
            code = ProblemCode.MUCH_EXCLUDED
            found.append(problem(code, trial=self.trial, percent=percent, limit=limit))
        return found

    def intact(self) -> tuple[TrialRecord, ...]:
        """Return the parts of the trial that an estimate may use, in order.

        A trial without gaps has one part, unless intervals of clipped commands divide it.

        Raises
        ------
        DataError
            If the trial is refused; the message names the bag and the trial.
        """
        if refusals := self.refusals:
            where = f"{self.bag}: " if self.bag else ""
            healing = self.segments and not replace(self, allow_gaps=True).refusals
            hint = "; --allow-gaps uses the intact parts" if healing else ""
            raise DataError(where + "; ".join(map(str, refusals)) + hint)
        return self.segments


def assemble_trials(
    streams: Streams, statuses: Sequence[TrialStatus], *, bag: str | None = None
) -> tuple[Trial, ...]:
    """Assemble every trial in a recording, or in the messages that a node has received.

    Parameters
    ----------
    streams : Streams
        All messages that were received.
    statuses : sequence of TrialStatus
        The trial statuses in order. If there are none, `infer_windows` infers the trials from the
        perturbation.
    bag : str, optional
        Bag from which the messages come.

    Returns
    -------
    tuple of Trial
        Empty if there are statuses, but none of a perturbation. Trials that were over before
        the first sample are left out.

    Raises
    ------
    DataError
        If stamps give no valid sampling rate, or trials are absurd or cannot be inferred.
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
    """Join the streams of one trial; they may hold other trials, too. `period` is in ns."""
    aligned, last_ns = _align(window, streams.stamped, period)
    leading, names = aligned[PERTURBATION], streams.joint_names
    counts, wrong = account_for(window, streams, aligned, last_ns)
    found = [*filter(None, [window.fault]), *wrong]
    span = leading.present.size
    usable = np.ones(span, np.bool_)
    for one in aligned.values():
        usable &= np.isfinite(one.values).all(axis=0) & ~one.contradicted
    for first, last in window.clipped_intervals:
        # A command acts until the next sample, which is the first to show its effect.
        usable[first : last + 2] = False
    whole = np.ma.clump_unmasked(np.ma.masked_array(usable, ~usable)) if span else []
    runs = [run for run in whole if run.stop - run.start > 1]
    segments: tuple[TrialRecord, ...] = ()
    joint = _joint_index(window, names)
    if joint is None:
        name = window.joint_name or window.joint + 1
        found = [problem(ProblemCode.JOINT_UNKNOWN, name=name, known=", ".join(names))]
    else:
        commands = _commands(streams, leading)
        segments = tuple(_record(window, joint, names, aligned, commands, run, bag) for run in runs)
        found += moved_further(streams, segments)
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


def _align(
    window: TrialWindow, stamped: Mapping[str, Stream], period: float
) -> tuple[dict[str, AlignedStream], int]:
    """Align the streams of a trial by control period, and find its last stamp in them, ns."""
    aligned = {t: AlignedStream(one, window.start_ns, period) for t, one in stamped.items()}
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
    for one in aligned.values():
        one.cut(span)
    count = int(np.searchsorted(numbers, span))
    return aligned, int(stamps[count - 1]) if count else window.start_ns


def _union(stamps: Sequence[IntArray]) -> IntArray:
    if all(np.array_equal(stamps[0], other) for other in stamps[1:]):
        return stamps[0]
    return np.unique(np.concatenate(stamps))


def _span(window: TrialWindow, aligned: Mapping[str, AlignedStream]) -> int:
    """Number of control periods that are expected."""
    if not all(one.numbers.size for one in aligned.values()):
        # The recording broke off before every stream had a sample of the trial.
        return window.ticks if window.ended and window.fault is None else 0
    span = window.ticks
    if not window.ended or window.fault is not None:
        # A last period that was cut while it was recorded does not count as lost.
        span = min(span, *(int(one.numbers[-1]) + 1 for one in aligned.values()))
    if window.fault is not None:
        # The perturbation is zero from the moment of the fault on.
        leading = aligned[PERTURBATION]
        order = leading.order[: int(np.searchsorted(leading.numbers, span))]
        active = np.flatnonzero(leading.stream.values[:, order].any(axis=0))
        span = int(leading.numbers[active[-1]]) + 1 if active.size else 0
    return span


def _joint_index(window: TrialWindow, joint_names: Sequence[str]) -> int | None:
    if window.joint_name:
        names = list(joint_names)
        return names.index(window.joint_name) if window.joint_name in names else None
    return window.joint if window.joint < len(joint_names) else None


def _record(
    window: TrialWindow,
    joint: int,
    joint_names: tuple[str, ...],
    aligned: Mapping[str, AlignedStream],
    commands: FloatArray,
    run: slice,
    bag: str | None,
) -> TrialRecord:
    leading = aligned[PERTURBATION]
    command = commands[:, run]
    return TrialRecord(
        trial=window.trial,
        perturbed_joint=joint,
        rate=NS_PER_S / leading.period,
        joint_names=joint_names,
        perturbation=leading.values[:, run],
        position=aligned[JOINT_STATES].values[:, run],
        torque=aligned[TORQUE_SENSORS].values[:, run],
        start_ns=int(leading.stamps[np.searchsorted(leading.numbers, run.start)]),
        command=command if np.isfinite(command).all() else None,
        bag=bag,
    )


def _commands(streams: Streams, leading: AlignedStream) -> FloatArray:
    """Commands by control period; NaN where they can't be matched with their perturbations."""
    commands, laid = streams.commands, np.full_like(leading.values, np.nan)
    # A recording may be cut between the two messages of a tick.
    if commands.defect or abs(leading.stream.count - commands.count) > 1:
        return laid
    numbers = commands.stamps
    jumps = (np.diff(numbers) != 1) & ~begins_anew(numbers) & numbers.any()
    matched = leading.order < (int(jumps.argmax()) + 1 if jumps.any() else commands.count)
    laid[:, leading.numbers[matched]] = commands.values[:, leading.order[matched]]
    return laid
