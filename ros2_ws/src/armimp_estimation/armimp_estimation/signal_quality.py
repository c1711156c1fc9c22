"""What is wrong with single signals: clipped, stuck, too coarse to tell.

Noise, hum and drift are no problem: the perturbation doesn't cause them, so the estimate is right
and its intervals know. But what follows from the motion itself biases it.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from armimp_common.topics import JOINT_STATES, TORQUE_SENSORS
from armimp_estimation.problems import Problem, ProblemCode
from armimp_estimation.record import TrialRecord

FloatArray = NDArray[np.float64]
Values = dict[str, float | int | str]

_UNITS: Final = {JOINT_STATES: "rad", TORQUE_SENSORS: "N·m"}
_CLIPPED = 8
_HEAPED = 4.0
_NEIGHBOURS = 8
STUCK = 0.1
"""Time for which a signal that moves may keep one value, s; longer where it moves slowly."""
_STUCK_TIMES = 6.0
_TELLING_COUNTS = 50.0
RESOLVED = 8.0
"""Peak to peak motion, in counts of the resolution, below which nothing is resolved."""


def judge_signals(record: TrialRecord) -> list[Problem]:
    """Find what is wrong with angles and torques of a trial.

    Parameters
    ----------
    record : TrialRecord
        One trial, without gaps.
    """
    problems = []
    streams = {JOINT_STATES: record.position, TORQUE_SENSORS: record.torque}
    for stream, signals in streams.items():
        for joint, (name, signal) in enumerate(zip(record.joint_names, signals, strict=True)):
            found: list[tuple[ProblemCode, Values]] = []
            for value, count in clipping(signal):
                about: Values = {"value": value, "unit": _UNITS[stream], "count": count}
                found.append((ProblemCode.CLIPPED, about))
            moves = stream == TORQUE_SENSORS or joint == record.perturbed_joint
            if moves:
                counts = counts_of(signal)
                if counts < RESOLVED and not (stream == TORQUE_SENSORS and counts == 0.0):
                    found.append((ProblemCode.UNRESOLVED, {"counts": counts}))
                longest, count, limit = sticking(signal, record.rate)
                if count:
                    about = {"longest": longest, "count": count, "limit": limit}
                    found.append((ProblemCode.STUCK, about))
            problems += [
                Problem(
                    code=code, trial=record.trial, values={"stream": stream, "name": name, **values}
                )
                for code, values in found
            ]
    return problems


def clipping(signal: FloatArray) -> list[tuple[float, int]]:
    """Values at which a signal is clipped, and in how many samples.

    A signal that turns where it likes has fewer samples at its extreme value than at the next
    ones. One that is clipped heaps them up there: it is taken as clipped if the extreme value has
    at least 8 samples and 4 times as many as each of the 8 distinct values next to it.

    Parameters
    ----------
    signal : ndarray, shape (N,)
    """
    values, counts = np.unique(signal, return_counts=True)
    if values.size <= _NEIGHBOURS:
        return []
    found = []
    for value, heap, inner in (
        (values[0], counts[0], counts[1 : 1 + _NEIGHBOURS]),
        (values[-1], counts[-1], counts[-1 - _NEIGHBOURS : -1]),
    ):
        if heap >= _CLIPPED and heap > _HEAPED * float(np.max(inner)):
            found.append((float(value), int(heap)))
    return found


def counts_of(signal: FloatArray) -> float:
    """Peak to peak motion in units of the least difference between two values; 0 if it rests."""
    values = np.unique(signal)
    if values.size < 2:
        return 0.0
    gaps = np.diff(values)
    least = float(np.min(gaps[gaps > 1e-9 * float(np.max(gaps))]))
    return float(values[-1] - values[0]) / least


def sticking(signal: FloatArray, rate: float) -> tuple[float, int, float]:
    """Longest time for which a signal keeps one value, how often it does so for too long, and that.

    What is too long follows from the signal: 6 times the time for which it keeps a value but in one
    of a hundred moments, and no less than 100 ms. Signals of fewer than 50 counts may rest as they
    like.

    Parameters
    ----------
    signal : ndarray, shape (N,)
    rate : float
        Samples per second, Hz.

    Returns
    -------
    longest, count, limit : float, int, float
        s, number of times, s.
    """
    edges = np.flatnonzero(np.diff(signal) != 0.0)
    runs = np.diff(np.concatenate(([-1], edges, [signal.size - 1])))
    if counts_of(signal) < _TELLING_COUNTS:
        return 0.0, 0, 0.0
    typical = float(np.quantile(runs, 0.99))
    limit = max(STUCK * rate, _STUCK_TIMES * typical)
    return float(np.max(runs)) / rate, int(np.sum(runs > limit)), limit / rate
