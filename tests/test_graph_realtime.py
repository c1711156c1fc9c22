"""Experiments that are paced by the wall clock.

Where tests run, other work may hold anything up, and a run in real time then ends as not valid.
So nothing here asks for a quick machine: the reports have to agree with what was recorded, and the
verdict with the reports.
"""

from __future__ import annotations

import os
import signal
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from armimp_bringup.config import ExperimentConfig, node_parameters
from armimp_bringup.offline import run_offline
from armimp_bringup.offline_estimate import estimate_bags
from armimp_bringup.orchestrator import run_experiment
from armimp_bringup.replay import replay_bags
from armimp_bringup.supervisor import Progress
from armimp_common.contract import CONTROLLER_NODE, DATA_STREAMS, PERIOD_NS, SIM_NODE, VALUE_FIELD
from armimp_common.errors import ConfigurationError
from armimp_common.liveliness import Presence
from armimp_common.urgency import require_precedence
from armimp_estimation.report import load_result
from armimp_estimation.report.report import report_page
from armimp_estimation.results import Summary, read_summary
from armimp_estimation.timing import TimingRecord
from support.runs import FinishedRun

SECONDS = 3.0
NO_SAMPLE, NO_COMMAND = "no sensor sample arrived any more", "no command for 5 ticks"
MODULES = {SIM_NODE: "armimp_sim.node", CONTROLLER_NODE: "armimp_control.node"}
pytestmark = [pytest.mark.alone, pytest.mark.usefixtures("environment")]


def config() -> ExperimentConfig:
    """A short experiment, with precedence where that is permitted."""
    priority = 30
    try:
        require_precedence(priority)
    except ConfigurationError:
        priority = 0
    return ExperimentConfig(
        mode="realtime",
        joints=1,
        priority=priority,
        imbic_controller={"sequence.duration": SECONDS},
    )


def process_of(directory: Path, node: str) -> int:
    """Process that runs a node of the experiment in this directory."""
    for entry in Path("/proc").iterdir():
        with suppress(OSError):
            command = (entry / "cmdline").read_bytes().decode(errors="replace")
            if entry.name.isdigit() and MODULES[node] in command and str(directory) in command:
                return int(entry.name)
    raise AssertionError(f"no process of {node}")


def run_held(directory: Path, node: str, seconds: float, times: int = 1) -> tuple[Summary, int]:
    """Run, and hold a node up with SIGSTOP as soon as it works; also tell how often."""
    held = 0

    def on_progress(progress: Progress) -> None:
        nonlocal held
        if held < times:
            process = process_of(directory, node)
            os.kill(process, signal.SIGSTOP)
            time.sleep(seconds)
            os.kill(process, signal.SIGCONT)
            held += 1

    return run_experiment(config(), directory, on_progress=on_progress), held


def assert_verdict_fits(summary: Summary) -> None:
    """Not valid if and only if there is a problem, one for each limit that is exceeded."""
    assert summary.valid is (not summary.problems)
    told = [problem for problem in summary.problems if problem.startswith("real time: ")]
    assert summary.timing is not None
    assert told == TimingRecord.of(summary.timing).problems


@pytest.fixture(scope="module")
def finished(environment: None, tmp_path_factory: pytest.TempPathFactory) -> FinishedRun:
    directory = tmp_path_factory.mktemp("realtime") / "out"
    return FinishedRun(directory=directory, summary=run_experiment(config(), directory))


def test_every_run_reports_its_timing_and_a_verdict_that_fits(finished: FinishedRun) -> None:
    summary = finished.summary
    assert_verdict_fits(summary)
    timing = summary.timing
    assert timing is not None
    assert timing.ticks > 0
    assert 0.0 < timing.latency_p50 <= timing.latency_p99 <= timing.latency_max
    assert 0.0 < timing.period_p50 <= timing.period_p99 <= timing.period_max
    assert summary == read_summary(finished.directory / "summary.json")
    assert 'id="timing"' in report_page(load_result(finished.directory))


def test_samples_have_the_stamps_of_a_thousand_each_second_and_take_as_long(
    finished: FinishedRun,
) -> None:
    if not finished.summary.trials:
        pytest.skip(f"the machine is too busy: {finished.summary.problems[0]}")
    (trial,) = finished.summary.trials
    (recorded,) = finished.trials()
    names = finished.joint_names
    stamps = {topic: recorded.stamps(topic, names) for topic in VALUE_FIELD}
    for topic in VALUE_FIELD:
        assert (np.diff(stamps[topic]) == PERIOD_NS).all()
    if finished.summary.valid:
        assert {len(recorded.streams[topic]) for topic in DATA_STREAMS} == {SECONDS * 1000}
        # As long as it should, but for what was under way at both ends.
        assert trial.rtf == pytest.approx(1.0, abs=0.1)


def test_when_every_command_was_in_time_expect_the_bits_of_lockstep(finished: FinishedRun) -> None:
    timing = finished.summary.timing
    if not finished.summary.valid or timing is None or timing.missed:
        pytest.skip("the machine is too busy: not every command was in time")
    lockstep = config().model_copy(update={"mode": "lockstep", "priority": 0})
    finished.assert_same_as_offline(run_offline([node_parameters(lockstep, None).rig()])[0])


def test_bags_tell_the_timing_and_give_the_same_estimate(finished: FinishedRun) -> None:
    if not finished.summary.valid:
        pytest.skip(f"the machine is too busy: {finished.summary.problems[0]}")
    live = finished.summary

    offline = estimate_bags(finished.bags, ("welch_siso", "lpm_full"))[0].summary
    replayed = replay_bags(finished.bags, (), None)

    for summary in (offline, replayed):
        assert summary.estimators == live.estimators
        assert summary.timing is not None
        assert live.timing is not None
        assert SECONDS * 1000 <= summary.timing.ticks <= live.timing.ticks
        assert summary.timing.missed <= live.timing.missed
        assert summary.timing.max_latency == live.timing.max_latency


def test_when_the_controller_is_held_up_for_three_periods_expect_missed_commands_counted(
    tmp_path: Path,
) -> None:
    summary, held = run_held(tmp_path / "out", CONTROLLER_NODE, 0.003, times=3)
    # Held up for longer than was asked, and figures end before that.
    ended = any(
        watchdog in problem for problem in summary.problems for watchdog in (NO_SAMPLE, NO_COMMAND)
    )
    if not held or ended:
        pytest.skip(f"the machine is too busy: {summary.problems[0]}")

    assert summary.timing is not None
    assert summary.timing.missed >= held
    assert summary.timing.latency_max >= 0.002
    assert_verdict_fits(summary)


@pytest.mark.parametrize(
    ("node", "watchdog"), [(CONTROLLER_NODE, NO_COMMAND), (SIM_NODE, NO_SAMPLE)]
)
def test_when_one_side_is_held_up_for_long_expect_the_other_to_end_the_run(
    tmp_path: Path, node: str, watchdog: str
) -> None:
    summary, held = run_held(tmp_path / "out", node, 0.05)
    if not held:
        pytest.skip(f"the machine is too busy: {summary.problems[0]}")

    assert not summary.valid
    # A stopped process is also looked up, which comes first where the other was held up itself.
    reasons = (watchdog, f"{node} {Presence.STALLED.value}")
    assert any(reason in problem for reason in reasons for problem in summary.problems), (
        summary.problems
    )
    assert_verdict_fits(summary)
    # It does not go on for as long as nothing can come of it.
    assert all(trial.ticks < SECONDS * 1000 for trial in summary.trials)
