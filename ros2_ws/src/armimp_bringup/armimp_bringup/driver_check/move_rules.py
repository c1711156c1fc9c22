"""Judgement of what a driver does with torque: the joint, the sign, the delay, and the end."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from armimp_bringup.driver_check.findings import Finding, inconclusive, judged, not_checked
from armimp_bringup.driver_check.limits import Limits
from armimp_bringup.driver_check.responses import (
    Letting,
    displacement,
    first_effect,
    letting,
    threshold,
)
from armimp_bringup.driver_check.samples import Ending, Record
from armimp_common import topics
from armimp_common.topics import NS_PER_S, PERIOD_NS

_STALE = "stale commands"
_STOP = "emergency stop"
_SECOND = "second publisher"
_PERIOD = PERIOD_NS / NS_PER_S
_LEAST = 0.35
"""Share of the usual motion that counts as one."""


def judge_moves(record: Record, limits: Limits) -> Iterator[Finding]:
    """Judge the answers to torque, to its absence, and to the emergency stop."""
    yield _judge_motion(record)
    yield _judge_obedience(record)
    yield from _judge_pushes(record, limits)
    limit = _ending_limit(limits)
    if record.stale is None:
        waits = "" if record.paced else "in lockstep time stands still without commands"
        yield not_checked(_STALE, waits, limit) if waits else _missing(record, _STALE, limit)
    else:
        yield from _judge_end(_STALE, record, record.stale, limits)
        yield _judge_latch(record.stale)
    if record.stop is None:
        yield _missing(record, _STOP, limit)
    else:
        yield from _judge_stop(record, record.stop, limits)
    if record.second is None:
        yield _missing(record, f"{_SECOND}: told", _told_limit(limits))
    else:
        yield from _judge_told(_SECOND, record, record.second, limits)


def _missing(record: Record, check: str, limit: str) -> Finding:
    """Return the finding for something that was not done: why, and whether it was asked for."""
    if record.broken:
        return inconclusive(check, f"given up: {record.broken}", limit)
    if record.troubled:
        return inconclusive(check, record.skipped, limit)
    return not_checked(check, record.skipped or "not tried", limit)


def _judge_motion(record: Record) -> Finding:
    check, limit = "torque: motion", f"≤ {record.most:g} rad from where each joint was"
    if record.moved is None:
        return _missing(record, check, limit)
    # Nothing else gives up while the driver goes on obeying.
    if record.broken and not record.stopped and "torque taken away" in record.broken:
        return judged(check, False, record.broken, limit)
    return judged(check, True, f"{record.moved:.3g} rad", limit)


def _judge_obedience(record: Record) -> Finding:
    check, limit = "torque: no stop", "no fault while commands come as they should"
    if record.stopped:
        return judged(check, False, record.stopped, limit)
    if record.moved is None or record.broken:
        return _missing(record, check, limit)
    figure = "none"
    if record.repeated:
        figure += (
            f"; {record.repeated} repeated, as commands came up to {1e3 * record.gap:.3g} ms apart"
        )
    return judged(check, True, figure, limit)


def _judge_latch(ending: Ending) -> Finding:
    check, limit = f"{_STALE}: latched", "no torque before the reset, whatever is commanded"
    if ending.again is None or ending.push is None:
        return not_checked(check, "not tried", limit)
    joint = ending.again.joint
    seen = float(np.abs(displacement(ending.again)[joint]))
    usual = float(np.abs(displacement(ending.push)[joint]))
    if usual <= threshold(ending.push.position, ending.push.on)[joint]:
        return inconclusive(check, "the torque had no effect: try a larger --torque", limit)
    share = seen / usual
    return judged(check, share <= _LEAST, f"{100 * share:.0f} % of the usual motion", limit)


def _judge_pushes(record: Record, limits: Limits) -> Iterator[Finding]:
    limit = "each joint turns the way of its torque"
    sign_limit = "the reading of torque goes the way of the joint"
    delay_limit = f"≤ {limits.reaction} periods from command to effect"
    if not record.pushes:
        yield _missing(record, "torque: joint and sign", limit)
        yield _missing(record, "torque_sensors: sign", sign_limit)
        yield _missing(record, "torque: delay", delay_limit)
        return
    ways = _ways(record)
    yield _judge_directions(record, ways, limit)
    if ways.mixed:
        reason = "torque acts on another joint"
        yield inconclusive("torque_sensors: sign", reason, sign_limit)
        yield inconclusive("torque: delay", reason, delay_limit)
        return
    answers = [first_effect(push) for push in record.pushes]
    seen = [answer for answer in answers if answer is not None]
    if len(seen) < len(answers):
        reason = "readings of torque do not answer: try a larger --torque"
        yield inconclusive("torque_sensors: sign", reason, sign_limit)
    else:
        changes = [
            change * sign * float(np.sign(push.torque))
            for (_, change), sign, push in zip(seen, ways.signs, record.pushes, strict=True)
        ]
        figure = ", ".join(
            f"{record.joints[push.joint]} {change:+.3g} N·m"
            for push, change in zip(record.pushes, changes, strict=True)
        )
        yield judged("torque_sensors: sign", min(changes) > 0.0, figure, sign_limit)
    if seen:
        worst = max(samples for samples, _ in seen)
        figure = f"{worst} periods"
        yield judged("torque: delay", worst <= limits.reaction, figure, delay_limit)
    else:
        yield inconclusive("torque: delay", "readings of torque do not answer", delay_limit)


@dataclass(frozen=True, kw_only=True)
class _Ways:
    """Which way joints turned under torque.

    Attributes
    ----------
    angles : motion of the pushed joint in each push, rad
    signs : 1, or -1 where that is clearly against the torque
    still : joints that did not move, though nothing else did
    mixed : what is mixed up
    """

    angles: tuple[float, ...]
    signs: tuple[float, ...]
    still: tuple[str, ...]
    mixed: tuple[str, ...]


def _ways(record: Record) -> _Ways:
    moved = np.array([displacement(push) / push.torque for push in record.pushes]).T
    clear = np.array([threshold(p.position, p.on) / abs(p.torque) for p in record.pushes]).T
    order = [push.joint for push in record.pushes]
    columns = range(len(order))
    own = np.array([moved[joint, column] for column, joint in enumerate(order)])
    own_clear = np.array([clear[joint, column] for column, joint in enumerate(order)])
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
    return _Ways(
        angles=tuple((own * [push.torque for push in record.pushes]).tolist()),
        signs=tuple(signs.tolist()),
        still=tuple(names[a] for a in columns if not moving[a]),
        mixed=tuple(mixed),
    )


def _judge_directions(record: Record, ways: _Ways, limit: str) -> Finding:
    check = "torque: joint and sign"
    names = [record.joints[push.joint] for push in record.pushes]
    wrong = ways.mixed or tuple(
        f"{name} turns against its torque"
        for name, sign in zip(names, ways.signs, strict=True)
        if sign < 0.0
    )
    if wrong:
        return judged(check, False, "; ".join(wrong), limit)
    if ways.still:
        reason = f"{' and '.join(ways.still)} did not move: try a larger --torque"
        return inconclusive(check, reason, limit)
    figure = ", ".join(
        f"{name} {angle:+.3g} rad at {push.torque:+g} N·m"
        for name, angle, push in zip(names, ways.angles, record.pushes, strict=True)
    )
    return judged(check, True, figure, limit)


def _judge_stop(record: Record, ending: Ending, limits: Limits) -> Iterator[Finding]:
    call, limit = ending.stop, f"success within {limits.answer:g} s"
    check = f"{_STOP}: answer"
    if call is None or call.success is None:
        yield judged(check, False, "no answer", limit)
        return
    figure = f"{'success' if call.success else f'refused: {call.message}'}, {call.seconds:.3f} s"
    yield judged(check, call.success and call.seconds <= limits.answer, figure, limit)
    yield from _judge_end(_STOP, record, ending, limits)


def _judge_end(check: str, record: Record, ending: Ending, limits: Limits) -> Iterator[Finding]:
    limit = _ending_limit(limits)
    if ending.push is None or ending.released is None or ending.held is None:
        if record.troubled:
            yield _missing(record, check, limit)
        else:
            yield not_checked(check, "no torque was there: --move", limit)
    else:
        found = letting(ending.push, ending.released, ending.held)
        yield _judge_letting(check, found, limits, limit)
    yield from _judge_told(check, record, ending, limits)


def _told_limit(limits: Limits) -> str:
    return f"status ERROR on {topics.DIAGNOSTICS} within {limits.told:g} s"


def _judge_told(check: str, record: Record, ending: Ending, limits: Limits) -> Iterator[Finding]:
    limit = _told_limit(limits)
    told = ending.told
    if told is None and record.faults:
        # That would go on, whatever the driver has to say.
        yield inconclusive(f"{check}: told", f"there was a fault before: {record.faults[0]}", limit)
    else:
        figure = "none" if told is None else f"after {told:.3f} s"
        yield judged(f"{check}: told", told is not None and told <= limits.told, figure, limit)
    limit = "granted under zero torque"
    reset = ending.reset
    if reset is None or reset.success is None:
        yield judged(f"{check}: reset", False, "no answer", limit)
    else:
        figure = "granted" if reset.success else f"refused: {reset.message}"
        yield judged(f"{check}: reset", reset.success, figure, limit)


def _ending_limit(limits: Limits) -> str:
    return f"torque gone within {1e3 * limits.ending:g} ms (± {1e3 * limits.blur:g} ms)"


def _judge_letting(check: str, found: Letting | None, limits: Limits, limit: str) -> Finding:
    if found is None:
        return inconclusive(check, "the torque had no effect: try a larger --torque", limit)
    if found.share < limits.share:
        figure = f"{100 * max(1 - found.share, 0):.0f} % of the torque seems to stay"
        return judged(check, False, figure, limit)
    delay = found.delay * _PERIOD
    good = delay <= limits.ending + limits.blur
    return judged(check, good, f"after about {1e3 * delay:.0f} ms", limit)
