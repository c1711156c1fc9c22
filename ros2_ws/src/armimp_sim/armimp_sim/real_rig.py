"""What a real rig and a real arm add to the equations of motion: drives, muscles, sensors.

At every step of the integration, commands become torques of the drives, and what muscles add to
the linear arm is added to the voluntary torque. Signals that are read pass one chain, the same for
angles and torques. Low-pass, delay and memory belong to *channels* of three kinds, n of each:
angles, torques on the arm, and what excites the reflexes. Signals are known at both ends of each
step, and taken as linear in between. A soft cuff needs none of this: with it a plant has twice the
coordinates, see :class:`armimp_sim.parameters.SimulatorParameters`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from armimp_common.arrays import FloatArray, IntArray
from armimp_common.compiled import compiled, compiled_entry
from armimp_sim import dynamics
from armimp_sim.dynamics import Batch, Block
from armimp_sim.model.arm import MuscleParameters, ReflexParameters
from armimp_sim.model.sensors import ORDERS, ReadingParameters, quantise
from armimp_sim.parameters import SimulatorParameters

ANGLE, TORQUE, REFLEX = 0, 1, 2
"""Kinds of channels."""
# Columns of a joint's row. Drive: steps by which commands are late, largest torque, share of the
# distance to the command that a current loop leaves after a step and on average over it, ripple and
# cogging with their cycles per radian. Muscles: whether they add anything, gains of the reflex,
# short-range stiffness and its reach, cubic stiffness. Memory: command and torque of the drive,
# voluntary torque, angle to which the short-range spring has yielded.
_LATE_COMMAND, _LARGEST, _KEEP, _SHARE = 0, 1, 2, 3
_RIPPLE, _RIPPLE_CYCLES, _COGGING, _COGGING_CYCLES = 4, 5, 6, 7
_MUSCULAR, _VELOCITY_GAIN, _STRETCH_GAIN, _SHORT_RANGE, _REACH, _CUBIC = 8, 9, 10, 11, 12, 13
_TARGET, _APPLIED, _VOLUNTARY, _YIELDED = 14, 15, 16, 17
# Then its channels, each with the order of the low-pass, steps by which it is late, signal and
# output at the end of the last step, and a row for each state of the low-pass: transition over a
# step, weights of the signal at its start and end, weight in the output, steady state for a signal
# of 1, the state and the next one. Last, the joint's row of the growth of K_h per second.
_CHANNELS = 18
_ORDER, _LATE, _LAST, _FILTERED, _LOW_PASS = 0, 1, 2, 3, 4
_START, _END, _OUTPUT, _SETTLED, _STATE, _NEXT = range(ORDERS, ORDERS + 6)
_WIDE = ORDERS + 6
_CHANNEL = _LOW_PASS + ORDERS * _WIDE
_GROWTH = _CHANNELS + 3 * _CHANNEL


class RealRig(NamedTuple):
    """L lanes with n joints, in the form that compiled code takes: parameters and memory."""

    rows: FloatArray
    """(L, n, …) what is needed at every step; for the columns, see above."""
    commands: FloatArray
    """(L, n, periods) commands of the last periods, N·m."""
    past: FloatArray
    """(L, n, 3, steps) past outputs of each channel, in the units of the signal."""
    clock: IntArray
    """(1,) steps taken."""
    mix: FloatArray
    """(L, 2, n, n) gain with cross-talk of the readings of angles and torques."""
    added: FloatArray
    """(L, 2, n, 2) offset, rad or N·m, and drift, rad/s or N·m/s."""
    chain: FloatArray
    """(L, 2, 5) amplitude and angular frequency of hum, half the hysteresis, limit, resolution."""
    played: FloatArray
    """(L, 2, n) signals as far as hysteresis lets them follow; NaN before the first reading."""


def real_rig(configs: Sequence[SimulatorParameters], step: float) -> RealRig | None:
    """Return all lanes, without any torque, for integration steps of `step` seconds.

    None if all of them are ideal rigs.
    """
    if all(one.ideal for one in configs):
        return None
    lanes, n, substeps = len(configs), configs[0].arm.joints, configs[0].substeps
    rows = np.zeros((lanes, n, _GROWTH + n))
    for lane, one in enumerate(configs):
        _fill(rows[lane], one, step)
    sensors = [(one.sensors.position, one.sensors.torque) for one in configs]
    late = max(int(rows[:, :, _CHANNELS + kind * _CHANNEL + _LATE].max()) for kind in range(3))
    return RealRig(
        rows=rows,
        commands=np.zeros((lanes, n, int(rows[:, :, _LATE_COMMAND].max()) // substeps + 2)),
        past=np.zeros((lanes, n, 3, late + substeps + 1)),
        clock=np.zeros(1, dtype=np.int64),
        mix=np.array([[_mix(reading, n) for reading in pair] for pair in sensors]),
        added=np.array([[_added(reading, n) for reading in pair] for pair in sensors]),
        chain=np.array([[_chain(reading) for reading in pair] for pair in sensors]),
        played=np.zeros((lanes, 2, n)),
    )


def _mix(reading: ReadingParameters, n: int) -> FloatArray:
    shares: FloatArray = np.where(np.eye(n) > 0.0, 1.0, reading.cross_talk)
    return np.resize(reading.gain, n)[:, None] * shares


def _added(reading: ReadingParameters, n: int) -> FloatArray:
    return np.stack([np.resize(reading.offset, n), np.resize(reading.drift, n)], axis=1)


def _chain(reading: ReadingParameters) -> tuple[float, ...]:
    speed, band = 2.0 * np.pi * reading.hum_frequency, 0.5 * reading.hysteresis
    return reading.hum, speed, band, reading.limit or np.inf, reading.resolution


def _fill(rows: FloatArray, config: SimulatorParameters, step: float) -> None:
    """Put the parameters of a rig into the rows of its joints."""
    drive, reflex, muscle = config.actuators, config.reflex, config.muscle
    over = step / drive.lag if drive.lag else np.inf
    for column, values in {
        _LATE_COMMAND: round(drive.delay / step),
        _LARGEST: drive.limit or np.inf,
        _KEEP: np.exp(-over),
        _SHARE: -np.expm1(-over) / over,
        _RIPPLE: drive.ripple,
        _RIPPLE_CYCLES: drive.ripple_cycles,
        _COGGING: drive.cogging,
        _COGGING_CYCLES: drive.cogging_cycles,
        _MUSCULAR: (reflex, muscle) != (ReflexParameters(), MuscleParameters()),
        _VELOCITY_GAIN: reflex.velocity_gain,
        _STRETCH_GAIN: reflex.stretch_gain,
        _SHORT_RANGE: muscle.short_range_stiffness,
        _REACH: muscle.short_range,
        _CUBIC: muscle.cubic * np.diag(config.arm.K),
    }.items():
        rows[:, column] = values
    rows[:, _GROWTH:] = muscle.stiffening * config.arm.K
    position, torque = config.sensors.position, config.sensors.torque
    for kind, (delay, low_pass) in {
        ANGLE: (position.delay, _butterworth(position, step)),
        TORQUE: (torque.delay, _butterworth(torque, step)),
        REFLEX: (reflex.delay, _muscle(reflex, step)),
    }.items():
        at = _CHANNELS + kind * _CHANNEL
        rows[:, at + _ORDER] = len(low_pass)
        rows[:, at + _LATE] = round(delay / step)
        rows[:, at + _LOW_PASS : at + _LOW_PASS + low_pass.size] = low_pass.ravel()


def _butterworth(reading: ReadingParameters, step: float) -> FloatArray:
    if not reading.cutoff:
        return np.zeros((0, _WIDE))
    # Imported here, as it is needed for a low-pass only.
    from scipy.signal import butter, zpk2ss

    zpk = butter(reading.order, 2.0 * np.pi * reading.cutoff, analog=True, output="zpk")
    a, b, c, _ = zpk2ss(*zpk)
    return _stepwise(a, b, c, step)


def _muscle(reflex: ReflexParameters, step: float) -> FloatArray:
    """Return the rows of the muscle ω²/(s² + 2ζωs + ω²), none without a reflex."""
    if reflex == ReflexParameters():
        return np.zeros((0, _WIDE))
    square = reflex.muscle**2
    a = np.array([[0.0, 1.0], [-square, -2.0 * reflex.damping_ratio * reflex.muscle]])
    return _stepwise(a, np.array([[0.0], [square]]), np.array([[1.0, 0.0]]), step)


def _stepwise(a: FloatArray, b: FloatArray, c: FloatArray, step: float) -> FloatArray:
    """Return rows of the states of a linear system, for a signal that is linear over a step, s."""
    from scipy.linalg import expm

    p = len(a)
    # State, signal at the start of the step, and its change over the step as one system.
    system = np.zeros((p + 2, p + 2))
    system[:p, :p], system[:p, p : p + 1] = a * step, b * step
    system[p, p + 1] = 1.0
    over = expm(system)
    numbers = np.zeros((p, _WIDE))
    numbers[:, :p] = over[:p, :p]
    numbers[:, _END] = over[:p, p + 1]
    numbers[:, _START] = over[:p, p] - over[:p, p + 1]
    numbers[:, _OUTPUT] = c[0]
    numbers[:, _SETTLED] = np.linalg.solve(-a, b)[:, 0]
    return numbers


class _Part(NamedTuple):
    """The lanes of one block: what :class:`Batch` and :class:`RealRig` hold of them."""

    block: Block
    steps: int
    h: float
    mean: bool
    rows: FloatArray
    commands: FloatArray
    past: FloatArray


@compiled
def _stretch(part: _Part, lane: int, i: int) -> float:
    """Return the angle of coordinate i from the posture."""
    w, n = part.block.w, len(part.block.joints)
    return float(w[dynamics.THETA * n + i, lane] - w[dynamics.POSTURE * n + i, lane])


@compiled
def _drive(part: _Part, lane: int, i: int, torque: float) -> None:
    """Apply the torque of a current loop to its joint, with ripple and cogging."""
    w, coordinates, row = part.block.w, len(part.block.joints), part.rows[lane, i]
    if row[_RIPPLE] > 0.0 or row[_COGGING] > 0.0:
        angle = w[dynamics.THETA * coordinates + i, lane]
        torque += torque * row[_RIPPLE] * np.sin(row[_RIPPLE_CYCLES] * angle)
        torque += row[_COGGING] * np.sin(row[_COGGING_CYCLES] * angle)
    w[dynamics.COMMAND * coordinates + i, lane] = torque


@compiled
def _effort(part: _Part, lane: int, now: int) -> None:
    """Apply to the arm the voluntary torque, and the torque of its muscles beyond K_h."""
    rows, past, seconds = part.rows, part.past, now * part.h
    n, coordinates = rows.shape[1], len(part.block.joints)
    arm = coordinates - n  # with a cuff, the arm comes after the robot
    for i in range(n):
        row = rows[lane, i]
        total = row[_VOLUNTARY]
        if row[_MUSCULAR] > 0.0:
            q = _stretch(part, lane, arm + i)
            total += row[_CUBIC] * q * q * q + row[_SHORT_RANGE] * (q - row[_YIELDED])
            late = int(row[_CHANNELS + REFLEX * _CHANNEL + _LATE])
            total += past[lane, i, REFLEX, (now - late) % past.shape[3]]
            for j in range(n):
                total += row[_GROWTH + j] * seconds * _stretch(part, lane, arm + j)
        part.block.w[dynamics.VOLUNTARY * coordinates + arm + i, lane] = total


@compiled
def _load(part: _Part, now: int) -> None:
    """Set TORQUE to the torque at the transducers, at the instant `now` steps from the start."""
    rows = part.rows
    for lane in range(rows.shape[0]):
        for i in range(rows.shape[1]):
            _drive(part, lane, i, rows[lane, i, _APPLIED])
        _effort(part, lane, now)
    dynamics.sample_block(part.block)


@compiled
def _signal(part: _Part, lane: int, kind: int, i: int) -> float:
    """Return the input of a channel at this instant."""
    w, rows, n = part.block.w, part.rows, len(part.block.joints)
    if kind == ANGLE:
        return float(w[dynamics.THETA * n + i, lane])
    if kind == TORQUE:
        return float(w[dynamics.TORQUE * n + i, lane])
    row, arm = rows[lane, i], n - rows.shape[1] + i
    velocity, stretch = w[dynamics.VELOCITY * n + arm, lane], _stretch(part, lane, arm)
    return float(row[_VELOCITY_GAIN] * velocity + row[_STRETCH_GAIN] * stretch)


@compiled
def _pass(row: FloatArray, past: FloatArray, kind: int, at: int, signal: float, mean: bool) -> None:
    """Advance a channel by a step ending with `signal`; store its output, or the mean in the step.

    `past` is that of the joint, (3, steps).
    """
    of = _CHANNELS + kind * _CHANNEL
    before, filtered = row[of + _LAST], row[of + _FILTERED]
    row[of + _LAST] = signal
    order = int(row[of + _ORDER])
    if order == 0:
        out, filtered = signal, before
    else:
        out = 0.0
        for p in range(order):
            state = of + _LOW_PASS + p * _WIDE
            total = row[state + _START] * before + row[state + _END] * signal
            for q in range(order):
                total += row[state + q] * row[of + _LOW_PASS + q * _WIDE + _STATE]
            row[state + _NEXT] = total
            out += row[state + _OUTPUT] * total
        for p in range(order):
            state = of + _LOW_PASS + p * _WIDE
            row[state + _STATE] = row[state + _NEXT]
    row[of + _FILTERED] = out
    past[kind, at] = 0.5 * (filtered + out) if mean else out


def settle(batch: Batch, rig: RealRig) -> None:
    """Put all channels in the state of a rig that has long stood still, without any command."""
    lanes, n, _ = rig.rows.shape
    block, lane = np.divmod(np.arange(lanes)[:, None], len(batch.width))

    def quantity(which: int) -> tuple[IntArray, IntArray, IntArray]:
        return block, which * len(batch.joints) + np.arange(n), lane

    angle, row = batch.w[quantity(dynamics.THETA)], np.moveaxis(rig.rows, 2, 0)
    batch.w[quantity(dynamics.COMMAND)] = row[_COGGING] * np.sin(row[_COGGING_CYCLES] * angle)
    dynamics.sample_now(batch)
    # The channels of reflexes start at zero, which is their state of rest.
    for kind, signal in ((ANGLE, angle), (TORQUE, batch.w[quantity(dynamics.TORQUE)])):
        of = _CHANNELS + kind * _CHANNEL
        row[of + _LAST] = row[of + _FILTERED] = signal
        states = slice(of + _LOW_PASS, of + _CHANNEL, _WIDE)
        row[_STATE:][states] = signal * row[_SETTLED:][states]
        rig.past[:, :, kind] = signal[..., None]
    rig.played[:] = np.nan


@compiled
def _take_inputs(part: _Part, tick: int) -> None:
    """Take commands and voluntary torques of the present period."""
    w, rows, commands = part.block.w, part.rows, part.commands
    n, coordinates = rows.shape[1], len(part.block.joints)
    for lane in range(rows.shape[0]):
        for i in range(n):
            row, command = rows[lane, i], w[dynamics.COMMAND * coordinates + i, lane]
            limited = min(max(command, -row[_LARGEST]), row[_LARGEST])
            commands[lane, i, tick % commands.shape[2]] = limited
            row[_VOLUNTARY] = w[(dynamics.VOLUNTARY + 1) * coordinates - n + i, lane]


@compiled
def _begin(part: _Part, now: int) -> None:
    """Have commands, and voluntary torque, take effect at the start of a step."""
    rows, commands, steps = part.rows, part.commands, part.steps
    jumps = now % steps == 0
    for lane in range(rows.shape[0]):
        jumps = jumps or (now - int(rows[lane, 0, _LATE_COMMAND])) % steps == 0
    if not jumps:
        return
    for lane in range(rows.shape[0]):
        for i in range(rows.shape[1]):
            row = rows[lane, i]
            tick = (now - int(row[_LATE_COMMAND])) // steps
            row[_TARGET] = commands[lane, i, tick % commands.shape[2]]
            if row[_KEEP] == 0.0:
                row[_APPLIED] = row[_TARGET]
    # The torque on the arm has jumped: the step begins with its new value.
    _load(part, now)
    for lane in range(rows.shape[0]):
        for i in range(rows.shape[1]):
            signal = _signal(part, lane, TORQUE, i)
            rows[lane, i, _CHANNELS + TORQUE * _CHANNEL + _LAST] = signal


@compiled
def _follow(part: _Part) -> None:
    """Advance the drives by a step; COMMAND becomes the mean of their torque over it."""
    for lane in range(part.rows.shape[0]):
        for i in range(part.rows.shape[1]):
            row = part.rows[lane, i]
            away = row[_APPLIED] - row[_TARGET]
            _drive(part, lane, i, row[_TARGET] + away * row[_SHARE])
            row[_APPLIED] = row[_TARGET] + away * row[_KEEP]


@compiled
def _end(part: _Part, now: int) -> None:
    """Advance muscles and channels by the step that ends `now` steps from the start."""
    rows, past = part.rows, part.past
    n, at = rows.shape[1], now % past.shape[3]
    for lane in range(rows.shape[0]):
        for i in range(n):
            row = rows[lane, i]
            if row[_MUSCULAR] > 0.0:
                signal = _signal(part, lane, REFLEX, i)
                _pass(row, past[lane, i], REFLEX, at, signal, False)
                q = _stretch(part, lane, len(part.block.joints) - n + i)
                row[_YIELDED] = min(max(row[_YIELDED], q - row[_REACH]), q + row[_REACH])
    _load(part, now)
    for lane in range(rows.shape[0]):
        for i in range(n):
            for kind in range(2):
                signal = _signal(part, lane, kind, i)
                averaged = part.mean and kind == TORQUE
                _pass(rows[lane, i], past[lane, i], kind, at, signal, averaged)


@compiled_entry
def advance(batch: Batch, rig: RealRig) -> None:
    """Advance all lanes as :func:`armimp_sim.dynamics.advance` does, for real rigs."""
    start, width = int(rig.clock[0]), len(batch.width)
    for number in range(batch.w.shape[0]):
        lanes = slice(number * width, (number + 1) * width)
        block = Block(batch.w[number], batch.joints, batch.width)
        part = _Part(
            block,
            batch.substeps,
            batch.step,
            batch.interval_mean,
            rig.rows[lanes],
            rig.commands[lanes],
            rig.past[lanes],
        )
        _take_inputs(part, start // batch.substeps)
        for now in range(start, start + batch.substeps):
            _begin(part, now)
            _follow(part)
            dynamics.rk4_step(block, batch.step)
            _end(part, now + 1)
    rig.clock[0] += batch.substeps


@compiled_entry
def read(batch: Batch, rig: RealRig, count: int, noise: FloatArray) -> None:
    """Take the readings of the present sample.

    Parameters
    ----------
    batch, rig : updated
    count : steps over which torques are averaged
    noise : (lanes, 2, n) on angles and torques, rad and N·m
    """
    rows, past, now, played = rig.rows, rig.past, int(rig.clock[0]), rig.played
    seconds = now * batch.step
    signals = np.empty(rows.shape[1])
    for lane in range(rows.shape[0]):
        for kind in range(2):
            hum, speed, band, limit, resolution = rig.chain[lane, kind]
            hum *= np.sin(speed * seconds)
            averaged = count if kind == TORQUE else 1
            for i in range(rows.shape[1]):
                newest = now - int(rows[lane, i, _CHANNELS + kind * _CHANNEL + _LATE])
                signals[i] = 0.0
                for back in range(averaged):
                    signals[i] += past[lane, i, kind, (newest - back) % past.shape[3]]
                signals[i] /= averaged
            for i in range(rows.shape[1]):
                value = 0.0
                for j in range(rows.shape[1]):
                    value += rig.mix[lane, kind, i, j] * signals[j]
                if np.isnan(played[lane, kind, i]):
                    played[lane, kind, i] = value
                value = min(max(played[lane, kind, i], value - band), value + band)
                played[lane, kind, i] = value
                offset, drift = rig.added[lane, kind, i]
                value += offset + drift * seconds + hum + noise[lane, kind, i]
                reading = quantise(min(max(value, -limit), limit), resolution)
                if kind == ANGLE:
                    batch.position[lane, i] = reading
                else:
                    batch.torque[lane, i] = reading
