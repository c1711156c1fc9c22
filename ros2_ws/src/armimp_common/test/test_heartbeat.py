"""Signs of life: what is known of a watched node, and how soon the death of a process is heard."""

import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any

import pytest
from rclpy.node import Node

from armimp_common import qos
from armimp_common.executor import Spinner
from armimp_common.heartbeat import Heartbeat, HeartbeatMonitor, Presence
from support.graph import eventually

OTHER = """
from armimp_common.heartbeat import Heartbeat
from armimp_common.executor import run_node
from rclpy.node import Node

def make(*, context):
    node = Node("other", context=context)
    node.sign = Heartbeat(node, "other")
    return node

raise SystemExit(run_node(make, ["other"]))
"""


@contextmanager
def other_process() -> "Iterator[subprocess.Popen[bytes]]":
    process = subprocess.Popen([sys.executable, "-c", OTHER])
    try:
        yield process
    finally:
        process.kill()
        process.wait()


def introduced(watch: HeartbeatMonitor, changes: list[Presence]) -> bool:
    """Whether the other node is known to live, and its process by name."""
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
    # What is to be heard before the lease runs out takes as long as a busy machine needs.
    monkeypatch.setattr(qos, "ALIVE_WATCHED", qos._alive(60_000))
    return HeartbeatMonitor(node, "other", lambda watch: changes.append(watch.presence))


@pytest.mark.parametrize(
    ("before", "alive", "silent", "after"),
    [
        (Presence.UNKNOWN, 0, 0, Presence.UNKNOWN),
        (Presence.UNKNOWN, 1, 0, Presence.ALIVE),
        (Presence.ALIVE, 0, 1, Presence.SILENT),
        (Presence.ALIVE, 0, 0, Presence.LEFT),
        (Presence.ALIVE, 1, 1, Presence.ALIVE),
        (Presence.SILENT, 1, 0, Presence.ALIVE),
        (Presence.SILENT, 0, 0, Presence.GONE),
        (Presence.GONE, 0, 0, Presence.GONE),
        (Presence.GONE, 1, 0, Presence.ALIVE),
        (Presence.LEFT, 1, 0, Presence.ALIVE),
        (Presence.LEFT, 0, 0, Presence.LEFT),
    ],
)
def test_what_is_known_follows_from_the_numbers_of_publishers(
    before: Presence, alive: int, silent: int, after: Presence
) -> None:
    assert before.after(alive, silent) is after


@pytest.mark.parametrize(
    ("lives", "after"),
    [(True, Presence.STALLED), (False, Presence.GONE), (None, Presence.SILENT)],
)
def test_a_silent_process_counts_as_what_a_look_at_it_tells(
    lives: bool | None, after: Presence
) -> None:
    assert Presence.ALIVE.after(0, 1, lives) is after
    assert Presence.STALLED.after(0, 1, lives) is after
    assert Presence.LEFT.after(0, 0, lives) is Presence.LEFT


@pytest.mark.parametrize(
    ("lives", "after"),
    [(True, Presence.ALIVE), (False, Presence.GONE), (None, Presence.ALIVE)],
)
def test_a_process_that_is_looked_up_in_vain_is_dead_though_its_lease_has_not_run_out(
    lives: bool | None, after: Presence
) -> None:
    assert Presence.ALIVE.after(1, 0, lives) is after
    assert Presence.ALIVE.after(1, 1, lives) is after


def test_when_a_process_is_stopped_for_a_moment_expect_it_stalled_and_alive_again(
    watch: HeartbeatMonitor, spinner: Spinner, changes: list[Presence]
) -> None:
    with other_process() as process:
        eventually(spinner, lambda: introduced(watch, changes), "a sign of life")
        process.send_signal(signal.SIGSTOP)
        eventually(spinner, lambda: changes[-1] is Presence.STALLED, "silence")
        process.send_signal(signal.SIGCONT)
        eventually(spinner, lambda: changes[-1] is Presence.ALIVE, "a sign of life")

    assert watch.presence is Presence.ALIVE


def test_when_the_lease_of_a_node_of_the_same_process_runs_out_expect_it_to_stay_alive(
    node: Node, watch: HeartbeatMonitor, spinner: Spinner, changes: list[Presence]
) -> None:
    sign = Heartbeat(node, "other")
    eventually(spinner, lambda: introduced(watch, changes), "a sign of life")
    # The binding of the event cannot be made by hand, but has the same attributes.
    run_out: Any = SimpleNamespace(alive_count=0, not_alive_count=1)
    watch._on_event(run_out)
    assert watch.presence is Presence.ALIVE

    node.destroy_publisher(sign.publisher)
    eventually(spinner, lambda: watch.presence is Presence.LEFT, "the end")
