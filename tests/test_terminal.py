"""What is on a real terminal while `armimp run` runs, and when it has ended."""

import fcntl
import os
import pty
import re
import struct
import subprocess
import sys
import termios
from pathlib import Path

import pyte
import pytest

ROWS = 24
PROGRAM = """
import sys, pytest
from armimp_bringup.cli import main
from armimp_bringup.terminal import Display
from support.telling import tell_by_samples

def drawn(display, snapshot, show=Display.show):
    show(display, snapshot)
    display._refresh()

with pytest.MonkeyPatch.context() as patch:
    tell_by_samples(patch)
    patch.setattr(Display, "show", drawn)
    sys.exit(main(sys.argv[1:]))
"""
"""The command, which draws all of its progress rather than what there is once a second."""
COMMAND = [sys.executable, "-c", PROGRAM, "run", "--duration", "10", "--joints", "1"]


def screens(command: list[str], columns: int) -> list[list[str]]:
    """Run a command in a terminal, and return its screen after each piece of output."""
    screen = pyte.Screen(columns, ROWS)
    stream = pyte.ByteStream(screen)
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", ROWS, columns, 0, 0))
    shared = str(Path(__file__).parent)
    environment = {**os.environ, "TERM": "xterm-256color", "PYTHONPATH": shared}
    for name in ("COLUMNS", "LINES", "NO_COLOR"):
        environment.pop(name, None)
    seen: list[list[str]] = []
    with subprocess.Popen(
        command, stdin=theirs, stdout=theirs, stderr=theirs, env=environment
    ) as process:
        os.close(theirs)
        while True:
            try:
                piece = os.read(ours, 1 << 16)
            except OSError:  # so Linux tells that nobody is at the other end any more
                break
            # However much comes at once: what is drawn begins at the first column.
            for part in re.split(rb"(?=\r)", piece):
                stream.feed(part)
                seen.append([line.rstrip() for line in screen.display])
        assert process.wait() == 0
    os.close(ours)
    return seen


@pytest.mark.parametrize(
    "columns", [80, *(pytest.param(wider, marks=pytest.mark.slow) for wider in (100, 120))]
)
def test_the_last_screen_has_the_trials_the_verdict_and_the_place_and_no_progress(
    columns: int, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    seen = screens([*COMMAND, "--out", str(out)], columns)

    last = [line for line in seen[-1] if line]
    assert [line for line in last if "bags/trial_1_joint_1" in line]
    assert "valid" in last
    text = "".join(last)  # a long path goes over several lines
    assert f"results in {out}" in text
    assert "left" not in text
    assert "drawing" not in text

    bars = {line for screen in seen for line in screen if "left" in line}
    assert bars
    for line in bars:
        assert line.startswith("trial 1/1  joint 1")
        assert "━" in line
        assert line.endswith(" left")
    phases = {line.split(",")[0] for screen in seen for line in screen if line.endswith(" s")}
    assert {"starting", "estimating", "drawing figures and report"} <= phases
