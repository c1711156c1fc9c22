"""The safety limiter, through which every command passes: its limits, and the compiled arithmetic.

Every tick goes through it in two steps, with the law between them. :func:`check_sample` checks the
sample before anything of it is used; :func:`limit_command` limits the command before it is sent.

1. Any NaN or infinity, in any joint of the sample, the perturbation or the command: zero torque on
   all joints at once.
2. Position and velocity of each joint. The velocity is the difference over the last
   :data:`WINDOW` ticks (over all there are, in the first ones). A difference over one tick would
   chatter by one count of the encoder per tick, which is 0.12 rad/s at the coarsest level of the
   study; over 5 it is 0.025 rad/s. The price is that it lags by 2.5 ticks.
3. Torque, its rate, and its power, in this order.

Beyond a limit of position or velocity, the limiter *stops*: the fault is latched, and the torque
falls to zero in a straight line, tick by tick. Beyond one of the others it stops or *clips*: the
command is changed by as little as the limit needs. Beyond the torque limit all joints get less in
proportion: the links are coupled, so a joint that gives less than its share would throw the others
about.

Every output u satisfies, whatever comes in (T, R, P: limits of torque, rate, power)::

    finite    |u_i| ≤ T_i    |u_i θ̇_i| ≤ P_i    |u_i − u_i(previous)| ≤ R_i L

with two exceptions to the last: zero torque at once (1, and where the caller asks for it); and a
command that has to approach zero faster, because the power would be too large otherwise. From a
fault on, the torque of every joint keeps its sign, never grows, is zero after the ticks of the
ramp, and stays zero: only a new limiter lets commands through again.

All comparisons are written so that a NaN fails them.
"""

from __future__ import annotations

import itertools
import math
from typing import Final, Literal, NamedTuple, TypeAlias

import numpy as np
from pydantic import Field

from armimp_common.arrays import FloatArray
from armimp_common.compiled import compiled
from armimp_common.errors import ConfigurationError
from armimp_common.schema import PositiveVector, Schema, each
from armimp_common.status import Cause
from armimp_common.topics import PERIOD

WINDOW = 5
"""Ticks over which a velocity is taken."""

LIMITS: Final = ("position", "velocity", "torque", "rate", "power")
POSITION, VELOCITY, TORQUE, RATE, POWER = range(len(LIMITS))
"""What is limited, and indices of the limits."""

COMMAND_LIMITS: Final = LIMITS[TORQUE:]
"""The limits of commands, which may be clipped."""

Action: TypeAlias = Literal["clip", "stop"]
"""What is done with a command beyond a limit of torque, rate or power."""

# Rows of the rules: the limits by index, in rad, rad/s, N·m, N·m per tick and W; then, at
# STOPS + index, whether a limit of commands means a stop, 1 or 0; the posture, rad; the number of
# ticks of a ramp.
STOPS = len(LIMITS) - TORQUE
CENTRE = STOPS + len(LIMITS)
RAMP = CENTRE + 1
RULE_ROWS = RAMP + 1

# Rows of the memory: what was sent last, what the law asked for, N·m; distance from the posture,
# rad; velocity, rad/s; the last positions, rad.
SENT, ASKED, EXCURSION, SPEED, HISTORY = range(5)
LIMITER_ROWS = HISTORY + WINDOW

# The journal. STOPPED: 0 while commands pass. REMAINING: ticks of the ramp that are left. SAMPLES:
# number of samples so far. FAULT and PRESENT: each a cause, a joint and a value, of the latched
# fault and of what is wrong with the last sample. CLIPPED: number of clipped joint commands for
# each limit.
STOPPED, REMAINING, SAMPLES, FAULT, PRESENT, CLIPPED = 0, 1, 2, 3, 6, 9
JOURNAL = CLIPPED + len(LIMITS)

# Causes of a fault: those from BAD_SAMPLE on are rows of the sample, those from LIMIT_CAUSE on
# limits.
NO_CAUSE, BAD_SAMPLE, BAD_COMMAND, LIMIT_CAUSE = 0, 1, 4, 5


class Limiter(NamedTuple):
    """The arrays of one limiter, in the form that compiled code takes."""

    rules: FloatArray
    """(RULE_ROWS, n) from :meth:`SafetyParameters.rules`."""
    memory: FloatArray
    """(LIMITER_ROWS, n), zeros before the first tick."""
    journal: FloatArray
    """(JOURNAL,), zeros before the first tick."""


_NOT_FINITE = {
    BAD_SAMPLE: "position of",
    BAD_SAMPLE + 1: "torque reading of",
    BAD_SAMPLE + 2: "perturbation of",
    BAD_COMMAND: "torque from the control law for",
}
_BEYOND = {
    POSITION: ("joint {joint} is {value:.4g} rad away from the posture", "rad"),
    VELOCITY: ("velocity of joint {joint} is {value:.4g} rad/s", "rad/s"),
    TORQUE: ("torque asked of joint {joint} is {value:.4g} N·m", "N·m"),
    RATE: ("torque asked of joint {joint} changes by {value:.4g} N·m in a tick", "N·m"),
    POWER: ("power asked of joint {joint} is {value:.4g} W", "W"),
}


class SafetyParameters(Schema):
    """Limits of commands, what is done beyond them, and the patience of the watchdog."""

    position_limit: PositiveVector = (0.5,)
    """Largest distance of a joint from the target posture (rad); one value for all joints or one
    for each."""
    velocity_limit: PositiveVector = (4.0,)
    """Largest speed of a joint over 5 ticks (rad/s); one value for all joints or one for each."""
    torque_limit: float = Field(default=80.0, gt=0.0)
    """Largest commanded torque of any joint (N·m)."""
    torque_action: Action = "clip"
    """What is done beyond the torque limit: clip or stop."""
    rate_limit: float = Field(default=150e3, gt=0.0)
    """Largest change of a command from tick to tick, per second (N·m/s)."""
    rate_action: Action = "clip"
    """What is done beyond the rate limit: clip or stop."""
    power_limit: float = Field(default=200.0, gt=0.0)
    """Largest power of a joint, commanded torque times velocity (W)."""
    power_action: Action = "clip"
    """What is done beyond the power limit: clip or stop."""
    watchdog_ticks: int = Field(default=5, ge=1, le=100)
    """Control periods without a sample after which the torque is taken away."""
    slowest_tick: float = Field(default=1.0, gt=0.0, le=10.0)
    """Wall time that counts as one period of the watchdog in mode lockstep, which has no pace (s);
    in mode realtime it is the control period."""
    ramp_time: float = Field(default=0.01, ge=0.0, le=0.05)
    """Time within which a stop brings the torque to zero (s); short, as the ramp begins at the last
    command, which may be a peak of chatter."""

    @property
    def ramp_ticks(self) -> int:
        """Ticks in which a stop brings the torque to zero."""
        return max(math.floor(self.ramp_time / PERIOD + 1e-9), 1)

    def rules(self, posture: FloatArray) -> FloatArray:
        """Return the limits as compiled code takes them, (RULE_ROWS, n).

        Parameters
        ----------
        posture : (n,) θ_rd, from which positions are counted, rad

        Raises
        ------
        ConfigurationError
            If the number of values does not fit the number of joints, or a stop could not bring the
            torque to zero in time without a step beyond the rate limit.
        """
        n, ticks = posture.size, self.ramp_ticks
        rows = np.empty((RULE_ROWS, n))
        for i, limit in enumerate(LIMITS):
            name = f"{limit}_limit"
            rows[i] = each(f"safety.{name}", np.atleast_1d(getattr(self, name)).tolist(), n)
        for i, limit in enumerate(COMMAND_LIMITS, TORQUE):
            rows[STOPS + i] = getattr(self, f"{limit}_action") == "stop"
        rows[RATE] *= PERIOD
        rows[CENTRE] = posture
        rows[RAMP] = ticks
        if not self.rate_limit * PERIOD * ticks >= self.torque_limit:
            raise ConfigurationError(
                f"safety: with rate_limit {self.rate_limit} N·m/s a stop can't bring torque_limit "
                f"{self.torque_limit} N·m to zero within {ticks * PERIOD:g} s"
            )
        return rows


def fault_of(limiter: Limiter, place: int) -> tuple[Cause, str]:
    """Return a fault as a code, and in words with its joint (from 1), the value and the limit.

    `place` is FAULT or PRESENT. The result is NONE and empty if there is none, or if the caller
    reported it itself.
    """
    cause, joint, value = limiter.journal[place : place + 3].tolist()
    cause, joint = int(cause), int(joint)
    if cause == NO_CAUSE:
        return Cause.NONE, ""
    if cause < LIMIT_CAUSE:
        return (
            Cause.MALFORMED,
            f"{_NOT_FINITE[cause]} joint {joint + 1} is not finite: {value}",
        )
    words, unit = _BEYOND[cause - LIMIT_CAUSE]
    limit = limiter.rules[cause - LIMIT_CAUSE, joint]
    found = words.format(joint=joint + 1, value=value)
    return Cause.LIMIT, f"{found}, beyond the limit of {limit:g} {unit}"


class SaturationCounter:
    """Counts clipped joint commands, and remembers the ticks in which that happened.

    The intervals hold every clipped tick. They hold others too only where there would be more than
    :data:`MOST_INTERVALS`: then the two that are nearest to each other are merged, the earliest of
    equally near ones.
    """

    MOST_INTERVALS = 100

    def __init__(self) -> None:
        self.clipped = 0
        self._intervals: list[tuple[int, int]] = []

    def add(self, tick: int, clipped: int) -> None:
        """Count ``clipped`` joint commands of a tick; ticks must come in increasing order."""
        if clipped <= 0:
            return
        self.clipped += clipped
        intervals = self._intervals
        if intervals and tick <= intervals[-1][1] + 1:
            intervals[-1] = intervals[-1][0], tick
            return
        intervals.append((tick, tick))
        if len(intervals) > self.MOST_INTERVALS:
            gaps = [later[0] - one[1] for one, later in itertools.pairwise(intervals)]
            nearest = gaps.index(min(gaps))
            intervals[nearest : nearest + 2] = [(intervals[nearest][0], intervals[nearest + 1][1])]

    @property
    def text(self) -> str:
        """First and last tick of each interval: ``10-12 20-20``; in order, without overlap."""
        return " ".join(f"{first}-{last}" for first, last in self._intervals)


@compiled
def _note(journal: FloatArray, place: int, cause: int, joint: int, value: float) -> None:
    journal[place] = cause
    journal[place + 1] = joint
    journal[place + 2] = value


@compiled
def _stop(journal: FloatArray, ticks: float, cause: int, joint: int, value: float) -> None:
    """Let no command through any more; the first cause is kept, and a ramp never gets longer."""
    if journal[STOPPED] == 0.0:
        journal[STOPPED] = 1.0
        journal[REMAINING] = ticks
        _note(journal, FAULT, cause, joint, value)
    elif not journal[REMAINING] <= ticks:
        journal[REMAINING] = ticks


@compiled
def copy_values(values: FloatArray, to: FloatArray) -> None:
    """Copy (n,) values; slice assignment, with its checks, would take 2.5 s more to compile."""
    for i in range(values.size):
        to[i] = values[i]


@compiled
def _first_bad(values: FloatArray) -> int:
    """Return the index of the first value that is not finite; -1 if there is none."""
    for i in range(values.size):
        if not abs(values[i]) < np.inf:
            return i
    return -1


@compiled
def _remember(theta: FloatArray, limiter: Limiter) -> None:
    """Compute excursions and velocities of a finite sample, and remember it."""
    rules, memory, journal = limiter
    samples = int(journal[SAMPLES])
    slot = HISTORY + samples % WINDOW
    span, oldest = (WINDOW, slot) if samples >= WINDOW else (samples, HISTORY)
    for i in range(theta.size):
        memory[EXCURSION, i] = theta[i] - rules[CENTRE, i]
        memory[SPEED, i] = (theta[i] - memory[oldest, i]) / (span * PERIOD) if span > 0 else 0.0
        memory[slot, i] = theta[i]
    journal[SAMPLES] = samples + 1


@compiled
def check_sample(sample: FloatArray, limiter: Limiter) -> bool:
    """Check a sample before anything of it is used; return whether the law may use it.

    Parameters
    ----------
    sample : (3, n) rad, N·m, N·m: encoders, torque transducers, perturbation
    limiter : Limiter, updated
    """
    rules, memory, journal = limiter
    cause, joint, value, ticks = NO_CAUSE, 0, 0.0, 0.0
    for row in range(3):
        i = _first_bad(sample[row])
        if i >= 0 and cause == NO_CAUSE:
            cause, joint, value = BAD_SAMPLE + row, i, sample[row, i]
    if cause == NO_CAUSE:
        _remember(sample[0], limiter)
        for i in range(sample.shape[1]):
            for number, row in ((POSITION, EXCURSION), (VELOCITY, SPEED)):
                if not abs(memory[row, i]) <= rules[number, i] and cause == NO_CAUSE:
                    cause, joint, value = LIMIT_CAUSE + number, i, memory[row, i]
                    ticks = rules[RAMP, i]
    _note(journal, PRESENT, cause, joint, value)
    if cause != NO_CAUSE:
        _stop(journal, ticks, cause, joint, value)
    return bool(journal[STOPPED] == 0.0)


@compiled
def _clip(command: FloatArray, i: int, value: float, number: int, journal: FloatArray) -> None:
    if command[i] != value:
        command[i] = value
        journal[CLIPPED + number] += 1.0


@compiled
def _within_torque(command: FloatArray, rules: FloatArray, journal: FloatArray) -> int:
    """Reduce all commands in proportion, if one of them is beyond its torque limit.

    Returns the joint whose excess means a stop; -1 if there is none.
    """
    largest = 1.0
    for i in range(command.size):
        if not abs(command[i]) <= rules[TORQUE, i]:
            if rules[STOPS + TORQUE, i] != 0.0:
                return i
            largest = max(largest, abs(command[i]) / rules[TORQUE, i])
    if largest > 1.0:
        for i in range(command.size):
            # Rounding must not lead beyond the limit, nor below it for the joint most beyond it.
            share = min(abs(command[i]) / largest, rules[TORQUE, i])
            if abs(command[i]) / rules[TORQUE, i] >= largest:
                share = rules[TORQUE, i]
            _clip(command, i, math.copysign(share, command[i]), TORQUE, journal)
    return -1


@compiled
def _limit(command: FloatArray, limiter: Limiter) -> tuple[int, int, float]:
    """Bring a finite command within the limits.

    Returns index of the limit, joint and value if a stop is due; otherwise the index is -1.
    """
    rules, memory, journal = limiter
    joint = _within_torque(command, rules, journal)
    if joint >= 0:
        return TORQUE, joint, command[joint]
    for i in range(command.size):
        for number in (RATE, POWER):
            limit = rules[number, i]
            if number == RATE:
                value = command[i] - memory[SENT, i]
                nearest = memory[SENT, i] + math.copysign(limit, value)
                # Rounding must not lead beyond the limit that came before.
                nearest = min(max(nearest, -rules[TORQUE, i]), rules[TORQUE, i])
            else:
                value = command[i] * memory[SPEED, i]
                nearest = math.copysign(limit / abs(memory[SPEED, i]), command[i])
            if not abs(value) <= limit:
                if rules[STOPS + number, i] != 0.0:
                    return number, i, value
                _clip(command, i, nearest, number, journal)
    return -1, 0, 0.0


@compiled
def _ramp(command: FloatArray, limiter: Limiter) -> None:
    """Take one tick of the ramp to zero: a straight line, or less where the power limit asks."""
    rules, memory, journal = limiter
    remaining = journal[REMAINING]
    share = (remaining - 1.0) / remaining if remaining > 1.0 else 0.0
    journal[REMAINING] = remaining - 1.0 if remaining > 1.0 else 0.0
    for i in range(command.size):
        command[i] = memory[SENT, i] * share if share > 0.0 else 0.0
        if not abs(command[i] * memory[SPEED, i]) <= rules[POWER, i]:
            limit = rules[POWER, i] / abs(memory[SPEED, i])
            command[i] = math.copysign(limit, command[i])


@compiled
def limit_command(command: FloatArray, limiter: Limiter) -> int:
    """Limit a command before it is sent; :func:`check_sample` has checked its sample.

    Parameters
    ----------
    command : (n,) N·m, changed where it has to be; after a stop the input is ignored
    limiter : Limiter, updated

    Returns
    -------
    int
        Number of joints whose command was clipped; 0 once the limiter has stopped.
    """
    rules, memory, journal = limiter
    clipped = 0
    if journal[STOPPED] == 0.0:
        copy_values(command, memory[ASKED])
        joint = _first_bad(command)
        cause, value, ticks = BAD_COMMAND, command[joint], 0.0
        if joint < 0:
            number, joint, value = _limit(command, limiter)
            cause, ticks = LIMIT_CAUSE + number, rules[RAMP, joint]
            if number < 0:
                cause = NO_CAUSE
        if cause != NO_CAUSE:
            _stop(journal, ticks, cause, joint, value)
    if journal[STOPPED] == 0.0:
        for i in range(command.size):
            if command[i] != memory[ASKED, i]:
                clipped += 1
    else:
        _ramp(command, limiter)
    copy_values(command, memory[SENT])
    return clipped


@compiled
def stop_commands(ticks: int, limiter: Limiter) -> None:
    """Let no command through any more, for a reason that the caller knows.

    The ramp to zero takes some ticks; with 0, the last command counts as zero from now on.
    """
    _stop(limiter.journal, ticks, NO_CAUSE, 0, 0.0)
    if ticks == 0:
        limiter.memory[SENT] = 0.0


@compiled
def continue_ramp(ticks: int, command: FloatArray, limiter: Limiter) -> None:
    """Advance the ramp after a stop, while no samples come and the last velocity counts.

    Parameters
    ----------
    ticks : control periods that have passed since the last command
    command : (n,) N·m, written
    limiter : Limiter, updated
    """
    sent = limiter.memory[SENT]
    copy_values(sent, command)
    for _ in range(ticks):
        _ramp(command, limiter)
        copy_values(command, sent)
