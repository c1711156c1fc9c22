"""Rules of section 10 of docs/interfaces.md that a driver is judged by.

Under torque nothing is assumed of arm and friction but that they do the same again when they are
pushed again.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from armimp_bringup.driver_check.findings import (
    Finding,
    Reason,
    Rule,
    inconclusive,
    judged,
    not_checked,
)
from armimp_bringup.driver_check.record import (
    SENSOR_TOPICS,
    Call,
    Ending,
    Message,
    Push,
    Record,
    readings,
)
from armimp_common import topics
from armimp_common.realtime import LATE_NS
from armimp_common.topics import COMMANDS, JOINT_STATES, NS_PER_S, PERIOD_NS, VALUE_FIELD

# Limits that the interfaces page does not state are chosen.
_LEAST = 100  # samples without which nothing is judged
_BOUNDS = {"position": 4.0 * math.pi, "effort": 500.0}  # rad, two turns; N·m: chosen
_UNITS = {"position": "rad", "effort": "N·m"}
_COARSEST = {"position": 2.0 * math.pi / 51200, "effort": 0.02}  # of the study
_JUMP = 0.1  # rad in one period, so 100 rad/s: chosen
_CLOCK = 2e-4  # relative error of the mean step of stamps, which the estimator allows
_RATE = 0.005  # relative error of the rate by the wall clock: chosen
_LATE = LATE_NS / NS_PER_S
_LATE_SHARE = 0.01  # as in a valid run
_LATENCY = 0.001  # s, likewise
_NOMINAL = NS_PER_S / PERIOD_NS

_STALE, _STOP, _SECOND = "stale commands", "emergency stop", "second publisher"
_PERIOD = PERIOD_NS / NS_PER_S
_USUAL = 0.35  # share of the usual motion that counts as one: chosen
_GONE = 0.65  # least part of a torque seen to go for all of it to count as gone: chosen
_BLUR = 0.01  # s; error with which that moment can be seen, measured with the simulated rig
_ENDING = 5 * _PERIOD + 0.05  # s; until torque that is to go has gone
_REACTION = 3  # periods from a command to its first effect: chosen
_ANSWER = 0.5  # s; for the answer of a service: chosen
_TOLD = 1.5  # s; until a fault is on /diagnostics, where it is repeated every second
_ENDING_LIMIT = {"bound": 1e3 * _ENDING, "blur": 1e3 * _BLUR}
_TOLD_LIMIT = {"topic": topics.DIAGNOSTICS, "bound": _TOLD}

_BASELINE = 50  # samples at rest
_WINDOW = 120  # samples after the end that are looked at, of which there must be _LEAST
_OVERLAP = 30  # samples of the window that lie after the end, wherever it is
_RAMPS = (1, 5, 10, 15, 20, 30, 40, 50, 60, 80)  # tried lengths of the way to zero, samples
_SIGMAS = 5.0


def judge(record: Record) -> list[Finding]:
    """Judge a driver by what was recorded of it."""
    return [
        *_judge_contract(record),
        *(found for topic in SENSOR_TOPICS for found in _judge_content(record, topic)),
        *_judge_timing(record),
        *_judge_moves(record),
    ]


def _judge_contract(record: Record) -> Iterator[Finding]:
    for topic in SENSOR_TOPICS:
        yield from _judge_topic(record, topic, "publisher")
    yield from _judge_topic(record, COMMANDS, "subscriber")
    for service in (topics.SIM_STOP_SERVICE, topics.SIM_RESET_SERVICE):
        there = service in record.services
        state = "there" if there else "missing"
        yield judged(Rule.SERVICE, there, f"service {service}", state=state)
    if record.lifecycle is None:
        yield not_checked(Rule.LIFECYCLE, Reason.NO_LIFECYCLE)
    else:
        yield judged(Rule.LIFECYCLE, True, state=record.lifecycle)
    # Whoever says so: armimp run takes it for a problem of the run.
    fault = record.faults[0] if record.faults else "none"
    yield judged(Rule.NO_FAULT, not record.faults, fault=fault, topic=topics.DIAGNOSTICS)


def _judge_topic(record: Record, topic: str, role: str) -> Iterator[Finding]:
    found = [end for end in record.endpoints if end.topic == topic and end.role == role]
    kind = topics.MESSAGE_TYPES[topic]
    types = sorted({end.type for end in found})
    good = types == [kind] and (len(found) == 1 or role == "subscriber")
    yield judged(
        Rule.TYPE,
        good,
        topic,
        why=None if found else Reason.NO_ENDPOINT,
        types=", ".join(types),
        nodes=", ".join(sorted(end.node for end in found)),
        role=role,
        kind=kind,
    )
    if not found:
        return
    reliable = all(end.reliable for end in found)
    transient = any(end.transient for end in found)
    yield judged(
        Rule.QUALITY,
        # A reader that asks for more than volatile refuses the publishers of this project.
        reliable and not (role == "subscriber" and transient),
        topic,
        quality=f"{'reliable' if reliable else 'best effort'}, "
        f"{'transient local' if transient else 'volatile'}",
        wanted="reliable" + (", volatile" if role == "subscriber" else ""),
    )


def _judge_content(record: Record, topic: str) -> Iterator[Finding]:
    """Judge joints, fields, numbers and units of a stream."""
    messages, malformed = record.streams.get(topic, ()), record.malformed.get(topic, 0)
    count = len(messages)
    enough = count >= _LEAST and not malformed
    yield judged(Rule.MESSAGES, enough, topic, count=count, malformed=malformed, least=_LEAST)
    if not messages:
        return
    orders = sorted({message.names for message in messages})
    right = all(sorted(names) == sorted(record.joints) for names in orders)
    shown = " / ".join(", ".join(names) or "none" for names in orders[:3])
    expected = ", ".join(record.joints)
    yield judged(Rule.JOINT_NAMES, right, topic, names=shown, expected=expected)
    field, n = VALUE_FIELD[topic], len(record.joints)
    lengths = sorted({len(getattr(message, field)) for message in messages})
    told = ", ".join(map(str, lengths[:3]))
    yield judged(Rule.FIELD, lengths == [n], topic, lengths=told, field=field, expected=n)
    yield from _judge_values(record, topic, messages)


def _judge_values(record: Record, topic: str, messages: Sequence[Message]) -> Iterator[Finding]:
    field = VALUE_FIELD[topic]
    angles, unit, bound = topic == JOINT_STATES, _UNITS[field], _BOUNDS[field]
    still = readings(record.joints, topic, messages)
    moving = readings(record.joints, topic, record.moving.get(topic, ()))
    # Of numbers in the wrong place at least that can be said.
    misplaced = [] if still.size else [v for m in messages for v in (*m.position, *m.effort)]
    numbers = np.hstack([still.ravel(), misplaced, moving.ravel()])
    bad = int(np.sum(~np.isfinite(numbers)))
    yield judged(Rule.FINITE, bad == 0, topic, bad=bad, count=numbers.size)
    if not still.size:
        yield not_checked(Rule.RANGE, Reason.NOT_WHOLE, topic, bound=bound, unit=unit)
        return
    parts = [np.where(np.isfinite(part), part, 0.0) for part in (still, moving)]
    largest = float(max(np.max(np.abs(part), initial=0.0) for part in parts))
    why = Reason.DEGREES if angles else Reason.MILLIMETRES
    good = largest <= bound
    yield judged(Rule.RANGE, good, topic, why=why, largest=largest, bound=bound, unit=unit)
    if angles:
        # Between the two parts of the recording samples are missing.
        jump = float(max(np.max(np.abs(np.diff(part)), initial=0.0) for part in parts))
        yield judged(Rule.JUMPS, jump <= _JUMP, topic, jump=jump, bound=_JUMP)
    coarsest: dict[str, Any] = {"bound": _COARSEST[field], "unit": unit}
    found = resolution(np.hstack(parts))
    if found is None:
        reason = Reason.STILL_ANGLES if angles else Reason.STILL_TORQUES
        yield not_checked(Rule.RESOLUTION, reason, topic, **coarsest)
        return
    step, certain = found
    fine = step <= 1.01 * _COARSEST[field]
    if fine or certain:
        yield judged(Rule.RESOLUTION, fine, topic, step=step, **coarsest)
    else:
        yield not_checked(Rule.RESOLUTION, Reason.FEW_LEVELS, topic, **coarsest)


def resolution(values: NDArray[np.float64]) -> tuple[float, bool] | None:
    """Smallest step between readings (n, N) of the joint with the largest one, None if none moves.

    Readings that are rounded lie on a grid, whose step this is as soon as neighbours occur.

    Returns
    -------
    step : float
        It is no smaller than the step of the grid.
    certain : bool
        Whether all readings lie on a grid of this step.
    """
    steps: list[tuple[float, bool]] = []
    for row in values:
        levels = np.unique(row)
        gaps = np.diff(levels)
        # Levels of one grid differ in the last bits.
        gaps = gaps[gaps > 1e-9 * max(float(np.max(np.abs(levels))), 1e-3)]
        if gaps.size:
            step = float(np.min(gaps))
            ratios = gaps / step
            steps.append((step, float(np.max(np.abs(ratios - np.rint(ratios)))) < 0.1))
    return max(steps, default=None)


def _judge_timing(record: Record) -> Iterator[Finding]:
    for topic in SENSOR_TOPICS:
        messages = record.streams.get(topic, ())
        if len(messages) < 2:
            continue
        yield from _judge_stamps(topic, messages)
        if record.paced:
            yield from _judge_pace(record, topic, messages)
            continue
        count = len(messages)
        good = 0 <= count - record.answered <= 1
        yield judged(Rule.ANSWERS, good, topic, count=count, commands=record.answered)
        yield not_checked(Rule.JITTER, Reason.NO_CLOCK, topic, **_late_limits())
    yield _judge_pairs(record)
    if record.timing is None or not record.timing.latency_p99 > 0.0:
        yield not_checked(Rule.LATENCY, Reason.NOT_REPORTED, bound=1e3 * _LATENCY)
        return
    latency = record.timing.latency_p99
    values = {"latency": 1e3 * latency, "bound": 1e3 * _LATENCY}
    # Part of the way is the checker's own.
    yield _unless_busy(record, Rule.LATENCY, latency <= _LATENCY, "", values)


def _unless_busy(
    record: Record, rule: Rule, good: bool, of: str, values: dict[str, Any]
) -> Finding:
    """Judge what a busy machine spoils: it is inconclusive where a process was held up for long."""
    found = judged(rule, good, of, **values)
    if good or max(record.stalls.share, (record.waited or 0.0) / _length(record)) <= _LATE_SHARE:
        return found
    return _held_up(record, found)


def _held_up(record: Record, found: Finding) -> Finding:
    stall, waited = 1e3 * record.stalls.longest, 1e3 * (record.waited or 0.0)
    values = {**found.values, "shown": found.figure, "stall": stall, "waited": waited}
    return inconclusive(found.rule, Reason.HELD_UP, found.of, **values)


def _judge_stamps(topic: str, messages: Sequence[Message]) -> Iterator[Finding]:
    stamps = np.array([message.stamp_ns for message in messages], dtype=np.int64)
    steps = np.diff(stamps)
    still, back = int(np.sum(steps == 0)), int(np.sum(steps < 0))
    yield judged(Rule.INCREASE, still == back == 0, topic, still=still, back=back)
    off, longest = int(np.sum(np.rint(steps / PERIOD_NS) != 1)), float(np.max(np.abs(steps))) / 1e6
    yield judged(Rule.STEPS, off == 0, topic, off=off, count=steps.size, longest=longest)
    mean = float(stamps[-1] - stamps[0]) / steps.size / PERIOD_NS
    good = abs(mean - 1.0) <= _CLOCK
    yield judged(Rule.CLOCK, good, topic, mean=mean, tolerance=100 * _CLOCK)


def _judge_pace(record: Record, topic: str, messages: Sequence[Message]) -> Iterator[Finding]:
    arrivals = np.array([message.arrival_ns for message in messages], dtype=np.int64)
    period = _beat(arrivals)
    rate = 1.0 / period if period > 0.0 else 0.0
    error = abs(rate / _NOMINAL - 1.0)
    values: dict[str, Any] = {"rate": rate, "nominal": _NOMINAL, "tolerance": 100 * _RATE}
    found = judged(Rule.RATE, error <= _RATE, topic, **values)
    # So much can stalls at both ends of the recording make of it.
    doubt = 2.0 * record.stalls.longest / max(period * arrivals.size, _LATE)
    yield _held_up(record, found) if _RATE < error <= _RATE + doubt else found
    delay = _lateness(arrivals)
    share = float(np.mean(delay > _LATE))
    values = {"late": 100 * share, "worst": 1e3 * float(np.max(delay)), **_late_limits()}
    yield _unless_busy(record, Rule.JITTER, share <= _LATE_SHARE, topic, values)


def _late_limits() -> dict[str, float]:
    return {"share": 100 * _LATE_SHARE, "bound": 1e3 * _LATE}


def _length(record: Record) -> float:
    """Length of the recording at rest, s."""
    kept = record.streams.get(JOINT_STATES, ())
    return max(kept[-1].arrival_ns - kept[0].arrival_ns, PERIOD_NS) / NS_PER_S if kept else 1.0


def _beat(arrivals_ns: NDArray[np.int64]) -> float:
    """Mean period, s, between the medians of the first and of the last tenth of arrivals."""
    part = max(arrivals_ns.size // 10, 1)
    since = arrivals_ns - arrivals_ns[0]
    length = float(np.median(since[-part:]) - np.median(since[:part]))
    return length / NS_PER_S / max(arrivals_ns.size - part, 1)


def _lateness(arrivals_ns: NDArray[np.int64]) -> NDArray[np.float64]:
    """Delay (N,) of each arrival, s, against a regular beat with their own mean rate.

    The beat is laid through the median, so that half of the arrivals are late, by little if all is
    well. A message that was held up does not move it.
    """
    seconds = (arrivals_ns - arrivals_ns[0]) / NS_PER_S
    offset = seconds - _beat(arrivals_ns) * np.arange(seconds.size)
    delay: NDArray[np.float64] = offset - np.median(offset)
    return delay


def _judge_pairs(record: Record) -> Finding:
    sets = [{m.stamp_ns for m in record.streams.get(topic, ())} for topic in SENSOR_TOPICS]
    if not all(sets):
        return judged(Rule.PAIRS, False, why=Reason.MISSING_STREAM)
    # A recording may begin and end between the two messages of a sample.
    first, last = max(map(min, sets)), min(map(max, sets))
    within = [{stamp for stamp in stamps if first <= stamp <= last} for stamps in sets]
    alone = len(within[0] ^ within[1]) if all(within) else len(sets[0] | sets[1])
    return judged(Rule.PAIRS, alone == 0, alone=alone)


# --- under torque --------------------------------------------------------------------------------


def _judge_moves(record: Record) -> Iterator[Finding]:
    """Judge the answers to torque, to its absence, and to the emergency stop."""
    moves = record.moves
    yield _judge_motion(record)
    yield _judge_obedience(record)
    yield from _judge_pushes(record)
    if moves.stale is not None:
        yield from _judge_end(_STALE, record, moves.stale)
        yield _judge_latch(moves.stale)
    elif not record.paced:
        yield not_checked(Rule.GONE, Reason.STANDS_STILL, _STALE, **_ENDING_LIMIT)
    else:
        yield _missing(record, Rule.GONE, _STALE, **_ENDING_LIMIT)
    if moves.stop is None:
        yield _missing(record, Rule.GONE, _STOP, **_ENDING_LIMIT)
    else:
        yield from _judge_stop(record, moves.stop)
    if moves.second is None:
        yield _missing(record, Rule.TOLD, _SECOND, **_TOLD_LIMIT)
    else:
        yield from _judge_told(_SECOND, record, moves.second)


def _missing(record: Record, rule: Rule, of: str = "", **values: object) -> Finding:
    """Return the finding for something that was not done: why, and whether it was asked for."""
    reason = record.moves.missing or Reason.NOT_TRIED
    make = not_checked if reason in (Reason.NOT_TRIED, Reason.NOT_ASKED) else inconclusive
    return make(rule, reason, of, **{**record.moves.values, **values})


def _judge_motion(record: Record) -> Finding:
    moves = record.moves
    if moves.moved is None:
        return _missing(record, Rule.MOTION, "torque", most=record.most)
    lost = moves.missing in (Reason.TOO_FAR, Reason.UNREADABLE)
    values = {"moved": moves.moved, **moves.values, "most": record.most}
    return judged(Rule.MOTION, not lost, "torque", why=moves.missing, **values)


def _judge_obedience(record: Record) -> Finding:
    moves = record.moves
    if moves.moved is None or (moves.missing and not moves.fault):
        return _missing(record, Rule.NO_STOP, "torque")
    return judged(
        Rule.NO_STOP,
        not moves.fault,
        "torque",
        fault=moves.fault or "none",
        repeated=moves.repeated,
        gap=1e3 * moves.gap,
    )


def _judge_pushes(record: Record) -> Iterator[Finding]:
    pushes, names = record.moves.pushes, record.joints
    if not pushes:
        yield _missing(record, Rule.WAYS, "torque")
        yield _missing(record, Rule.SENSOR_SIGN, "torque_sensors")
        yield _missing(record, Rule.DELAY, "torque", bound=_REACTION)
        return
    ways = _ways(record)
    yield _judge_ways(record, ways)
    effects = [first_effect(push) for push in pushes]
    seen = [effect for effect in effects if effect is not None]
    reason = Reason.MIXED if ways.mixed else Reason.DEAF
    if ways.mixed or len(seen) < len(effects):
        yield inconclusive(Rule.SENSOR_SIGN, reason, "torque_sensors")
    else:
        changes = [
            effect.change * sign * float(np.sign(push.torque))
            for effect, sign, push in zip(seen, ways.signs, pushes, strict=True)
        ]
        told = (
            f"{names[push.joint]} {change:+.3g} N·m"
            for push, change in zip(pushes, changes, strict=True)
        )
        yield judged(
            Rule.SENSOR_SIGN, min(changes) > 0.0, "torque_sensors", changes=", ".join(told)
        )
    if ways.mixed or not seen:
        yield inconclusive(Rule.DELAY, reason, "torque", bound=_REACTION)
    else:
        worst = max(effect.samples for effect in seen)
        yield judged(Rule.DELAY, worst <= _REACTION, "torque", periods=worst, bound=_REACTION)


class _Ways(NamedTuple):
    """Which way joints turned under torque."""

    angles: list[float]  # motion of the pushed joint in each push, rad
    signs: list[float]  # 1, or -1 where that is clearly against the torque
    still: list[str]  # joints that did not move, though nothing else did
    mixed: list[str]  # what is mixed up


def _ways(record: Record) -> _Ways:
    pushes = record.moves.pushes
    moved = np.array([displacement(push) / push.torque for push in pushes]).T
    clear = np.array([threshold(p.position, p.on) / abs(p.torque) for p in pushes]).T
    order, columns = [push.joint for push in pushes], range(len(pushes))
    own, own_clear = moved[order, columns], clear[order, columns]
    signs = np.where(own < -own_clear, -1.0, 1.0)
    moving = np.any(np.abs(moved) > clear, axis=0)
    names = [record.joints[joint] for joint in order]
    mixed = []
    for a in columns:
        for b in range(a):
            # A passive rig cannot turn two torques into motion that does no work.
            block = (moved * signs)[np.ix_([order[b], order[a]], [b, a])]
            if moving[a] and moving[b] and not float(np.linalg.det(block)) > 0.0:
                mixed.append(f"{names[b]} and {names[a]} mixed up")
    if not mixed:
        mixed = [
            f"{names[a]} does not move, but others do"
            for a in columns
            if moving[a] and abs(own[a]) <= own_clear[a]
        ]
    angles = (own * [push.torque for push in pushes]).tolist()
    still = [names[a] for a in columns if not moving[a]]
    return _Ways(angles, signs.tolist(), still, mixed)


def _judge_ways(record: Record, ways: _Ways) -> Finding:
    pushes = record.moves.pushes
    names = [record.joints[push.joint] for push in pushes]
    turned = [
        f"{name} turns against its torque"
        for name, sign in zip(names, ways.signs, strict=True)
        if sign < 0.0
    ]
    if wrong := ways.mixed or turned:
        return judged(Rule.WAYS, False, "torque", ways="; ".join(wrong))
    if ways.still:
        joints = " and ".join(ways.still)
        return inconclusive(Rule.WAYS, Reason.NO_MOTION, "torque", joints=joints)
    told = (
        f"{name} {angle:+.3g} rad at {push.torque:+g} N·m"
        for name, angle, push in zip(names, ways.angles, pushes, strict=True)
    )
    return judged(Rule.WAYS, True, "torque", ways=", ".join(told))


def _judge_latch(ending: Ending) -> Finding:
    again, push = ending.again, ending.push
    if again is None or push is None:
        return not_checked(Rule.LATCHED, Reason.NOT_TRIED, _STALE)
    usual = float(np.abs(displacement(push)[again.joint]))
    if usual <= threshold(push.position, push.on)[again.joint]:
        return inconclusive(Rule.LATCHED, Reason.NO_EFFECT, _STALE)
    share = float(np.abs(displacement(again)[again.joint])) / usual
    return judged(Rule.LATCHED, share <= _USUAL, _STALE, share=100 * share)


def _judge_stop(record: Record, ending: Ending) -> Iterator[Finding]:
    call = ending.stop
    if call is None or call.success is None:
        yield judged(Rule.ANSWER, False, _STOP, why=Reason.NO_ANSWER, bound=_ANSWER)
        return
    good = call.success and call.seconds <= _ANSWER
    answer = "success" if call.success else f"refused: {call.message}"
    yield judged(Rule.ANSWER, good, _STOP, answer=answer, seconds=call.seconds, bound=_ANSWER)
    yield from _judge_end(_STOP, record, ending)


def _judge_end(of: str, record: Record, ending: Ending) -> Iterator[Finding]:
    moves = record.moves
    if ending.push is None or moves.released is None or moves.held is None:
        asked = moves.missing not in (None, Reason.NOT_ASKED)
        if asked:
            yield _missing(record, Rule.GONE, of, **_ENDING_LIMIT)
        else:
            yield not_checked(Rule.GONE, Reason.NO_TORQUE, of, **_ENDING_LIMIT)
    else:
        yield _judge_letting(of, letting(ending.push, moves.released, moves.held))
    yield from _judge_told(of, record, ending)


def _judge_letting(of: str, found: Letting | None) -> Finding:
    if found is None:
        return inconclusive(Rule.GONE, Reason.NO_EFFECT, of, **_ENDING_LIMIT)
    delay, stays = found.delay * _PERIOD, 100 * max(1 - found.share, 0)
    gone = found.share >= _GONE
    good, why = gone and delay <= _ENDING + _BLUR, None if gone else Reason.STAYS
    values = {"delay": 1e3 * delay, "stays": stays, **_ENDING_LIMIT}
    return judged(Rule.GONE, good, of, why=why, **values)


def _judge_told(of: str, record: Record, ending: Ending) -> Iterator[Finding]:
    told = ending.told
    if told is None and record.faults:
        # That would go on, whatever the driver has to say.
        fault = record.faults[0]
        yield inconclusive(Rule.TOLD, Reason.FAULT_AT_REST, of, fault=fault, **_TOLD_LIMIT)
    else:
        good, why = told is not None and told <= _TOLD, Reason.NEVER if told is None else None
        yield judged(Rule.TOLD, good, of, why=why, told=told, **_TOLD_LIMIT)
    reset = ending.reset or Call(success=None)
    if reset.success is None:
        yield judged(Rule.RESET, False, of, why=Reason.NO_ANSWER)
    else:
        answer = "granted" if reset.success else f"refused: {reset.message}"
        yield judged(Rule.RESET, reset.success, of, answer=answer)


def displacement(push: Push) -> NDArray[np.float64]:
    """Mean change of each angle (n,), rad, in the second half of the push."""
    position = push.position
    later = np.mean(position[:, (push.on + push.off) // 2 : push.off + 1], axis=1)
    found: NDArray[np.float64] = later - _baseline(position, push.on)
    return found


def threshold(values: NDArray[np.float64], on: int) -> NDArray[np.float64]:
    """Change (n,) of readings (n, N) that is no noise: five sigma at rest, and over one count."""
    rest = values[:, max(on - _BASELINE, 0) : on + 1]
    changes = np.abs(np.diff(np.sort(values, axis=1), axis=1))
    count = np.array([np.min(row[row > 1e-9], initial=np.inf) for row in changes])
    # Unquantised readings have steps of any size; those of noise are below five sigma anyway.
    count = np.where(np.isfinite(count), count, 0.0)
    noise: NDArray[np.float64] = np.maximum(_SIGMAS * np.std(rest, axis=1), 1.5 * count)
    return noise


class Effect(NamedTuple):
    """The first answer of a reading of torque, and how it changed then (mean of three), N·m."""

    samples: int  # since the one which the first command answered
    change: float


def first_effect(push: Push) -> Effect | None:
    """When, and with what sign, the reading of torque answers; None if it doesn't."""
    effort = push.effort
    change = effort[push.joint] - _baseline(effort, push.on)[push.joint]
    bound = threshold(effort, push.on)[push.joint]
    seen = np.flatnonzero(np.abs(change[push.on + 1 : push.off + 1]) > bound)
    if not seen.size:
        return None
    first = push.on + 1 + int(seen[0])
    return Effect(first - push.on, float(np.mean(change[first : first + 3])))


@dataclass(frozen=True)
class Letting:
    """How the effect of a torque ended."""

    share: float
    """Part of the torque that went, 1 if all of it."""
    delay: int
    """Samples from ``off`` until it had gone."""


def letting(ended: Push, released: Push, held: Push) -> Letting | None:
    """Find when and how far the torque of a push went after ``off``, None if it had no effect.

    Parameters
    ----------
    ended : Push
        The push in question.
    released : Push
        The same, ended by a command of zero torque: what the end of it looks like.
    held : Push
        The same, but longer: how the readings would have gone on.

    What ``ended`` differs from ``held`` by after its end is compared with what ``released`` does,
    as if the torque had gone in a straight line: at every delay, of every length, by least squares.
    """
    length = min(_WINDOW, *(_room(push, ended) for push in (ended, held)))
    size = min(_WINDOW, *(_room(push, released) for push in (released, held)))
    if min(length, size) < _LEAST:
        return None
    for kind in ("effort", "position"):  # torque is the sharper witness, as it feels acceleration
        pattern = _difference(kind, held, released, size)
        bound = threshold(getattr(held, kind), held.on)[held.joint]
        if float(np.max(np.abs(pattern))) > bound:
            break
    else:
        return None
    rest = _difference(kind, held, ended, length)
    best, found = 0.0, Letting(0.0, 0)
    for ramp in _RAMPS:
        faded = np.convolve(pattern, np.full(ramp, 1.0 / ramp))[:size]
        for start in range(length - _OVERLAP):
            model = faded[: length - start]
            part = rest[start : start + model.size]
            product, power = float(model @ part), float(model @ model)
            share = min(product / power, 1.0) if power > 0.0 else 0.0  # not more than there was
            explained = share * (2.0 * product - share * power)
            if share > 0.0 and explained > best:
                best, found = explained, Letting(share, start + ramp - 1)
    return found


def _room(push: Push, ended: Push) -> int:
    """Samples that a push has after the end of another one, both counted from their beginning."""
    return int(push.position.shape[1]) - (push.on + ended.off - ended.on + 1)


def _difference(kind: str, held: Push, ended: Push, length: int) -> NDArray[np.float64]:
    """What the readings of the pushed joint differ by after the end of ``ended``.

    They are compared at the last sample before, as friction leaves each push at another angle.
    """
    found = []
    for push in (held, ended):
        values: NDArray[np.float64] = getattr(push, kind)[push.joint]
        first = push.on + ended.off - ended.on + 1
        found.append(values[first : first + length] - np.mean(values[first - 5 : first]))
    difference: NDArray[np.float64] = found[0] - found[1]
    return difference


def _baseline(values: NDArray[np.float64], on: int) -> NDArray[np.float64]:
    mean: NDArray[np.float64] = np.mean(values[:, max(on - _BASELINE, 0) : on + 1], axis=1)
    return mean
