"""Rules by which a driver is judged, from section 10 of docs/interfaces.md."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence

import numpy as np

from armimp_bringup.driver_check import (
    SENSOR_TOPICS,
    Ending,
    Finding,
    Message,
    Outcome,
    Push,
    Record,
    readings,
)
from armimp_common import topics
from armimp_common.arrays import FloatArray
from armimp_common.realtime import LATE_NS
from armimp_common.topics import COMMANDS, JOINT_STATES, NS_PER_S, PERIOD_NS, RATE, VALUE_FIELD

# Limits marked as chosen are ours; the interfaces page does not state them.
_LEAST = 100  # fewest samples that a stream must have
_JUMP = 0.1  # rad in one period, so 100 rad/s: chosen
_CLOCK = 2e-4  # relative error of the mean step of stamps, which the estimator allows
_RATE_ERROR = 0.005  # relative error of the rate by the wall clock: chosen
_LATE = LATE_NS / NS_PER_S
_LATE_SHARE = 0.01  # as in a valid run

_USUAL = 0.35  # tolerance when motion is compared with the usual one, as a share of it: chosen
_REACTION = 3  # periods from a command to its first effect: chosen
_REGULAR = 0.004  # s between commands that give no driver a reason to stop: 5 periods would
_ANSWER = 0.5  # s; for the answer of a service: chosen
_REPORT = 1.5  # s; until a fault is on /diagnostics, where it is repeated every second
_LARGER = "try a larger --torque"
_WAYS_LIMIT = "each joint turns the way of its torque"
_SIGN_LIMIT = "the reading of torque goes the way of the joint"
_DELAY_LIMIT = f"≤ {_REACTION} periods from command to effect"
_GONE_LIMIT = "torque gone within 60 ms, as after a command of none"
_LATCH_LIMIT = "no torque before the reset, whatever is commanded"

_RANGES = {"position": ("rad", 4.0 * math.pi, "degrees?"), "effort": ("N·m", 500.0, "N·mm?")}
"""Unit of readings, their bound (two turns; chosen), and the likely unit if one exceeds it."""


def judge(record: Record) -> list[Finding]:
    """Judge a driver by its record."""
    return [
        *_judge_contract(record),
        *(found for topic in SENSOR_TOPICS for found in _judge_content(record, topic)),
        *_judge_timing(record),
        *_judge_moves(record),
    ]


def _judged(check: str, good: bool | None, figure: str, limit: str) -> Finding:
    """Return the finding of a check that passed, or failed; inconclusive if `good` is None."""
    outcomes = {True: Outcome.PASS, False: Outcome.FAIL, None: Outcome.INCONCLUSIVE}
    return Finding(check, outcomes[good], figure, limit)


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
        yield Finding("lifecycle", Outcome.NOT_CHECKED, figure, limit)
    else:
        yield _judged("lifecycle", True, f"was {record.lifecycle}", limit)
    # No matter which node reports it: armimp run takes any ERROR for a problem of the run.
    fault = record.faults[0] if record.faults else "none"
    limit = f"no status ERROR on {topics.DIAGNOSTICS}"
    yield _judged("no fault at rest", not record.faults, fault, limit)


def _judge_topic(record: Record, topic: str, role: str) -> Iterator[Finding]:
    found = [end for end in record.endpoints if end.topic == topic and end.role == role]
    kind = topics.TOPICS[topic].type
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
        # A transient-local subscriber would refuse the volatile publishers of this project.
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
    # Numbers in the wrong place can at least be tested for being finite.
    misplaced = [] if still.size else [v for m in messages for v in (*m.position, *m.effort)]
    numbers = np.hstack([still.ravel(), misplaced, moving.ravel()])
    bad = int(np.sum(~np.isfinite(numbers)))
    figure = f"{bad} of {numbers.size} are not"
    yield _judged(f"{topic}: finite", bad == 0, figure, "no NaN, no infinity")
    limit = f"|value| ≤ {bound:.4g} {unit}"
    if not still.size:
        yield Finding(f"{topic}: range", Outcome.NOT_CHECKED, "no complete message", limit)
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
        yield from _judge_pace(topic, messages)
    yield _judge_pairs(record)


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
    """Judge arrivals against a regular grid with their own mean rate.

    The period of the grid follows from the medians of the first and of the last tenth of arrivals,
    and its offset is the median of all, so that a single delayed message does not move it.
    """
    arrivals_ns = np.array([message.arrival_ns for message in messages], dtype=np.int64)
    since = (arrivals_ns - arrivals_ns[0]) / NS_PER_S
    part = max(since.size // 10, 1)
    length = float(np.median(since[-part:]) - np.median(since[:part]))
    period = length / max(since.size - part, 1)
    rate = 1.0 / period if period > 0.0 else 0.0
    good, limit = abs(rate / RATE - 1.0) <= _RATE_ERROR, f"{RATE:g} Hz ± {100 * _RATE_ERROR:g} %"
    yield _judged(f"{topic}: rate", good, f"{rate:.1f} Hz", limit)
    offset = since - period * np.arange(since.size)
    delay = offset - np.median(offset)
    share = float(np.mean(delay > _LATE))
    figure = f"{100 * share:.3g} %; worst {1e3 * float(np.max(delay)):.3g} ms"
    limit = f"≤ {100 * _LATE_SHARE:g} % arrive more than {1e3 * _LATE:g} ms late"
    # Other work on this machine causes jitter as well as a driver does, so no driver fails here.
    yield _judged(f"{topic}: jitter", share <= _LATE_SHARE or None, figure, limit)


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
    """Judge the responses to torque, silence, emergency stop and a second publisher."""
    moves = record.moves
    check, limit = "torque: motion", f"≤ {record.most:g} rad from where each joint was"
    if moves.moved is None:
        yield _missing(record, check, limit)
    else:
        figure = moves.missing if moves.astray else f"{moves.moved:.3g} rad"
        yield _judged(check, not moves.astray, figure, limit)
    check = "torque: no stop"
    limit = f"no fault while commands come at most {1e3 * _REGULAR:g} ms apart"
    if moves.moved is None or (moves.missing and not moves.fault):
        yield _missing(record, check, limit)
    else:
        excused = bool(moves.fault) and moves.gap > _REGULAR
        held_up = f"; commands were held up for {1e3 * moves.gap:.3g} ms" if excused else ""
        good = None if excused else not moves.fault
        yield _judged(check, good, (moves.fault or "none") + held_up, limit)
    if moves.pushes:
        yield from _judge_pushes(record)
    else:
        yield _missing(record, "torque: joint and sign", _WAYS_LIMIT)
        yield _missing(record, "torque_sensors: sign", _SIGN_LIMIT)
        yield _missing(record, "torque: delay", _DELAY_LIMIT)
    yield from _judge_ending(record, "stale commands", moves.stale)
    if moves.stop is not None:
        yield _judge_answer(moves.stop)
    yield from _judge_ending(record, "emergency stop", moves.stop)
    yield from _judge_ending(record, "second publisher", moves.second)


def _missing(record: Record, check: str, limit: str) -> Finding:
    """Return the finding for a test that was not done: inconclusive if torque was requested."""
    missing = record.moves.missing
    outcome = Outcome.INCONCLUSIVE if missing else Outcome.NOT_CHECKED
    return Finding(check, outcome, missing or "not without --move", limit)


def _judge_pushes(record: Record) -> Iterator[Finding]:
    pushes = record.moves.pushes
    names = [record.joints[push.joint] for push in pushes]
    own = np.array([push.moved[push.joint] / push.torque for push in pushes])
    clear = np.array([push.still[push.joint] / abs(push.torque) for push in pushes])
    ways = np.where(own < -clear, -1.0, 1.0)
    mixed, still = _mixed_up(record, ways)
    turned = [
        f"{name} turns against its torque"
        for name, way in zip(names, ways, strict=True)
        if way < 0.0
    ]
    motions = (
        f"{name} {push.moved[push.joint]:+.3g} rad at {push.torque:+g} N·m"
        for name, push in zip(names, pushes, strict=True)
    )
    wrong = "; ".join(mixed or turned)
    idle = f"{' and '.join(still)} did not move: {_LARGER}" if still else ""
    good = False if wrong else None if idle else True
    yield _judged("torque: joint and sign", good, wrong or idle or ", ".join(motions), _WAYS_LIMIT)
    delays = [push.delay for push in pushes if push.delay is not None]
    why = (
        "torque acts on another joint" if mixed else f"readings of torque do not answer: {_LARGER}"
    )
    changes = [
        push.change * way * float(np.sign(push.torque))
        for push, way in zip(pushes, ways, strict=True)
    ]
    good, figure = None, why
    if not mixed and len(delays) == len(pushes):
        good = min(changes) > 0.0
        signed = (f"{name} {change:+.3g} N·m" for name, change in zip(names, changes, strict=True))
        figure = ", ".join(signed)
    yield _judged("torque_sensors: sign", good, figure, _SIGN_LIMIT)
    good, figure = None, why
    if not mixed and delays:
        good, figure = max(delays) <= _REACTION, f"{max(delays)} period{'s' * (max(delays) != 1)}"
    yield _judged("torque: delay", good, figure, _DELAY_LIMIT)


def _mixed_up(record: Record, ways: FloatArray) -> tuple[list[str], list[str]]:
    """Return sentences about joints that are mixed up, and the joints whose push moved no joint.

    On a passive rig torques do positive work, so the 2×2 matrix of the responses of two joints to
    their pushes has a positive determinant. `ways` are −1 for joints that turn the wrong way.
    """
    pushes = record.moves.pushes
    order = [push.joint for push in pushes]
    moved = np.array([push.moved / push.torque for push in pushes]).T[order]
    clear = np.array([push.still / abs(push.torque) for push in pushes]).T[order]
    moving = np.any(np.abs(moved) > clear, axis=0)
    names = [record.joints[joint] for joint in order]
    mixed = []
    for a, b in itertools.combinations(range(len(pushes)), 2):
        block = (moved * ways)[np.ix_([a, b], [a, b])]
        if moving[a] and moving[b] and not float(np.linalg.det(block)) > 0.0:
            mixed.append(f"{names[a]} and {names[b]} mixed up")
    if not mixed:
        mixed = [
            f"{name} does not move, but others do"
            for a, name in enumerate(names)
            if moving[a] and abs(moved[a, a]) <= clear[a, a]
        ]
    return mixed, [name for name, moves in zip(names, moving, strict=True) if not moves]


def _judge_answer(ending: Ending) -> Finding:
    call, check, limit = ending.stop, "emergency stop: answer", f"success within {_ANSWER:g} s"
    if call is None or call.success is None:
        return _judged(check, False, "no answer", limit)
    answer = "success" if call.success else f"refused: {call.message}"
    good = call.success and call.seconds <= _ANSWER
    return _judged(check, good, f"{answer}, {call.seconds:.3f} s", limit)


def _judge_ending(record: Record, of: str, ending: Ending | None) -> Iterator[Finding]:
    """Judge whether a fault was reported, latched and reset."""
    check, limit = f"{of}: reported", f"status ERROR on {topics.DIAGNOSTICS} within {_REPORT:g} s"
    if ending is None:
        yield _missing(record, check, limit)
        return
    if ending.stop is not None and not ending.stop.success:
        return
    if ending.reported is not None:
        good = ending.reported <= _REPORT
        yield _judged(check, good, f"after {ending.reported:.3f} s", limit)
    elif record.faults:
        # Statuses that were in ERROR before do not count, so this fault may be among them.
        yield _judged(check, None, f"there was a fault before: {record.faults[0]}", limit)
    else:
        yield _judged(check, False, "none", limit)
    if ending.ended is not None:
        yield _judge_end(record, of, ending.ended)
    if of != "second publisher":
        yield _judge_latch(record, of, ending)
    call = ending.reset
    refused = "no answer" if call.success is None else f"refused: {call.message}"
    granted = "granted" if call.success else refused
    yield _judged(f"{of}: reset", bool(call.success), granted, "granted under zero torque")


def _judge_end(record: Record, of: str, ended: Push) -> Finding:
    """Compare the return of the joint with that after a push that a zero command ended."""
    usual, check = record.moves.pushes[ended.joint], f"{of}: torque"
    if abs(usual.back) <= usual.still[usual.joint]:
        return _judged(check, None, f"no effect: {_LARGER}", _GONE_LIMIT)
    share = ended.back / usual.back
    figure = f"{100 * share:.0f} % of the usual way back"
    return _judged(check, share >= 1.0 - _USUAL, figure, _GONE_LIMIT)


def _judge_latch(record: Record, of: str, ending: Ending) -> Finding:
    """Compare a push that must have no effect with the first push of the same joint."""
    again, check = ending.again, f"{of}: latched"
    if again is None:
        return Finding(check, Outcome.NOT_CHECKED, "no torque was there: --move", _LATCH_LIMIT)
    usual = record.moves.pushes[again.joint]
    moved = abs(float(usual.moved[again.joint]))
    if moved <= usual.still[again.joint]:
        return _judged(check, None, f"no effect: {_LARGER}", _LATCH_LIMIT)
    share = abs(float(again.moved[again.joint])) / moved
    return _judged(check, share <= _USUAL, f"{100 * share:.0f} % of the usual motion", _LATCH_LIMIT)
