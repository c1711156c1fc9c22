"""Processes: whether one lives, and which is which."""

import os
import signal
import subprocess
import sys

import pytest

from armimp_common.process import STOPPED, identity, state_of

TELL = "import time; from armimp_common.process import identity; print(identity(), flush=True)"


def test_a_process_lives_until_it_ends_even_if_it_is_stopped_or_not_waited_for() -> None:
    program = f"{TELL}; time.sleep(1000)"
    process = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    told = process.stdout.readline().strip()
    assert told != identity()
    assert state_of(told) in ("R", "S")
    process.send_signal(signal.SIGSTOP)
    os.waitid(os.P_PID, process.pid, os.WSTOPPED | os.WNOWAIT)
    assert state_of(told) in STOPPED
    process.kill()
    os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOWAIT)  # It ended, and is still listed.
    assert state_of(told) == ""
    process.wait()
    assert state_of(told) == ""
    process.stdout.close()


def test_another_process_with_the_same_number_is_not_taken_for_it() -> None:
    *place, number, start = identity().split()

    assert state_of(" ".join([*place, number, str(int(start) + 1)])) == ""


@pytest.mark.parametrize("process", ["", "rubbish", "boot pid:[1] 1 1", "] x y", "boot pid:[1]"])
def test_of_a_process_elsewhere_nothing_is_known(process: str) -> None:
    assert state_of(process) is None
