"""Judgement of time: stamps, pairs, rate, jitter, and what the driver reports itself."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from armimp_bringup.driver_check.findings import Finding, inconclusive, judged, not_checked
from armimp_bringup.driver_check.limits import Limits
from armimp_bringup.driver_check.samples import SENSOR_TOPICS, Message, Record
from armimp_bringup.driver_check.witness import Stalls
from armimp_common.topics import JOINT_STATES, NS_PER_S, PERIOD_NS


def judge_timing(record: Record, limits: Limits) -> Iterator[Finding]:
    """Judge the timing of both sensor streams, and of them together."""
    for topic in SENSOR_TOPICS:
        messages = record.streams.get(topic, ())
        if len(messages) >= 2:
            yield from _judge_stamps(topic, messages, limits)
            if record.paced:
                yield from _judge_pace(record, topic, messages, limits)
            else:
                extra = len(messages) - record.answered
                limit = "one for each command, and the first"
                figure = f"{len(messages)} for {record.answered} commands"
                yield judged(f"{topic}: rate", 0 <= extra <= 1, figure, limit)
                reason = "in lockstep there is no clock"
                yield not_checked(f"{topic}: jitter", reason, _late_limit(limits))
    yield _judge_pairs(record)
    limit = f"99 % ≤ {1e3 * limits.latency:g} ms, as arm_sim: timing reports it"
    if record.timing is None or not record.timing.latency_p99 > 0.0:
        yield not_checked("sample to command", "the driver does not report it", limit)
    else:
        latency = record.timing.latency_p99
        figure = f"99 %: {1e3 * latency:.3g} ms"
        # Part of the way is the checker's own.
        busy = max(record.stalls.share, _waited(record) / _length(record)) > limits.late_share
        if not latency <= limits.latency and busy:
            yield inconclusive("sample to command", figure + _held_up(record.stalls), limit)
        else:
            yield judged("sample to command", latency <= limits.latency, figure, limit)


def _judge_stamps(topic: str, messages: Sequence[Message], limits: Limits) -> Iterator[Finding]:
    stamps = np.array([message.stamp_ns for message in messages], dtype=np.int64)
    # The moment of arrival is no part of what a message says.
    copies = Counter((m.stamp_ns, m.names, m.position, m.effort) for m in messages)
    doubled = sum(count - 1 for count in copies.values())
    yield judged(f"{topic}: doubled samples", doubled == 0, f"{doubled}", "none")
    steps = np.diff(stamps)
    still, back = int(np.sum(steps == 0)), int(np.sum(steps < 0))
    figure = f"{still} repeat, {back} go back"
    yield judged(f"{topic}: stamps increase", still == back == 0, figure, "none repeats, goes back")
    off = np.rint(steps / PERIOD_NS) != 1
    longest = float(np.max(np.abs(steps))) / 1e6
    figure = f"{int(np.sum(off))} of {steps.size} are not; longest {longest:.4g} ms"
    yield judged(f"{topic}: stamps 1 ms apart", not np.any(off), figure, "all, within half of that")
    mean = float(stamps[-1] - stamps[0]) / steps.size / PERIOD_NS
    limit = f"1 ms ± {100 * limits.clock:g} %"
    yield judged(f"{topic}: clock", abs(mean - 1.0) <= limits.clock, f"{mean:.6f} ms", limit)


def _judge_pace(
    record: Record, topic: str, messages: Sequence[Message], limits: Limits
) -> Iterator[Finding]:
    stalls = record.stalls
    arrivals = np.array([message.arrival_ns for message in messages], dtype=np.int64)
    period = beat(arrivals)
    rate = 1.0 / period if period > 0.0 else 0.0
    nominal = NS_PER_S / PERIOD_NS
    limit = f"{nominal:g} Hz ± {100 * limits.rate:g} %"
    error = abs(rate / nominal - 1.0)
    # So much can stalls at both ends of the recording make of it.
    doubt = 2.0 * stalls.longest / max(period * arrivals.size, limits.late)
    if limits.rate < error <= limits.rate + doubt:
        yield inconclusive(f"{topic}: rate", f"{rate:.1f} Hz" + _held_up(stalls), limit)
    else:
        yield judged(f"{topic}: rate", error <= limits.rate, f"{rate:.1f} Hz", limit)
    delay = lateness(arrivals)
    late = delay > limits.late
    share, worst = float(np.mean(late)), 1e3 * float(np.max(delay))
    rest = late & ~record.stalls.excuse(arrivals, delay)
    own = float(np.mean(rest))
    figure = f"{100 * share:.3g} %; worst {worst:.3g} ms"
    check, limit = f"{topic}: jitter", _late_limit(limits)
    if share > limits.late_share >= own:
        figure += f"; but for {100 * own:.3g} % of all, this process was held up itself"
        yield inconclusive(check, figure, limit)
    elif own > limits.late_share and _waited(record) >= 0.5 * float(np.sum(delay[rest])):
        figure += f"; the driver's process waited {1e3 * _waited(record):.3g} ms for a processor"
        yield inconclusive(check, figure, limit)
    else:
        yield judged(check, share <= limits.late_share, figure, limit)


def _length(record: Record) -> float:
    """Length of the recording at rest, s."""
    kept = record.streams.get(JOINT_STATES, ())
    return max(kept[-1].arrival_ns - kept[0].arrival_ns, PERIOD_NS) / NS_PER_S if kept else 1.0


def _waited(record: Record) -> float:
    return record.waited or 0.0


def _held_up(stalls: Stalls) -> str:
    return f"; this process was held up itself, by up to {1e3 * stalls.longest:.3g} ms"


def _late_limit(limits: Limits) -> str:
    return f"≤ {100 * limits.late_share:g} % arrive more than {1e3 * limits.late:g} ms late"


def beat(arrivals_ns: NDArray[np.int64]) -> float:
    """Mean period of arrivals (N,), s, whatever held some of them up.

    Taken between the medians of the first and of the last tenth.
    """
    part = max(arrivals_ns.size // 10, 1)
    count = arrivals_ns.size - part
    ends = (
        np.median(arrivals_ns[-part:] - arrivals_ns[0]),
        np.median(arrivals_ns[:part] - arrivals_ns[0]),
    )
    return float(ends[0] - ends[1]) / NS_PER_S / max(count, 1)


def lateness(arrivals_ns: NDArray[np.int64]) -> NDArray[np.float64]:
    """Delay (N,) of each arrival, s, against a regular beat with their own mean rate.

    The beat is laid through the median, so that half of the arrivals are late, by little if all is
    well. A message that was held up does not move it.
    """
    seconds = (arrivals_ns - arrivals_ns[0]) / NS_PER_S
    offset = seconds - beat(arrivals_ns) * np.arange(seconds.size)
    delay: NDArray[np.float64] = offset - np.median(offset)
    return delay


def _judge_pairs(record: Record) -> Finding:
    sets = [{m.stamp_ns for m in record.streams.get(topic, ())} for topic in SENSOR_TOPICS]
    limit = "both streams have the same stamps"
    if not all(sets):
        return judged("pairs", False, "a stream is missing", limit)
    # A recording may begin and end between the two messages of a sample.
    first, last = max(map(min, sets)), min(map(max, sets))
    within = [{stamp for stamp in stamps if first <= stamp <= last} for stamps in sets]
    alone = len(within[0] ^ within[1]) if all(within) else len(sets[0] | sets[1])
    return judged("pairs", alone == 0, f"{alone} readings without a partner", limit)
