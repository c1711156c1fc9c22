"""Experiments in real time.

How quick the machine is must decide nothing here. So most of these runs are on a clock of their
own: it stands still while an answer is computed, and each answer then takes as long as the test
says. In runs on the clock of the machine, what is reported has to agree with what was recorded, and
watchdogs are so patient that only a process which is stopped wakes them.
"""

from __future__ import annotations

import os
import signal
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from armimp_bringup.config import ExperimentConfig
from armimp_bringup.orchestrator import run_experiment
from armimp_common.heartbeat import Presence
from armimp_common.realtime import Pacer
from armimp_common.status import Progress
from armimp_common.topics import (
    CONTROLLER_NODE,
    NS_PER_S,
    PERIOD_NS,
    SIM_NODE,
)
from armimp_estimation.problems import ProblemCode
from armimp_estimation.summary import Summary
from armimp_sim.simulator import RealtimeSimulator, SimulatedRig
from support.priority import permitted_priority
from support.processes import processes_of
from support.runs import FinishedRun

SECONDS = 2.0
PATIENCE = 100
"""Periods after which watchdogs take the torque away: as many as can be chosen."""
HELD = 0.4
"""For how long a process is stopped (s): four times as long."""
MODULES = {SIM_NODE: "armimp_sim.node", CONTROLLER_NODE: "armimp_control.node"}
pytestmark = pytest.mark.usefixtures("environment")


def config(**options: Any) -> ExperimentConfig:
    return ExperimentConfig.model_validate(
        {
            "mode": "realtime",
            "duration": SECONDS,
            **options,
        }
    )


def assert_verdict_fits(summary: Summary) -> None:
    """Not valid if and only if there is a problem, one for each limit that is exceeded."""
    assert summary.valid is (not summary.problems)
    assert summary.timing is not None
    codes = {ProblemCode.SAMPLES_LATE, ProblemCode.COMMANDS_LATE, ProblemCode.LATENCY}
    assert [one for one in summary.problems if one.code in codes] == summary.timing.problems


class OwnClock:
    """A clock on which the answer to each sample takes as long as it is told to.

    Parameters
    ----------
    latency : from the sample of a tick to its answer, s
    """

    def __init__(self, latency: Callable[[int], float]) -> None:
        self.latency = latency
        self.ns = 10**12

    def rig(
        self,
        rig: SimulatedRig,
        send: Callable[[], None],
        pacer: Pacer,
        *,
        watchdog_ticks: int,
    ) -> RealtimeSimulator:
        """Return what takes the place of a `RealtimeSimulator`."""
        return _RigOnOwnClock(self, rig, send, watchdog_ticks)


class _RigOnOwnClock(RealtimeSimulator):
    def __init__(
        self, clock: OwnClock, rig: SimulatedRig, send: Callable[[], None], watchdog_ticks: int
    ) -> None:
        pacer = Pacer(PERIOD_NS, now=lambda: clock.ns, sleep=self._pass_time)
        super().__init__(rig, send, pacer, watchdog_ticks=watchdog_ticks)
        self._clock = clock
        self._awaited: deque[int] = deque()
        self._answers: deque[Sequence[float]] = deque()
        self._came = threading.Condition()

    def _sample(self, tick: int) -> None:
        self._awaited.append(self._clock.ns + round(self._clock.latency(tick) * NS_PER_S))
        super()._sample(tick)

    def command(self, command: Sequence[float]) -> None:
        """Keep it until it is due."""
        with self._came:
            self._answers.append(command)
            self._came.notify()

    def _pass_time(self, seconds: float) -> None:
        until_ns = self._clock.ns + round(seconds * NS_PER_S)
        while self._awaited and self._awaited[0] < until_ns:
            with self._came:
                while not self._answers:
                    if self._stopped.is_set():
                        return
                    self._came.wait(0.05)
                command = self._answers.popleft()
            self._clock.ns = self._awaited.popleft()
            super().command(command)
        self._clock.ns = until_ns


def run_on_own_clock(directory: Path, latency: Callable[[int], float]) -> FinishedRun:
    """Run an experiment in which the answer to the sample of each tick takes so long (s)."""
    clock = OwnClock(latency)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("armimp_sim.node.RealtimeSimulator", clock.rig)
        # Samples need time of the machine on their way, of which the rig's clock knows nothing.
        patch.setattr("armimp_control.node.time", SimpleNamespace(monotonic=lambda: 0.0))
        summary = run_experiment(config(processes="composed"), directory).summary
    return FinishedRun(directory=directory, summary=summary)


@pytest.fixture(scope="module")
def in_time(environment: None, tmp_path_factory: pytest.TempPathFactory) -> FinishedRun:
    """Each command comes in time."""
    return run_on_own_clock(tmp_path_factory.mktemp("in_time") / "out", lambda _: 0.0003)


def test_when_every_command_is_in_time_expect_a_valid_result_with_its_timing(
    in_time: FinishedRun,
) -> None:
    summary, timing = in_time.summary, in_time.summary.timing
    assert summary.problems == []
    assert summary.valid
    assert timing is not None
    assert (timing.late, timing.missed) == (0, 0)
    assert timing.ticks >= SECONDS * 1000
    for latency in (timing.latency_p50, timing.latency_p99, timing.latency_max):
        assert latency == pytest.approx(0.0003, rel=0.05)
    for period in (timing.period_p50, timing.period_p99, timing.period_max):
        assert period == pytest.approx(0.001, rel=0.05)


def test_when_every_command_is_in_time_expect_the_bits_of_lockstep(
    in_time: FinishedRun, composed: FinishedRun
) -> None:
    in_time.assert_same_streams(composed)


# On the clock of the machine.


def patient() -> ExperimentConfig:
    """With precedence where that is permitted, and watchdogs that wait for as long as they may."""
    return config(
        priority=permitted_priority(),
        arm_sim={"watchdog_ticks": PATIENCE},
        imbic_controller={"safety.watchdog_ticks": PATIENCE},
    )


@pytest.mark.alone
@pytest.mark.slow
@pytest.mark.parametrize(
    ("node", "watchdog"),
    [
        (CONTROLLER_NODE, f"no command for {PATIENCE} ticks"),
        (SIM_NODE, "no sensor sample arrived any more"),
    ],
)
def test_when_one_side_is_held_up_for_long_expect_the_other_to_end_the_run(
    tmp_path: Path, node: str, watchdog: str
) -> None:
    directory, held = tmp_path / "out", 0

    def on_progress(progress: Progress) -> None:
        nonlocal held
        if not held:
            (process,) = processes_of(MODULES[node], directory)
            os.kill(process, signal.SIGSTOP)
            time.sleep(HELD)
            os.kill(process, signal.SIGCONT)
            held += 1

    summary = run_experiment(patient(), directory, on_progress=on_progress).summary

    assert held
    assert not summary.valid
    # A stopped process is also looked up, which comes first where the other was held up itself.
    reasons = (watchdog, f"{node} {Presence.STALLED.value}")
    assert any(reason in problem.sentence for reason in reasons for problem in summary.problems), (
        summary.problems
    )
    assert_verdict_fits(summary)
    # It does not go on for as long as nothing can come of it.
    assert all(trial.ticks < SECONDS * 1000 for trial in summary.trials)
