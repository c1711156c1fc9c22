"""Judgement of what the sensor messages say: joints, fields, numbers and units."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from armimp_bringup.driver_check.findings import Finding, judged, not_checked
from armimp_bringup.driver_check.limits import Limits
from armimp_bringup.driver_check.samples import SENSOR_TOPICS, Message, Record
from armimp_common.topics import JOINT_STATES, VALUE_FIELD

_UNIT = {"position": "rad", "effort": "N·m"}


def judge_streams(record: Record, limits: Limits) -> Iterator[Finding]:
    """Judge the content of both sensor streams."""
    for topic in SENSOR_TOPICS:
        messages = record.streams.get(topic, ())
        broken = record.malformed.get(topic, 0)
        figure = f"{len(messages)}" + (f", and {broken} that cannot be decoded" if broken else "")
        enough = len(messages) >= limits.least and not broken
        yield judged(f"{topic}: messages", enough, figure, f"≥ {limits.least}, all decodable")
        if messages:
            yield from _judge_joints(record, topic, messages)
            yield from _judge_values(record, topic, messages, limits)


def values_in_order(
    joints: Sequence[str], topic: str, messages: Sequence[Message]
) -> NDArray[np.float64]:
    """Return the readings (n, N) of a stream by expected joint, of whole messages only.

    A message is whole if it has the expected joints and as many values.
    """
    field = VALUE_FIELD[topic]
    columns: list[list[float]] = []
    places: dict[tuple[str, ...], list[int]] = {}
    for message in messages:
        values: tuple[float, ...] = getattr(message, field)
        if sorted(message.names) != sorted(joints) or len(values) != len(joints):
            continue
        place = places.get(message.names)
        if place is None:
            place = places[message.names] = [message.names.index(joint) for joint in joints]
        columns.append([values[i] for i in place])
    readings: NDArray[np.float64] = np.array(columns).reshape(-1, len(joints)).T
    return readings


def _judge_joints(record: Record, topic: str, messages: Sequence[Message]) -> Iterator[Finding]:
    expected = record.joints
    orders = sorted({message.names for message in messages})
    shown = " / ".join(", ".join(names) or "none" for names in orders[:3])
    right = all(sorted(names) == sorted(expected) for names in orders)
    yield judged(f"{topic}: joint names", right, shown, f"{', '.join(expected)}, each once")
    limit = f"{', '.join(expected)}, as in the commands"
    if right and orders != [expected]:
        # Allowed, as joints are matched by name; yet the usual sign of commands mixed up, too.
        reason = f"{shown}: allowed in messages"
        if record.pushes:
            yield judged(f"{topic}: joint order", True, f"{reason}; commands, see below", limit)
        else:
            yield not_checked(f"{topic}: joint order", f"{reason}; of commands: --move", limit)
    elif right:
        yield judged(f"{topic}: joint order", True, shown, limit)
    else:
        yield not_checked(f"{topic}: joint order", "the names are wrong", limit)

    field = VALUE_FIELD[topic]
    lengths = sorted({(len(message.position), len(message.effort)) for message in messages})
    figure = "; ".join(f"{a} in position, {b} in effort" for a, b in lengths[:3])
    index = ("position", "effort").index(field)
    good = all(pair[index] == len(expected) for pair in lengths)
    yield judged(f"{topic}: field", good, figure, f"{len(expected)} in {field}")


def _judge_values(
    record: Record, topic: str, messages: Sequence[Message], limits: Limits
) -> Iterator[Finding]:
    unit = _UNIT[VALUE_FIELD[topic]]
    angles = topic == JOINT_STATES
    finite_limit = "no NaN, no infinity"
    readings = values_in_order(record.joints, topic, messages)
    # Of numbers in the wrong place at least that can be said.
    numbers = [v for m in messages for v in (*m.position, *m.effort)] if not readings.size else []
    moving = values_in_order(record.joints, topic, record.moving.get(topic, ()))
    everything = np.hstack([readings.ravel() if readings.size else numbers, moving.ravel()])
    bad = int(np.sum(~np.isfinite(everything)))
    yield judged(f"{topic}: finite", bad == 0, f"{bad} of {everything.size} are not", finite_limit)
    bound = limits.angle if angles else limits.torque
    limit = f"|value| ≤ {bound:.4g} {unit}"
    if not readings.size:
        yield not_checked(f"{topic}: range", "no whole message", limit)
        return
    still, moved = (np.where(np.isfinite(part), part, 0.0) for part in (readings, moving))
    sound = np.hstack([still, moved])
    largest = float(np.max(np.abs(sound)))
    hint = " (degrees?)" if angles else " (N·mm?)"
    figure = f"{largest:.4g} {unit}"
    yield judged(
        f"{topic}: range", largest <= bound, figure + (hint if largest > bound else ""), limit
    )
    if angles:
        # Between the two parts of the recording samples are missing.
        jump = max(
            float(np.max(np.abs(np.diff(part, axis=1)), initial=0.0)) for part in (still, moved)
        )
        limit = f"≤ {limits.step:g} rad from one sample to the next"
        yield judged(f"{topic}: jumps", jump <= limits.step, f"{jump:.3g} rad", limit)
    coarsest = limits.encoder if angles else limits.transducer
    limit = f"≤ {coarsest:.4g} {unit}, the coarsest of the study"
    found = resolution(sound)
    if found is None:
        reason = "readings do not change" + ("" if not angles else ": move the arm, or --move")
        yield not_checked(f"{topic}: resolution", reason, limit)
        return
    step, certain = found
    good = step <= 1.01 * coarsest
    if not good and not certain:
        yield not_checked(f"{topic}: resolution", "too few readings that differ", limit)
    else:
        yield judged(f"{topic}: resolution", good, f"{step:.4g} {unit}", limit)


def resolution(readings: NDArray[np.float64]) -> tuple[float, bool] | None:
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
    for row in readings:
        levels = np.unique(row)
        gaps = np.diff(levels)
        # Levels of one grid differ in the last bits.
        gaps = gaps[gaps > 1e-9 * max(float(np.max(np.abs(levels))), 1e-3)]
        if gaps.size:
            step = float(np.min(gaps))
            ratios = gaps / step
            steps.append((step, float(np.max(np.abs(ratios - np.rint(ratios)))) < 0.1))
    return max(steps, default=None)
