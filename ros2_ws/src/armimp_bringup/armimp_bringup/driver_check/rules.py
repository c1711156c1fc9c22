"""Rules of section 10 of docs/interfaces.md that a driver is judged by.

Under torque nothing is assumed of arm and friction but that they do the same again when they are
pushed again.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from armimp_bringup.driver_check import (
    SENSOR_TOPICS,
    Call,
    Ending,
    Finding,
    Message,
    Push,
    Record,
    Verdict,
    readings,
)
from armimp_common import topics
from armimp_common.realtime import LATE_NS
from armimp_common.topics import COMMANDS, JOINT_STATES, NS_PER_S, PERIOD_NS, VALUE_FIELD

# Limits that the interfaces page does not state are chosen.
_LEAST = 100  # samples without which nothing is judged
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
_END_LIMIT = f"torque gone within {1e3 * _ENDING:g} ms (± {1e3 * _BLUR:g} ms)"
_LARGER = "try a larger --torque"
_WAYS_LIMIT = "each joint turns the way of its torque"
_SIGN_LIMIT = "the reading of torque goes the way of the joint"
_DELAY_LIMIT = f"≤ {_REACTION} periods from command to effect"

_BASELINE = 50  # samples at rest
_WINDOW = 120  # samples after the end that are looked at, of which there must be _LEAST
_OVERLAP = 30  # samples of the window that lie after the end, wherever it is
_RAMPS = (1, 5, 10, 15, 20, 30, 40, 50, 60, 80)  # tried lengths of the way to zero, samples
_SIGMAS = 5.0


_RANGES = {"position": ("rad", 4.0 * math.pi, "degrees?"), "effort": ("N·m", 500.0, "N·mm?")}
"""Unit of readings, what none exceeds (two turns; chosen), and what they are if one does."""


def judge(record: Record) -> list[Finding]:
    """Judge a driver by what was recorded of it."""
    return [
        *_judge_contract(record),
        *(found for topic in SENSOR_TOPICS for found in _judge_content(record, topic)),
        *_judge_timing(record),
        *_judge_moves(record),
    ]


def _judged(check: str, good: bool, figure: str, limit: str) -> Finding:
    return Finding(check, Verdict.PASS if good else Verdict.FAIL, figure, limit)


def _judge_contract(record: Record) -> Iterator[Finding]:
    for topic in SENSOR_TOPICS:
        yield from _judge_topic(record, topic, "publisher")
    yield from _judge_topic(record, COMMANDS, "subscriber")
    for service in (topics.SIM_STOP_SERVICE, topics.SIM_RESET_SERVICE):
        there = service in record.services
        yield _judged(f"service {service}", there, "there" if there else "missing", "there")
    limit = "lifecycle services, for armimp run --processes external"
    if record.lifecycle is None:
        figure = "none: nobody can lead this node through its life"
        yield Finding("lifecycle", Verdict.NOT_CHECKED, figure, limit)
    else:
        yield _judged("lifecycle", True, f"was {record.lifecycle}", limit)
    # Whoever says so: armimp run takes it for a problem of the run.
    fault = record.faults[0] if record.faults else "none"
    limit = f"no status ERROR on {topics.DIAGNOSTICS}"
    yield _judged("no fault at rest", not record.faults, fault, limit)


def _judge_topic(record: Record, topic: str, role: str) -> Iterator[Finding]:
    found = [end for end in record.endpoints if end.topic == topic and end.role == role]
    kind = topics.MESSAGE_TYPES[topic]
    types, nodes = (sorted({getattr(end, of) for end in found}) for of in ("type", "node"))
    good = types == [kind] and (len(found) == 1 or role == "subscriber")
    figure = f"{', '.join(types)} from {', '.join(nodes)}" if found else f"no {role}"
    yield _judged(f"{topic}: type", good, figure, f"one {role} of {kind}")
    if not found:
        return
    reliable = all(end.reliable for end in found)
    transient = any(end.transient for end in found)
    yield _judged(
        f"{topic}: quality of service",
        # A reader that asks for more than volatile refuses the publishers of this project.
        reliable and not (role == "subscriber" and transient),
        f"{'reliable' if reliable else 'best effort'}, "
        f"{'transient local' if transient else 'volatile'}",
        "reliable" + (", volatile" if role == "subscriber" else ""),
    )


def _judge_content(record: Record, topic: str) -> Iterator[Finding]:
    """Judge joints, fields, numbers and units of a stream."""
    messages, malformed = record.streams.get(topic, ()), record.malformed.get(topic, 0)
    count = len(messages)
    enough = count >= _LEAST and not malformed
    figure = f"{count}, and {malformed} that cannot be decoded"
    yield _judged(f"{topic}: messages", enough, figure, f"≥ {_LEAST}, and none")
    if not messages:
        return
    orders = sorted({message.names for message in messages})
    right = all(sorted(names) == sorted(record.joints) for names in orders)
    figure = " / ".join(", ".join(names) or "none" for names in orders[:3])
    limit = f"{', '.join(record.joints)}, each once"
    yield _judged(f"{topic}: joint names", right, figure, limit)
    field, n = VALUE_FIELD[topic], len(record.joints)
    lengths = sorted({len(getattr(message, field)) for message in messages})
    figure = f"{', '.join(map(str, lengths[:3]))} values in {field}"
    yield _judged(f"{topic}: field", lengths == [n], figure, f"{n} in {field}")
    yield from _judge_values(record, topic, messages)


def _judge_values(record: Record, topic: str, messages: Sequence[Message]) -> Iterator[Finding]:
    unit, bound, hint = _RANGES[VALUE_FIELD[topic]]
    still = readings(record.joints, topic, messages)
    moving = readings(record.joints, topic, record.moving.get(topic, ()))
    # Of numbers in the wrong place at least that can be said.
    misplaced = [] if still.size else [v for m in messages for v in (*m.position, *m.effort)]
    numbers = np.hstack([still.ravel(), misplaced, moving.ravel()])
    bad = int(np.sum(~np.isfinite(numbers)))
    figure = f"{bad} of {numbers.size} are not"
    yield _judged(f"{topic}: finite", bad == 0, figure, "no NaN, no infinity")
    limit = f"|value| ≤ {bound:.4g} {unit}"
    if not still.size:
        yield Finding(f"{topic}: range", Verdict.NOT_CHECKED, "no whole message", limit)
        return
    parts = [np.where(np.isfinite(part), part, 0.0) for part in (still, moving)]
    largest = float(max(np.max(np.abs(part), initial=0.0) for part in parts))
    good = largest <= bound
    figure = f"{largest:.4g} {unit}" + ("" if good else f" ({hint})")
    yield _judged(f"{topic}: range", good, figure, limit)
    if topic == JOINT_STATES:
        # Between the two parts of the recording samples are missing.
        jump = float(max(np.max(np.abs(np.diff(part)), initial=0.0) for part in parts))
        limit = f"≤ {_JUMP:g} rad from one sample to the next"
        yield _judged(f"{topic}: jumps", jump <= _JUMP, f"{jump:.3g} rad", limit)


def _judge_timing(record: Record) -> Iterator[Finding]:
    for topic in SENSOR_TOPICS:
        messages = record.streams.get(topic, ())
        if len(messages) < 2:
            continue
        yield from _judge_stamps(topic, messages)
        if record.paced:
            yield from _judge_pace(topic, messages)
            continue
        figure = f"{len(messages)} for {record.answered} commands"
        good = 0 <= len(messages) - record.answered <= 1
        yield _judged(f"{topic}: rate", good, figure, "one for each command, and the first")
    yield _judge_pairs(record)
    limit = f"99 % ≤ {1e3 * _LATENCY:g} ms, as arm_sim: timing reports it"
    if record.timing is None or not record.timing.latency_p99 > 0.0:
        figure = "the driver does not report it"
        yield Finding("sample to command", Verdict.NOT_CHECKED, figure, limit)
    else:
        latency = record.timing.latency_p99
        # Part of the way is the checker's own.
        good, figure = latency <= _LATENCY, f"99 %: {1e3 * latency:.3g} ms"
        yield _unless_busy("sample to command", good, figure, limit)


def _unless_busy(check: str, good: bool, figure: str, limit: str) -> Finding:
    """Judge what other work on this machine spoils as well as a driver does."""
    if good:
        return _judged(check, True, figure, limit)
    figure = f"{figure}; or this machine is busy"
    return Finding(check, Verdict.INCONCLUSIVE, figure, limit)


def _judge_stamps(topic: str, messages: Sequence[Message]) -> Iterator[Finding]:
    stamps = np.array([message.stamp_ns for message in messages], dtype=np.int64)
    steps = np.diff(stamps)
    still, back = int(np.sum(steps == 0)), int(np.sum(steps < 0))
    figure = f"{still} repeat, {back} go back"
    yield _judged(
        f"{topic}: stamps increase", still == back == 0, figure, "none repeats, goes back"
    )
    off, longest = int(np.sum(np.rint(steps / PERIOD_NS) != 1)), float(np.max(np.abs(steps))) / 1e6
    figure = f"{off} of {steps.size} are not; longest {longest:.4g} ms"
    yield _judged(f"{topic}: stamps 1 ms apart", off == 0, figure, "all, within half of that")
    mean = float(stamps[-1] - stamps[0]) / steps.size / PERIOD_NS
    good, limit = abs(mean - 1.0) <= _CLOCK, f"1 ms ± {100 * _CLOCK:g} %"
    yield _judged(f"{topic}: clock", good, f"{mean:.6f} ms", limit)


def _judge_pace(topic: str, messages: Sequence[Message]) -> Iterator[Finding]:
    """Judge arrivals against a regular beat with their own mean rate.

    Its period is that between the medians of the first and of the last tenth of arrivals, and it is
    laid through the median of all, so that a message that was held up does not move it.
    """
    arrivals_ns = np.array([message.arrival_ns for message in messages], dtype=np.int64)
    since = (arrivals_ns - arrivals_ns[0]) / NS_PER_S
    part = max(since.size // 10, 1)
    length = float(np.median(since[-part:]) - np.median(since[:part]))
    period = length / max(since.size - part, 1)
    rate = 1.0 / period if period > 0.0 else 0.0
    good, limit = abs(rate / _NOMINAL - 1.0) <= _RATE, f"{_NOMINAL:g} Hz ± {100 * _RATE:g} %"
    yield _judged(f"{topic}: rate", good, f"{rate:.1f} Hz", limit)
    offset = since - period * np.arange(since.size)
    delay = offset - np.median(offset)
    share = float(np.mean(delay > _LATE))
    figure = f"{100 * share:.3g} %; worst {1e3 * float(np.max(delay)):.3g} ms"
    limit = f"≤ {100 * _LATE_SHARE:g} % arrive more than {1e3 * _LATE:g} ms late"
    yield _unless_busy(f"{topic}: jitter", share <= _LATE_SHARE, figure, limit)


def _judge_pairs(record: Record) -> Finding:
    limit = "both streams have the same stamps"
    sets = [{m.stamp_ns for m in record.streams.get(topic, ())} for topic in SENSOR_TOPICS]
    if not all(sets):
        return _judged("pairs", False, "a stream is missing", limit)
    # A recording may begin and end between the two messages of a sample.
    first, last = max(map(min, sets)), min(map(max, sets))
    within = [{stamp for stamp in stamps if first <= stamp <= last} for stamps in sets]
    alone = len(within[0] ^ within[1]) if all(within) else len(sets[0] | sets[1])
    return _judged("pairs", alone == 0, f"{alone} readings without a partner", limit)


# --- under torque --------------------------------------------------------------------------------


def _judge_moves(record: Record) -> Iterator[Finding]:
    """Judge the answers to torque, to its absence, and to the emergency stop."""
    moves = record.moves
    limit = f"≤ {record.most:g} rad from where each joint was"
    if moves.moved is None:
        yield _missing(record, "torque: motion", limit)
    else:
        figure = moves.missing if moves.astray else f"{moves.moved:.3g} rad"
        yield _judged("torque: motion", not moves.astray, figure, limit)
    limit = "no fault while commands come as they should"
    if moves.moved is None or (moves.missing and not moves.fault):
        yield _missing(record, "torque: no stop", limit)
    else:
        again = f"{moves.repeated} repeated, commands up to {1e3 * moves.gap:.3g} ms apart"
        figure = f"{moves.fault or 'none'}; {again}"
        yield _judged("torque: no stop", not moves.fault, figure, limit)
    yield from _judge_pushes(record)
    if moves.stale is not None:
        yield from _judge_end(_STALE, record, moves.stale)
        yield _judge_latch(moves.stale)
    elif record.paced:
        yield _missing(record, _STALE, _END_LIMIT)
    if moves.stop is None:
        yield _missing(record, _STOP, _END_LIMIT)
    else:
        yield from _judge_stop(record, moves.stop)
    if moves.second is None:
        yield _missing(record, f"{_SECOND}: told", _told_limit())
    else:
        yield from _judge_told(_SECOND, record, moves.second)


def _missing(record: Record, check: str, limit: str) -> Finding:
    """Return the finding for something that was not done: why, and whether it was asked for."""
    moves = record.moves
    in_vain = moves.asked and moves.missing
    verdict = Verdict.INCONCLUSIVE if in_vain else Verdict.NOT_CHECKED
    return Finding(check, verdict, moves.missing or "not tried", limit)


def _judge_pushes(record: Record) -> Iterator[Finding]:
    pushes, names = record.moves.pushes, record.joints
    ways, sign, delay = "torque: joint and sign", "torque_sensors: sign", "torque: delay"
    if not pushes:
        yield _missing(record, ways, _WAYS_LIMIT)
        yield _missing(record, sign, _SIGN_LIMIT)
        yield _missing(record, delay, _DELAY_LIMIT)
        return
    found = _ways(record)
    yield _judge_ways(ways, record, found)
    effects = [first_effect(push) for push in pushes]
    seen = [effect for effect in effects if effect is not None]
    why = f"readings of torque do not answer: {_LARGER}"
    if found.mixed:
        why = "torque acts on another joint"
    if found.mixed or len(seen) < len(effects):
        yield Finding(sign, Verdict.INCONCLUSIVE, why, _SIGN_LIMIT)
    else:
        changes = [
            effect.change * way * float(np.sign(push.torque))
            for effect, way, push in zip(seen, found.signs, pushes, strict=True)
        ]
        told = (
            f"{names[push.joint]} {change:+.3g} N·m"
            for push, change in zip(pushes, changes, strict=True)
        )
        yield _judged(sign, min(changes) > 0.0, ", ".join(told), _SIGN_LIMIT)
    if found.mixed or not seen:
        yield Finding(delay, Verdict.INCONCLUSIVE, why, _DELAY_LIMIT)
    else:
        worst = max(effect.samples for effect in seen)
        yield _judged(delay, worst <= _REACTION, f"{worst} periods", _DELAY_LIMIT)


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


def _judge_ways(check: str, record: Record, ways: _Ways) -> Finding:
    pushes = record.moves.pushes
    names = [record.joints[push.joint] for push in pushes]
    turned = [
        f"{name} turns against its torque"
        for name, sign in zip(names, ways.signs, strict=True)
        if sign < 0.0
    ]
    if wrong := ways.mixed or turned:
        return _judged(check, False, "; ".join(wrong), _WAYS_LIMIT)
    if ways.still:
        figure = f"{' and '.join(ways.still)} did not move: {_LARGER}"
        return Finding(check, Verdict.INCONCLUSIVE, figure, _WAYS_LIMIT)
    told = (
        f"{name} {angle:+.3g} rad at {push.torque:+g} N·m"
        for name, angle, push in zip(names, ways.angles, pushes, strict=True)
    )
    return _judged(check, True, ", ".join(told), _WAYS_LIMIT)


def _judge_latch(ending: Ending) -> Finding:
    again, push, check = ending.again, ending.push, f"{_STALE}: latched"
    limit = "no torque before the reset, whatever is commanded"
    if again is None or push is None:
        return Finding(check, Verdict.NOT_CHECKED, "not tried", limit)
    usual = float(np.abs(displacement(push)[again.joint]))
    if usual <= threshold(push.position, push.on)[again.joint]:
        return Finding(check, Verdict.INCONCLUSIVE, f"no effect: {_LARGER}", limit)
    share = float(np.abs(displacement(again)[again.joint])) / usual
    return _judged(check, share <= _USUAL, f"{100 * share:.0f} % of the usual motion", limit)


def _judge_stop(record: Record, ending: Ending) -> Iterator[Finding]:
    call, check, limit = ending.stop, f"{_STOP}: answer", f"success within {_ANSWER:g} s"
    if call is None or call.success is None:
        yield _judged(check, False, "no answer", limit)
        return
    answer = "success" if call.success else f"refused: {call.message}"
    good = call.success and call.seconds <= _ANSWER
    yield _judged(check, good, f"{answer}, {call.seconds:.3f} s", limit)
    yield from _judge_end(_STOP, record, ending)


def _judge_end(of: str, record: Record, ending: Ending) -> Iterator[Finding]:
    moves = record.moves
    if ending.push is not None and moves.released is not None and moves.held is not None:
        yield _judge_letting(of, letting(ending.push, moves.released, moves.held))
    elif moves.asked and moves.missing:
        yield _missing(record, of, _END_LIMIT)
    else:
        yield Finding(of, Verdict.NOT_CHECKED, "no torque was there: --move", _END_LIMIT)
    yield from _judge_told(of, record, ending)


def _judge_letting(of: str, found: Letting | None) -> Finding:
    if found is None:
        return Finding(of, Verdict.INCONCLUSIVE, f"no effect: {_LARGER}", _END_LIMIT)
    delay = found.delay * _PERIOD
    if found.share < _GONE:
        stays = f"{100 * max(1 - found.share, 0):.0f} % of the torque seems to stay"
        return _judged(of, False, stays, _END_LIMIT)
    return _judged(of, delay <= _ENDING + _BLUR, f"after about {1e3 * delay:.0f} ms", _END_LIMIT)


def _told_limit() -> str:
    return f"status ERROR on {topics.DIAGNOSTICS} within {_TOLD:g} s"


def _judge_told(of: str, record: Record, ending: Ending) -> Iterator[Finding]:
    told, check = ending.told, f"{of}: told"
    if told is None and record.faults:
        # That would go on, whatever the driver has to say.
        figure = f"there was a fault before: {record.faults[0]}"
        yield Finding(check, Verdict.INCONCLUSIVE, figure, _told_limit())
    else:
        figure = "none" if told is None else f"after {told:.3f} s"
        yield _judged(check, told is not None and told <= _TOLD, figure, _told_limit())
    reset = ending.reset or Call(success=None)
    refused = "no answer" if reset.success is None else f"refused: {reset.message}"
    granted = "granted" if reset.success else refused
    yield _judged(f"{of}: reset", bool(reset.success), granted, "granted under zero torque")


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
