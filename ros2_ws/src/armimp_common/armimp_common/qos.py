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


PROFILES: Final[dict[str, QoSProfile]] = {
    topic: _profile(offered) for topic, offered in topics.QOS.items()
}
"""The profile of every topic of the contract."""

SAMPLE: Final = _profile(topics.SAMPLE_QOS)
LATCHED: Final = _profile(topics.LATCHED_QOS)
PROGRESS: Final = PROFILES[topics.PROGRESS]
CLOCK: Final = PROFILES[topics.CLOCK]
DIAGNOSTICS: Final = PROFILES[topics.DIAGNOSTICS]

OFFERED_LEASE_MS: Final = 3000
"""Lease of a heartbeat (ms): the middleware renews it after two thirds of that time.

Not shorter. The thread that renews it takes a lock which another thread holds while it forgets a
publisher that has left, and which then waits for the first: if both coincide, the middleware is
locked up for good (as in Fast DDS issue 6502). With a renewal every 20 ms, and a busy machine, this
came once in some forty times that a program joined and left.
"""

WATCHED_LEASE_MS: Final = 6000
"""Silence after which a process counts as dead that cannot be looked up, being elsewhere (ms)."""


def _alive(lease_ms: int) -> QoSProfile:
    profile = _profile(topics.Qos(1, durability="transient_local"))
    profile.liveliness = LivelinessPolicy.AUTOMATIC
    profile.liveliness_lease_duration = Duration(nanoseconds=lease_ms * 1_000_000)
    return profile


ALIVE: Final = _alive(OFFERED_LEASE_MS)
"""Profile of whoever publishes a heartbeat."""

ALIVE_WATCHED: Final = _alive(WATCHED_LEASE_MS)
"""Profile of whoever monitors a heartbeat."""
