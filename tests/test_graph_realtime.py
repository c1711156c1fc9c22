"""Experiments in real time.

The speed of the machine must decide nothing here: what is reported has to agree with what was
recorded, and watchdogs wait so long that only a process which is stopped trips them.
"""

import os
import signal
import time
from pathlib import Path

import pytest

from armimp_bringup.config import ExperimentConfig
from armimp_bringup.nodes import MODULES
from armimp_bringup.orchestrator import run_experiment
from armimp_common.heartbeat import Presence
from armimp_common.status import Progress
from armimp_common.topics import CONTROLLER_NODE, SIM_NODE
from armimp_estimation.problems import ProblemCode
from armimp_estimation.summary import Summary
from support.processes import permitted_priority, processes_of

SECONDS = 2.0
PATIENCE = 100
"""Periods after which watchdogs take the torque away: as many as can be chosen."""
HELD = 0.4
"""For how long a process is stopped (s): four times as long."""
pytestmark = pytest.mark.usefixtures("environment")


def assert_verdict_fits(summary: Summary) -> None:
    """Not valid if and only if there is a problem, one for each limit that is exceeded."""
    assert summary.valid is (not summary.faults)
    assert summary.timing is not None
    codes = {ProblemCode.SAMPLES_LATE, ProblemCode.COMMANDS_LATE, ProblemCode.LATENCY}
    assert [one for one in summary.problems if one.code in codes] == summary.timing.problems


def patient() -> ExperimentConfig:
    """Real time with priority where that is permitted, and with the most patient watchdogs."""
    return ExperimentConfig(
        mode="realtime",
        duration=SECONDS,
        priority=permitted_priority(),
        arm_sim={"watchdog_ticks": PATIENCE},
        imbic_controller={"safety.watchdog_ticks": PATIENCE},
    )


@pytest.mark.parametrize("processes", ["composed", "separate"])
def test_a_run_reports_its_timing_and_is_valid_unless_that_is_beyond_a_limit(
    tmp_path: Path, processes: str
) -> None:
    config = patient().model_copy(update={"processes": processes})
    summary = run_experiment(config, tmp_path / "out").summary

    assert_verdict_fits(summary)
    assert summary.timing is not None
    assert summary.timing.ticks >= sum(trial.ticks for trial in summary.trials) > 0


@pytest.mark.alone
@pytest.mark.slow
@pytest.mark.parametrize(
    ("node", "watchdog"),
    [
        (CONTROLLER_NODE, f"no command for {PATIENCE} periods"),
        (SIM_NODE, "no sensor sample arrived any more"),
    ],
)
def test_when_one_side_is_held_up_for_long_expect_the_other_to_end_the_run(
    tmp_path: Path, node: str, watchdog: str
) -> None:
    directory, held = tmp_path / "out", list[int]()

    def on_progress(progress: Progress) -> None:
        if not held:
            held.extend(processes_of(*MODULES[node], directory))
            os.kill(held[0], signal.SIGSTOP)
            time.sleep(HELD)
            os.kill(held[0], signal.SIGCONT)

    summary = run_experiment(patient(), directory, on_progress=on_progress).summary

    assert held
    assert not summary.valid
    # That a process is stopped is also seen directly: first, if the other was held up itself.
    reasons = (watchdog, f"{node} {Presence.STALLED.value}")
    assert any(reason in problem.sentence for reason in reasons for problem in summary.problems), (
        summary.problems
    )
    assert_verdict_fits(summary)
    # The run does not go on when its result cannot be valid any more.
    assert all(trial.ticks < SECONDS * 1000 for trial in summary.trials)
