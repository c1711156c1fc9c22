"""Judgement of a driver against section 10 of docs/interfaces.md: topics, numbers and time."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

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
from armimp_bringup.driver_check.move_rules import judge_moves
from armimp_bringup.driver_check.record import SENSOR_TOPICS, Message, Record, readings
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


def judge(record: Record) -> list[Finding]:
    """Judge a driver by what was recorded of it."""
    return [
        *_judge_contract(record),
        *(found for topic in SENSOR_TOPICS for found in _judge_content(record, topic)),
        *_judge_timing(record),
        *judge_moves(record),
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
