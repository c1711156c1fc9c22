"""What is wrong with single signals: clipped, stuck, too coarse to tell; and lost readings mended.

So is a torque that stays while its joint moves, as behind cuffs that are loose.

Noise, hum and drift are no problem: the perturbation doesn't cause them, so the estimate is right
and its intervals know. But what follows from the motion itself biases it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from armimp_common.arrays import BoolArray, ComplexArray, FloatArray
from armimp_common.topics import JOINT_STATES, TORQUE_SENSORS
from armimp_estimation.hold_correction import command_steps, regress
from armimp_estimation.problems import Problem, ProblemCode, Severity, problem
from armimp_estimation.record import EXACT, TrialRecord, resolution_of

Values = dict[str, Any]

_UNITS: Final = {JOINT_STATES: "rad", TORQUE_SENSORS: "N·m"}
_CLIPPED = 8
_HEAPED = 4.0
_NEIGHBOURS = 8
_REACH = 3.0
_VISITS = 3
_PASSED = 20
_FELT = 0.005
_APPROACH = 5
_UNSLOWED = 0.4
STUCK = 0.1
"""Time for which a signal that moves may keep one value, s; longer where it moves slowly."""
_STUCK_TIMES = 6.0
_RESTING = 0.3
_JUMP = 12.0
_SETS_OFF = 4.0
_HELD_TIMES = 3.0
_LEAST_HELD = 5
_LEAST_DIPS = 3
_KICK = 4
"""Samples for which a law needs to answer a step of the angle, at most."""
DROPPED = 0.002
"""Share of the samples that may be dropped; as large is the bias of what is lost."""
_BRIEF = 5
"""Samples in a row that are mended at most: one less than those over which extremes are taken."""
_USUAL = 0.98
_AWAY = 16.0
"""What readings stand out by that are lost, per what one in fifty does, or count: sound ones do so
by 12.5 at most, where a joint that sticks begins to slip."""
_SMALL = 0.05
"""Share of the rms of a signal by which lost readings may stand out and hardly change it."""
_PERIODS = 6
"""For which torques follow a command by jumps and not as the arm moves."""
MENDED = 0.005
"""Share of the samples that may be mended; of those lost some remain that don't stand out."""
_TELLING_COUNTS = 50.0
_TELLING_SAMPLES = 4096
_TELLING_MOST = 16384
_REPEATED = 0.15
_BESIDE = 9.0
_BROAD = 0.5
_LOST = 0.16
_LEADING, _MOST_LED, _UNGATHERED, _LEAD_ERROR = 0.12, 0.1, 0.2, 0.5
"""Assumptions for :func:`rounding_lead`: its factor, a lead times the speed in the band at most, in
steps, and as standard errors that of ln ρ and the relative one of the lead."""
_DISTINCT = 0.1
"""Least eigenvalue of an inertia, in units of those of the joints, twice, that can be inverted."""
_SLOW, _USUAL_SLOW, _LITTLE = (0.0, 0.1), (0.5, 1.0), 0.25
_TINY = float(np.finfo(np.float64).tiny)
_WINDOW = 0.5
_VALUES = 3
_CHANGES = 5
_COPIED = 0.005
"""Share of a torque beside a multiple of its command below which it is none on the arm: a robot has
inertia, but hardly any beside a heavy arm."""
_LAGS = 4
_BINS, _FOLDED, _FOLLOWING, _ALIKE = 10, 0.3, 0.85, 0.8
"""Bins of a coherence; power of a perturbation near half of the rate relative to that at 15 to
40 Hz, from which on it may have more beyond; share of the motion that follows it otherwise; and
share of quick motion per that of slow motion from which on they are alike."""
_QUICK, _NEAR, _LINGERS, _STILL, _SURE = (3.0, 40.0), 0.2, 0.04, 0.5, 4.0
_SETTLED = 3.0
"""Seconds of a trial from which on it is looked at whether a joint moves without the arm."""
RESOLVED_SHARE = 0.25
"""Share of the motion of a locked joint that may be unseen where its motion counts as resolved."""
RESOLVED: Final = {JOINT_STATES: 20.0, TORQUE_SENSORS: 8.0}
"""Peak to peak motion and torque, in counts of the resolution, below which nothing is resolved."""


def judge_signals(record: TrialRecord) -> list[Problem]:
    """Find what is wrong with angles and torques of a trial.

    Parameters
    ----------
    record : TrialRecord
        One trial, without gaps.
    """
    # What was interpolated with all that is recorded did the same to cause and effect.
    resampled = repeating(record.perturbation[record.perturbed_joint]) > 0.0
    return [
        problem(code, trial=record.trial, stream=stream, name=name, **values)
        for stream in (JOINT_STATES, TORQUE_SENSORS)
        for joint, name in enumerate(record.joint_names)
        for code, values in _faults(record, stream, joint)
        if not (code is ProblemCode.TORQUE_REPEATS and resampled)
    ]


def _faults(record: TrialRecord, stream: str, joint: int) -> Iterator[tuple[ProblemCode, Values]]:
    """What is wrong with one signal, with the values of each problem."""
    k, torques = record.perturbed_joint, stream == TORQUE_SENSORS
    signal, step = record.readings[stream][joint], float(record.resolution[stream][joint])
    for value, count in clipping(signal, step):
        yield ProblemCode.CLIPPED, {"value": value, "unit": _UNITS[stream], "count": count}
    if torques or joint == k:
        counts = float(np.ptp(signal)) / step if step else 0.0
        if counts < RESOLVED[stream]:
            yield ProblemCode.UNRESOLVED, {"counts": counts}
        partner = (record.position if torques else record.torque)[k]
        if counts >= _TELLING_COUNTS:
            longest, count, limit = sticking(signal, record.rate, partner)
            if count:
                yield ProblemCode.STUCK, {"longest": longest, "count": count, "limit": limit}
        kicked = None if joint == k else record.position[joint]
        dropped, share = dropouts(signal, partner, kicked)
        if share > DROPPED:
            yield ProblemCode.DROPPED, {"count": dropped, "percent": 100.0 * share}
    if joint == k and not torques and (share := aliased(record)) < 1.0:
        yield ProblemCode.ALIASED, {"percent": 100.0 * share}
    if torques and (count := zeros_beyond_chance(signal, step)):
        yield ProblemCode.DEAD_ZONE, {"count": count, "percent": 100.0 * count / signal.size}
    if torques and (share := repeating(signal)):
        yield ProblemCode.TORQUE_REPEATS, {"percent": 100.0 * share}
    if torques and joint == k:
        yield from _faults_of_response(record)


def _faults_of_response(record: TrialRecord) -> Iterator[tuple[ProblemCode, Values]]:
    """What is wrong with the torque of the perturbed joint."""
    for source in ("command", "perturbation"):
        factor, share = _copied(record, source)
        if share < _COPIED:
            about: Values = {"source": source, "factor": factor, "percent": 100.0 * share}
            yield ProblemCode.TORQUE_IS_COMMAND, about
    value, share = floating(record) if record.duration > _SETTLED else (0.0, 0.0)
    if share:
        yield ProblemCode.ARM_FLOATS, {"value": value, "percent": 100.0 * share}


def floating(record: TrialRecord) -> tuple[float, float]:
    """Torque of the perturbed joint beside which it moves without the arm, and how often.

    An arm that is loose in its cuffs, or behind play, leaves a torque as it is while the joint
    moves. That of a linear arm changes whatever it is. So its change between 3 and 40 Hz, where a
    person adds little, is compared with that of the torque which follows linearly from angles,
    speeds and accelerations there, at all torques within a tenth of a standard deviation of one.

    Parameters
    ----------
    record : TrialRecord
        One trial, without gaps.

    Returns
    -------
    torque : float
        Of those at which it changes by less than half of what is usual, in power and beyond the
        chance of as many visits, the one where it is most often, for 4 % of the time at least, N·m.
    share : float
        Of the time in which it is at any of them; 0 if there is none.
    """
    k, f = record.perturbed_joint, np.fft.rfftfreq(record.samples, 1.0 / record.rate)
    top, s = min(_QUICK[1], 0.4 * record.rate), 2j * np.pi * f
    quick = (f > _QUICK[0]) & (f < top)
    angles, torque = (
        np.fft.rfft(one - one.mean(axis=-1, keepdims=True))
        for one in (record.position, record.torque[k])
    )
    motion = np.concatenate([s[quick] ** order * angles[:, quick] for order in range(3)])
    motion /= np.linalg.norm(motion, axis=1, keepdims=True) + _TINY
    parts = [np.concatenate((one.real, one.imag), axis=-1) for one in (motion, torque[quick])]
    follows = np.zeros_like(torque)
    follows[quick] = np.linalg.lstsq(parts[0].T, parts[1], rcond=None)[0] @ motion
    signals = np.fft.irfft(
        np.stack((torque * (f < top), s * quick * torque, s * follows)), record.samples
    )
    level, own, expected = signals[:, round(record.rate) : -round(record.rate)]
    width = _NEAR * float(np.std(level))
    if record.resolution[TORQUE_SENSORS][k] >= width or not expected.any():
        return 0.0, 0.0  # it changes by counts alone, or not at all
    lowest = np.rint(np.min(level) / width)
    place = (np.rint(level / width) - lowest).astype(np.int64)
    share = np.bincount(place) / place.size
    changes, usual = (
        np.bincount(place, weights=one**2) / np.mean(one**2) / place.size for one in (own, expected)
    )
    visits = np.bincount(place[1:][np.diff(place) != 0], minlength=share.size)
    limit = np.minimum(_STILL, 1.0 - _SURE * np.sqrt(2.0 / np.maximum(visits, 1)))
    still = (share > _LINGERS) & (usual > 0.5 * share) & (changes < limit * usual)
    if not still.any():
        return 0.0, 0.0
    where = int(np.argmax(np.where(still, share, 0.0)))
    return float(record.torque[k].mean() + (where + lowest) * width), float(np.sum(share[still]))


def mended(record: TrialRecord) -> tuple[TrialRecord, list[Problem]]:
    """Interpolate readings that are lost: up to 5 in a row that jump away, and back again.

    A bus or a converter that fails now and then shows 0, an old value, or any other. How far a
    reading stands out is by how much it exceeds both what is least within 5 samples before and
    after it, or the same downwards. What commands that chatter make of torques is taken out before.
    A record of which nothing stands out stays as it is.

    Parameters
    ----------
    record : TrialRecord
        One trial, without gaps.

    Returns
    -------
    record : TrialRecord
    problems : list of Problem
        How many samples of which signals; errors where they are too many.
    """
    problems, k = [], np.arange(record.samples)
    whole = {stream: signals.copy() for stream, signals in record.readings.items()}
    known = {JOINT_STATES: np.zeros_like(record.position), TORQUE_SENSORS: _of_commands(record)}
    for stream, signals in whole.items():
        for joint, (name, signal) in enumerate(zip(record.joint_names, signals, strict=True)):
            rest = signal - known[stream][joint]
            height = np.maximum(_over_opening(rest), _over_opening(-rest))
            if record.command is not None:
                height[:_PERIODS] = 0.0  # which follow commands that nobody recorded
            usual = max(float(np.quantile(height, _USUAL)), record.resolution[stream][joint])
            away = height > max(_AWAY * usual, _SMALL * float(np.std(signal)))
            if not away.any():
                continue
            signal[away] += np.interp(k[away], k[~away], rest[~away]) - rest[away]
            share = float(np.mean(away))
            problems.append(
                problem(
                    ProblemCode.MENDED,
                    severity=Severity.NOTE if share <= MENDED else Severity.ERROR,
                    trial=record.trial,
                    stream=stream,
                    name=name,
                    count=int(np.sum(away)),
                    percent=100.0 * share,
                )
            )
    if problems:
        record = replace(record, position=whole[JOINT_STATES], torque=whole[TORQUE_SENSORS])
    return record, problems


def _of_commands(record: TrialRecord) -> FloatArray:
    """What the commands of the last periods make of the torques by jumps, (n, N)."""
    if record.command is None or record.samples <= _TELLING_COUNTS:
        return np.zeros_like(record.torque)
    lags = range(_PERIODS)
    steps = np.pad(command_steps(record), ((0, 0), (_PERIODS, 0)))
    lagged = np.concatenate([steps[:, _PERIODS - lag : steps.shape[1] - lag] for lag in lags])
    changes = np.diff(record.torque, axis=1, prepend=record.torque[:, :1])
    answers, _ = regress([lagged[:, :_TELLING_MOST]], [changes[:, :_TELLING_MOST]])
    return np.asarray(np.cumsum(answers @ lagged, axis=1))


def _over_opening(signal: FloatArray) -> FloatArray:
    """By how much a signal (N,) exceeds its morphological opening: peaks that are brief."""
    opened = np.pad(signal, _BRIEF, mode="edge")
    for extreme in (np.minimum, np.maximum):
        of_two = extreme(opened[:-1], opened[1:])
        opened = extreme(extreme(of_two[:-4], of_two[2:-2]), of_two[4:])
    return np.asarray(signal - opened)


def clipping(signal: FloatArray, step: float) -> list[tuple[float, int]]:
    """Values at which a signal is clipped, and in how many samples.

    A signal that turns where it likes has fewer samples at its extreme value than at the next
    ones. One that is clipped heaps them up there: it is taken as clipped if the extreme value, to
    its resolution, has at least 8 samples and 4 times as many as each of the 8 distinct values next
    to it, and of those within 3 usual steps: a fast signal that was interpolated has many values
    from one count to the next. A joint that
    friction holds may rest there as long. But it does not come back to the same value, and it slows
    down before: so a signal is clipped only if it comes there 3 times, at both ends together, and
    arrives with more than 0.4 of the speed that it had 5 samples before. (A motion that comes to
    rest steadily has a third of it.)

    Parameters
    ----------
    signal : ndarray, shape (N,)
    step : float
        Its resolution.
    """
    levels = np.rint(signal / (step or 1.0))
    values, counts = np.unique(levels, return_counts=True)
    if values.size <= _NEIGHBOURS:
        return []
    steps = np.abs(np.diff(signal))
    reach = _REACH * float(np.median(steps[steps > 0.0])) / step
    above = max(_NEIGHBOURS, int(np.sum(values <= values[0] + reach)) - 1)
    below = max(_NEIGHBOURS, int(np.sum(values >= values[-1] - reach)) - 1)
    found, visits = [], 0
    speed = np.zeros(2)
    for end, heap, inner in (
        (0, counts[0], counts[1 : 1 + above]),
        (values.size - 1, counts[-1], counts[-1 - below : -1]),
    ):
        if heap >= _CLIPPED and heap > _HEAPED * float(np.max(inner)):
            rank = np.abs(np.searchsorted(values, levels) - end)
            arrivals = _arrivals(rank)
            found.append((float(signal[rank == 0][0]), int(heap)))
            visits += arrivals.size
            before = signal[np.maximum(arrivals - _APPROACH * np.arange(3)[:, None], 0)]
            speed += np.abs(np.sum(np.diff(before, axis=0), axis=1))
    return found if visits >= _VISITS and speed[0] > _UNSLOWED * speed[1] else []


def _arrivals(rank: NDArray[np.int_]) -> NDArray[np.int_]:
    """Samples that reach rank 0 for the first time after one of more than 8."""
    there = np.flatnonzero((rank == 0) | (rank > _NEIGHBOURS))
    at_end = rank[there] == 0
    came: NDArray[np.int_] = there[at_end & ~np.concatenate(([False], at_end[:-1]))]
    return came


def lost_motion(records: Sequence[TrialRecord]) -> tuple[FloatArray, FloatArray]:
    """Motion that follows the perturbation and that the encoders of locked joints may not show.

    Rounding to steps q takes ``2 exp(-2π²σ²/q²)`` off the response of a motion of the standard
    deviation σ, which follows from that of the readings in each half second, less that of rounding,
    ``q²/12``. A joint that shows fewer than three values there, or hardly changes between them, may
    be held by friction, and move as it likes within a step. Of a motion of 0.2 q, at which most of
    it is lost, that is 0.16 q.

    Parameters
    ----------
    records : sequence of TrialRecord
        One trial for each joint, in order.

    Returns
    -------
    share : ndarray, shape (n, n)
        Of each joint in each trial, 0 to 1 of the motion that its encoder shows: all while it seems
        to rest, as it may be less if rounding goes to and fro.
    beside : ndarray, shape (n, n)
        Of each joint in each trial, rad, while it seems to rest. Both are 0 where all is seen.
    """
    shares, beside = np.zeros((2, len(records), len(records)))
    for joint, k in np.ndindex(shares.shape):
        step = float(records[joint].resolution[JOINT_STATES][joint])
        size = round(_WINDOW * records[k].rate)
        if k == joint or step == 0.0 or records[k].samples < size:
            continue
        signal = records[k].position[joint]
        counts = (signal - signal[0]) / step
        counts = counts[: counts.size // size * size].reshape(-1, size)
        changes = np.sum(np.abs(np.diff(counts, axis=1)), axis=1)
        rests = (np.ptp(counts, axis=1) < _VALUES - 1.5) | (changes < _CHANGES - 0.5)
        spread = np.maximum(np.var(counts, axis=1) - 1.0 / 12.0, 0.0)
        lacks = np.minimum(2.0 * np.exp(-2.0 * np.pi**2 * spread), 1.0)
        shares[joint, k] = np.mean(np.where(rests, 1.0, lacks))
        beside[joint, k] = _LOST * step * np.mean(rests)
    return shares, beside


def rounding_lead(
    records: Sequence[TrialRecord], inertia: FloatArray, band_end: float
) -> tuple[FloatArray, FloatArray]:
    """How far the motion that encoders show is ahead of that of the joints.

    A law that holds a joint throws it back where its reading steps, so that the joint stays near
    the thresholds, or between them. Rounding then isn't independent of the motion, but follows its
    speed. How often a reading steps tells: ``ρ |v|/q`` times a second at a mean speed of ``|v|``,
    where ρ is the density of the angle at thresholds of steps q, over that elsewhere. Of joints
    that laws of 30 to 250 rad/s hold at 250 to 4000 Hz readings led by about
    ``0.12 (1 - 2d) ln(ρ) q/|v|`` where a share d of the readings steps, and at most by a tenth of a
    step at the speed in the band, which is assumed.

    Parameters
    ----------
    records : sequence of TrialRecord
        One trial for each joint, in order.
    inertia : ndarray, shape (n, n)
        Of the arm, kg·m²: above the band, torques tell the speed.
    band_end : float
        Frequency up to which angles tell it, Hz.

    Returns
    -------
    lead, error : ndarray, shape (n, n)
        Of each joint in each trial, s; its standard error, both 0 where nothing is rounded.
    """
    lead, error = np.zeros((2, len(records), len(records)))
    for k, record in enumerate(records):
        speeds = np.mean(np.abs(_speeds(record, inertia, band_end)), axis=1)
        for joint, (angle, speed) in enumerate(zip(record.position, speeds, strict=True)):
            step = float(records[joint].resolution[JOINT_STATES][joint])
            steps = np.abs(np.diff(angle)) / step if step > 0.0 else np.zeros(1)
            stepping = float(np.mean(np.minimum(steps, 1.0)))
            if np.sum(steps) < _CHANGES - 0.5 or not speed > 0.0:
                continue
            density = float(np.mean(steps)) * record.rate * step / speed
            least = _LEADING * max(1.0 - 2.0 * stepping, 0.0) * step / speed
            found = least * math.log(density)
            in_band = float(np.std(speed_of(angle, record.rate, band_end)))
            most = _MOST_LED * step / max(in_band, _TINY)
            lead[joint, k] = math.copysign(min(abs(found), most), found)
            error[joint, k] = min(math.hypot(_LEAD_ERROR * found, _UNGATHERED * least), most)
    return lead, error


def _speeds(record: TrialRecord, inertia: FloatArray, band_end: float) -> FloatArray:
    """Speeds, (n, N), rad/s: of the angles in the band; above it, of the torques, if they tell."""
    turning = 2.0 * np.pi * np.fft.rfftfreq(record.samples, 1.0 / record.rate)
    beyond = turning > 2.0 * np.pi * band_end
    spectrum = 1j * turning * np.fft.rfft(record.position - record.position[:, :1])
    spectrum[:, beyond] = 0.0
    size = np.sqrt(np.abs(np.diag(inertia)))
    own = inertia / np.maximum(np.outer(size, size), _TINY)
    if np.min(np.linalg.eigvalsh(own + own.T)) > _DISTINCT:
        felt = np.fft.rfft(record.torque)[:, beyond] / (1j * turning[beyond])
        spectrum[:, beyond] = np.linalg.solve(inertia, felt)
    return np.asarray(np.fft.irfft(spectrum, record.samples))


def without_slow(records: Sequence[TrialRecord]) -> BoolArray:
    """Torques, and angles, that show little of what is slow, as behind a high-pass, (2, n).

    A person, noise and drift have as much power below 0.1 Hz as at 0.5 to 1 Hz, and most
    perturbations have; behind a high-pass of 0.3 Hz it is a tenth.

    Parameters
    ----------
    records : sequence of TrialRecord
        One trial for each joint, in order.
    """
    powers = np.zeros((2, 2, len(records)))
    for record in records:
        signals = np.stack((record.torque, record.position))
        # The posture itself is no motion: without it, before the window makes it some.
        signals = (signals - signals.mean(axis=2, keepdims=True)) * np.hanning(record.samples)
        f = np.fft.rfftfreq(record.samples, 1.0 / record.rate)
        power = np.abs(np.fft.rfft(signals)) ** 2
        for place, (low, high) in enumerate((_SLOW, _USUAL_SLOW)):
            within = power[:, :, (f > low) & (f <= high)]
            powers[place] += within.mean(axis=2) if within.size else 0.0
    return np.asarray(powers[0] < _LITTLE * powers[1])


def spectrum_by_bins(signal: FloatArray) -> ComplexArray:
    """Spectrum of a signal, (N,), behind a Hann window, by bins of `_BINS` frequencies, (m, 10)."""
    bins = signal.size // 2 // _BINS * _BINS
    spectrum = np.fft.rfft((signal - signal.mean()) * np.hanning(signal.size))
    return np.asarray(spectrum[:bins].reshape(-1, _BINS))


def followed(
    cause: ComplexArray, signal: ComplexArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Coherence of a signal with its cause, and the power of both, by bins, (m,).

    Both are taken as :func:`spectrum_by_bins` gives them.
    """
    power, answer = (np.sum(np.abs(one) ** 2, axis=1) for one in (cause, signal))
    cross = np.abs(np.sum(np.conj(cause) * signal, axis=1)) ** 2
    return cross / np.maximum(answer * power, _TINY), power, answer


def aliased(record: TrialRecord) -> float:
    """Share of the motion that follows a perturbation with power between the samples; 1 if all.

    A recorder that keeps one sample in several, without a low-pass, folds what is beyond half of
    its rate. Torques follow such a perturbation at once, and fold with it, but angles follow what
    it sums up to: so they seem to follow a part of it, alike at all frequencies. What encoders or a
    person add is quick or slow. So motion has to follow less than 0.85 of the perturbation at 3 to
    8 Hz, and as little, within a fifth, at 15 to 40 Hz, where rounding is taken off its power.
    """
    k = record.perturbed_joint
    angle = record.position[k]
    signals = record.perturbation[k, 1:-1], np.diff(angle, n=2)
    share, power, answer = followed(*map(spectrum_by_bins, signals))
    f = (np.arange(share.size) + 0.5) * _BINS * record.rate / (record.samples - 2)
    slow, quick = (f > 3.0) & (f < 8.0), (f > 15.0) & (f < 40.0)
    told = slow.any() and quick.any()
    if not told or np.mean(power[f > 0.375 * record.rate]) < _FOLDED * np.mean(power[quick]):
        return 1.0
    # Second differences of rounding, of the power q²/12, behind a Hann window.
    rounding = record.resolution[JOINT_STATES][k] ** 2 / 12.0 * 0.375 * record.samples * _BINS
    moved = np.maximum(1.0 - rounding * (2.0 * np.sin(np.pi * f / record.rate)) ** 4 / answer, 0.02)
    shares = [float(np.mean((share / moved)[one])) for one in (slow, quick)]
    return max(shares) if max(shares) < _FOLLOWING and shares[1] > _ALIKE * shares[0] else 1.0


def speed_of(angle: FloatArray, rate: float, band_end: float) -> FloatArray:
    """Speed of a joint, up to a frequency in Hz, (N,), rad/s."""
    turning = 2.0 * np.pi * np.fft.rfftfreq(angle.size, 1.0 / rate)
    spectrum = 1j * turning * np.fft.rfft(angle - np.mean(angle))
    spectrum[turning > 2.0 * np.pi * band_end] = 0.0
    return np.asarray(np.fft.irfft(spectrum, angle.size))


def sticking(signal: FloatArray, rate: float, partner: FloatArray) -> tuple[float, int, float]:
    """Longest time for which a signal keeps one value, how often it does so for too long, and that.

    What is too long follows from the signal: 6 times the time for which it keeps a value but in one
    of a hundred moments, and no less than 100 ms. A signal may rest as it likes where its partner
    rests as well: a joint that friction holds has a steady torque. If the person pushes against
    that friction, it has not, but such a joint sets off slowly: unless its record ends there, a
    signal is stuck only if it then jumps by more than 4 times the usual step.

    Parameters
    ----------
    signal : ndarray, shape (N,)
    rate : float
        Samples per second, Hz.
    partner : ndarray, shape (N,)
        Signal that moves whenever this one does: the torque of an angle, or the angle of a torque.

    Returns
    -------
    longest, count, limit : float, int, float
        s, number of times, s.
    """
    edges = np.flatnonzero(np.diff(signal) != 0.0)
    runs = np.diff(np.concatenate(([-1], edges, [signal.size - 1])))
    typical = float(np.quantile(runs, 0.99))
    limit = max(STUCK * rate, _STUCK_TIMES * typical)
    starts = np.concatenate(([0], edges + 1))
    sizes = np.abs(np.diff(signal)[edges])
    jumps = np.concatenate((sizes > _SETS_OFF * float(np.median(sizes)), [True]))
    chosen = (runs > limit) & jumps
    long = [
        int(run)
        for start, run in zip(starts[chosen], runs[chosen], strict=True)
        if not _rests(partner, start, run)
    ]
    return max(long, default=int(np.max(runs))) / rate, len(long), limit / rate


def dropouts(
    signal: FloatArray, partner: FloatArray, kicked: FloatArray | None = None
) -> tuple[int, float]:
    """How often a signal drops out, and in which share of its samples.

    It does where it keeps one value for 3 times longer than but in one of a hundred moments, while
    its partner moves, and then jumps by 12 times the usual step to where it should be; and where it
    jumps so to and from a value, mostly the same one, as 0.

    Parameters
    ----------
    signal : ndarray, shape (N,)
    partner : ndarray, shape (N,)
        As :func:`sticking` takes it.
    kicked : ndarray, shape (N,), optional
        Angle of the locked joint whose torque the signal is. Where that rests as well, and steps as
        the torque jumps, the law has thrown the joint back.
    """
    steps = np.diff(signal)
    edges = np.flatnonzero(steps)
    if edges.size <= _TELLING_COUNTS:
        return 0, 0.0
    sizes = np.abs(steps[edges])
    jumps = sizes > _JUMP * float(np.median(sizes))
    starts, runs = edges[:-1] + 1, np.diff(edges)
    long = max(_HELD_TIMES * float(np.quantile(runs, 0.99)), _LEAST_HELD)
    found = (runs >= long) & jumps[1:]
    for place in np.flatnonzero(found):
        start, run = int(starts[place]), int(runs[place])
        thrown = False
        if kicked is not None:
            stepped = np.flatnonzero(np.diff(kicked[start : start + run + 1]))
            thrown = bool(stepped.size) and int(stepped[0]) >= run - _KICK
        found[place] = not (thrown or _rests(partner, start, run))
    dips = jumps[:-1] & jumps[1:]
    values, counts = np.unique(signal[starts[dips]], return_counts=True)
    if counts.size and np.max(counts) >= max(_LEAST_DIPS, np.sum(dips) / 2):
        found |= dips & (signal[starts] == values[np.argmax(counts)])
    return int(np.sum(found)), float(np.sum(runs[found])) / signal.size


def zeros_beyond_chance(signal: FloatArray, step: float) -> int:
    """In how many samples a signal is 0 where it passes that; 0 if chance explains it.

    Torques that are small are shown as none by a dead zone, and lost ones by a bus. A sound signal
    of which most is larger than that is 0 about as often as it has, to its resolution, any of the 8
    values on either side: 4 times as much is more. Where it rests, it does so at any value, and is
    counted for 20 samples. It has to come from larger values and go on to others within as many:
    without a perturbation a relaxed arm has no torque.

    Parameters
    ----------
    signal : ndarray, shape (N,)
    step : float
        Its resolution.
    """
    levels = np.rint(signal / (step or 1.0))
    away = np.cumsum(np.pad(np.abs(levels) > _NEIGHBOURS, (_PASSED + 1, _PASSED)))
    before = away[_PASSED:-_PASSED] > away[: -2 * _PASSED]
    after = away[2 * _PASSED :] > away[_PASSED:-_PASSED]
    zero = np.concatenate(([False], signal == 0.0, [False]))
    edges = np.flatnonzero(zero[1:] != zero[:-1])
    starts, ends = edges[::2], edges[1::2]
    passed = np.minimum(ends - starts, _PASSED)[before[starts] & after[ends]]
    count, passing = int(np.sum(passed)), (before | after)[1:]
    if passed.size < _CLIPPED or count < _FELT * signal.size:
        return 0
    values, counts = np.unique(levels[passing], return_counts=True)
    place = int(np.searchsorted(values, 0.0))
    around = counts[max(place - _NEIGHBOURS, 0) : place + _NEIGHBOURS + 1]
    few = around.size <= 2 * _NEIGHBOURS or np.sum(around) > _BROAD * signal.size
    others = np.delete(around, min(place, _NEIGHBOURS))
    return 0 if few or count <= _HEAPED * float(np.max(others)) else count


def repeating(signal: FloatArray) -> float:
    """In which share of its samples a signal stays the same or goes on straight; 0 if by chance.

    A median filter returns values as they were, readings of a lower rate are held or interpolated
    by lines: what is quick in the torque, as where a law throws a joint back, is then lost, or
    comes back at other frequencies. Rounding makes a sound signal do the same, but then steps by
    one count, or another, are as frequent. So it repeats itself where it does so in more than
    15 % of the samples, 9 times as often as it takes the most frequent step in either direction,
    and less than half of the other steps are of that size. Sound torques have 4 times at most.

    Parameters
    ----------
    signal : ndarray, shape (N,)
    """
    signal = signal[: 2 * _TELLING_SAMPLES]
    levels = np.rint(signal / (resolution_of(signal) or 1.0))
    counts = np.unique(levels, return_inverse=True)[1]
    unit = max(EXACT * float(np.ptp(signal)), _TINY)
    changes, bends = np.diff(counts), np.rint(np.diff(signal, n=2) / unit)
    for steps in (changes, bends[changes[1:] != 0]):
        still = float(np.mean(steps == 0.0)) if steps.size else 1.0
        if _REPEATED < still < 1.0:
            others = np.unique(np.abs(steps[steps != 0.0]), return_counts=True)[1]
            usual = float(np.max(others)) / steps.size
            if still > _BESIDE * 0.5 * usual and usual < _BROAD * (1.0 - still):
                return still
    return 0.0


def _copied(record: TrialRecord, source: str) -> tuple[float, float]:
    """Torque of the perturbed joint per command or perturbation, up to 3 samples late.

    And the rms of the rest per rms of the torque, 1 without commands.
    """
    k, best = record.perturbed_joint, (0.0, 1.0)
    torque, streams = record.torque[k], getattr(record, source)
    if streams is None or record.samples <= _LAGS or not np.ptp(torque):
        return best
    for lag in range(_LAGS):
        given, shown = streams[k, : torque.size - lag], torque[lag:]
        given, shown = given - np.mean(given), shown - np.mean(shown)
        factor = float(given @ shown) / max(float(given @ given), _TINY)
        share = float(np.std(shown - factor * given)) / float(np.std(torque))
        best = min(best, (factor, share), key=lambda one: one[1])
    return best


def _rests(signal: FloatArray, start: int, run: int) -> bool:
    """Whether a signal moves far less over a run than it can over as many samples."""
    whole = signal[: signal.size // run * run].reshape(-1, run)
    usual = float(np.quantile(np.ptp(whole, axis=1), 0.9))
    # A torque is ahead of the angle that it begins to move, by up to some milliseconds.
    within = signal[start + run // 10 : start + run - run // 10]
    return float(np.ptp(within)) < _RESTING * usual
