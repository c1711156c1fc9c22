"""Heartbeats: what is known of a watched node, and how soon a dead process is noticed."""

import signal
import subprocess

import pytest
from rclpy.node import Node
from std_msgs.msg import String

from armimp_common import qos
from armimp_common.executor import Spinner
from armimp_common.heartbeat import HeartbeatMonitor, Presence, offer_heartbeat
from support.graph import eventually, report


def introduced(watch: HeartbeatMonitor, changes: list[Presence]) -> bool:
    """Whether the other node is known to be alive, and its process is identified."""
    known = watch.presence is Presence.ALIVE and watch._process != ""
    if known:
        # A busy machine may hold up the first messages for longer than the lease.
        changes[:] = [Presence.ALIVE]
    return known


@pytest.fixture
def changes() -> list[Presence]:
    return []


@pytest.fixture
def watch(node: Node, changes: list[Presence], monkeypatch: pytest.MonkeyPatch) -> HeartbeatMonitor:
    # On a busy machine it may take long until all is heard that precedes the end of the lease.
    monkeypatch.setattr(qos, "ALIVE_WATCHED", qos._alive(60_000))
    return HeartbeatMonitor(node, "other", lambda watch: changes.append(watch.presence))


@pytest.mark.parametrize(
    ("before", "alive", "silent", "lives", "after"),
    [
        (Presence.UNKNOWN, 0, 0, None, Presence.UNKNOWN),
        (Presence.UNKNOWN, 1, 0, None, Presence.ALIVE),
        (Presence.ALIVE, 0, 1, None, Presence.SILENT),
        (Presence.ALIVE, 0, 0, None, Presence.LEFT),
        (Presence.ALIVE, 1, 1, None, Presence.ALIVE),
        (Presence.SILENT, 1, 0, None, Presence.ALIVE),
        (Presence.SILENT, 0, 0, None, Presence.GONE),
        (Presence.GONE, 0, 0, None, Presence.GONE),
        (Presence.GONE, 1, 0, None, Presence.ALIVE),
        (Presence.LEFT, 1, 0, None, Presence.ALIVE),
        (Presence.LEFT, 0, 0, None, Presence.LEFT),
        # A silent process counts as what a look at the process tells,
        (Presence.ALIVE, 0, 1, True, Presence.STALLED),
        (Presence.STALLED, 0, 1, True, Presence.STALLED),
        (Presence.ALIVE, 0, 1, False, Presence.GONE),
        (Presence.STALLED, 0, 1, None, Presence.SILENT),
        (Presence.LEFT, 0, 0, False, Presence.LEFT),
        # and one that is not found any more is dead, even before its lease has run out.
        (Presence.ALIVE, 1, 0, True, Presence.ALIVE),
        (Presence.ALIVE, 1, 0, False, Presence.GONE),
        (Presence.ALIVE, 1, 1, False, Presence.GONE),
    ],
)
def test_what_is_known_follows_from_numbers_of_publishers_and_a_look_at_the_process(
    before: Presence, alive: int, silent: int, lives: bool | None, after: Presence
) -> None:
    assert before.after(alive, silent, lives) is after


def test_when_a_process_is_stopped_for_a_moment_expect_it_stalled_and_alive_again(
    watch: HeartbeatMonitor,
    spinner: Spinner,
    changes: list[Presence],
    other: "subprocess.Popen[bytes]",
) -> None:
    eventually(spinner, lambda: introduced(watch, changes), "a sign of life")
    other.send_signal(signal.SIGSTOP)
    eventually(spinner, lambda: changes[-1] is Presence.STALLED, "silence")
    other.send_signal(signal.SIGCONT)
    eventually(spinner, lambda: changes[-1] is Presence.ALIVE, "a sign of life")


def test_when_the_lease_of_a_node_of_this_process_runs_out_expect_it_alive_whatever_others_say(
    node: Node, watch: HeartbeatMonitor, spinner: Spinner, changes: list[Presence]
) -> None:
    publisher = offer_heartbeat(node, "other")
    eventually(spinner, lambda: introduced(watch, changes), "a sign of life")
    watch._on_identity(String(data="what a stranger says"))
    report(watch, alive=0, silent=1)
    assert watch.presence is Presence.ALIVE

    node.destroy_publisher(publisher)
    eventually(spinner, lambda: watch.presence is Presence.LEFT, "the end")
