"""Heartbeats: how a process learns that another one has died.

Each node offers a latched topic of its own, with the identity of its process. A thread of the
middleware keeps the publisher alive as long as the process runs, so neither a busy callback nor a
held interpreter lock looks like a death. Data topics have no lease, since a reader that asks for
one refuses every publisher that does not offer one, and few drivers do.

A process of the same machine is also looked up, every 20 ms. So its death or stop is soon known,
even if the middleware of the other processes is held up; and a process that is only silent, on a
busy machine, does not count as dead. The lease is for processes of other machines, and long: see
:data:`armimp_common.qos.OFFERED_LEASE_MS`.

A process does not watch itself: the middleware lets the lease between two nodes of one process
expire without a cause, and then never renews it.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from enum import Enum

from rclpy.event_handler import QoSLivelinessChangedInfo, SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.publisher import Publisher
from std_msgs.msg import String

from armimp_common import qos, topics
from armimp_common.executor import steady_timer
from armimp_common.process import STOPPED, identity, state_of

_CHECK_PERIOD = 0.02


class Presence(Enum):
    """What is known of a node; the value completes a sentence that begins with its name."""

    UNKNOWN = "has never been heard of"
    ALIVE = "is alive"
    STALLED = "gives no sign of life, but its process is there"
    SILENT = f"gave no sign of life for {qos.WATCHED_LEASE_MS / 1e3:g} s: it is dead or stopped"
    GONE = "is dead"
    LEFT = "has left"

    @property
    def gone(self) -> bool:
        """Whether the node has certainly ended."""
        return self in (Presence.GONE, Presence.LEFT)

    @property
    def silent(self) -> bool:
        """Whether the node gives no sign of life now, and may still be there."""
        return self in (Presence.STALLED, Presence.SILENT)

    @property
    def lost(self) -> bool:
        """Whether the node was there and, as far as can be known, no longer is."""
        return self.gone or self is Presence.SILENT

    def after(self, alive: int, silent: int, process_lives: bool | None = None) -> Presence:
        """Return the presence that follows from the latest observations.

        Parameters
        ----------
        alive, silent : numbers of publishers whose lease is renewed, and of those whose lease has
            run out
        process_lives : whether the process of the node exists; None if that is not known
        """
        if alive or silent:
            if process_lives is False:
                return Presence.GONE
            if alive:
                return Presence.ALIVE
            return Presence.STALLED if process_lives else Presence.SILENT
        if self.gone or self is Presence.UNKNOWN:
            return self
        # The middleware forgets a silent publisher when the lease of its process expires.
        return Presence.LEFT if self is Presence.ALIVE else Presence.GONE


def offer_heartbeat(node: Node, name: str) -> Publisher:
    """Offer the heartbeat of the process that `node` is in, for as long as the publisher exists.

    Parameters
    ----------
    node : holds the publisher; its namespace applies
    name : name within the topic, which remapping of the node's own name does not change
    """
    publisher = node.create_publisher(String, topics.alive(name), qos.ALIVE)
    publisher.publish(String(data=identity()))
    return publisher


class HeartbeatMonitor:
    """Listens to the heartbeat of another node, for as long as `node` exists.

    Parameters
    ----------
    node : the node that listens; callbacks run in its executor
    name : name of the other node, as for `offer_heartbeat`
    on_change : called with the monitor when `presence` has changed

    Attributes
    ----------
    presence : latest known presence; it stays UNKNOWN for a node that offers no heartbeat
    checked : when the process was last looked up (monotonic, s)
    """

    def __init__(
        self, node: Node, name: str, on_change: Callable[[HeartbeatMonitor], None]
    ) -> None:
        self.name = name
        self.presence = Presence.UNKNOWN
        self.checked = time.monotonic()
        self._on_change = on_change
        self._alive = self._silent = 0
        self._process, self._own_process = "", identity()
        self.subscription = node.create_subscription(
            String,
            topics.alive(name),
            self._on_identity,
            qos.ALIVE_WATCHED,
            event_callbacks=SubscriptionEventCallbacks(liveliness=self._on_event),
        )
        self._timer = steady_timer(node, _CHECK_PERIOD, self.check, autostart=False)

    @property
    def sentence(self) -> str:
        """What is known of the node, in words."""
        return f"{self.name} {self.presence.value}"

    @property
    def ghost(self) -> bool:
        """Whether the node is lost but still listed, so that its topics seem to be there."""
        return self.presence.lost and self._alive + self._silent > 0

    def _on_identity(self, message: String) -> None:
        # Others may publish here too: what cannot be looked up replaces no process that is there.
        if state_of(message.data) is not None or not state_of(self._process):
            self._process = message.data
        self.check()

    def _on_event(self, event: QoSLivelinessChangedInfo) -> None:
        # Within one process, the middleware may count below zero.
        self._alive, self._silent = max(event.alive_count, 0), event.not_alive_count
        self.check()

    def check(self) -> None:
        """Look up the process, and call back if its presence has changed."""
        self.checked = time.monotonic()
        alive, silent = self._alive, self._silent
        process_lives = None
        if self._process and self._process == self._own_process:
            alive, silent = alive + silent, 0
        elif alive or silent:
            state = state_of(self._process)
            process_lives = None if state is None else state != ""
            if state in STOPPED:
                alive, silent = 0, alive + silent
        presence = self.presence.after(alive, silent, process_lives)
        if not process_lives:
            self._timer.cancel()
        elif self._timer.is_canceled():
            self._timer.reset()
        if presence is not self.presence:
            self.presence = presence
            self._on_change(self)
