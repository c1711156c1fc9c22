"""A campaign against the safety limiter: random sequences, and a judge that knows its promises.

The sequences hold what no rig should send: NaN, infinities, denormal and enormous numbers, jumps.
Limits, actions, ramps and the number of joints are random, too. Half of the sequences give
arbitrary commands, the others go through the law of the study. The judge sees what goes in and what
comes out, works out velocities anew, and counts how often a promise of
:mod:`armimp_control.safety_limiter` was broken.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armimp_common.compiled import compiled, compiled_entry
from armimp_control.laws.base import (
    COMMAND,
    IMBIC,
    IMBIC_OBSERVER,
    LATE,
    MEMORY_ROWS,
    MODEL_ROWS,
    MOST_DELAY,
    ROLE_ROWS,
    SENSED,
)
from armimp_control.laws.law import control_tick
from armimp_control.safety_limiter import (
    ASKED,
    BAD_COMMAND,
    CENTRE,
    FAULT,
    JOURNAL,
    LIMITER_ROWS,
    LIMITS,
    NO_CAUSE,
    POSITION,
    POWER,
    RAMP,
    RATE,
    RULE_ROWS,
    STOPPED,
    STOPS,
    TORQUE,
    VELOCITY,
    WINDOW,
    check_sample,
    limit_command,
    stop_commands,
)

PROMISES = (
    "the output is finite",
    "no torque is beyond its limit",
    "no torque changes faster than the rate limit",
    "no power is beyond its limit",
    "what is not finite takes all torque away the same tick",
    "after a fault no torque grows or changes its sign",
    "after the ramp the torque is zero and stays so",
    "what is within all limits passes unchanged",
    "the number of clipped commands is told",
    "a sample beyond a limit that means a stop stops the limiter",
    "a limiter that has stopped stays so",
    "the law remembers what was sent",
)
"""What the judge looks at; indices of the counts of violations."""

(
    _FINITE,
    _TORQUE,
    _RATE,
    _POWER,
    _AT_ONCE,
    _GROWS,
    _STAYS,
    _UNCHANGED,
    _COUNT,
    _STOP,
    _CLOSED,
    _LAW,
) = range(len(PROMISES))

_PERIOD = 1e-3
_TICKS = 80
_CHUNK = 1000
_TOLERANCE = 1e-9  # of rounding, relative
_NONE, _STOPPED, _CUT, _RELEASED = range(4)


@dataclass(frozen=True, kw_only=True)
class CampaignResult:
    """What happened in a campaign.

    Attributes
    ----------
    sequences, ticks : how many there were, of all together
    faults : sequences that ended in a fault
    poisoned : ticks with something that is not finite
    clipped : joint commands that were clipped
    violations : how often each promise was broken, by the words of :data:`PROMISES`
    """

    sequences: int
    ticks: int
    faults: int
    poisoned: int
    clipped: int
    violations: dict[str, int]


@compiled
def _finite(values: NDArray[np.float64]) -> bool:
    return bool(np.all(np.isfinite(values)))


@compiled
def _velocity(
    theta: NDArray[np.float64], kept: NDArray[np.float64], count: int, i: int, period: float
) -> float:
    """Velocity of a joint from the finite samples of the past, ``kept`` (ticks, n)."""
    span = min(count, WINDOW)
    if span == 0:
        return 0.0
    return (theta[i] - kept[count - span, i]) / (span * period)  # type: ignore[no-any-return]


@compiled
def _judge_output(
    command: NDArray[np.float64],
    before: NDArray[np.float64],
    speed: NDArray[np.float64],
    rules: NDArray[np.float64],
    poisoned: bool,
    cut: bool,
    fallen: int,
    broken: NDArray[np.int64],
) -> None:
    """Count the broken promises about the output of one tick.

    ``fallen`` is the number of ticks since the limiter closed, the present one included; 0 if it is
    open.
    """
    for i in range(command.size):
        u, last = command[i], before[i]
        power = abs(u * speed[i]) if u != 0.0 else 0.0
        smaller = abs(u) <= abs(last) and u * last >= 0.0
        broken[_FINITE] += not abs(u) < np.inf
        broken[_TORQUE] += not abs(u) <= rules[TORQUE, i]
        broken[_POWER] += not power <= rules[POWER, i] * (1.0 + _TOLERANCE)
        if not (abs(u - last) <= rules[RATE, i] + _TOLERANCE * rules[TORQUE, i] or poisoned or cut):
            # Faster only towards zero, and only as far as the power demands.
            full = power >= rules[POWER, i] * (1.0 - _TOLERANCE) or abs(speed[i]) == np.inf
            broken[_RATE] += not (smaller and full)
        broken[_AT_ONCE] += poisoned and u != 0.0
        broken[_GROWS] += fallen > 0 and not smaller
        broken[_STAYS] += fallen >= rules[RAMP, i] and u != 0.0


@compiled
def _judge_passing(
    command: NDArray[np.float64],
    before: NDArray[np.float64],
    asked: NDArray[np.float64],
    speed: NDArray[np.float64],
    excursion: NDArray[np.float64],
    rules: NDArray[np.float64],
    clipped: int,
    broken: NDArray[np.int64],
) -> None:
    """Count the broken promises of an open limiter about what it does to a command."""
    changed = 0
    within = True
    for i in range(command.size):
        changed += command[i] != asked[i]
        far = not abs(excursion[i]) <= rules[POSITION, i]
        fast = not abs(speed[i]) <= rules[VELOCITY, i]
        within = (
            within
            and abs(asked[i]) <= rules[TORQUE, i]
            and abs(asked[i] - before[i]) <= rules[RATE, i]
            and abs(asked[i] * speed[i]) <= rules[POWER, i]
            and not (far and asked[i] * excursion[i] > 0.0)
            and not (fast and asked[i] * speed[i] > 0.0)
        )
        broken[_STOP] += far and rules[STOPS + POSITION, i] != 0.0
        broken[_STOP] += fast and rules[STOPS + VELOCITY, i] != 0.0
    broken[_UNCHANGED] += within and changed > 0
    broken[_COUNT] += clipped != changed


@compiled
def _run_sequence(  # noqa: PLR0917 (compiled code takes no objects)
    law: int,
    theta: NDArray[np.float64],
    tau_h: NDArray[np.float64],
    tau_delta: NDArray[np.float64],
    asked: NDArray[np.float64],
    role: NDArray[np.float64],
    model: NDArray[np.float64],
    rules: NDArray[np.float64],
    event: int,
    event_tick: int,
    broken: NDArray[np.int64],
    counts: NDArray[np.int64],
) -> None:
    """Run one sequence and judge every tick of it.

    Parameters
    ----------
    law : kind of the law that commands come from; negative: from ``asked``
    theta, tau_h, tau_delta, asked : (ticks, n) rad, N·m
    role, model, rules : (ROLE_ROWS, n), (MODEL_ROWS, n, n), (RULE_ROWS, n) of law and limiter
    event, event_tick : what the caller asks the limiter for, and when
    broken : (promises,) added to
    counts : (3,) of faults, poisoned ticks and clipped joint commands, added to
    """
    ticks, n = theta.shape
    memory, limiter, journal = (
        np.zeros((MEMORY_ROWS, n)),
        np.zeros((LIMITER_ROWS, n)),
        np.zeros(JOURNAL),
    )
    command, before, kept = np.zeros(n), np.zeros(n), np.zeros((ticks, n))
    speed, excursion = np.zeros(n), np.zeros(n)
    count, closed_at = 0, -1
    for k in range(ticks):
        cut = False
        if event != _NONE and k == event_tick:
            cut = event == _CUT
            stop_commands(0 if cut else int(rules[RAMP, 0]), event != _RELEASED, limiter, journal)
        poisoned = not (_finite(theta[k]) and _finite(tau_h[k]) and _finite(tau_delta[k]))
        if not poisoned:
            for i in range(n):
                speed[i] = _velocity(theta[k], kept, count, i, _PERIOD)
                excursion[i] = theta[k, i] - rules[CENTRE, i]
                kept[count, i] = theta[k, i]
            count += 1
        was_closed = journal[STOPPED] != 0.0
        if law >= 0:
            clipped = control_tick(
                law,
                theta[k],
                tau_h[k],
                tau_delta[k],
                role,
                rules[CENTRE],
                model,
                100.0,
                _PERIOD,
                rules,
                memory,
                limiter,
                journal,
                command,
            )
        else:
            used = check_sample(theta[k], tau_h[k], tau_delta[k], rules, _PERIOD, limiter, journal)
            command[:] = asked[k]
            clipped = limit_command(command, rules, limiter, journal)
            poisoned = poisoned or (used and not _finite(asked[k]))
        closed = journal[STOPPED] != 0.0
        if closed and closed_at < 0:
            closed_at = k
        broken[_CLOSED] += closed_at >= 0 and not closed
        if law >= 0:
            differs = False
            for i in range(n):
                differs = differs or memory[COMMAND, i] != (0.0 if closed else command[i])
            broken[_LAW] += differs
            # That the law itself overflows, nobody but the limiter can see.
            cut = cut or (closed and not was_closed and journal[FAULT] == BAD_COMMAND)
        fallen = k - closed_at + 1 if closed else 0
        _judge_output(command, before, speed, rules, poisoned, cut, fallen, broken)
        if not closed:
            _judge_passing(
                command, before, limiter[ASKED], speed, excursion, rules, clipped, broken
            )
        before[:] = command
        counts[1] += poisoned
        counts[2] += clipped
    counts[0] += journal[FAULT] != NO_CAUSE


@compiled_entry
def _run_sequences(  # noqa: PLR0917 (compiled code takes no objects)
    theta: NDArray[np.float64],
    tau_h: NDArray[np.float64],
    tau_delta: NDArray[np.float64],
    asked: NDArray[np.float64],
    roles: NDArray[np.float64],
    models: NDArray[np.float64],
    rules: NDArray[np.float64],
    events: NDArray[np.int64],
    event_ticks: NDArray[np.int64],
    broken: NDArray[np.int64],
    counts: NDArray[np.int64],
) -> None:
    """Run sequences with the arrays of :func:`_run_sequence` stacked, every other by the law."""
    for j in range(theta.shape[0]):
        _run_sequence(
            (-1, IMBIC, -1, IMBIC_OBSERVER)[j % 4],
            theta[j],
            tau_h[j],
            tau_delta[j],
            asked[j],
            roles[j],
            models[j],
            rules[j],
            events[j],
            event_ticks[j],
            broken,
            counts,
        )


_STRANGE = np.array(
    [
        np.nan,
        np.inf,
        -np.inf,
        5e-324,
        -5e-324,
        1e-310,
        1.7e308,
        -1.7e308,
        1e300,
        -1e200,
        0.0,
        -0.0,
        0.1,
        -1.0,
        1e3,
    ]
)


def _spoil(
    rng: np.random.Generator, values: NDArray[np.float64], share: NDArray[np.float64]
) -> None:
    """Put strange values into (m, ticks, n), with a probability per sequence, (m,)."""
    where = rng.random(values.shape) < share[:, None, None]
    values[where] = rng.choice(_STRANGE, int(where.sum()))


def _rules(rng: np.random.Generator, m: int, n: int) -> NDArray[np.float64]:
    """Random limits (m, RULE_ROWS, n) which `SafetyParameters` allows."""
    rows = np.zeros((m, RULE_ROWS, n))
    ramp = rng.integers(1, 51, (m, 1))
    torque = 10.0 ** rng.uniform(-3, 6, (m, 1))
    rows[:, POSITION] = 10.0 ** rng.uniform(-3, 2, (m, n))
    rows[:, VELOCITY] = 10.0 ** rng.uniform(-2, 4, (m, n))
    rows[:, TORQUE] = torque
    rows[:, RATE] = np.maximum(10.0 ** rng.uniform(-3, 6, (m, 1)), torque / ramp)
    rows[:, POWER] = 10.0 ** rng.uniform(-3, 6, (m, 1))
    stops = rng.random((m, LIMITS)) < rng.choice([0.0, 0.2, 0.6], (m, 1))
    rows[:, STOPS : STOPS + LIMITS] = stops[:, :, None]
    rows[:, CENTRE] = rng.uniform(-2, 2, (m, n))
    rows[:, RAMP] = ramp
    return rows


def campaign(sequences: int, seed: int) -> CampaignResult:
    """Run random sequences of 80 ticks against the limiter.

    Parameters
    ----------
    sequences : how many
    seed : of everything; equal seeds give equal campaigns

    Returns
    -------
    CampaignResult
    """
    rng = np.random.default_rng(seed)
    broken, counts = np.zeros(len(PROMISES), np.int64), np.zeros(3, np.int64)
    for first in range(0, sequences, _CHUNK):
        m, n = min(_CHUNK, sequences - first), int(rng.integers(1, 8))
        shape = (m, _TICKS, n)
        rules = _rules(rng, m, n)
        steps = 10.0 ** rng.uniform(-7, -1, (m, 1, 1))
        theta = rules[:, None, CENTRE] + np.cumsum(rng.normal(size=shape) * steps, axis=1)
        tau_h, tau_delta, asked = (
            rng.normal(size=shape) * 10.0 ** rng.uniform(-2, 4, (m, 1, 1)) for _ in range(3)
        )
        share = rng.choice([0.0, 0.0, 1e-3, 0.02], m)
        for values in (theta, tau_h, tau_delta, asked):
            _spoil(rng, values, share)
        roles = 10.0 ** rng.uniform(-1, 4, (m, ROLE_ROWS, n))
        roles[:, SENSED] = rng.integers(0, 2, (m, n))
        roles[:, LATE] = rng.integers(0, MOST_DELAY + 1, (m, 1))
        _run_sequences(
            theta,
            tau_h,
            tau_delta,
            asked,
            roles,
            np.eye(n) * 10.0 ** rng.uniform(-2, 1, (m, MODEL_ROWS, 1, 1)),
            rules,
            rng.choice([_NONE, _NONE, _STOPPED, _CUT, _RELEASED], m),
            rng.integers(0, _TICKS, m),
            broken,
            counts,
        )
    return CampaignResult(
        sequences=sequences,
        ticks=sequences * _TICKS,
        faults=int(counts[0]),
        poisoned=int(counts[1]),
        clipped=int(counts[2]),
        violations={what: int(count) for what, count in zip(PROMISES, broken, strict=True)},
    )
