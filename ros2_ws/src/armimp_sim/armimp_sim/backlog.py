"""Flow control in lockstep: the simulator waits for a recorder that falls behind.

Nothing else in lockstep has a pace of its own, so without this a recorder on a loaded machine would
lose samples once the queues are full.
"""

from __future__ import annotations

from armimp_common.contract import RECORDER_GONE

LIMIT = 100
"""Samples that may be under way to the recorder.

Their 400 messages fit the 512 places of a shared-memory port of Fast DDS. What does not fit is lost
by the transport, and a writer that waits repairs that only with its next heartbeat, seconds later.
"""


class Backlog:
    """Number of samples that a recorder has still to receive.

    A recorder tells how many samples it has received since it began; 0 announces it, and
    :data:`armimp_common.contract.RECORDER_GONE` takes leave. Without a recorder nothing waits.
    """

    def __init__(self) -> None:
        self._sent = self._base = self._received = 0
        self._recorder = False

    def count_sent(self) -> None:
        """One more sample is under way."""
        self._sent += 1

    def acknowledge(self, received: int) -> None:
        """Take what the recorder tells."""
        if received == 0:
            self._base = self._sent
        self._recorder = received != RECORDER_GONE
        self._received = received

    @property
    def full(self) -> bool:
        """Whether the next sample has to wait."""
        return self._recorder and self._sent - self._base - self._received >= LIMIT
