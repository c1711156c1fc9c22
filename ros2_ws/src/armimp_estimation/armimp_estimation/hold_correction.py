"""Correct torque readings for the zero-order hold of the commands, from the records themselves.

Between two updates the joints accelerate with ``θ̈ = (M_r + M_h)⁻¹ (u - ...)``, where the command u
is held and all the rest, friction included, changes continuously. So at each update by Δu the
torque on the arm jumps by ``D Δu`` with ``D = M_h (M_r + M_h)⁻¹``. Its slope jumps by ``S Δu/L``,
since damping and the friction of the robot act on the velocity that the jump builds up. A reading
just before the update lacks just these jumps. The torque between the updates follows from readings
and jumps by the Euler-Maclaurin formula (coefficients 1/2 and 1/12), up to fourth order in ωL:

    τ(ω) = τ_before(ω) + [D (1/2 - jωL/12) + S/12] Δu(ω)

:mod:`armimp_estimation.torque_timing` has the closed form, also for readings that pass a filter or
are late. A shift by half a sample, ``T exp(jωL/2)``, also corrects the inertial torque, but
overcorrects what does not jump (it adds ``K L/2`` to B and ``B L/2`` to M) and ignores the part of
u that overcomes friction. D need not be precise: an error of 10 % leaves 10 % of the skew.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.fft import next_fast_len

from armimp_common.arrays import TINY, BoolArray, ComplexArray, FloatArray
from armimp_estimation.record import TrialRecord
from armimp_estimation.torque_timing import TorqueReading

# Periods for which the torque is followed after a jump, once the jump has passed the filter.
_PERIODS = 3
# Share of a step that a reading may lack and still count as showing all of it.
_PASSED = 0.01
_DIFFERENCES = 4
_CHATTER_EXPLAINS = 0.9
"""Share of the torque's differences that the last steps must explain: noise, or friction that acts
within the period, biases the value and slope that they give."""
_OF_OTHERS, _CHATTER_SEEN = 0.95, 0.2
"""Commands are misaligned if a single step of another sample explains more than the first share of
what all steps explain, and these more than the second share of the torque's differences."""
_LEFT, _LEFT_BESIDE, _OFF = 1.0, 2.2, 0.15
"""Largest rms residual of a torque regressed on motion and jumps, relative to the part that jumps
alone explain; the same if chatter gives another row of D; relative error of D over that ratio."""
_SHOWN = 0.5
"""Least power of the changes of a torque, relative to that of the jumps that it should show."""
_PARTS, _ENOUGH = 8, 16_384
"""Parts of each record, whose scatter gives the error of answers to rounding, and samples that
suffice: the time goes with the square of the number of joints."""
_EXPLAINED = 0.01
"""Share of the changes of torques that steps recorded within one period of them must explain; if
commands are recorded later, they explain 0.003 at most, by chance. Rounding of angles must explain
as much of the steps: that of other encoders explains 0.007 at most."""
_BESIDE = 3
"""Periods by which commands may be recorded too late or too early and are still found."""
_QUICK = (2.0, 3.0, 15.0, 20.0)
"""Edges of a band-pass, Hz: it rises over the first two and falls over the last two."""


@dataclass(frozen=True, kw_only=True, eq=False)
class HoldCorrection:
    """Jumps of the torques on the arm with a step of the commands.

    Attributes
    ----------
    torque : ndarray, shape (n, n)
        D: torques jump by ``D Δu``, N·m per N·m.
    slope : ndarray, shape (n, n)
        S: their slopes jump by ``S Δu / L``, N·m per N·m.
    error : ndarray, shape (n,)
        Relative standard error of the rows of D and S because of errors of the angles.
    """

    torque: FloatArray
    slope: FloatArray
    error: FloatArray


def without_skew(
    f: FloatArray, record: TrialRecord, jump: HoldCorrection | None = None, late: float = 0.0
) -> ComplexArray:
    """Coefficients that give the torques on the arm from readings and steps of commands.

    Parameters
    ----------
    f : ndarray, shape (n_freq,)
        Frequencies, Hz.
    record : TrialRecord
        A trial with n joints.
    jump : HoldCorrection, optional
        How torques jump with the commands; by default steps have no coefficients.
    late : float
        Fitted delay of the torques beyond the known one, s.

    Returns
    -------
    ndarray, shape (n, n, n_freq) or, with those of the n steps, (n, 2n, n_freq)
    """
    known = record.reading.at_rate(record.rate)
    coefficients = np.eye(record.joints)[:, :, None]
    if jump is not None:
        edge, bend = known.folded(f, record.rate)
        lacking = jump.torque[:, :, None] * edge + jump.slope[:, :, None] * bend
        coefficients = np.concatenate((coefficients + 0.0 * f, lacking), axis=1)
    turned = np.exp(2j * np.pi * f * late) / known.response(f)
    return np.asarray(coefficients * turned, dtype=np.complex128)


def command_steps(record: TrialRecord) -> FloatArray:
    """Difference of each command from the one before, ``u_k - u_{k-1}``, shape (n, N), N·m.

    The first is 0, as the command before it is unknown. The spectrum of an error at one sample is
    flat, so it looks like leakage.
    """
    if record.command is None:
        raise ValueError(f"trial {record.trial} has no commands")
    steps: FloatArray = np.diff(record.command, axis=1, prepend=record.command[:, :1])
    return steps


def update_jump(records: Sequence[TrialRecord]) -> HoldCorrection | None:
    """Estimate the jumps of the torques and their slopes with steps Δu of the commands.

    With encoders of finite resolution the command chatters, and fourth differences of the torque
    consist almost only of its effect. They are regressed on fourth differences of the steps of the
    last three updates. This gives the change of the torque 1, 2 and 3 periods after a step, and a
    parabola through these is extrapolated back to the moment after the step itself. (The friction
    of a robot can take 3 % off the jump within the first period.)

    Without chatter, angles are so fine that the motion itself determines D:

        τ_before = -½ D Δu + M (θ_{k+1} - 2θ_k + θ_{k-1})/L² + B (θ_{k+1} - θ_{k-1})/2L + K θ

    is fitted by least squares from 2 to 20 Hz, where a person does little, and the slope, which
    hardly matters then, is taken as 0. Errors of the angles would bias D, so the residual must not
    be large compared with what D alone explains. The row of each torque comes from chatter if that
    determines it, else from the motion.

    Readings that are late or have passed a low-pass show a step later, and more slowly. So the
    poles of the low-pass are removed from them, and its known responses to a step, a ramp and a
    parabola of the torque are fitted. Only chatter is used then.

    Parameters
    ----------
    records : sequence of TrialRecord
        Trials of one arm, with torques read just before the updates if it is not known how.

    Returns
    -------
    HoldCorrection or None
        None if readings do not miss the jumps, or they are not identified: a trial has no commands,
        neither way explains a torque, commands seem to be those of other samples, or the
        eigenvalues of D do not lie between 0 and 1, as they do for any two inertias.
    """
    known = records[0].reading.at_rate(records[0].rate)
    if known.without_jumps or any(record.command is None for record in records):
        return None
    chatter = _chatter(records, known)
    jump, explained = _from_chatter(*chatter, known, records[0].rate)
    sure = explained > _CHATTER_EXPLAINS
    if sure.all():
        if _is_share_of_inertia(jump.torque):
            return jump
        sure = np.zeros_like(sure)
    else:
        at_all, elsewhere = _explained_by_chatter(records, known)
        if (~sure & (at_all > _CHATTER_SEEN) & (elsewhere > _OF_OTHERS * at_all)).any():
            return None
    if not known.prompt:
        return None
    moved = _from_motion(records)
    jump = HoldCorrection(
        torque=np.where(sure[:, None], jump.torque, moved.torque),
        slope=np.where(sure[:, None], jump.slope, moved.slope),
        error=np.where(sure, 0.0, moved.error),
    )
    most = _OFF * (_LEFT_BESIDE if sure.any() else _LEFT)
    determined = (sure | (moved.error < most) & _shows(*chatter, moved)).all()
    return jump if determined and _is_share_of_inertia(jump.torque) else None


def answers_to_rounding(records: Sequence[TrialRecord]) -> tuple[FloatArray, FloatArray]:
    """Estimate the share of a step of a joint's command that its torque shows at once.

    A law may feed back torques with their noise, and commands that follow this noise are no cause
    of it. But only the law acts on the rounding of angles. So the changes of torques are regressed
    on the part of the steps that rounded angles explain (instrumental variables).

    Parameters
    ----------
    records : sequence of TrialRecord
        Trials of one arm, with commands, and with angles whose second differences are mostly
        rounding.

    Returns
    -------
    answers, errors : ndarray, shape (n, 2)
        Shares in readings just after and just before the updates, and their standard errors from
        the scatter of parts of the records; infinite where the steps are those of other samples.
    """
    n, reading = records[0].joints, TorqueReading()
    at = slice(_BESIDE - 1, _BESIDE + 1)
    records = [one.part(0, min(one.samples, _ENOUGH)) for one in records]
    steps, changes = _chatter(records, reading, beside=_BESIDE, differences=1)
    rounded = [replace(record, command=record.position) for record in records]
    angles, _ = _chatter(rounded, reading, beside=_BESIDE, differences=1)
    by, told = regress(angles, steps)
    predicted = [by @ one for one in angles]

    def cut(rows: Sequence[FloatArray], part: int) -> list[FloatArray]:
        return [np.array_split(one, _PARTS, axis=1)[part] for one in rows]

    found = [regress(cut(predicted, part), cut(changes, part))[0] for part in range(_PARTS)]
    own = np.arange(n)
    answers = np.reshape(found, (_PARTS, n, -1, n))[:, own, at, own]
    errors = np.std(answers, axis=1, ddof=1) / np.sqrt(_PARTS)
    # Commands of other samples explain nothing of the torques.
    beside = slice(n * (_BESIDE - 1), n * (_BESIDE + 2))
    _, explained = regress([rows[beside] for rows in steps], changes)
    # Nor does rounding of another encoder than the law has, as at the motor of a soft drive.
    known = np.minimum(explained, np.min(np.reshape(told, (-1, n))[at], axis=0))
    return np.mean(answers, axis=1), np.where(known[:, None] > _EXPLAINED, errors, np.inf)


def _is_share_of_inertia(transmission: FloatArray) -> bool:
    eigenvalues = np.linalg.eigvals(transmission)
    return bool((eigenvalues.real > 0.0).all() and (np.abs(eigenvalues) < 1.0).all())


def _from_chatter(
    inputs: Sequence[FloatArray],
    outputs: Sequence[FloatArray],
    reading: TorqueReading,
    rate: float,
) -> tuple[HoldCorrection, FloatArray]:
    _, to_parabola, edge = _lags(reading, rate)
    products = _products(inputs, outputs)
    coefficients, _ = _solved(*products)
    n = len(outputs[0])
    # The last steps have to explain nearly all; else the commands are those of other samples.
    _, explained = _solved(*products, slice(n * edge))
    torque, slope = (
        sum(weight * coefficients[:, n * lag : n * (lag + 1)] for lag, weight in enumerate(row))
        for row in to_parabola
    )
    return HoldCorrection(torque=torque, slope=slope, error=np.zeros(n)), explained


def _explained_by_chatter(
    records: Sequence[TrialRecord], reading: TorqueReading
) -> tuple[FloatArray, FloatArray]:
    """Shares of the torques' differences, (n,), explained by all steps and by one wrong lag alone.

    All steps include those of the next sample; the largest share of any wrong lag is returned.
    """
    inputs, outputs = _chatter(records, reading, beside=1)
    n = records[0].joints
    others = [0, *range(2, len(inputs[0]) // n)]
    products = _products(inputs, outputs)
    alone = [_solved(*products, slice(n * k, n * (k + 1)))[1] for k in others]
    return _solved(*products)[1], np.max(alone, axis=0)


def _shows(
    inputs: Sequence[FloatArray], outputs: Sequence[FloatArray], jump: HoldCorrection
) -> BoolArray:
    """Whether torques, (n,), change about as much as the last steps alone make them jump."""
    # A filter that angles and torques passed alike removes the jumps and leaves the motion.
    jumped, shown = np.zeros((2, len(outputs[0])))
    for steps, changes in zip(inputs, outputs, strict=True):
        jumped += np.sum((jump.torque @ steps[: len(changes)]) ** 2, axis=1)
        shown += np.sum(changes**2, axis=1)
    return np.asarray(shown >= _SHOWN * jumped)


def _chatter(
    records: Sequence[TrialRecord],
    reading: TorqueReading,
    beside: int = 0,
    differences: int = _DIFFERENCES,
) -> tuple[list[FloatArray], list[FloatArray]]:
    """Differences of steps, newest first, and of the changes of torques that follow them.

    Either has an array for each trial. `beside` is the number of further lags on either side.
    """
    weights, to_parabola, _ = _lags(reading, records[0].rate)
    lags = to_parabola.shape[1] + 2 * beside
    before = reading.first(records[0].rate)[0] - 1 - beside
    inputs, outputs = [], []
    for record in records:
        torque, steps = record.torque, command_steps(record)
        if weights.size > 1:
            last = record.samples
            cut = [torque[:, weights.size - 1 - age : last - age] for age in range(weights.size)]
            torque = sum(weight * one for weight, one in zip(weights, cut, strict=True))
            steps = steps[:, weights.size - 1 :]
        changes = np.diff(torque, axis=1)
        # The step after reading k shows first in the change to a later reading, mostly reading
        # k + 1, or to an earlier one if readings are early.
        start = max(lags - 1, -before)
        last = min(changes.shape[1] - before, steps.shape[1])
        lagged = [steps[:, start - lag : last - lag] for lag in range(lags)]
        inputs.append(np.diff(np.concatenate(lagged), n=differences, axis=1))
        outputs.append(np.diff(changes[:, before + start : before + last], n=differences, axis=1))
    return inputs, outputs


def _lags(reading: TorqueReading, rate: float) -> tuple[FloatArray, FloatArray, int]:
    """Coefficients that give value and slope of the torque after a step from changes of readings.

    First those of readings, newest first, that remove the poles of the low-pass. Then, (2, lags),
    those of their changes from the first that shows a step on; last after how many it is complete.
    """
    weights = reading.whitening(rate)
    count = weights.size + 1 + _PERIODS
    answers = reading.answers(rate, count)
    answers = np.array([np.convolve(one, weights)[:count] for one in answers])
    edge = 1 + int(np.max(np.flatnonzero(np.abs(answers[0] - 1.0) > _PASSED), initial=-1)) + 1
    lags = edge + _PERIODS - 1
    changes = np.diff(answers[:, :lags], axis=1, prepend=0.0)
    return weights, np.linalg.pinv(changes.T)[:2], edge


def _from_motion(records: Sequence[TrialRecord]) -> HoldCorrection:
    inputs, outputs = [], []
    for record in records:
        angle = record.position - record.position.mean(axis=1, keepdims=True)
        torque = record.torque - record.torque.mean(axis=1, keepdims=True)
        before, now, after = angle[:, :-2], angle[:, 1:-1], angle[:, 2:]
        acceleration = (after - 2.0 * now + before) * record.rate**2
        velocity = 0.5 * (after - before) * record.rate
        steps = command_steps(record)[:, 1:-1]
        moved = np.concatenate((-0.5 * steps, acceleration, velocity, now))
        inputs.append(_quick(moved, record.rate))
        outputs.append(_quick(torque[:, 1:-1], record.rate))
    products, n = _products(inputs, outputs), records[0].joints
    coefficients, explained = _solved(*products)
    _, without = _solved(*products, slice(n, None))
    by_jumps = np.maximum(explained - without, TINY)
    transmission = coefficients[:, :n]
    return HoldCorrection(
        torque=transmission,
        slope=np.zeros_like(transmission),
        error=_OFF * np.sqrt(np.maximum(1.0 - explained, 0.0) / by_jumps),
    )


def _quick(signals: FloatArray, rate: float) -> FloatArray:
    """Filter signals (p, N) to the band `_QUICK`, and cut off a second at either end."""
    # Whatever the length of the record, its transforms are to be quick; the ends do not matter.
    samples = next_fast_len(signals.shape[1], real=True)
    f = np.fft.rfftfreq(samples, 1.0 / rate)
    foot, top, shoulder, end = _QUICK
    rise = np.clip((f - foot) / (top - foot), 0.0, 1.0)
    fall = np.clip((end - f) / (end - shoulder), 0.0, 1.0)
    passed = np.fft.irfft(rise * fall * np.fft.rfft(signals, samples), samples)
    return np.asarray(passed[:, round(rate) : signals.shape[1] - round(rate)])


def regress(
    inputs: Sequence[FloatArray], outputs: Sequence[FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """Regress outputs on inputs: coefficients, (m, p), and shares of power explained, (m,).

    Parameters
    ----------
    inputs, outputs : sequence of ndarray, shapes (p, N) and (m, N)
        Signals of each trial.
    """
    return _solved(*_products(inputs, outputs))


def _products(
    inputs: Sequence[FloatArray], outputs: Sequence[FloatArray]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Scalar products of inputs, (p, p), of outputs with them, (m, p), and of outputs, (m,).

    They are summed by numpy alone to be the same on every machine.
    """
    p, m = len(inputs[0]), len(outputs[0])
    squares, mixed, total = np.zeros((p, p)), np.zeros((m, p)), np.zeros(m)
    for x, y in zip(inputs, outputs, strict=True):
        for i in range(p):
            squares[i, i:] += [np.sum(x[i] * other) for other in x[i:]]
        mixed += [[np.sum(one * other) for other in x] for one in y]
        total += np.sum(y**2, axis=1)
    return np.triu(squares) + np.triu(squares, 1).T, mixed, total


def _solved(
    squares: FloatArray, mixed: FloatArray, total: FloatArray, rows: slice = slice(None)
) -> tuple[FloatArray, FloatArray]:
    """Regression on some rows of the inputs, from the scalar products of all."""
    squares, mixed = squares[rows, rows], mixed[:, rows]
    scale = np.sqrt(np.diag(squares))
    scale[scale == 0.0] = 1.0
    solution = np.linalg.lstsq(squares / np.outer(scale, scale), (mixed / scale).T, rcond=None)[0]
    coefficients = solution.T / scale
    residual = total - np.sum(coefficients * (2.0 * mixed - coefficients @ squares), axis=1)
    explained = 1.0 - np.divide(residual, total, out=np.ones_like(total), where=total > 0.0)
    return coefficients, explained
