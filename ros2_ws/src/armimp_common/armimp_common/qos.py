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


def _profile(depth: int, *, reliable: bool = True, latched: bool = False) -> QoSProfile:
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


SAMPLE: Final = _profile(2000)
"""Data streams: two seconds of depth, since a process that stalls must not lose samples."""

LATCHED: Final = _profile(10, latched=True)
"""Trial status and results: whoever joins late must still learn the last ones."""

PROGRESS: Final = _profile(10)
"""Live progress: for people who look now, of no use later."""

CLOCK: Final = _profile(1, reliable=False)
"""Simulated time: only the newest counts, and a slow reader must not hold the simulator up."""

DIAGNOSTICS: Final = _profile(10)
"""Diagnostics: what diagnostic aggregators expect."""

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
    profile = _profile(1, latched=True)
    profile.liveliness = LivelinessPolicy.AUTOMATIC
    profile.liveliness_lease_duration = Duration(nanoseconds=lease_ms * 1_000_000)
    return profile


ALIVE: Final = _alive(OFFERED_LEASE_MS)
"""Profile of whoever publishes a heartbeat."""

ALIVE_WATCHED: Final = _alive(WATCHED_LEASE_MS)
"""Profile of whoever monitors a heartbeat."""

PROFILES: Final[dict[str, QoSProfile]] = {
    **dict.fromkeys(topics.DATA_STREAMS, SAMPLE),
    topics.TRIAL: LATCHED,
    topics.RESULT: LATCHED,
    topics.RECEIVED: LATCHED,
    topics.STOPPING: LATCHED,
    topics.PROGRESS: PROGRESS,
    topics.CLOCK: CLOCK,
    topics.DIAGNOSTICS: DIAGNOSTICS,
}
"""The profile of every topic of the contract."""
