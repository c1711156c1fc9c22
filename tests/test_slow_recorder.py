"""In lockstep a recorder that is held up loses nothing: the simulator waits for it."""

import os
import signal
import threading
import time
from pathlib import Path

import pytest

from armimp_bringup.config import load_config
from armimp_bringup.orchestrator import run_experiment
from armimp_common.status import Progress
from support.processes import processes_of

pytestmark = [pytest.mark.alone, pytest.mark.slow]

HELD_UP = 1.5
"""Seconds, in which the simulator could send several thousand samples."""


def hold_up(process: int) -> None:
    os.kill(process, signal.SIGSTOP)
    time.sleep(HELD_UP)
    os.kill(process, signal.SIGCONT)


def test_when_the_estimator_process_is_held_up_expect_no_sample_lost(tmp_path: Path) -> None:
    threads: list[threading.Thread] = []

    def on_progress(progress: Progress) -> None:
        if not threads and progress.samples > 500:
            (process,) = processes_of("armimp_estimation.node", tmp_path)
            threads.append(threading.Thread(target=hold_up, args=(process,)))
            threads[0].start()

    config = load_config(None, {"duration": 10.0, "processes": "separate"})
    summary = run_experiment(config, tmp_path / "out", on_progress=on_progress).summary
    for thread in threads:
        thread.join()

    assert threads
    assert summary.problems == []
    assert [(trial.ticks, trial.lost) for trial in summary.trials] == [(10_000, 0)] * 2
