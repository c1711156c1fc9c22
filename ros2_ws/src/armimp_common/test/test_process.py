"""Whether a process of this machine lives is told from its identity."""

import os
import signal
import subprocess
import sys
import time

import pytest

from armimp_common.process import Life, identity, life_of, waited_ns

TELL = "import time; from armimp_common.process import identity; print(identity(), flush=True)"


def test_this_process_lives() -> None:
    assert life_of(identity()) is Life.RUNNING


def test_a_process_lives_until_it_ends_even_if_it_is_stopped_or_not_waited_for() -> None:
    program = f"{TELL}; time.sleep(1000)"
    process = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    told = process.stdout.readline().strip()
    assert told != identity()
    assert life_of(told) is Life.RUNNING
    process.send_signal(signal.SIGSTOP)
    os.waitid(os.P_PID, process.pid, os.WSTOPPED | os.WNOWAIT)
    assert life_of(told) is Life.STOPPED
    assert life_of(told).there

    process.kill()
    os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOWAIT)  # It ended, and is still listed.

    assert life_of(told) is Life.ENDED
    process.wait()
    assert life_of(told) is Life.ENDED
    assert life_of(told).there is False
    process.stdout.close()


def test_another_process_with_the_same_number_is_not_taken_for_it() -> None:
    *place, number, start = identity().split()

    assert life_of(" ".join([*place, number, str(int(start) + 1)])) is Life.ENDED


def test_of_two_processes_on_one_core_each_waits_for_the_other() -> None:
    core = min(os.sched_getaffinity(0))
    program = f"{TELL}; import os; os.sched_setaffinity(0, {{{core}}})\nwhile True: pass"
    busy = [
        subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True)
        for _ in range(2)
    ]
    try:
        told = []
        for process in busy:
            assert process.stdout is not None
            told.append(process.stdout.readline().strip())
        before = [waited_ns(process) for process in told]
        time.sleep(0.5)
        after = [waited_ns(process) for process in told]
    finally:
        for process in busy:
            process.kill()
            process.communicate()
    for first, last in zip(before, after, strict=True):
        assert first is not None
        assert last is not None
        assert last - first > 100_000_000
    assert waited_ns(told[0]) is None


@pytest.mark.parametrize("process", ["", "rubbish", "boot pid:[1] 1 1", "] x y", "boot pid:[1]"])
def test_of_a_process_elsewhere_nothing_is_known(process: str) -> None:
    assert life_of(process) is Life.UNKNOWN
    assert life_of(process).there is None
    assert waited_ns(process) is None


def test_age_is_the_time_since_the_process_was_started() -> None:
    program = "import time; from armimp_common.process import age; a = age(); time.sleep(0.5); "
    began = time.monotonic()
    told = subprocess.check_output([sys.executable, "-c", f"{program}print(a, age())"], text=True)
    took = time.monotonic() - began
    first, second = map(float, told.split())
    assert 0.0 < first < second <= took + 0.02
    assert second - first >= 0.5
