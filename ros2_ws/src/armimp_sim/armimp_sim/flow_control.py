"""Flow control in lockstep: the simulator waits for a recorder that falls behind.

Nothing else in lockstep has a pace of its own, so without this a recorder on a loaded machine would
lose samples once the queues are full.
"""

from __future__ import annotations

from armimp_common.topics import RECORDER_GONE

LIMIT = 45
"""Samples that may be under way to the recorder.

They are lost if it is killed, and so is what it has not yet written, at most 50 ms of samples:
together less than 100 ms. Their messages, four each, also fit the receive buffer of a socket: the
kernel takes 1.3 KiB for one, and grants at least 416 KiB by default. What does not fit is lost by
the transport, and a writer that waits repairs that only with its next heartbeat.
"""


class FlowControl:
    """Number of samples that a recorder has still to receive.

    A recorder tells how many samples it has received since it began; 0 announces it, and
    :data:`armimp_common.topics.RECORDER_GONE` takes leave. Without a recorder nothing waits.

    Attributes
    ----------
    silent : whether the recorder gives no sign of life, so that the next sample waits in any case
    """

    def __init__(self) -> None:
        self._sent = self._base = self._received = 0
        self._recorder = False
        self.silent = False

    def count_sent(self) -> None:
        """One more sample is under way."""
        self._sent += 1

    def acknowledge(self, received: int) -> None:
        """Take what the recorder tells."""
        if received == 0:
            self._base = self._sent
        elif received < self._received < RECORDER_GONE:
            return  # of somebody else: a recorder does not forget what it has received
        self._recorder = received != RECORDER_GONE
        self._received = received

    @property
    def recorded(self) -> bool:
        """Whether there is a recorder that has not taken leave."""
        return self._recorder

    @property
    def full(self) -> bool:
        """Whether the next sample has to wait."""
        under_way = self._sent - self._base - self._received
        return self._recorder and (self.silent or under_way >= LIMIT)
