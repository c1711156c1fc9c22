"""Faults of single signals, such as clipping or coarse resolution; repair of lost readings.

A torque that stays constant while its joint moves, as in loose cuffs, is a fault as well.
Noise, hum and drift are not: the perturbation doesn't cause them, so they don't bias the estimate,
and its intervals include them. But errors that depend on the motion itself do bias it.

In all functions `record` is one trial without gaps, `records` are one for each joint, in order, and
signals have the shape (N,).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from armimp_common.arrays import TINY, BoolArray, ComplexArray, FloatArray
from armimp_common.topics import JOINT_STATES, TORQUE_SENSORS
from armimp_estimation.hold_correction import command_steps, regress
from armimp_estimation.problems import Problem, ProblemCode, Severity, problem
from armimp_estimation.record import EXACT, TrialRecord, resolution_of
from armimp_estimation.spectra import sums_within

Values = dict[str, Any]

_UNITS: Final = {JOINT_STATES: "rad", TORQUE_SENSORS: "N·m"}
_OFTEN = 8  # least number of samples at a clipped value, and of passages through a dead zone
_HEAPED = 4.0  # ratio of samples at a suspect value to those at each neighbouring value
_NEIGHBOURS = 8  # distinct values next to a suspect one that it is compared with
_REACH = 3.0  # range of those values, in median steps of the signal, where that includes more
_VISITS = 3  # least number of arrivals at clipped values
_NEXT, _GAP = 2.5, 0.25  # size of a second count at most, and gap between counts, in first counts
_PASSED = 20  # samples around zeros that larger values must reach; most that count of one run
_FELT = 0.005  # share of samples that are 0 in a dead zone, at least
_APPROACH = 5  # samples over which the speed before an arrival is taken
_UNSLOWED = 0.4  # speed at an arrival at a limit relative to that before, at least
STUCK = 0.1
"""Time for which a signal that moves may keep one value, s; longer where it moves slowly."""
_STUCK_TIMES = 6.0  # the same, in 99 % quantiles of the times for which it keeps a value
_RESTING = 0.3  # range of a resting signal, relative to what it usually covers in that time
_JUMP = 12.0  # jump at the end of a dropout, in median steps, at least
_SETS_OFF = 4.0  # jump after which a signal was stuck, in median steps, at least
_HELD_TIMES = 3.0  # length of a dropout, in 99 % quantiles of its runs of one value, at least
_LEAST_HELD = 5  # length of a dropout that holds a value, in samples, at least
_LEAST_DIPS = 3  # jumps to and from one and the same value that are dropouts, at least
_KICK = 4
"""Samples that a control law takes to respond to a step of the angle, at most."""
DROPPED = 0.002
"""Share of samples that may be dropouts; they bias the estimate by about as much."""
_BRIEF = 5
"""Most samples in a row that are mended: one less than the morphological opening takes."""
_USUAL = 0.98  # quantile of the heights of readings above or below their neighbours
_AWAY = 16.0
"""Height from which on a reading is lost, in units of that quantile or, if larger, the resolution.
Sound readings reach 12.5 at most, where a sticking joint begins to slip."""
_SMALL = 0.05
"""Height relative to the standard deviation of a signal up to which lost readings hardly matter."""
_SUDDEN = 0.9
"""Largest step within or next to lost readings, in their largest height, at least. A motion that
turns has 0.8 of it at most."""
_PERIODS = 6
"""Control periods in which torques follow a command by jumps, before the arm has moved."""
MENDED = 0.005
"""Share of samples that may be mended; beyond, too many lost ones remain that don't stand out."""
_ENOUGH = 50.0  # range in counts, or number of changes or samples, that suffices for a test
_SEARCHED = 8192  # samples that are searched for repetitions
_REGRESSED = 16384  # samples that suffice for a regression on commands
_REPEATED = 0.15  # share of repetitions that chance doesn't reach
_BESIDE = 9.0  # ratio of repetitions to the most frequent step that chance doesn't reach
_ROUNDING, _BRIDGE, _KINK = 2e-14, 0.1, 1e3
"""For :func:`bridged`: fourth differences by rounding, in the largest value, at most; length of a
stretch, s, and fourth differences at its ends, in those of rounding, at least."""
BRIDGED = 0.05
"""Share of time that may be interpolated."""
_BROAD = 0.5  # share of samples near 0, or of changes of one size, that leaves a test undecided
_SLOW, _USUAL_SLOW, _LITTLE = (0.0, 0.1), (0.5, 1.0), 0.25  # bands, Hz; ratio of their power
_COPIED = 0.005
"""Residual of a torque, relative to it, below which it is a multiple of its command, and not the
torque on the arm: a robot has inertia, if hardly any beside that of a heavy arm."""
_LAGS = 4  # lags, in samples from 0 on, at which such a torque is looked for
_BINS, _FOLDED, _FOLLOWING, _ALIKE = 10, 0.3, 0.85, 0.8
"""For :func:`aliased`: frequencies per bin; power of a perturbation near the Nyquist frequency,
relative to that at 15 to 40 Hz, from which on it may have more beyond; least share of the motion
that follows a sound one; ratio of that share at high and low frequencies if they are alike."""
JUMPED = 0.001
"""Share of lost or repeated time from which on a trial is refused; M is off by twice that."""
_ABOUT, _CLEAR, _COUNTS, _STEADY, _WHOLE, _AS_WELL = 4, 16.0, 4.0, 0.5, 0.4, 0.25
"""For :func:`time_jumps`: number of steps on either side of one; size of their mean, in usual
differences from it and in counts of an encoder, at least; difference between both sides, at most,
relative to it; distance of a jump from whole samples, relative to it, at most; share of the jumps
of a perturbation that angles have, at least."""
_JOINED, _USUAL_STEP, _FAR = 8.0, 5.0, 0.5
"""For :func:`seam`: size of a step in largest steps about it, in 99.9 % quantiles of all steps, and
in standard deviations of the angle, at least."""
_QUICK, _NEAR, _LINGERS, _STILL, _SURE = (3.0, 40.0), 0.2, 0.04, 0.5, 4.0
"""For :func:`floating`: band, Hz; width of a bin of torque, in standard deviations; least share of
time in it; power of changes relative to what is usual, at most; standard deviations of chance."""
_SETTLED = 3.0
"""Length of a trial from which on it is judged whether a joint moves without the arm, s."""
RESOLVED: Final = {JOINT_STATES: 20.0, TORQUE_SENSORS: 8.0}
"""Peak to peak motion and torque, in counts of the resolution, below which nothing is resolved."""


def judge_signals(record: TrialRecord) -> list[Problem]:
    """Find the faults of the angles and torques of a trial."""
    return [
        problem(code, trial=record.trial, stream=stream, name=name, **values)
        for stream in (JOINT_STATES, TORQUE_SENSORS)
        for joint, name in enumerate(record.joint_names)
        for code, values in _faults(record, stream, joint)
    ]


def _faults(record: TrialRecord, stream: str, joint: int) -> Iterator[tuple[ProblemCode, Values]]:
    """Yield the faults of one signal, with the values for the sentence of each problem."""
    k, torques = record.perturbed_joint, stream == TORQUE_SENSORS
    signal, step = record.readings[stream][joint], float(record.resolution[stream][joint])
    for value, count in clipping(signal, step):
        yield ProblemCode.CLIPPED, {"value": value, "unit": _UNITS[stream], "count": count}
    if torques or joint == k:
        counts = float(np.ptp(signal)) / step if step else 0.0
        if counts < RESOLVED[stream]:
            yield ProblemCode.UNRESOLVED, {"counts": counts}
        partner = (record.position if torques else record.torque)[k]
        if counts >= _ENOUGH:
            longest, count, limit = sticking(signal, record.rate, partner)
            if count:
                yield ProblemCode.STUCK, {"longest": longest, "count": count, "limit": limit}
        kicked = None if joint == k else record.position[joint]
        dropped, share = dropouts(signal, partner, kicked)
        if share > DROPPED:
            yield ProblemCode.DROPPED, {"count": dropped, "percent": 100.0 * share}
    if torques and (count := zeros_beyond_chance(signal, step)):
        yield ProblemCode.DEAD_ZONE, {"count": count, "percent": 100.0 * count / signal.size}
    if torques or joint == k:
        repeated = repeating(signal) if torques else 0.0
        # If the perturbation was interpolated as well, cause and effect have changed alike.
        if repeated and repeating(record.perturbation[k]):
            repeated = 0.0
        if (share := max(repeated, bridged(signal, record.rate))) > BRIDGED:
            yield ProblemCode.INTERPOLATED, {"percent": 100.0 * share}
    if joint == k:
        yield from _faults_of_response(record) if torques else _faults_of_motion(record)


def _faults_of_motion(record: TrialRecord) -> Iterator[tuple[ProblemCode, Values]]:
    """Yield the faults of the angle of the perturbed joint."""
    if (share := aliased(record)) < 1.0:
        yield ProblemCode.ALIASED, {"percent": 100.0 * share}
    if (share := time_jumps(record)) > JUMPED:
        yield ProblemCode.TIME_JUMPS, {"percent": 100.0 * share}
    if record.periods is not None and (jump := seam(record.position[record.perturbed_joint])):
        yield ProblemCode.JOINED, {"jump": jump}


def _faults_of_response(record: TrialRecord) -> Iterator[tuple[ProblemCode, Values]]:
    """Yield the faults of the torque of the perturbed joint."""
    for source in ("command", "perturbation"):
        factor, share = _copied(record, source)
        if share < _COPIED:
            about: Values = {"source": source, "factor": factor, "percent": 100.0 * share}
            yield ProblemCode.TORQUE_IS_COMMAND, about
    value, share = floating(record) if record.duration > _SETTLED else (0.0, 0.0)
    if share:
        yield ProblemCode.ARM_FLOATS, {"value": value, "percent": 100.0 * share}


def floating(record: TrialRecord) -> tuple[float, float]:
    """Torque at which the perturbed joint moves without the arm, and the share of time spent there.

    While an arm is loose in its cuffs, or behind play, the torque stays constant although the joint
    moves. The torque of a linear arm changes at any level. So the rate of change of the torque from
    3 to 40 Hz, where a person adds little, is compared with that of its linear regression on
    angles, speeds and accelerations, in bins of torque a fifth of a standard deviation wide.

    Returns
    -------
    torque : float
        Centre of the most frequent bin in which the torque stays, N·m: over 4 % of the time, with
        less than half of the power of changes that the regression has there, and beyond chance.
    share : float
        Share of time in all such bins; 0 if there is none.
    """
    k, f = record.perturbed_joint, np.fft.rfftfreq(record.samples, 1.0 / record.rate)
    top, s = min(_QUICK[1], 0.4 * record.rate), 2j * np.pi * f
    quick = (f > _QUICK[0]) & (f < top)
    # A second at each end fades in and out: where ends do not meet, their leakage hides the motion.
    faded = np.minimum(np.arange(record.samples) / record.rate, 1.0)
    fading = np.sin(0.5 * np.pi * np.minimum(faded, faded[::-1])) ** 2
    angles, torque = (
        np.fft.rfft(fading * (one - one.mean(axis=-1, keepdims=True)))
        for one in (record.position, record.torque[k])
    )
    motion = np.concatenate([s[quick] ** order * angles[:, quick] for order in range(3)])
    motion /= np.linalg.norm(motion, axis=1, keepdims=True) + TINY
    parts = [np.concatenate((one.real, one.imag), axis=-1) for one in (motion, torque[quick])]
    follows = np.zeros_like(torque)
    found = np.linalg.lstsq(parts[0].T, parts[1], rcond=None)[0] @ motion
    # Rounded angles, derived twice, are mostly noise beyond the perturbation: of each band of 1 Hz
    # only what the torque has in common with them counts.
    near = np.asarray(f[quick], dtype=np.float64)
    cross, _ = sums_within(near, torque[quick] * np.conj(found), 0.5)
    power, _ = sums_within(near, np.abs(found) ** 2, 0.5)
    follows[quick] = cross / np.maximum(power, TINY) * found
    signals = np.fft.irfft(
        np.stack((torque * (f < top), s * quick * torque, s * follows)), record.samples
    )
    level, own, expected = signals[:, round(record.rate) : -round(record.rate)]
    width = _NEAR * float(np.std(level))
    if record.resolution[TORQUE_SENSORS][k] >= width or not expected.any():
        return 0.0, 0.0  # the torque changes by single counts, or not at all
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
    """Interpolate readings that were lost: up to 5 in a row that jump away, and back again.

    A bus or a converter that fails now and then shows 0, an old value, or any other. A lost reading
    stands out by its height above the morphological opening of the signal over 6 samples, or its
    depth below the closing, and as suddenly. Jumps that chattering commands cause in torques are
    subtracted before.
    A record without such outliers stays as it is.

    Returns
    -------
    record : TrialRecord
        The trial with lost readings interpolated.
    problems : list of Problem
        How many samples of which signals were mended; errors where they are too many.
    """
    problems, k = [], np.arange(record.samples)
    whole = {stream: signals.copy() for stream, signals in record.readings.items()}
    known = {JOINT_STATES: np.zeros_like(record.position), TORQUE_SENSORS: _of_commands(record)}
    for stream, signals in whole.items():
        for joint, (name, signal) in enumerate(zip(record.joint_names, signals, strict=True)):
            rest = signal - known[stream][joint]
            height = np.maximum(_over_opening(rest), _over_opening(-rest))
            height[:_PERIODS] = 0.0  # these follow commands from before the record
            usual = max(float(np.quantile(height, _USUAL)), record.resolution[stream][joint])
            away = height > max(_AWAY * usual, _SMALL * float(np.std(signal)))
            away &= _sudden(rest, height, away)
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
    """Part of the torques that jumps with the commands of the last periods, (n, N), N·m.

    Without commands, with the perturbation, which they contain.
    """
    if record.samples <= _ENOUGH:
        return np.zeros_like(record.torque)
    lags = range(_PERIODS)
    own = record.perturbation[[record.perturbed_joint]]
    pushes = np.diff(own, axis=1, prepend=own[:, :1])
    steps = pushes if record.command is None else command_steps(record)
    steps = np.pad(steps, ((0, 0), (_PERIODS, 0)))
    lagged = np.concatenate([steps[:, _PERIODS - lag : steps.shape[1] - lag] for lag in lags])
    changes = np.diff(record.torque, axis=1, prepend=record.torque[:, :1])
    answers, _ = regress([lagged[:, :_REGRESSED]], [changes[:, :_REGRESSED]])
    return np.asarray(np.cumsum(answers @ lagged, axis=1))


def _over_opening(signal: FloatArray) -> FloatArray:
    """Height of a signal, (N,), above its morphological opening, which removes brief peaks."""
    opened = np.pad(signal, _BRIEF, mode="edge")
    for extreme in (np.minimum, np.maximum):
        of_two = extreme(opened[:-1], opened[1:])
        opened = extreme(extreme(of_two[:-4], of_two[2:-2]), of_two[4:])
    return np.asarray(signal - opened)


def _sudden(signal: FloatArray, height: FloatArray, away: BoolArray) -> BoolArray:
    """Which samples, (N,), of those `away` are in a run that a signal enters or leaves at once."""
    ends = np.flatnonzero(np.diff(away, prepend=False, append=False)).reshape(-1, 2)
    steps = np.abs(np.diff(signal, prepend=signal[0], append=signal[-1]))
    found = np.zeros_like(away)
    for start, end in ends:
        enough = _SUDDEN * np.max(height[start:end])
        found[start:end] = np.max(steps[start : end + 1]) >= enough
    return found


def clipping(signal: FloatArray, step: float) -> list[tuple[float, int]]:
    """Values at which a signal is clipped, and the number of samples at each.

    A signal that turns freely has fewer samples at its extreme value than at the next ones, while
    clipping heaps them up there. So the extreme value, to the resolution, must have at least 8
    samples, and more than 4 times as many as each of the 8 distinct values next to it and each one
    within 3 median steps (an interpolated fast signal has many values between two counts). A joint
    that friction holds may rest at an extreme as long, but doesn't come back to the same value, and
    slows down before. So a clipped signal must also arrive 3 times, at both ends together, with
    more than 0.4 of the speed that it had 5 samples before. (A motion that comes to rest steadily
    has a third of that speed.) `step` is the resolution of the signal.
    """
    levels = np.rint(signal / (step or 1.0))
    values, counts = np.unique(levels, return_counts=True)
    if values.size <= _NEIGHBOURS:
        return []
    steps = np.abs(np.diff(signal))
    reach = _REACH * float(np.median(steps[steps > 0.0])) / (step or 1.0)
    above = max(_NEIGHBOURS, int(np.sum(values <= values[0] + reach)) - 1)
    below = max(_NEIGHBOURS, int(np.sum(values >= values[-1] - reach)) - 1)
    found, visits = [], 0
    speed = np.zeros(2)
    for end, heap, inner in (
        (0, counts[0], counts[1 : 1 + above]),
        (values.size - 1, counts[-1], counts[-1 - below : -1]),
    ):
        if heap >= _OFTEN and heap > _HEAPED * float(np.max(inner)):
            rank = np.abs(np.searchsorted(values, levels) - end)
            arrivals = _arrivals(rank)
            found.append((float(signal[rank == 0][0]), int(heap)))
            visits += arrivals.size
            before = signal[np.maximum(arrivals - _APPROACH * np.arange(3)[:, None], 0)]
            speed += np.abs(np.sum(np.diff(before, axis=0), axis=1))
    return found if visits >= _VISITS and speed[0] > _UNSLOWED * speed[1] else []


def _arrivals(rank: NDArray[np.int_]) -> NDArray[np.int_]:
    """Samples that reach rank 0, the extreme value, for the first time since a rank above 8."""
    there = np.flatnonzero((rank == 0) | (rank > _NEIGHBOURS))
    at_end = rank[there] == 0
    came: NDArray[np.int_] = there[at_end & ~np.concatenate(([False], at_end[:-1]))]
    return came


def without_slow(records: Sequence[TrialRecord]) -> BoolArray:
    """Whether torques, and angles, have little power at low frequencies, as behind a high-pass.

    A person, noise, drift and most perturbations have as much power density below 0.1 Hz as at 0.5
    to 1 Hz. Behind a high-pass of 0.3 Hz it is a tenth. The result has the shape (2, n).
    """
    powers = np.zeros((2, 2, len(records)))
    for record in records:
        signals = np.stack((record.torque, record.position))
        # The window would give the mean, which is the posture, power at low frequencies.
        signals = (signals - signals.mean(axis=2, keepdims=True)) * np.hanning(record.samples)
        f = np.fft.rfftfreq(record.samples, 1.0 / record.rate)
        power = np.abs(np.fft.rfft(signals)) ** 2
        for place, (low, high) in enumerate((_SLOW, _USUAL_SLOW)):
            within = power[:, :, (f > low) & (f <= high)]
            powers[place] += within.mean(axis=2) if within.size else 0.0
    return np.asarray(powers[0] < _LITTLE * powers[1])


def spectrum_by_bins(signal: FloatArray) -> ComplexArray:
    """Spectrum of a signal, (N,), with a Hann window, in bins of `_BINS` frequencies, (m, 10)."""
    bins = signal.size // 2 // _BINS * _BINS
    spectrum = np.fft.rfft((signal - signal.mean()) * np.hanning(signal.size))
    return np.asarray(spectrum[:bins].reshape(-1, _BINS))


def followed(
    cause: ComplexArray, signal: ComplexArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Coherence of a signal with its cause, power of the cause and of the signal, in bins, (m,).

    Both are given as :func:`spectrum_by_bins` returns them, (m, 10).
    """
    power, answer = (np.sum(np.abs(one) ** 2, axis=1) for one in (cause, signal))
    cross = np.abs(np.sum(np.conj(cause) * signal, axis=1)) ** 2
    return cross / np.maximum(answer * power, TINY), power, answer


def aliased(record: TrialRecord) -> float:
    """Share of the motion that follows a perturbation which was aliased; 1 if it was not.

    A recorder that keeps one sample in several, without a low-pass, folds what is above its Nyquist
    frequency. Torques follow such a perturbation at once and are aliased alike, but angles follow
    its integral. So they seem to follow only a part of it, the same part at all frequencies, while
    encoders add noise at high frequencies, and a person at low ones. So if the perturbation has
    power near the Nyquist frequency, its coherence with the motion, less the power of rounding, has
    to be below 0.85 at 3 to 8 Hz and at 15 to 40 Hz, and at most a fifth lower in the upper band.
    """
    k = record.perturbed_joint
    pushes = spectrum_by_bins(record.perturbation[k, 1:-1])
    power = np.sum(np.abs(pushes) ** 2, axis=1)
    f = (np.arange(power.size) + 0.5) * _BINS * record.rate / (record.samples - 2)
    slow, quick = (f > 3.0) & (f < 8.0), (f > 15.0) & (f < 40.0)
    comparable = slow.any() and quick.any()
    if not comparable or np.mean(power[f > 0.375 * record.rate]) < _FOLDED * np.mean(power[quick]):
        return 1.0
    share, _, answer = followed(pushes, spectrum_by_bins(np.diff(record.position[k], n=2)))
    # Power of the second differences of rounding, whose variance is q²/12, with a Hann window.
    rounding = record.resolution[JOINT_STATES][k] ** 2 / 12.0 * 0.375 * record.samples * _BINS
    moved = np.maximum(1.0 - rounding * (2.0 * np.sin(np.pi * f / record.rate)) ** 4 / answer, 0.02)
    shares = [float(np.mean((share / moved)[one])) for one in (slow, quick)]
    return max(shares) if max(shares) < _FOLLOWING and shares[1] > _ALIKE * shares[0] else 1.0


def time_jumps(record: TrialRecord) -> float:
    """Share of the time that is lost, or too much, as all streams lack samples or repeat them.

    A recorder that closes up what it lost, or fills it in, leaves regular stamps. But where a
    signal changes steadily, its step over lost samples is a multiple of the steps about it, and
    there is none between a sample and its copy. Such steps of the perturbation count if the angle
    makes them, too, as a controller may itself skip or repeat a value of the perturbation. Readings
    that are only late, so that a double step follows where there was none, leave time as it is.
    """
    k, counts = record.perturbed_joint, (0.0, _COUNTS)
    if record.samples <= 2 * _ABOUT + 1:
        return 0.0
    lost = looked = 0.0
    steps = np.diff(np.stack((record.perturbation[k], record.position[k])))
    windows = sliding_window_view(steps, 2 * _ABOUT + 1, axis=1)
    # Without the steps next to it, as after a reading that comes too late one is too long.
    before = windows[..., : _ABOUT - 1].mean(axis=-1)
    after = windows[..., 1 - _ABOUT :].mean(axis=-1)
    usual = 0.5 * (before + after)
    apart = windows[..., _ABOUT] - usual
    beside = 0.5 * (windows[..., _ABOUT - 1] + windows[..., _ABOUT + 1])
    # A motion that slows down and hurries on has small steps next to its smallest one, too.
    uneven = np.maximum(np.abs(after - before), 2.0 * np.abs(beside - usual))
    steady = uneven < _STEADY * np.abs(usual)
    for channel, count in enumerate(counts):
        noise, own = float(np.median(np.abs(apart[channel]))), usual[channel]
        least = max(_CLEAR * noise, count * float(record.resolution[JOINT_STATES][k]))
        # A signal that mostly keeps its value tells nothing.
        clear = steady[channel] & (np.abs(own) > (least if noise else np.inf))
        # Samples that each step is too long: those that were lost, or -1 for one recorded twice.
        ratio = np.divide(apart[channel], own, out=np.zeros_like(own), where=clear)
        jumps = np.rint(ratio)
        jumps *= (jumps >= -1.0) & (np.abs(ratio - jumps) < _WHOLE * np.abs(jumps))
        expected = jumps * usual[1]
        if expected @ apart[1] > _AS_WELL * (expected @ expected):
            lost += abs(float(np.sum(jumps)))
        looked += np.count_nonzero(clear)
    return lost / max(looked, 1.0)


def seam(angle: FloatArray) -> float:
    """Largest step of an angle that no motion makes, as between recordings, rad; 0 without one.

    If the same perturbation was recorded several times and joined, each period has the same step,
    so that its scatter doesn't show what is lost at the end. A reading that catches up after others
    were held is another fault: it follows steps of 0.
    """
    steps = np.abs(np.diff(angle))
    if steps.size <= 2 * _ABOUT + 1:
        return 0.0
    windows = sliding_window_view(steps, 2 * _ABOUT + 1)
    before = windows[:, :_ABOUT].max(axis=1)
    around = np.maximum(before, windows[:, _ABOUT + 1 :].max(axis=1))
    usual = max(_USUAL_STEP * float(np.quantile(steps, 0.999)), _FAR * float(np.std(angle)))
    own = windows[:, _ABOUT]
    found = own[(own > np.maximum(_JOINED * around, usual)) & (before > 0.0)]
    return float(np.max(found, initial=0.0))


def sticking(signal: FloatArray, rate: float, partner: FloatArray) -> tuple[float, int, float]:
    """How long and how often a signal keeps one value for too long.

    The limit follows from the signal: 6 times the 99 % quantile of the times for which it keeps a
    value, and at least 100 ms. A signal may rest while its partner rests as well: a joint that
    friction holds has a steady torque. If the person pushes against that friction, the torque isn't
    steady, but such a joint sets off slowly. So a signal is stuck only if it jumps afterwards by
    more than 4 median steps, or if the record ends there.

    Parameters
    ----------
    rate : float
        Samples per second, Hz.
    partner : ndarray, shape (N,)
        Signal that moves whenever this one does: the torque of an angle, or the angle of a torque.

    Returns
    -------
    longest, count, limit : float, int, float
        Longest time for which the signal was stuck or, if it never was, kept one value, s; number
        of times that it was stuck; limit, s.
    """
    starts, runs, sizes = _runs(signal)
    limit = max(STUCK * rate, _STUCK_TIMES * float(np.quantile(runs, 0.99)))
    jumps = np.append(sizes > _SETS_OFF * float(np.median(sizes)), True)
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
    """Number of dropouts of a signal, and their share of its samples.

    In a dropout a signal keeps one value for at least 3 times the 99 % quantile of such times,
    while its partner moves, and then jumps by over 12 median steps to where it should be. Jumps as
    large to a value and back are dropouts, too, if that value is mostly the same one, such as 0.

    Parameters
    ----------
    partner : ndarray, shape (N,)
        As for :func:`sticking`.
    kicked : ndarray, shape (N,), optional
        Angle of the locked joint whose torque the signal is. Where it rests as well, and steps when
        the torque jumps, the control law has thrown the joint back, which is no dropout.
    """
    starts, runs, sizes = _runs(signal)
    if sizes.size <= _ENOUGH:
        return 0, 0.0
    jumps = sizes > _JUMP * float(np.median(sizes))
    starts, runs = starts[1:-1], runs[1:-1]  # those with a jump at either end
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
    """Number of samples in which a signal is 0 as it passes through 0; 0 if chance explains them.

    A dead zone shows small torques as 0, and a bus may show lost readings as 0. A sound signal,
    most of which is farther from 0, has the value 0 about as often as any of the 8 values, to its
    resolution, on either side; more than 4 times as often is beyond chance. Readings that were
    rounded before they were multiplied, as a force by a lever that changes with the angle, have a
    heap of values for each count, apart from the next one. A run of zeros counts for 20 samples at
    most, as a signal may rest at any value. Within 20 samples before and after it the signal has to
    leave the range of those values: a relaxed, unperturbed arm has no torque. `step` is the
    resolution of the signal.
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
    if passed.size < _OFTEN or count < _FELT * signal.size:
        return 0
    values, counts = np.unique(levels[passing], return_counts=True)
    place = int(np.searchsorted(values, 0.0))
    around = counts[max(place - _NEIGHBOURS, 0) : place + _NEIGHBOURS + 1]
    few = around.size <= 2 * _NEIGHBOURS or np.sum(around) > _BROAD * signal.size
    others = np.delete(around, min(place, _NEIGHBOURS))
    sizes = np.sort(np.abs(signal[signal != 0.0]))
    beyond = _NEXT * sizes[0]
    gaps = np.diff(sizes[sizes < beyond], append=beyond) > _GAP * sizes[0]
    heap = 0.5 * float(np.argmax(gaps) + 1) if gaps.any() else 0.0
    return 0 if few or count <= _HEAPED * max(float(np.max(others)), heap) else count


def repeating(signal: FloatArray) -> float:
    """Share of samples in which a signal stays constant or on a straight line; 0 if by chance.

    A median filter repeats values, and readings of a lower rate are held or interpolated linearly.
    Fast torques, as where a control law throws a joint back, are then lost, or aliased. Rounding
    makes a sound signal repeat values as well, but then steps by one count, or another, are as
    frequent. So a signal counts as repeating if it does so in more than 15 % of the samples, more
    than 9 times as often as it takes the most frequent step in either direction (sound torques: 4
    times at most), and if less than half of the steps that aren't 0 are of that size.
    """
    signal = signal[:_SEARCHED]
    levels = np.rint(signal / (resolution_of(signal) or 1.0))
    counts = np.unique(levels, return_inverse=True)[1]
    unit = max(EXACT * float(np.ptp(signal)), TINY)
    changes, bends = np.diff(counts), np.rint(np.diff(signal, n=2) / unit)
    for steps in (changes, bends[changes[1:] != 0]):
        still = float(np.mean(steps == 0.0)) if steps.size else 1.0
        if _REPEATED < still < 1.0:
            others = np.unique(np.abs(steps[steps != 0.0]), return_counts=True)[1]
            usual = float(np.max(others)) / steps.size
            if still > _BESIDE * 0.5 * usual and usual < _BROAD * (1.0 - still):
                return still
    return 0.0


def bridged(signal: FloatArray, rate: float) -> float:
    """Share of samples in stretches that were interpolated by a straight line or a cubic.

    In such a stretch, of 0.1 s or more, fourth differences are those of rounding; within 4 samples
    of either end they are 1000 times as large at least. The smooth motion of a simulation begins or
    ends less suddenly. Steps by the same counts as elsewhere, or by none, are those of an encoder.
    """
    if signal.size <= _ENOUGH:
        return 0.0
    nothing = max(_ROUNDING * float(np.max(np.abs(signal))), TINY)
    bends = np.abs(np.diff(signal, n=4))
    starts, runs, _ = _runs(np.where(bends < nothing, 0.0, 1.0))
    ends = starts + runs
    long = (bends[starts] < nothing) & (runs + 4 >= _BRIDGE * rate)
    if not long.any():
        return 0.0
    sudden = sliding_window_view(np.pad(bends, 4), 4).max(axis=1) > _KINK * nothing
    stretches = [
        slice(start, end + 3)
        for start, end in zip(starts[long], ends[long], strict=True)
        if sudden[start] and sudden[end + 4]
    ]
    steps = np.rint(np.diff(signal) / nothing)
    elsewhere = np.ones(steps.size, dtype=bool)
    for one in stretches:
        elsewhere[one] = False
    usual = np.isin(steps, np.append(steps[elsewhere], 0.0))
    found = [one.stop - one.start for one in stretches if np.mean(usual[one]) < _BROAD]
    return float(sum(found)) / signal.size


def _copied(record: TrialRecord, source: str) -> tuple[float, float]:
    """Regress the torque of the perturbed joint on its command or perturbation, at lags of 0 to 3.

    Returns the factor, and the rms of the residual relative to the torque's: 1 without commands.
    """
    k, best = record.perturbed_joint, (0.0, 1.0)
    torque, streams = record.torque[k], getattr(record, source)
    if streams is None or record.samples <= _LAGS or not np.ptp(torque):
        return best
    for lag in range(_LAGS):
        given, shown = streams[k, : torque.size - lag], torque[lag:]
        given, shown = given - np.mean(given), shown - np.mean(shown)
        factor = float(given @ shown) / max(float(given @ given), TINY)
        share = float(np.std(shown - factor * given)) / float(np.std(torque))
        best = min(best, (factor, share), key=lambda one: one[1])
    return best


def _runs(signal: FloatArray) -> tuple[NDArray[np.intp], NDArray[np.intp], FloatArray]:
    """First samples and lengths of all runs of one value, and sizes of the steps between them."""
    steps = np.diff(signal)
    starts = np.append(0, np.flatnonzero(steps) + 1)
    return starts, np.diff(starts, append=signal.size), np.abs(steps[starts[1:] - 1])


def _rests(signal: FloatArray, start: int, run: int) -> bool:
    """Whether a signal moves far less in a run of samples than it usually can in as many."""
    whole = signal[: signal.size // run * run].reshape(-1, run)
    usual = float(np.quantile(np.ptp(whole, axis=1), 0.9))
    # A torque is ahead of the angle that it begins to move by up to some milliseconds.
    within = signal[start + run // 10 : start + run - run // 10]
    return float(np.ptp(within)) < _RESTING * usual
