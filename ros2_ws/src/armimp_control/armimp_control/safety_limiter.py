"""The safety gate, through which every command passes: pure mathematics, compiled.

Every tick goes through it in two steps, with the law between them. :func:`examine` looks at the
sample before anything of it is used; :func:`let_through` looks at the command before it is sent.

1. Any NaN or infinity, in any joint of the sample, the perturbation or the command: zero torque on
   all joints at once.
2. Position and velocity of each joint. The velocity is the difference over the last
   :data:`WINDOW` ticks (over all there are, in the first ones). A difference over one tick would
   chatter by one count of the encoder per tick, which is 0.12 rad/s at the coarsest level of the
   study; over 5 it is 0.025 rad/s. The price is that it lags by 2.5 ticks.
3. Torque, its rate, and its power, in this order.

Beyond a limit the gate does one of two things. *Stop*: the fault is latched, and the torque falls
to zero in a straight line, tick by tick. *Clip*: the command is changed by as little as the limit
needs, joint by joint. Beyond a limit of position or velocity that means: no torque that drives the
joint farther out, or that makes it faster.

What holds for every output u, whatever comes in (T, R, P: limits of torque, rate, power)::

    finite    |u_i| ≤ T_i    |u_i θ̇_i| ≤ P_i    |u_i − u_i(previous)| ≤ R_i L

with two exceptions of the last: zero torque at once (1, and where the caller asks for it); and a
command that has to come closer to zero faster, because the power would be too large otherwise.
From a fault on, the torque of every joint keeps its sign, never grows, is zero after the ticks of
the ramp, and stays so: the way back is a new gate.

All comparisons are written so that a NaN fails them.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from armimp_common.compiled import compiled, compiled_entry

WINDOW = 5
"""Ticks over which a velocity is taken."""

POSITION, VELOCITY, TORQUE, RATE, POWER = range(5)
"""Numbers of the limits."""

LIMITS = 5
"""How many there are."""

# Rows of the rules, an array (RULE_ROWS, n): the limits by number, in rad, rad/s, N·m, N·m per tick
# and W; then in the same order whether each means a stop, 1 or 0; the posture, rad; the number of
# ticks of a ramp.
STOPS = LIMITS
CENTRE, RAMP = 2 * LIMITS, 2 * LIMITS + 1
RULE_ROWS = 2 * LIMITS + 2

# Rows of the memory, an array (GATE_ROWS, n), zeros before the first tick: what was sent last, what
# the law asked for, N·m; distance from the posture, rad; velocity, rad/s; the last positions, rad.
SENT, ASKED, EXCURSION, SPEED, HISTORY = range(5)
GATE_ROWS = HISTORY + WINDOW

# The journal, a vector, zeros before the first tick. CLOSED: 0 while commands pass. REMAINING:
# ticks of the ramp that are left. SAMPLES: number of samples so far. FAULT and PRESENT: each a
# cause, a joint and a value, of the latched fault and of what is wrong with the last sample.
# CLIPS: number of clipped joint commands for each limit.
CLOSED, REMAINING, SAMPLES, FAULT, PRESENT, CLIPS = 0, 1, 2, 3, 6, 9
JOURNAL = CLIPS + LIMITS

# Causes of a fault; those from LIMIT_CAUSE on are limits.
NO_CAUSE, OTHER_CAUSE, BAD_POSITION, BAD_TORQUE, BAD_PERTURBATION, BAD_COMMAND = range(6)
LIMIT_CAUSE = 6


@compiled
def _note(journal: NDArray[np.float64], place: int, cause: int, joint: int, value: float) -> None:
    journal[place] = cause
    journal[place + 1] = joint
    journal[place + 2] = value


@compiled
def _close(
    journal: NDArray[np.float64], ticks: float, cause: int, joint: int, value: float
) -> None:
    """Let no command through any more; the first cause stays, and a ramp never gets longer."""
    if journal[CLOSED] == 0.0:
        journal[CLOSED] = 1.0
        journal[REMAINING] = ticks
        _note(journal, FAULT, cause, joint, value)
    elif not journal[REMAINING] <= ticks:
        journal[REMAINING] = ticks


@compiled
def _first_bad(values: NDArray[np.float64]) -> int:
    """Index of the first value that is not finite; -1 if there is none."""
    for i in range(values.size):
        if not abs(values[i]) < np.inf:
            return i
    return -1


@compiled
def _remember(
    theta: NDArray[np.float64],
    rules: NDArray[np.float64],
    period: float,
    memory: NDArray[np.float64],
    journal: NDArray[np.float64],
) -> None:
    """Work out excursions and velocities of a finite sample, and keep it."""
    samples = int(journal[SAMPLES])
    slot = HISTORY + samples % WINDOW
    span, oldest = (WINDOW, slot) if samples >= WINDOW else (samples, HISTORY)
    for i in range(theta.size):
        memory[EXCURSION, i] = theta[i] - rules[CENTRE, i]
        memory[SPEED, i] = (theta[i] - memory[oldest, i]) / (span * period) if span > 0 else 0.0
        memory[slot, i] = theta[i]
    journal[SAMPLES] = samples + 1


@compiled
def examine(
    theta: NDArray[np.float64],
    tau_h: NDArray[np.float64],
    tau_delta: NDArray[np.float64],
    rules: NDArray[np.float64],
    period: float,
    memory: NDArray[np.float64],
    journal: NDArray[np.float64],
) -> bool:
    """Look at a sample before anything of it is used.

    Parameters
    ----------
    theta, tau_h, tau_delta : (n,) rad, N·m, N·m: encoders, torque transducers, perturbation
    rules : (RULE_ROWS, n) from :meth:`armimp_control.safety.SafetyConfig.rules`
    period : L, s
    memory, journal : (GATE_ROWS, n) and (JOURNAL,), updated

    Returns
    -------
    bool
        Whether the law may use the sample.
    """
    cause, joint, value, ticks = NO_CAUSE, 0, 0.0, 0.0
    for bad, values in ((BAD_POSITION, theta), (BAD_TORQUE, tau_h), (BAD_PERTURBATION, tau_delta)):
        i = _first_bad(values)
        if i >= 0 and cause == NO_CAUSE:
            cause, joint, value = bad, i, values[i]
    if cause == NO_CAUSE:
        _remember(theta, rules, period, memory, journal)
        for i in range(theta.size):
            for number, row in ((POSITION, EXCURSION), (VELOCITY, SPEED)):
                within = abs(memory[row, i]) <= rules[number, i]
                if not within and rules[STOPS + number, i] != 0.0 and cause == NO_CAUSE:
                    cause, joint, value = LIMIT_CAUSE + number, i, memory[row, i]
                    ticks = rules[RAMP, i]
    _note(journal, PRESENT, cause, joint, value)
    if cause != NO_CAUSE:
        _close(journal, ticks, cause, joint, value)
    return bool(journal[CLOSED] == 0.0)


@compiled
def _clip(
    command: NDArray[np.float64],
    i: int,
    value: float,
    number: int,
    journal: NDArray[np.float64],
) -> None:
    if command[i] != value:
        command[i] = value
        journal[CLIPS + number] += 1.0


@compiled
def _limit(
    command: NDArray[np.float64],
    rules: NDArray[np.float64],
    memory: NDArray[np.float64],
    journal: NDArray[np.float64],
) -> tuple[int, int, float]:
    """Bring a finite command within the limits.

    Returns the number of the limit, the joint and the value where that means a stop; else -1.
    """
    for i in range(command.size):
        for number, row in ((POSITION, EXCURSION), (VELOCITY, SPEED)):
            # What means a stop has led to one with the sample.
            outward = command[i] * memory[row, i] > 0.0
            if outward and not abs(memory[row, i]) <= rules[number, i]:
                _clip(command, i, 0.0, number, journal)
        for number in (TORQUE, RATE, POWER):
            limit = rules[number, i]
            value = command[i]
            nearest = math.copysign(limit, command[i])
            if number == RATE:
                value = command[i] - memory[SENT, i]
                nearest = memory[SENT, i] + math.copysign(limit, value)
                # Rounding must not lead beyond the limit that came before.
                nearest = min(max(nearest, -rules[TORQUE, i]), rules[TORQUE, i])
            elif number == POWER:
                value = command[i] * memory[SPEED, i]
                nearest = math.copysign(limit / abs(memory[SPEED, i]), command[i])
            if not abs(value) <= limit:
                if rules[STOPS + number, i] != 0.0:
                    return number, i, value
                _clip(command, i, nearest, number, journal)
    return -1, 0, 0.0


@compiled
def _ramp(
    command: NDArray[np.float64],
    rules: NDArray[np.float64],
    memory: NDArray[np.float64],
    journal: NDArray[np.float64],
) -> None:
    """One tick of the way down to zero: a straight line, or less where the power says so."""
    remaining = journal[REMAINING]
    share = (remaining - 1.0) / remaining if remaining > 1.0 else 0.0
    journal[REMAINING] = remaining - 1.0 if remaining > 1.0 else 0.0
    for i in range(command.size):
        command[i] = memory[SENT, i] * share if share > 0.0 else 0.0
        if not abs(command[i] * memory[SPEED, i]) <= rules[POWER, i]:
            limit = rules[POWER, i] / abs(memory[SPEED, i])
            command[i] = math.copysign(limit, command[i])


@compiled
def let_through(
    command: NDArray[np.float64],
    rules: NDArray[np.float64],
    memory: NDArray[np.float64],
    journal: NDArray[np.float64],
) -> int:
    """Look at a command before it is sent; :func:`examine` has looked at its sample.

    Parameters
    ----------
    command : (n,) N·m, changed where it has to be; without meaning once the gate is closed
    rules, memory, journal : as of :func:`examine`

    Returns
    -------
    int
        Number of joints whose command was clipped; 0 once the gate is closed.
    """
    clipped = 0
    if journal[CLOSED] == 0.0:
        memory[ASKED] = command
        joint = _first_bad(command)
        cause, value, ticks = BAD_COMMAND, command[joint], 0.0
        if joint < 0:
            number, joint, value = _limit(command, rules, memory, journal)
            cause, ticks = LIMIT_CAUSE + number, rules[RAMP, joint]
            if number < 0:
                cause = NO_CAUSE
        if cause != NO_CAUSE:
            _close(journal, ticks, cause, joint, value)
    if journal[CLOSED] == 0.0:
        for i in range(command.size):
            if command[i] != memory[ASKED, i]:
                clipped += 1
    else:
        _ramp(command, rules, memory, journal)
    memory[SENT] = command
    return clipped


@compiled_entry
def close_gate(
    ticks: int, fault: bool, memory: NDArray[np.float64], journal: NDArray[np.float64]
) -> None:
    """Let no command through any more, for a reason that the caller knows.

    Parameters
    ----------
    ticks : length of the ramp to zero; with 0, what was sent counts as zero from now on
    fault : whether this is a fault, or just the end
    memory, journal : as of :func:`examine`
    """
    if fault:
        _close(journal, ticks, OTHER_CAUSE, 0, 0.0)
    else:
        _close(journal, ticks, NO_CAUSE, 0, 0.0)
    if ticks == 0:
        memory[SENT] = 0.0


@compiled_entry
def fall(
    ticks: int,
    command: NDArray[np.float64],
    rules: NDArray[np.float64],
    memory: NDArray[np.float64],
    journal: NDArray[np.float64],
) -> None:
    """Go on with the ramp of a closed gate where no samples come.

    Parameters
    ----------
    ticks : that have passed since the last command
    command : (n,) N·m, written
    rules, memory, journal : as of :func:`examine`; the velocity is that of the last sample
    """
    command[:] = memory[SENT]
    for _ in range(ticks):
        _ramp(command, rules, memory, journal)
        memory[SENT] = command
