"""A recorder killed at any moment loses little, and what it leaves opens everywhere by itself."""

import os
import random
import signal
import struct
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from armimp_bringup.offline_estimate import estimate_bags
from armimp_estimation.bags import read_bag
from armimp_estimation.bags.reader import BAGS
from armimp_estimation.bags.writer import finish_bag
from support.bag_files import assert_other_readers_open
from support.fault_figures import Figures
from support.synthetic_bags import recorded_arm

pytestmark = [pytest.mark.alone, pytest.mark.slow]

SETTLE = 60
SAMPLES = 6000
MOST_LOST = 100
"""Samples, one every millisecond."""

# Records one trial at 1 kHz as the node does, and tells after each sample that it has arrived.
RECORDER = """
import os, struct, sys, time
from pathlib import Path
from armimp_estimation.alignment.synchronizer import TOGETHER
from armimp_estimation.recorder import TrialRecorder
from support.streams import record
from support.synthetic_bags import recorded_arm

directory, trial, samples = Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3])
arm = recorded_arm(samples)
ticks = 60 + samples + 60
begin = (trial - 1) * ticks * 1_000_000

def paced():
    began, present = time.monotonic(), begin
    for message in arm.messages:
        stamp = message[1]
        if begin <= stamp < begin + ticks * 1_000_000:
            if stamp > present:
                os.write(1, struct.pack("<q", (present - begin) // 1_000_000))
                present = stamp
                time.sleep(max(began + (stamp - begin) / 1e9 - time.monotonic(), 0.0))
            yield message

recorder = TrialRecorder(arm.records[0].joint_names, directory, {}, lambda *_: None)
record(recorder, paced(), TOGETHER)
"""


@dataclass(frozen=True)
class Killed:
    """What a recorder left, and how many samples of its trial it had accepted."""

    directory: Path
    trial: int
    received: int

    @property
    def bag(self) -> Path:
        (bag,) = (self.directory / BAGS).iterdir()
        return bag


def kill_a_recorder(directory: Path, trial: int, after: float) -> Killed:
    """Kill one this long (s) after its first sample."""
    command = [sys.executable, "-c", RECORDER, str(directory), str(trial), str(SAMPLES)]
    shared = {**os.environ, "PYTHONPATH": str(Path(__file__).parent)}
    with subprocess.Popen(command, stdout=subprocess.PIPE, env=shared) as process:
        assert process.stdout is not None
        told = process.stdout.read(8)
        time.sleep(after)
        os.kill(process.pid, signal.SIGKILL)
        told += process.stdout.read()
    assert process.returncode == -signal.SIGKILL
    whole = len(told) // 8 * 8
    (tick,) = struct.unpack("<q", told[whole - 8 : whole])
    return Killed(directory, trial, tick + 1 - SETTLE)


def kill_recorders(directory: Path, moments: list[float]) -> list[Killed]:
    """Kill one at each of these moments, in trial 1 and 2 in turn."""
    with ThreadPoolExecutor(3) as pool:
        jobs = [
            pool.submit(kill_a_recorder, directory / str(i), 1 + i % 2, moment)
            for i, moment in enumerate(moments)
        ]
        return [job.result() for job in jobs]


def assert_little_is_lost(killed: Killed) -> int:
    """The samples that are left, each as it was sent; their number."""
    (trial,) = read_bag(killed.bag).trials
    (record,) = trial.intact()
    sent = recorded_arm(SAMPLES).records[killed.trial - 1]
    np.testing.assert_array_equal(record.position, sent.position[:, : record.samples])
    np.testing.assert_array_equal(record.torque, sent.torque[:, : record.samples])
    assert killed.received - MOST_LOST <= record.samples <= killed.received + 1
    return record.samples


@pytest.mark.timeout(1200)
def test_when_killed_at_twenty_random_moments_expect_little_lost_each_time(
    tmp_path: Path, figures: Figures
) -> None:
    rng = random.Random(2)
    killed = kill_recorders(tmp_path, [rng.uniform(0.15, 4.0) for _ in range(20)])

    for one in killed:
        left = assert_little_is_lost(one)
        assert finish_bag(one.bag)
        assert_other_readers_open(one.bag)
        assert assert_little_is_lost(one) == left
        figures.add("recorder killed", loss=(one.received - left, "ms"))
    longest = [max(killed[k::2], key=lambda one: one.received).bag for k in (0, 1)]
    assert estimate_bags(longest, ()).curves
