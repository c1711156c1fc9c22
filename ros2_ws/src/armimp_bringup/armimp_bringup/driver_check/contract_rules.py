"""Judgement of what discovery tells: topics, types, quality of service, services."""

from __future__ import annotations

from collections.abc import Iterator

from armimp_bringup.driver_check.findings import Finding, judged, not_checked
from armimp_bringup.driver_check.samples import SENSOR_TOPICS, Endpoint, Record
from armimp_common import topics

_DEPTH = 2000


def judge_contract(record: Record) -> Iterator[Finding]:
    """Judge the topics and services of a driver."""
    for topic in SENSOR_TOPICS:
        yield from _judge_topic(record, topic, "publisher")
    yield from _judge_topic(record, topics.COMMANDS, "subscriber")
    for service in (topics.SIM_STOP_SERVICE, topics.SIM_RESET_SERVICE):
        there = service in record.services
        yield judged(f"service {service}", there, "there" if there else "missing", "there")
    limit = "lifecycle services, for armimp run --processes external"
    if record.lifecycle is None:
        yield not_checked("lifecycle", "none: nobody can lead this node through its life", limit)
    else:
        yield judged("lifecycle", True, f"was {record.lifecycle}", limit)
    # Whoever says so: armimp run takes it for a problem of the run.
    limit = f"no status ERROR on {topics.DIAGNOSTICS}"
    figure = record.faults[0] if record.faults else "none"
    yield judged("no fault at rest", not record.faults, figure, limit)


def _judge_topic(record: Record, topic: str, role: str) -> Iterator[Finding]:
    found = [end for end in record.endpoints if end.topic == topic and end.role == role]
    kind = topics.MESSAGE_TYPES[topic]
    limit = f"one {role} of {kind}"
    if not found:
        yield judged(f"{topic}: type", False, f"no {role}", limit)
        return
    types = sorted({end.type for end in found})
    one = len(found) == 1 or role == "subscriber"
    nodes = ", ".join(sorted(end.node for end in found))
    figure = ", ".join(types) + (f" from {nodes}" if not one else "")
    yield judged(f"{topic}: type", types == [kind] and one, figure, limit)
    yield _judge_reliability(topic, role, found)
    depths = [end.depth for end in found if end.depth is not None]
    limit = f"depth ≥ {_DEPTH}"
    if depths:
        yield judged(f"{topic}: depth", min(depths) >= _DEPTH, f"depth {min(depths)}", limit)
    else:
        yield not_checked(f"{topic}: depth", "discovery does not tell", limit)


def _judge_reliability(topic: str, role: str, found: list[Endpoint]) -> Finding:
    reliable = all(end.reliable for end in found)
    # A reader that asks for more than volatile refuses the publishers of this project.
    transient = role == "subscriber" and any(end.transient for end in found)
    durability = "transient local" if any(end.transient for end in found) else "volatile"
    figure = f"{'reliable' if reliable else 'best effort'}, {durability}"
    limit = "reliable" + (", volatile" if role == "subscriber" else "")
    return judged(f"{topic}: quality of service", reliable and not transient, figure, limit)
