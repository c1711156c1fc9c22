"""An hour of simulated trials back to back in one process: nothing is lost, nothing piles up."""

import json
import time
from pathlib import Path
from types import SimpleNamespace

import pytest

from support.fault_figures import Figures
from support.processes import run_python

pytestmark = [pytest.mark.alone, pytest.mark.slow]

EXPERIMENTS = 36
"""Of two trials of 50 s each: an hour."""
WARM_UP = 6
"""Experiments after which libraries are loaded, code is compiled and caches are full."""
MOST_GROWTH = 6.0
"""MB that the process may grow from the experiments after the first few to the last few: half of
what a single graph that is not taken down costs, and less than three bytes of each sample."""

# Runs experiments as `armimp run` does; prints after each how it went, and what is in use.
PROGRAM = """
import json, os, shutil, sys
from pathlib import Path
from armimp_bringup.config import ExperimentConfig
from armimp_bringup.orchestrator import run_experiment

for number in range(int(sys.argv[2])):
    directory = Path(sys.argv[1]) / str(number)
    summary = run_experiment(ExperimentConfig(seed=number), directory).summary
    shutil.rmtree(directory)
    status = dict(line.split(":", 1) for line in open("/proc/self/status"))
    told = {
        "problems": [str(problem) for problem in summary.problems],
        "ticks": [trial.ticks for trial in summary.trials],
        "lost": [trial.lost for trial in summary.trials],
        "memory": int(status["VmRSS"].split()[0]) / 1024,
        "threads": int(status["Threads"]),
        "files": len(os.listdir("/proc/self/fd")),
    }
    print(json.dumps(told), flush=True)
"""


@pytest.mark.timeout(3600)
def test_in_an_hour_of_trials_nothing_is_lost_and_nothing_piles_up(
    tmp_path: Path, figures: Figures
) -> None:
    began = time.monotonic()
    printed = run_python("-c", PROGRAM, str(tmp_path), str(EXPERIMENTS))
    told = [SimpleNamespace(**json.loads(line)) for line in printed.splitlines()]

    assert len(told) == EXPERIMENTS
    assert [one.problems for one in told] == [[]] * EXPERIMENTS
    assert [one.ticks for one in told] == [[50_000, 50_000]] * EXPERIMENTS
    assert sum(sum(one.lost) for one in told) == 0
    warm, last = told[WARM_UP : 2 * WARM_UP], told[-WARM_UP:]
    # What was freed may stay in the process for a while, or not: the least is what it needs.
    before, after = (min(one.memory for one in part) for part in (warm, last))
    growth = after - before
    figures.add(
        "trial of 50 s, back to back in one process",
        2 * EXPERIMENTS,
        lost_samples=(sum(sum(one.lost) for one in told), ""),
        growth=(growth, "MB"),
        memory=(max(one.memory for one in told), "MB"),
        threads=(max(one.threads for one in last), ""),
        open_files=(max(one.files for one in last), ""),
        wall_time=(time.monotonic() - began, "s"),
    )
    print("memory, MB:", *(round(one.memory) for one in told))
    assert growth < MOST_GROWTH
    assert max(one.threads for one in last) <= max(one.threads for one in warm)
    assert max(one.files for one in last) <= max(one.files for one in warm)
