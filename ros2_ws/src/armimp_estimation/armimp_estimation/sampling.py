"""The sampling rate of a recording, from its stamps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from armimp_common.arrays import IntArray
from armimp_common.errors import DataError
from armimp_common.topics import NS_PER_S, PERIOD_NS
from armimp_estimation.problems import Problem, ProblemCode, problem

LOWEST, HIGHEST = 200.0, 4000.0
"""Sampling rates that are taken, Hz."""
TOLERANCE = 5e-4
"""Relative difference of a rate from a customary one: five times that of a poor crystal."""
_DRIFT = 1e-3
_SCATTER = 0.1
_LARGEST = 0.45
_MISSING = 1.85


def sampling_period(streams: Mapping[str, IntArray]) -> float:
    """Mean time between samples, ns; that of the contract if it is within the tolerance.

    Each step is rounded to whole periods by the median step, so that samples which are missing,
    late or repeated don't count: ``L = Σ steps / Σ periods``. Of several streams it is the median.

    Parameters
    ----------
    streams : mapping of str to ndarray of int64, shape (N,)
        IntArray (ns) of each stream, in any order, by topic.

    Raises
    ------
    DataError
        If the rate is not between :data:`LOWEST` and :data:`HIGHEST`, or stamps don't advance.
    """
    for topic, stamps in streams.items():
        if stamps.size > 2.0 * (distinct := np.unique(stamps).size):
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
            f"stamps give a sampling rate of {rate:.6g} Hz; rates from {LOWEST:g} to "
            f"{HIGHEST:g} Hz can be estimated from"
        )
    return float(PERIOD_NS) if abs(period / PERIOD_NS - 1.0) <= TOLERANCE else period


def is_customary(rate: float) -> bool:
    """Whether a rig may well have this sampling rate, Hz.

    Customary are powers of two, and 1 kHz times a ratio of whole numbers up to 5.
    """
    ratios = {1000.0 * p / q for p in range(1, 6) for q in range(1, 6)}
    customary = ratios | {2.0**power for power in range(7, 13)}
    return any(abs(rate / one - 1.0) <= TOLERANCE for one in customary)


def judge_stamps(
    streams: Mapping[str, IntArray], period: float, *, trial: int, planned: float | None
) -> list[Problem]:
    """Find what is wrong with the stamps of a trial.

    Parameters
    ----------
    streams : mapping of str to ndarray of int64
        IntArray (ns) of each stream within the trial, ascending, by topic.
    period : float
        Sampling period that is used, ns.
    trial : int
        Number of the trial, for the problems.
    planned : float or None
        Rate that the recording was made for, Hz, if that is known.

    Returns
    -------
    list of Problem
    """
    rate = NS_PER_S / period
    found: list[tuple[ProblemCode, dict[str, Any]]] = []
    if planned is not None:
        if abs(rate / planned - 1.0) > TOLERANCE:
            found.append((ProblemCode.RATE_UNPLANNED, {"rate": rate, "planned": planned}))
    elif not is_customary(rate):
        found.append((ProblemCode.RATE_UNCUSTOMARY, {"rate": rate}))
    for topic, stamps in streams.items():
        own = _period(stamps)
        if own is not None and abs(own / period - 1.0) > _DRIFT:
            rates = {"stream": topic, "rate": NS_PER_S / own, "other": rate}
            found.append((ProblemCode.STREAM_RATES_DIFFER, rates))
    grid = Grid.of(next(iter(streams.values())))
    if grid is not None and abs(grid.drift) > _DRIFT:
        first, second = rate * (1.0 - 0.5 * grid.drift), rate * (1.0 + 0.5 * grid.drift)
        found.append((ProblemCode.RATE_DRIFTS, {"first": first, "second": second}))
    elif grid is not None and not (grid.scatter <= _SCATTER and grid.largest <= _LARGEST):
        off = {"scatter": grid.scatter, "largest": grid.largest, "rate": rate}
        found.append((ProblemCode.STAMPS_IRREGULAR, off))
    return [problem(code, trial=trial, **values) for code, values in found]


@dataclass(frozen=True, kw_only=True)
class Grid:
    """How far stamps are from a regular grid."""

    drift: float
    """Relative change of the rate from the first half to the second."""
    scatter: float
    largest: float
    """Rms and largest distance of a stamp from the grid, periods."""

    @classmethod
    def of(cls, stamps: IntArray) -> Grid | None:
        """Compare stamps with the straight line through them; None for fewer than 20."""
        period = _period(stamps)
        if stamps.size < 20 or period is None:
            return None
        steps = np.asarray(np.diff(stamps) / period, dtype=np.float64)
        whole = np.where(steps < _MISSING, 1.0, np.rint(steps))
        numbers = np.concatenate(([0.0], np.cumsum(whole)))
        times = (stamps - stamps[0]) / period
        half = stamps.size // 2
        slopes = [
            np.polyfit(numbers[part], times[part], 1)[0]
            for part in (slice(None, half), slice(half, None))
        ]
        off = times - np.polyval(np.polyfit(numbers, times, 1), numbers)
        return cls(
            drift=float(slopes[0] / slopes[1] - 1.0),
            scatter=float(np.std(off)),
            largest=float(np.max(np.abs(off))),
        )


def _period(stamps: IntArray) -> float | None:
    steps = np.diff(np.unique(stamps))
    if steps.size == 0:
        return None
    relative = np.asarray(steps / float(np.median(steps)), dtype=np.float64)
    # A step that is only a little longer or shorter is jitter, not a sample that is missing.
    whole = np.where(relative < _MISSING, 1.0, np.rint(relative))
    return float(np.sum(steps) / np.sum(whole))
