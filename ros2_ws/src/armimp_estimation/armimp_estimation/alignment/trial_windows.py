"""Time window and perturbed joint of each trial of a recording, and the rate of its stamps."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.ndimage import uniform_filter1d

from armimp_common.arrays import FloatArray, IntArray
from armimp_common.errors import DataError
from armimp_common.status import Cause, Phase, TrialStatus
from armimp_common.topics import NS_PER_S, PERIOD_NS
from armimp_estimation.periods import Periods
from armimp_estimation.problems import Problem, ProblemCode, problem

PAUSE_NS: Final = 250_000_000
"""Zero perturbation for this long (ns) separates two trials if there are no statuses."""
_PULSES, _FEW_PULSES, _LONGER = 8, 3, 3.0
"""Such pauses of one joint from which on they are those between pulses, also if the joint is
perturbed for less than a second in between; except where one is longer than the median by this
factor."""


MOST_TICKS: Final = 10_000_000
"""Largest plausible number of samples of a trial: almost three hours at 1 kHz."""

_LATEST_NS: Final = 1 << 61  # the stamp of a message has 32 bits of seconds

_MOST_TRIALS: Final = 1000

LOWEST, HIGHEST = 200.0, 4000.0
"""Sampling rates that are accepted, Hz."""
_CUSTOMARY: Final = (
    *(1000.0 * p / q for p in range(1, 6) for q in range(1, 6)),
    *(2.0**power for power in range(7, 13)),
)
"""Customary sampling rates of a rig, Hz."""
TOLERANCE = 5e-4
"""Largest relative difference from a customary rate: five times that of a poor crystal."""
_DRIFT = 1e-3
"""Largest relative difference in rate between streams, and between halves of a trial."""
_SCATTER = 0.1
_LARGEST = 0.45
"""Rms and largest distance of stamps from a regular grid that are accepted, periods."""
_MISSING = 1.85
"""Steps between stamps below this are one period with jitter; longer ones span missing samples."""

_GRID: Final = 51
"""Stamps over which the phase of the clock is averaged: enough to average out jitter."""


@dataclass(frozen=True, kw_only=True)
class TrialWindow:
    """The part of a recording that is one trial.

    Raises
    ------
    DataError
        If start or number of samples are beyond reason.
    """

    trial: int
    """Number of the trial, 1-based."""
    joint: int
    """Perturbed joint, 0-based, in the order of the controller."""
    joint_name: str
    """Its name, which takes precedence over the number; may be empty."""
    start_ns: int
    """Stamp of the first perturbed sample (ns)."""
    ticks: int
    """Planned number of samples."""
    seed: int | None
    """Seed of the experiment, if known."""
    ended: bool
    """Whether the recording goes on after the trial, so that all of its samples are expected;
    otherwise it may end within the trial."""
    fault: Problem | None = None
    """What spoiled the trial, according to the controller."""
    clipped: int = 0
    """Joint commands that the controller clipped."""
    clipped_intervals: tuple[tuple[int, int], ...] = ()
    """First and last tick of the trial, from 0, of each run of clipped commands."""
    saved: int = 0
    """Planned samples beyond `ticks`, by which the controller ended the trial early."""
    tare: tuple[float, ...] = ()
    """Torque that the controller subtracted from the readings of each joint, N·m, in its order of
    joints. The samples still contain it. Empty without a tare."""

    def __post_init__(self) -> None:
        if not 0 <= self.ticks <= MOST_TICKS:
            raise DataError(f"trial {self.trial} cannot have {self.ticks} samples")
        if abs(self.start_ns) > _LATEST_NS:
            raise DataError(f"trial {self.trial} cannot start at {self.start_ns} ns")


def windows_from_statuses(statuses: Sequence[TrialStatus]) -> tuple[TrialWindow, ...]:
    """Find the trials that the controller announced, by statuses in the order of publication.

    Returns
    -------
    tuple of TrialWindow
        One for every trial whose perturbation began, in order.
    """
    found: dict[tuple[int, int], list[TrialStatus]] = {}
    for status in statuses:
        if status.phase is not Phase.SETTLE and status.start_ns is not None:
            # A status may come again later, as a latched topic repeats its last message.
            found.setdefault((status.trial, status.start_ns), []).append(status)
    return tuple(
        _window(start_ns, of_trial, ended=statuses[-1] is not of_trial[-1])
        for (_, start_ns), of_trial in found.items()
    )


def _window(start_ns: int, statuses: Sequence[TrialStatus], *, ended: bool) -> TrialWindow:
    """Window of a trial from all of its statuses."""
    first = statuses[0]
    ticks = min(status.ticks for status in statuses)
    faults = [fault for status in statuses if (fault := fault_of(status)) is not None]
    aborted = [one for one in faults if one.code is ProblemCode.TRIAL_ABORTED]
    spoiled = [one for one in faults if one.code is ProblemCode.TRIAL_SPOILED]
    clipped = next((status for status in reversed(statuses) if status.clipped), first)
    limits = [part.split("-") for part in clipped.clipped_intervals.split()]
    return TrialWindow(
        trial=first.trial,
        joint=first.joint,
        joint_name=first.joint_name,
        start_ns=start_ns,
        ticks=ticks,
        seed=first.seed,
        ended=ended or any(status.phase is not Phase.PERTURB for status in statuses),
        fault=next(iter([*aborted[-1:], *spoiled, *faults[-1:]]), None),
        clipped=clipped.clipped,
        clipped_intervals=tuple((int(start), int(end)) for start, end in limits),
        saved=first.ticks - ticks,
        tare=next((one.tare for one in reversed(statuses) if one.tare), ()),
    )


def fault_of(status: TrialStatus) -> Problem | None:
    """Return the fault that a status reports of its trial; None if it reports none."""
    reason = status.reason or "no reason given"
    if status.phase is Phase.ABORTED:
        code = ProblemCode.TRIAL_ABORTED
    elif not status.valid:
        lost = status.cause is Cause.SAMPLES_LOST
        code = ProblemCode.SAMPLES_LOST if lost else ProblemCode.TRIAL_SPOILED
    else:
        return None
    return problem(code, trial=status.trial, reason=reason)


def infer_windows(
    stamps: IntArray, perturbation: FloatArray, period: float = PERIOD_NS
) -> tuple[TrialWindow, ...]:
    """Find the trials of a recording without statuses, from its perturbation alone.

    A trial lasts from the first to the last sample with a nonzero perturbation, or from the one
    before if that completes a period. Another one begins when another joint is perturbed, or after
    `PAUSE_NS` without perturbation; after three times the median of such pauses where a joint has
    eight or more, as between pulses, or three or more and is perturbed for less than a second in
    between.

    Parameters
    ----------
    stamps : ndarray, shape (N,)
        Stamps of the perturbation messages (ns).
    perturbation : ndarray, shape (n, N)
        Perturbation torques, N·m.
    period : float
        Sampling period, ns.

    Raises
    ------
    DataError
        If no joint is perturbed, or several are at once.
    """
    stamps, first = np.unique(stamps, return_index=True)
    perturbation = np.nan_to_num(perturbation[:, first])
    active = perturbation != 0.0
    together = np.flatnonzero(active.sum(axis=0) > 1)
    if together.size:
        joints = ", ".join(str(k + 1) for k in np.flatnonzero(active[:, together[0]]))
        raise DataError(
            f"joints {joints} are perturbed at once and there is no trial status: "
            "the perturbed joint cannot be inferred"
        )
    samples = np.flatnonzero(active.any(axis=0))
    if not samples.size:
        raise DataError("no joint is perturbed and there is no trial status")
    joint = active.argmax(axis=0)[samples]
    pauses, other = np.diff(stamps[samples]), np.diff(joint) != 0
    divides = pauses > PAUSE_NS
    ends = np.flatnonzero(np.append(divides | other, True))
    lasted = stamps[samples[ends]] - stamps[samples[np.append(0, ends[:-1] + 1)]]
    for one in np.unique(joint):
        own = divides & ~other & (joint[1:] == one)
        brief = np.max(lasted[joint[ends] == one]) < NS_PER_S
        if np.count_nonzero(own) >= (_FEW_PULSES if brief else _PULSES):
            divides[own] = pauses[own] > _LONGER * np.median(pauses[own])
    apart = np.flatnonzero(divides | other)
    require_few_trials(apart.size + 1)
    windows = []
    for number, run in enumerate(np.split(np.arange(samples.size), apart + 1), 1):
        k, start, stop = int(joint[run[0]]), int(samples[run[0]]), int(samples[run[-1]]) + 1
        periods = Periods.of(perturbation[k, start:stop])
        lacks_one = periods is not None and periods.end - periods.used == periods.samples - 1
        rested = start > 0 and not active[:, start - 1].any()
        if lacks_one and rested and stamps[start] - stamps[start - 1] < _MISSING * period:
            start -= 1  # a period that begins with 0, as that of a sine does
        window = TrialWindow(
            trial=number,
            joint=k,
            joint_name="",
            start_ns=int(stamps[start]),
            ticks=int(tick_numbers(stamps[start:stop], period)[-1]) + 1,
            seed=None,
            ended=stop < stamps.size,
        )
        windows.append(window)
    return tuple(windows)


def tick_numbers(stamps: IntArray, period: float = PERIOD_NS) -> IntArray:
    """Number the control periods of ascending stamps, starting from 0.

    Stamps are rounded to a grid whose phase is the circular mean over neighbouring stamps. So the
    error of a slightly fast or slow clock does not add up, and steps need not be regular.

    Parameters
    ----------
    stamps : ndarray, shape (N,)
        Ascending, ns.
    period : float
        Sampling period, ns.

    Returns
    -------
    ndarray, shape (N,)
        Never decreasing; equal numbers where several stamps belong to one period.
    """
    if not stamps.size:
        return np.zeros(0, np.int64)
    turns = (stamps - stamps[0]) / period
    clock = uniform_filter1d(np.exp(2j * np.pi * turns), _GRID, mode="nearest")
    phase = np.unwrap(np.angle(clock)) / (2.0 * np.pi)
    numbers = np.maximum.accumulate(np.rint(turns - phase).astype(np.int64))
    return np.asarray(numbers - numbers[0])


def require_few_trials(trials: int) -> None:
    """Refuse a recording with more trials than an experiment can have.

    Raises
    ------
    DataError
        If there are more than 1000.
    """
    if trials > _MOST_TRIALS:
        raise DataError(f"{trials} trials are more than the {_MOST_TRIALS} of one recording")


def sampling_period(streams: Mapping[str, IntArray]) -> float:
    """Mean time between samples, ns; `PERIOD_NS` if it differs from that by `TOLERANCE` at most.

    Each step is rounded to a whole number of median steps, so that missing, late and repeated
    samples don't matter: ``L = Σ steps / Σ periods``. The result is the median over all streams.

    Parameters
    ----------
    streams : mapping of str to ndarray of int64, shape (N,)
        Stamps (ns) of each stream, in any order, by topic.

    Raises
    ------
    DataError
        If the rate is not between :data:`LOWEST` and :data:`HIGHEST`, or stamps don't advance.
    """
    for topic, stamps in streams.items():
        if stamps.size > 2.0 * (distinct := _steps(stamps).size + 1):
            raise DataError(
                f"{stamps.size} messages of {topic} have {distinct} different stamps: without "
                "stamps that say when samples were taken there is no sampling rate"
            )
    periods = [found for stamps in streams.values() if (found := _period(stamps)) is not None]
    if not periods:
        return float(PERIOD_NS)
    period = float(np.median(periods))
    rate = NS_PER_S / period
    if not LOWEST * (1.0 - TOLERANCE) <= rate <= HIGHEST * (1.0 + TOLERANCE):
        raise DataError(
            f"stamps give a sampling rate of {rate:.6g} Hz; only rates from {LOWEST:g} to "
            f"{HIGHEST:g} Hz are supported"
        )
    return float(PERIOD_NS) if abs(period / PERIOD_NS - 1.0) <= TOLERANCE else period


def judge_stamps(streams: Mapping[str, IntArray], period: float) -> Iterator[Problem]:
    """Find what is wrong with the stamps of a trial.

    Parameters
    ----------
    streams : mapping of str to ndarray of int64
        Stamps (ns) of each stream within the trial, ascending, by topic.
    period : float
        Sampling period that is used, ns.
    """
    rate = NS_PER_S / period
    if not any(abs(rate / one - 1.0) <= TOLERANCE for one in _CUSTOMARY):
        yield problem(ProblemCode.RATE_UNCUSTOMARY, rate=rate)
    for topic, stamps in streams.items():
        own = _period(stamps)
        if own is not None and abs(own / period - 1.0) > _DRIFT:
            code = ProblemCode.STREAM_RATES_DIFFER
            yield problem(code, stream=topic, rate=NS_PER_S / own, other=rate)
    if (off := _off_grid(next(iter(streams.values())))) is not None:
        drift, scatter, largest = off
        if abs(drift) > _DRIFT:
            first, second = rate * (1.0 - 0.5 * drift), rate * (1.0 + 0.5 * drift)
            yield problem(ProblemCode.RATE_DRIFTS, first=first, second=second)
        elif not (scatter <= _SCATTER and largest <= _LARGEST):
            code = ProblemCode.STAMPS_IRREGULAR
            yield problem(code, scatter=scatter, largest=largest, rate=rate)


def _off_grid(stamps: IntArray) -> tuple[float, float, float] | None:
    """Deviation of stamps from a regular grid; None for fewer than 20 stamps.

    These are the relative change of the rate from the first half to the second, and rms and largest
    distance of a stamp from the straight line through all, periods.
    """
    period = _period(stamps)
    if stamps.size < 20 or period is None:
        return None
    numbers = np.concatenate(
        ([0.0], np.cumsum(_whole(np.asarray(np.diff(stamps) / period, dtype=np.float64))))
    )
    times = (stamps - stamps[0]) / period
    half = stamps.size // 2
    first, second = (
        np.polyfit(numbers[part], times[part], 1)[0] for part in (slice(half), slice(half, None))
    )
    off = times - np.polyval(np.polyfit(numbers, times, 1), numbers)
    return float(first / second - 1.0), float(np.std(off)), float(np.max(np.abs(off)))


def _period(stamps: IntArray) -> float | None:
    steps = _steps(stamps)
    if steps.size == 0:
        return None
    relative = np.asarray(steps / float(np.median(steps)), dtype=np.float64)
    return float(np.sum(steps) / np.sum(_whole(relative)))


def _steps(stamps: IntArray) -> IntArray:
    """Steps from each distinct stamp to the next, ns."""
    steps = np.diff(np.sort(stamps))
    return np.asarray(steps[steps > 0])


def _whole(steps: FloatArray) -> FloatArray:
    """Number of whole periods in each step; a step of about one period has jitter only."""
    return np.where(steps < _MISSING, 1.0, np.rint(steps))
