"""A child process ends in order when its parent is gone, whatever ended that one."""

import os
import subprocess
import sys
from collections.abc import Iterator

import pytest

from armimp_common.parent_watchdog import ParentWatchdog, follow_lifeline

CHILD = """
import sys, time
from armimp_common.parent_watchdog import follow_lifeline
from armimp_common.executor import stop_on_signals

with stop_on_signals() as stopped:
    follow_lifeline()
    print("ready", flush=True)
    while not stopped():
        time.sleep(0.01)
print("ended in order", flush=True)
"""
PARENT = f"""
import subprocess, sys, time
from armimp_common.parent_watchdog import ParentWatchdog

lifeline = ParentWatchdog()
subprocess.Popen(
    [sys.executable, "-c", {CHILD!r}],
    pass_fds=[lifeline.child_end],
    env=lifeline.environment(),
    start_new_session=True,
)
time.sleep(1000)
"""


@pytest.fixture
def parent() -> "Iterator[subprocess.Popen[str]]":
    process = subprocess.Popen([sys.executable, "-c", PARENT], stdout=subprocess.PIPE, text=True)
    yield process
    process.kill()
    process.communicate()


def test_when_the_parent_is_killed_expect_the_child_to_end_in_order(
    parent: "subprocess.Popen[str]",
) -> None:
    assert parent.stdout is not None
    assert parent.stdout.readline() == "ready\n"

    parent.kill()

    # The child inherited the output, which ends only with it.
    assert parent.stdout.read() == "ended in order\n"


def test_when_the_parent_lets_go_expect_the_child_to_end_in_order() -> None:
    lifeline = ParentWatchdog()
    with subprocess.Popen(
        [sys.executable, "-c", CHILD],
        stdout=subprocess.PIPE,
        text=True,
        pass_fds=[lifeline.child_end],
        env=lifeline.environment(),
    ) as child:
        assert child.stdout is not None
        assert child.stdout.readline() == "ready\n"
        lifeline.close()
        assert child.stdout.read() == "ended in order\n"
    assert child.returncode == 0


@pytest.mark.parametrize("value", [None, "", "rubbish", "9999"])
def test_without_a_pipe_nothing_is_followed(
    monkeypatch: pytest.MonkeyPatch, value: str | None
) -> None:
    if value is not None:
        monkeypatch.setenv("ARMIMP_LIFELINE", value)

    follow_lifeline()

    # Children of this process have no part in it.
    assert "ARMIMP_LIFELINE" not in os.environ
