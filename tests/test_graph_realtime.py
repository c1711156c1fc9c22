"""Experiments in real time.

The speed of the machine must decide nothing here: what is reported has to agree with what was
recorded, and watchdogs wait so long that only a process which is stopped trips them.
"""

import itertools
import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.serialization import deserialize_message
from rclpy.time import Time

from armimp_bringup.config import ExperimentConfig
from armimp_bringup.nodes import MODULES
from armimp_bringup.orchestrator import run_experiment
from armimp_common.heartbeat import Presence
from armimp_common.status import Progress, TimingFigures, values_of
from armimp_common.topics import CONTROLLER_NODE, DIAGNOSTICS, PERIOD_NS, SIM_NODE
from armimp_estimation.problems import ProblemCode
from armimp_estimation.summary import Summary
from support import known
from support.bag_files import iterate_messages
from support.problems import codes
from support.processes import permitted_priority, processes_of

SECONDS = 2.0
PATIENCE = 100
"""Periods after which watchdogs take the torque away: as many as can be chosen."""
HELD = 0.4
"""For how long a process is stopped (s): four times as long."""
LATE = {ProblemCode.SAMPLES_LATE, ProblemCode.COMMANDS_LATE, ProblemCode.LATENCY}
pytestmark = pytest.mark.usefixtures("environment")


def assert_verdict_fits(summary: Summary) -> None:
    """One problem for each limit that is exceeded, and none of them in a valid result."""
    timing = known(summary.timing)
    exceeded = {
        ProblemCode.SAMPLES_LATE: timing.late > 0.01 * timing.ticks,
        ProblemCode.COMMANDS_LATE: timing.missed > 0.01 * timing.ticks,
        ProblemCode.LATENCY: not timing.latency_p99 <= 0.001,
    }
    found = [code for code in codes(summary.problems) if code in LATE]
    assert found == [code for code, beyond in exceeded.items() if beyond]
    assert not (summary.valid and found)


def told_of_timing(bag: Path) -> Iterator[TimingFigures]:
    """What the rig told of its timing while a bag was recorded."""
    for topic, _, raw in iterate_messages(bag):
        if topic == DIAGNOSTICS and TimingFigures.STATUS_NAME.encode() in raw:
            array = deserialize_message(raw, DiagnosticArray)
            figures = TimingFigures.from_values(values_of(array.status[0]))
            # All samples before this instant were sent; that of it was, or will be at its deadline.
            stamp_ns = Time.from_msg(array.header.stamp).nanoseconds
            assert figures.ticks - stamp_ns // PERIOD_NS in (0, 1)
            yield figures


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
    bags = [tmp_path / "out" / trial.bag for trial in summary.trials if trial.bag is not None]
    told = [*itertools.chain.from_iterable(map(told_of_timing, bags)), known(summary.timing)]
    assert len(told) > sum(trial.ticks for trial in summary.trials) / 1000
    for one, later in itertools.pairwise(told):
        more = later.ticks - one.ticks
        assert 0 <= later.late - one.late <= more
        assert 0 <= later.missed - one.missed <= more
        assert later.period_max >= one.period_max
    assert summary.valid or LATE & set(codes(summary.problems)), summary.problems


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
    if summary.timing is not None:
        assert_verdict_fits(summary)
    else:  # the run ended before the rig reported any
        assert not LATE & set(codes(summary.problems))
    # The run does not go on when its result cannot be valid any more.
    assert all(trial.ticks < SECONDS * 1000 for trial in summary.trials)
