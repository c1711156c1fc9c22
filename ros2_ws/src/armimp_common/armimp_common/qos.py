"""Quality-of-service profiles, one for each role that a topic can have."""

from typing import Final

from rclpy.duration import Duration
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    LivelinessPolicy,
    QoSProfile,
    ReliabilityPolicy,
)

from armimp_common import topics


def _profile(offered: topics.Qos) -> QoSProfile:
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=offered.depth,
        reliability=ReliabilityPolicy[offered.reliability.upper()],
        durability=DurabilityPolicy[offered.durability.upper()],
    )


PROFILES: Final = {name: _profile(topic.qos) for name, topic in topics.TOPICS.items()}
"""The profile of each topic of :data:`armimp_common.topics.TOPICS`."""

SAMPLE: Final = PROFILES[topics.JOINT_STATES]
LATCHED: Final = PROFILES[topics.TRIAL]

OFFERED_LEASE_MS: Final = 3000
"""Lease of a heartbeat (ms): the middleware renews it after two thirds of that time.

It must not be shorter. The thread that renews the lease takes a lock that another thread holds
while it removes a publisher that has left, and that other thread waits for the first: if both
coincide, the middleware is deadlocked for good (as in Fast DDS issue 6502). With renewals every
20 ms on a busy machine, this happened about once in forty times that a program joined and left.
"""

WATCHED_LEASE_MS: Final = 6000
"""Silence (ms) after which a process counts as dead if it cannot be looked up from here."""


def _alive(lease_ms: int) -> QoSProfile:
    profile = _profile(topics.Qos(1, durability="transient_local"))
    profile.liveliness = LivelinessPolicy.AUTOMATIC
    profile.liveliness_lease_duration = Duration(nanoseconds=lease_ms * 1_000_000)
    return profile


ALIVE: Final = _alive(OFFERED_LEASE_MS)
"""Profile of the publisher of a heartbeat."""

ALIVE_WATCHED: Final = _alive(WATCHED_LEASE_MS)
"""Profile of the monitors of a heartbeat."""
