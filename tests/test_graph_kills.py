"""A process of the graph is killed at any moment: the others are safe within 200 ms, and say so.

The limit is a safety requirement for a machine that has time for the graph. So only the long
version of these tests, which runs alone, enforces it.
"""

import json
import os
import random
import signal
import subprocess
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from armimp_bringup.graph import LOOPBACK
from armimp_bringup.nodes import MODULES, NODES
from armimp_common.status import Phase, TrialStatus
from armimp_common.topics import CONTROLLER_NODE, ESTIMATOR_NODE, SIM_NODE, SUPERVISOR_NODE
from armimp_estimation.bags.reader import read_bag
from support import known
from support.bag_files import assert_other_readers_open
from support.command import program
from support.fault_figures import Figures
from support.graph import free_domain
from support.processes import processes_of, wait_until

LIMIT = 0.2
"""Seconds after a death in which the others reach a safe state (safety requirement)."""
LOST = 100
"""Samples before a death that the bag may lack (safety requirement: 100 ms)."""
PATIENCE = 200.0
MOMENTS = int(os.environ.get("ARMIMP_KILL_MOMENTS", "1"))
"""Random moments in each phase for the long version."""
REACH = {
    "ROS_AUTOMATIC_DISCOVERY_RANGE": "SYSTEM_DEFAULT",
    "FASTRTPS_DEFAULT_PROFILES_FILE": str(LOOPBACK),
}
"""Discovery settings of the witness, which are those of the graph."""
SHARED = Path(__file__).parent
TRANSITIONS = ("configuring", "activating")
"""Of the victim, unless that is the orchestrator."""


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


def hear(witness: "subprocess.Popen[str]", words: str) -> None:
    """Wait until the witness says something that begins with these words."""
    output = known(witness.stdout)
    while not (line := output.readline()).startswith(words):
        assert line, "the witness has ended"


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

    For the time `blind` (s) the orchestrator is stopped: nodes must manage without it. Trials last
    `duration` (s), so long that the phase is not over by then.
    """
    domain = str(free_domain())
    # The graph itself does as it does by default.
    environment = {name: value for name, value in os.environ.items() if name not in REACH}
    out, errors = directory / "out", directory / "errors"
    reach = {**os.environ, **REACH, "ROS_DOMAIN_ID": domain, "PYTHONPATH": str(SHARED)}
    options = ["--processes", "separate", "--estimator", "welch_siso", "--domain-id", domain]
    options += ["--duration", str(duration), "--out", str(out)]
    witnessing = program(module="kill_witness", stdout=subprocess.PIPE, stderr=None, env=reach)
    with witnessing as witness, errors.open("w") as stderr:
        hear(witness, "listens")
        run = program("run", *options, stdout=subprocess.DEVNULL, stderr=stderr, env=environment)
        with run as experiment:
            processes = {SUPERVISOR_NODE: [experiment.pid]}

            def there() -> bool:
                assert experiment.poll() is None, errors.read_text()
                processes.update((name, processes_of(*one, out)) for name, one in MODULES.items())
                return all(processes.values())

            wait_until(there, "the processes of all nodes")
            if phase != "start":
                # Nothing happens before the witness is known, so that it misses nothing.
                experiment.send_signal(signal.SIGSTOP)
                hear(witness, "known")
                experiment.send_signal(signal.SIGCONT)
                transition = phase in TRANSITIONS and victim in NODES
                hear(witness, f"{phase} {victim}" if transition else phase)
            time.sleep(delay)
            if blind:
                experiment.send_signal(signal.SIGSTOP)
            moment = time.monotonic()
            os.kill(processes[victim][0], signal.SIGKILL)
            time.sleep(blind)
            experiment.send_signal(signal.SIGCONT)
            experiment.wait(PATIENCE)
            ended = time.monotonic()
            # Nodes that lost their orchestrator end by themselves.
            wait_until(lambda: not processes_of(out), "the end of all processes")
        witness.terminate()
        told, _ = witness.communicate(timeout=PATIENCE)
        assert witness.returncode == 0
    return Kill(
        directory=out,
        victim=victim,
        time=moment,
        ended=ended,
        exit_status=experiment.returncode,
        errors=errors.read_text(),
        seen=json.loads(told.splitlines()[-1]),
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
    """The survivor takes the torque away during a trial and says why; return when (s)."""
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


def assert_recorded(done: Kill, figures: Figures) -> None:
    """The bag so far opens everywhere, and lacks a tenth of a second at most."""
    perturbed = [values for _, values in done.seen["statuses"] if values["phase"] == "perturb"]
    start_ns = int(perturbed[-1]["start_ns"])
    before = [stamp_ns for moment, stamp_ns in done.seen["stamps"] if moment < done.time]
    samples = sum(stamp_ns >= start_ns for stamp_ns in before)
    bag = sorted((done.directory / "bags").iterdir())[-1]
    assert_other_readers_open(bag)
    if samples > LOST:
        (trial,) = read_bag(bag).trials
        lost = max(samples - known(trial.record).samples, 0)
        figures.add(f"{done.victim} killed while it was recorded", lost_samples=(lost, ""))
        assert lost <= LOST


@pytest.mark.parametrize("victim", [*NODES, SUPERVISOR_NODE])
def test_when_a_node_is_killed_in_a_trial_expect_the_others_safe_even_without_orchestrator(
    tmp_path: Path, victim: str, figures: Figures
) -> None:
    done = kill(tmp_path, "moving", victim, blind=5.0, duration=100)

    assert done.seen["torques"]
    assert_told(done)
    if victim in (SIM_NODE, ESTIMATOR_NODE):
        assert done.status(Phase.ABORTED)[1].reason.startswith(f"{victim} ")
    assert_named(done)
    assert_recorded(done, figures)


TRIAL_PHASES = ("settle 1", "perturb 1", "rest 1", "settle 2", "perturb 2")
LENGTH = {"start": 1.0, "perturb 1": 2.0, "perturb 2": 2.0}
"""Seconds within which a moment of the phase is chosen; of others within 0.1."""


@pytest.mark.slow
@pytest.mark.alone
@pytest.mark.parametrize("moment", range(MOMENTS))
@pytest.mark.parametrize("victim", [*NODES, SUPERVISOR_NODE])
@pytest.mark.parametrize("phase", ["start", *TRANSITIONS, *TRIAL_PHASES, "done 2", "shuttingdown"])
def test_when_any_process_is_killed_at_any_moment_expect_the_others_safe(
    tmp_path: Path, figures: Figures, phase: str, victim: str, moment: int
) -> None:
    delay = random.Random(f"{phase} {victim} {moment}").uniform(0.0, LENGTH.get(phase, 0.1))

    done = kill(tmp_path, phase, victim, delay=delay)

    assert_named(done)
    if phase in TRIAL_PHASES:
        assert_safe_in_time(done, figures)
        if phase.startswith("perturb"):
            assert_recorded(done, figures)
    else:
        assert done.last_torque < LIMIT
        figures.add(
            f"{victim} killed before the first trial or after the last",
            until_the_end=(done.after(done.ended), "s"),
        )
