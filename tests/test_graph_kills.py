"""A process of the graph is killed at any moment: the others are safe within 200 ms, and say so.

The limit is one of safety and means a machine that has time for the graph. So only the long version
of these tests, which run alone, holds the others to it.
"""

import json
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from armimp_bringup.graph import LOOPBACK
from armimp_common.status import Phase, TrialStatus
from armimp_common.topics import CONTROLLER_NODE, ESTIMATOR_NODE, SIM_NODE, SUPERVISOR_NODE
from armimp_estimation.bags import read_bag
from support.bag_files import assert_other_readers_open
from support.fault_figures import Figures
from support.processes import processes_of

LIMIT = 0.2
"""Seconds after a death in which the others reach a safe state (safety requirement)."""
LOST = 100
"""Samples before a death that the bag may lack (safety requirement: 100 ms)."""
PATIENCE = 200.0
NODES = (SIM_NODE, CONTROLLER_NODE, ESTIMATOR_NODE)
MOMENTS = int(os.environ.get("ARMIMP_KILL_MOMENTS", "1"))
"""Random moments in each phase for the long version."""
REACH = {
    "ROS_AUTOMATIC_DISCOVERY_RANGE": "SYSTEM_DEFAULT",
    "FASTRTPS_DEFAULT_PROFILES_FILE": str(LOOPBACK),
}
"""Of the witness: that of the graph."""
PROGRAM = Path(__file__).parent / "killed_run.py"
WITNESS = Path(__file__).parent / "kill_witness.py"


@dataclass(frozen=True, kw_only=True)
class Kill:
    """An experiment of which one process was killed."""

    directory: Path
    victim: str
    time: float
    """When (monotonic, s)."""
    ended: float
    """When the orchestrator had ended."""
    exit_status: int
    """That of the orchestrator."""
    errors: str
    """Its standard error."""
    seen: dict[str, Any]
    """What the witness saw, each with the monotonic time at which it did."""

    @property
    def last_torque(self) -> float:
        """When (s after the kill) the last command other than zero came; 0 if none did."""
        # A kill in the first moments of a trial may come before the first torque.
        return max(map(self.after, self.seen["torques"]), default=0.0)

    def after(self, moment: float) -> float:
        return moment - self.time

    def status(self, phase: Phase) -> tuple[float, TrialStatus]:
        """The first announcement of a phase, and when (s after the kill) it came."""
        for moment, values in self.seen["statuses"]:
            if (status := TrialStatus.from_values(values)).phase is phase:
                return self.after(moment), status
        raise AssertionError(f"nobody announced {phase}")


@contextmanager
def witness(domain: str, file: Path) -> Iterator[None]:
    """A process that listens to this domain, and leaves what it saw in a file at its end."""
    process = subprocess.Popen(
        [sys.executable, str(WITNESS), str(file)],
        env={**os.environ, **REACH, "ROS_DOMAIN_ID": domain},
    )
    try:
        yield
        process.terminate()
        assert process.wait(PATIENCE) == 0
    finally:
        process.kill()
        process.wait()


def event(file: Path, name: str) -> str | None:
    """What the program tells under this name, if it does already."""
    lines = file.read_text().splitlines() if file.exists() else []
    return next((line.split()[1] for line in lines if line.split()[0] == name), None)


def kill(
    directory: Path,
    phase: str,
    victim: str,
    *,
    delay: float = 0.0,
    blind: float = 0.0,
    duration: int = 10,
) -> Kill:
    """Run an experiment, and kill a process of it some time after a phase has begun.

    For the time `blind` (s) the orchestrator does not see it: nodes must manage without. Trials are
    to last so long (s) that the phase is not over by then.
    """
    # The graph itself does as it does by default.
    environment = {name: value for name, value in os.environ.items() if name not in REACH}
    events, out, seen = directory / "events", directory / "out", directory / "seen"
    program = [sys.executable, str(PROGRAM), str(events), str(seen), phase, victim]
    options = ["--processes", "separate", "--estimator", "welch_siso"]
    options += ["--duration", str(duration)]
    deadline = time.monotonic() + PATIENCE
    with (directory / "errors").open("w") as errors:
        experiment = subprocess.Popen(
            [*program, str(delay), str(blind), "run", *options, "--out", str(out)],
            stdout=subprocess.DEVNULL,
            stderr=errors,
            text=True,
            env=environment,
        )
        try:
            while (domain := event(events, "domain")) is None:
                assert experiment.poll() is None, (directory / "errors").read_text()
                assert time.monotonic() < deadline
                time.sleep(0.01)
            ended = 0.0

            def over() -> bool:
                nonlocal ended
                if not ended and experiment.poll() is not None:
                    ended = time.monotonic()
                # Nodes that lost their orchestrator end by themselves.
                return time.monotonic() > deadline or (bool(ended) and not processes_of(out))

            with witness(domain, seen):
                while not over():
                    time.sleep(0.05)
            assert not processes_of(out), "processes are left over"
        finally:
            experiment.kill()
            experiment.wait()
            for orphan in processes_of(out):
                os.kill(orphan, signal.SIGKILL)
        moment = event(events, "killed")
        assert moment is not None, f"{phase} never came"
        return Kill(
            directory=out,
            victim=victim,
            time=float(moment),
            ended=ended,
            exit_status=experiment.returncode,
            errors=(directory / "errors").read_text(),
            seen=json.loads(seen.read_text()),
        )


def assert_named(done: Kill) -> None:
    """The orchestrator, if it lives, says who died, as the first problem, and exits 1."""
    if done.victim == SUPERVISOR_NODE:
        assert done.exit_status == -signal.SIGKILL
        return
    assert done.exit_status == 1
    summary = json.loads((done.directory / "summary.json").read_text())
    assert not summary["valid"]
    first = summary["problems"][0]["sentence"]
    assert first.startswith(f"node {done.victim} was killed by SIGKILL")
    assert f"node {done.victim} was killed by SIGKILL" in done.errors
    assert "Traceback" not in done.errors


def assert_told(done: Kill) -> float:
    """Who remains takes the torque away in the midst of a trial, and says why: when (s)."""
    if done.victim == CONTROLLER_NODE:
        late = (one for one in done.seen["reports"] if one[0] > done.time)
        moment, message, applied = next(one for one in late if one[1] != "running")
        told = done.after(moment)
        assert message.startswith(f"{CONTROLLER_NODE} ") or message == "stopped"
        assert applied == "0.0 0.0"
    else:
        told, aborted = done.status(Phase.ABORTED)
        assert aborted.reason
        assert done.seen["resting"]
    return told


def assert_safe_in_time(done: Kill, figures: Figures) -> None:
    """Torque is gone and the reason told within the limit; figures are printed beside it."""
    told = assert_told(done)
    figures.add(
        f"{done.victim} killed in a trial",
        last_torque_after=(1e3 * done.last_torque, "ms"),
        told_after=(1e3 * told, "ms"),
    )
    assert max(done.last_torque, told) < LIMIT


def assert_recorded(done: Kill) -> None:
    """The bag so far opens everywhere, and lacks a tenth of a second at most."""
    start_ns = done.status(Phase.PERTURB)[1].start_ns or 0
    before = [stamp_ns for moment, stamp_ns in done.seen["stamps"] if moment < done.time]
    samples = sum(stamp_ns >= start_ns for stamp_ns in before)
    assert samples
    (bag,) = (done.directory / "bags").iterdir()
    if done.victim != SUPERVISOR_NODE:  # who finishes the bag of a recorder that died
        assert_other_readers_open(bag)
    (trial,) = read_bag(bag).trials
    assert trial.record is not None
    assert trial.record.samples >= samples - LOST


@pytest.mark.parametrize("victim", [*NODES, SUPERVISOR_NODE])
def test_when_a_node_is_killed_in_a_trial_expect_the_others_safe_even_without_orchestrator(
    tmp_path: Path, victim: str
) -> None:
    done = kill(tmp_path, "moving", victim, blind=5.0, duration=100)

    assert done.seen["torques"]
    assert_told(done)
    if victim in (SIM_NODE, ESTIMATOR_NODE):
        assert done.status(Phase.ABORTED)[1].reason.startswith(f"{victim} ")
    assert_named(done)
    assert_recorded(done)


TRIAL_PHASES = ("settle 1", "perturb 1", "rest 1", "settle 2", "perturb 2")
LENGTH = {"start": 1.0, "perturb 1": 2.0, "perturb 2": 2.0}
"""Seconds within which a moment of the phase is chosen; else LENGTH_OF_OTHERS."""
LENGTH_OF_OTHERS = 0.1


@pytest.mark.slow
@pytest.mark.alone
@pytest.mark.parametrize("moment", range(MOMENTS))
@pytest.mark.parametrize("victim", [*NODES, SUPERVISOR_NODE])
@pytest.mark.parametrize(
    "phase", ["start", "configure", "activate", *TRIAL_PHASES, "done 2", "shutdown"]
)
def test_when_any_process_is_killed_at_any_moment_expect_the_others_safe(
    tmp_path: Path,
    figures: Figures,
    phase: str,
    victim: str,
    moment: int,
) -> None:
    delay = random.Random(f"{phase} {victim} {moment}").uniform(
        0.0, LENGTH.get(phase, LENGTH_OF_OTHERS)
    )

    done = kill(tmp_path, phase, victim, delay=delay)

    assert_named(done)
    if phase in TRIAL_PHASES:
        assert_safe_in_time(done, figures)
    else:
        assert done.last_torque < LIMIT
        figures.add(
            f"{victim} killed before the first trial or after the last",
            until_the_end=(done.after(done.ended), "s"),
        )
