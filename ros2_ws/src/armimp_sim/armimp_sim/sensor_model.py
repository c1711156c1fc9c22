"""What a real rig does to torques: offset, drift, gain, anti-alias filter, delay, actuator lag.

Every lane has one row of numbers: what its sensors and drives are, then what they remember. The
torque on the arm is known at both ends of each step of the integration, and taken as linear between
them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from armimp_common.compiled import compiled, compiled_entry
from armimp_sim import dynamics
from armimp_sim.model.sensors import ORDERS, SensorParameters
from armimp_sim.simd.lanes import Tag

# What a lag leaves of the distance to the command after a step, and on the mean over it; step of a
# period at whose end is read; whole periods that this is late; order of the low-pass; periods run.
KEEP, MEAN, CAPTURE, PERIODS, ORDER, TICKS = 0, 1, 2, 3, 4, 5
# The low-pass: its transition over a step, what the torque at both ends of that adds, output, and
# where a constant torque of 1 N·m takes it.
TRANSITION, FROM_START, FROM_END, OUTPUT, SETTLED = 6, 22, 26, 30, 34
JOINTS = 38
# Of each joint, from JOINTS on: the reading; command and torque of the drive; the torque on the arm
# at the end of the last step; output of the low-pass; sum for the mean of the interval; state of
# the low-pass, and the next one.
GAIN, OFFSET, DRIFT, TARGET, APPLIED, LOAD, FILTERED, SUM = 0, 1, 2, 3, 4, 5, 6, 7
STATE, NEXT = 8, 8 + ORDERS
PER_JOINT = NEXT + ORDERS
# Then, for each joint, the values of the last periods that are still to be read.


def whole_periods(sensors: SensorParameters, step: float, substeps: int) -> int:
    """Whole control periods in the delay of the torque."""
    return round(sensors.torque_delay / step) // substeps


def lane_numbers(
    sensors: SensorParameters,
    actuator_lag: float,
    *,
    joints: int,
    step: float,
    substeps: int,
    periods: int,
) -> NDArray[np.float64]:
    """Sensors and drives of one lane as compiled code takes them, settled without torque.

    Parameters
    ----------
    sensors : SensorParameters
    actuator_lag : time constant with which the torque of the drives follows commands, s; 0: at once
    joints : n
    step : of the integration, s
    substeps : steps in a control period
    periods : room for so many whole periods of delay, at least :func:`whole_periods`
    """
    numbers = np.zeros(JOINTS + joints * (PER_JOINT + periods + 1))
    if actuator_lag > 0.0:
        numbers[KEEP] = np.exp(-step / actuator_lag)
        numbers[MEAN] = -np.expm1(-step / actuator_lag) * actuator_lag / step
    late = round(sensors.torque_delay / step)
    numbers[CAPTURE] = substeps - late % substeps
    numbers[PERIODS] = late // substeps
    if sensors.torque_cutoff > 0.0:
        _put_filter(numbers, sensors, step)
    per_joint = numbers[JOINTS : JOINTS + PER_JOINT * joints].reshape(joints, -1)
    per_joint[:, GAIN] = sensors.torque_gain
    per_joint[:, OFFSET] = sensors.torque_offset
    per_joint[:, DRIFT] = np.array(sensors.torque_drift) * (step * substeps)
    return numbers


def _put_filter(numbers: NDArray[np.float64], sensors: SensorParameters, step: float) -> None:
    """Exact transition of the low-pass for a torque that is linear over a step."""
    # Where there is no low-pass, nobody has to wait for these imports.
    from scipy.linalg import expm
    from scipy.signal import butter, zpk2ss

    p = sensors.torque_order
    zpk = butter(p, 2.0 * np.pi * sensors.torque_cutoff, analog=True, output="zpk")
    a, b, c, _ = zpk2ss(*zpk)
    # State, torque at the start of the step, and its change over the step as one system.
    system = np.zeros((p + 2, p + 2))
    system[:p, :p], system[:p, p : p + 1] = a * step, b * step
    system[p, p + 1] = 1.0
    over = expm(system)
    numbers[ORDER] = p
    matrix = np.zeros((ORDERS, ORDERS))
    matrix[:p, :p] = over[:p, :p]
    numbers[TRANSITION : TRANSITION + ORDERS**2] = matrix.ravel()
    end = over[:p, p + 1]
    numbers[FROM_START : FROM_START + p] = over[:p, p] - end
    numbers[FROM_END : FROM_END + p] = end
    numbers[OUTPUT : OUTPUT + p] = c[0]
    numbers[SETTLED : SETTLED + p] = np.linalg.solve(-a, b)[:, 0]


@compiled
def _of(joint: int, what: int) -> int:
    return JOINTS + joint * PER_JOINT + what


@compiled
def _follow(
    w: NDArray[np.float64], block: int, joints: Tag, width: Tag, lanes: NDArray[np.float64]
) -> None:
    """Drives go on by a step; COMMAND is the mean of their torque over it."""
    n, m = len(joints), len(width)
    for lane in range(block * m, min(block * m + m, lanes.shape[0])):
        row = lanes[lane]
        for i in range(n):
            target = row[_of(i, TARGET)]
            away = row[_of(i, APPLIED)] - target
            w[dynamics.place(lane, dynamics.COMMAND * n + i, m)] = target + away * row[MEAN]
            row[_of(i, APPLIED)] = target + away * row[KEEP]


@compiled
def _load(
    w: NDArray[np.float64], block: int, joints: Tag, width: Tag, lanes: NDArray[np.float64]
) -> None:
    """TORQUE is that on the arm at this instant."""
    n, m = len(joints), len(width)
    for lane in range(block * m, min(block * m + m, lanes.shape[0])):
        for i in range(n):
            w[dynamics.place(lane, dynamics.COMMAND * n + i, m)] = lanes[lane, _of(i, APPLIED)]
    dynamics.sample_block(w, block, joints, width)


@compiled
def _pass(row: NDArray[np.float64], i: int, load: float) -> None:
    """Let the torque of joint i through the low-pass, up to the end of a step."""
    before = row[_of(i, LOAD)]
    row[_of(i, LOAD)] = load
    order = int(row[ORDER])
    if order == 0:
        row[_of(i, SUM)] += 0.5 * (before + load)
        row[_of(i, FILTERED)] = load
        return
    for p in range(order):
        total = row[FROM_START + p] * before + row[FROM_END + p] * load
        for q in range(order):
            total += row[TRANSITION + p * ORDERS + q] * row[_of(i, STATE) + q]
        row[_of(i, NEXT) + p] = total
    filtered = 0.0
    for p in range(order):
        row[_of(i, STATE) + p] = row[_of(i, NEXT) + p]
        filtered += row[OUTPUT + p] * row[_of(i, NEXT) + p]
    row[_of(i, SUM)] += 0.5 * (row[_of(i, FILTERED)] + filtered)
    row[_of(i, FILTERED)] = filtered


@compiled
def reading(row: NDArray[np.float64], i: int, joints: int) -> float:
    """Reading of joint i at the end of the period, before it is rounded, N·m."""
    periods = int(row[PERIODS])
    ticks = int(row[TICKS])
    values = JOINTS + joints * PER_JOINT + i * (periods + 1)
    late = row[values + (ticks + 1) % (periods + 1)]
    return float(row[_of(i, GAIN)] * late + row[_of(i, OFFSET)] + row[_of(i, DRIFT)] * ticks)


@compiled_entry
def settle(w: NDArray[np.float64], joints: Tag, width: Tag, lanes: NDArray[np.float64]) -> None:
    """Readings of a rig on whose arm the present torque has been for long, into TORQUE.

    Parameters
    ----------
    w, joints, width : the batch, as in :mod:`armimp_sim.dynamics`
    lanes : (lanes, size(n, periods)), updated; the torques of the drives are as they are
    """
    n, m = len(joints), len(width)
    for block in range(w.shape[0]):
        _load(w, block, joints, width, lanes)
        for lane in range(block * m, min(block * m + m, lanes.shape[0])):
            row = lanes[lane]
            for i in range(n):
                load = w[dynamics.place(lane, dynamics.TORQUE * n + i, m)]
                row[_of(i, LOAD)] = row[_of(i, FILTERED)] = load
                row[_of(i, SUM)] = 0.0
                for p in range(ORDERS):
                    row[_of(i, STATE) + p] = load * row[SETTLED + p]
                values = JOINTS + n * PER_JOINT + i * (int(row[PERIODS]) + 1)
                for age in range(int(row[PERIODS]) + 1):
                    row[values + age] = load
                w[dynamics.place(lane, dynamics.TORQUE * n + i, m)] = reading(row, i, n)


@compiled_entry
def advance(
    w: NDArray[np.float64],
    joints: Tag,
    width: Tag,
    steps: int,
    h: float,
    interval_mean: bool,
    lanes: NDArray[np.float64],
) -> None:
    """As :func:`armimp_sim.dynamics.advance`, with sensors and drives; TORQUE is the reading.

    Parameters
    ----------
    w, joints, width, steps, h, interval_mean : as there; COMMAND is what is commanded
    lanes : (lanes, size(n, periods)), updated
    """
    n, m = len(joints), len(width)
    for block in range(w.shape[0]):
        first, last = block * m, min(block * m + m, lanes.shape[0])
        for lane in range(first, last):
            row = lanes[lane]
            row[TICKS] += 1.0
            for i in range(n):
                target = w[dynamics.place(lane, dynamics.COMMAND * n + i, m)]
                row[_of(i, TARGET)] = target
                if row[KEEP] == 0.0:
                    row[_of(i, APPLIED)] = target
        # The torque on the arm jumps with the command.
        _load(w, block, joints, width, lanes)
        for lane in range(first, last):
            for i in range(n):
                load = w[dynamics.place(lane, dynamics.TORQUE * n + i, m)]
                lanes[lane, _of(i, LOAD)] = load
        for step in range(1, steps + 1):
            _follow(w, block, joints, width, lanes)
            dynamics.rk4_step(w, block, joints, width, h)
            _load(w, block, joints, width, lanes)
            for lane in range(first, last):
                row = lanes[lane]
                for i in range(n):
                    _pass(row, i, w[dynamics.place(lane, dynamics.TORQUE * n + i, m)])
                    if step == int(row[CAPTURE]):
                        periods = int(row[PERIODS])
                        place = JOINTS + n * PER_JOINT + i * (periods + 1)
                        place += int(row[TICKS]) % (periods + 1)
                        mean = row[_of(i, SUM)] / steps
                        row[place] = mean if interval_mean else row[_of(i, FILTERED)]
                        row[_of(i, SUM)] = 0.0
        for lane in range(first, last):
            for i in range(n):
                w[dynamics.place(lane, dynamics.TORQUE * n + i, m)] = reading(lanes[lane], i, n)
