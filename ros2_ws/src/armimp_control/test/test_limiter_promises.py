"""What the safety limiter promises for every output, whatever comes in: random sequences."""

import numpy as np
import pytest

from armimp_common.arrays import BoolArray, FloatArray, IntArray
from armimp_common.compiled import compiled, compiled_entry
from armimp_common.topics import PERIOD
from armimp_control.safety_limiter import (
    CENTRE,
    JOURNAL,
    LIMITER_ROWS,
    LIMITS,
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
    Limiter,
    check_sample,
    copy_values,
    limit_command,
    stop_commands,
)
from support.fault_figures import Figures

PROMISES = (
    "the output is finite",
    "no torque is beyond its limit",
    "no power is beyond its limit",
    "no torque changes faster than the rate limit, but towards zero where the power demands it",
    "what is not finite takes all torque away the same tick",
    "after a fault no torque grows or changes its sign",
    "after the ramp the torque is zero and stays so",
    "what is within all limits passes unchanged",
    "the number of clipped commands is told",
    "a sample beyond a limit of position or velocity stops the limiter",
    "a limiter that has stopped stays so",
)
"""What the judge looks at; indices of the counts of violations."""

_TICKS = 80
_CHUNK = 1000
_TOLERANCE = 1e-9  # of rounding, relative
_NONE, _STOPPED, _CUT, _RELEASED = range(4)
_STRANGE = (np.nan, np.inf, -np.inf, 5e-324, -5e-324, 1e-310, 1.7e308, -1.7e308, 1e300, -1e200)


@compiled
def _judge(  # noqa: PLR0917 (compiled code takes no objects)
    command: FloatArray,
    before: FloatArray,
    asked: FloatArray,
    speed: FloatArray,
    excursion: FloatArray,
    rules: FloatArray,
    poisoned: bool,
    cut: bool,
    fallen: int,
    clipped: int,
    broken: IntArray,
) -> None:
    """Count the promises (11,) that one tick breaks, ``fallen`` ticks since the limiter stopped."""
    changed, within = 0, True
    for i in range(command.size):
        u, last, wanted = command[i], before[i], asked[i]
        power = abs(u * speed[i]) if u != 0.0 else 0.0
        smaller = abs(u) <= abs(last) and u * last >= 0.0
        broken[0] += not abs(u) < np.inf
        broken[1] += not abs(u) <= rules[TORQUE, i]
        broken[2] += not power <= rules[POWER, i] * (1.0 + _TOLERANCE)
        slow = abs(u - last) <= rules[RATE, i] + _TOLERANCE * rules[TORQUE, i]
        full = power >= rules[POWER, i] * (1.0 - _TOLERANCE) or abs(speed[i]) == np.inf
        broken[3] += not (slow or poisoned or cut or (smaller and full))
        broken[4] += poisoned and u != 0.0
        broken[5] += fallen > 0 and not smaller
        broken[6] += fallen >= rules[RAMP, i] and u != 0.0
        far = not abs(excursion[i]) <= rules[POSITION, i]
        fast = not abs(speed[i]) <= rules[VELOCITY, i]
        changed += u != wanted
        within &= abs(wanted) <= rules[TORQUE, i] and abs(wanted - last) <= rules[RATE, i]
        within &= abs(wanted * speed[i]) <= rules[POWER, i]
        if not fallen:
            broken[9] += far or fast
    if not fallen:
        broken[7] += within and changed > 0
        broken[8] += clipped != changed


@compiled_entry
def _run_sequence(
    inputs: FloatArray,
    finite: BoolArray,
    rules: FloatArray,
    event: int,
    event_tick: int,
    broken: IntArray,
    counts: IntArray,
) -> None:
    """Run one sequence and judge every tick of it.

    Parameters
    ----------
    inputs : (4, ticks, n) angles, torques, perturbations and commands, rad, N·m
    finite : (4, ticks) whether those of all joints are
    rules : (RULE_ROWS, n) of the limiter
    event, event_tick : what the caller asks the limiter for, and when
    broken, counts : of promises; of faults, poisoned ticks and clipped joint commands: added to
    """
    theta, asked = inputs[0], inputs[3]
    ticks, n = theta.shape
    journal = np.zeros(JOURNAL)
    limiter = Limiter(rules, np.zeros((LIMITER_ROWS, n)), journal)
    command, before, kept = np.zeros(n), np.zeros(n), np.zeros((ticks, n))
    speed, excursion = np.zeros(n), np.zeros(n)
    count, closed_at, released = 0, -1, False
    for k in range(ticks):
        cut = event == _CUT and k == event_tick
        if event != _NONE and k == event_tick:
            released = event == _RELEASED and journal[STOPPED] == 0.0
            stop_commands(0 if cut else int(rules[RAMP, 0]), limiter)
        poisoned = not (finite[0, k] and finite[1, k] and finite[2, k])
        if not poisoned:
            span = min(count, WINDOW)
            for i in range(n):
                past = kept[count - span, i]
                speed[i] = (theta[k, i] - past) / (span * PERIOD) if span else 0.0
                excursion[i] = theta[k, i] - rules[CENTRE, i]
                kept[count, i] = theta[k, i]
            count += 1
        used = check_sample(inputs[:3, k], limiter)
        copy_values(asked[k], command)
        clipped = limit_command(command, limiter)
        poisoned = poisoned or (used and not finite[3, k])
        closed = journal[STOPPED] != 0.0
        if closed and closed_at < 0:
            closed_at = k
        broken[10] += closed_at >= 0 and not closed
        fallen = k - closed_at + 1 if closed else 0
        _judge(
            command, before, asked[k], speed, excursion, rules, poisoned, cut, fallen, clipped,
            broken,
        )  # fmt: skip
        copy_values(command, before)
        counts[1] += poisoned
        counts[2] += clipped
    counts[0] += journal[STOPPED] != 0.0 and not released


def _rules(rng: np.random.Generator, m: int, n: int) -> FloatArray:
    """Random limits (m, RULE_ROWS, n) which `SafetyParameters` allows."""
    rows = np.zeros((m, RULE_ROWS, n))
    ramp = rng.integers(1, 51, (m, 1))
    torque = 10.0 ** rng.uniform(-3, 6, (m, 1))
    rows[:, POSITION] = 10.0 ** rng.uniform(-3, 2, (m, n))
    rows[:, VELOCITY] = 10.0 ** rng.uniform(-2, 4, (m, n))
    rows[:, TORQUE] = torque
    rows[:, RATE] = np.maximum(10.0 ** rng.uniform(-3, 6, (m, 1)), torque / ramp)
    rows[:, POWER] = 10.0 ** rng.uniform(-3, 6, (m, 1))
    stops = rng.random((m, len(LIMITS) - TORQUE)) < rng.choice([0.0, 0.2, 0.6], (m, 1))
    rows[:, STOPS + TORQUE : STOPS + len(LIMITS)] = stops[:, :, None]
    rows[:, CENTRE] = rng.uniform(-2, 2, (m, n))
    rows[:, RAMP] = ramp
    return rows


def campaign(sequences: int, seed: int) -> tuple[dict[str, int], list[int]]:
    """Run random sequences of 80 ticks, with what no rig should send, against the limiter.

    Returns how often each promise was broken; and how many sequences ended in a fault, ticks had
    something that is not finite, and joint commands were clipped.
    """
    rng = np.random.default_rng(seed)
    broken, counts = np.zeros(len(PROMISES), np.int64), np.zeros(3, np.int64)
    for first in range(0, sequences, _CHUNK):
        m, n = min(_CHUNK, sequences - first), int(rng.integers(1, 8))
        rules = _rules(rng, m, n)
        inputs = rng.normal(size=(4, m, _TICKS, n))
        inputs[1:] *= 10.0 ** rng.uniform(-2, 4, (3, m, 1, 1))
        steps = 10.0 ** rng.uniform(-7, -1, (m, 1, 1))
        inputs[0] = rules[:, None, CENTRE] + np.cumsum(inputs[0] * steps, axis=1)
        share = rng.choice([0.0, 0.0, 1e-3, 0.02], m)
        where = rng.random(inputs.shape) < share[:, None, None]
        inputs[where] = rng.choice(_STRANGE, int(where.sum()))
        events = rng.choice([_NONE, _NONE, _STOPPED, _CUT, _RELEASED], m)
        event_ticks = rng.integers(0, _TICKS, m)
        for j in range(m):
            given = np.ascontiguousarray(inputs[:, j])
            finite = np.asarray(np.isfinite(given).all(axis=2))
            _run_sequence(given, finite, rules[j], events[j], event_ticks[j], broken, counts)
    return dict(zip(PROMISES, broken.tolist(), strict=True)), counts.tolist()


MANY = pytest.param(1_000_000, marks=[pytest.mark.slow, pytest.mark.timeout(1200)])


@pytest.mark.parametrize("sequences", [3000, MANY])
def test_whatever_comes_in_the_torque_is_finite_limited_and_gone_after_a_fault(
    sequences: int, figures: Figures
) -> None:
    violations, (faults, poisoned, clipped) = campaign(sequences, seed=1)
    assert violations == dict.fromkeys(PROMISES, 0)
    # The sequences were demanding.
    assert min(faults, poisoned) > 0.5 * sequences
    assert clipped > 10 * sequences
    if sequences > 3000:
        figures.add(
            "safety limiter fed a random sequence of 80 ticks",
            sequences,
            faults_latched=(faults, ""),
            broken_promises=(sum(violations.values()), ""),
        )
