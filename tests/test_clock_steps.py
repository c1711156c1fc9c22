"""Somebody sets the wall clock while an experiment runs: nothing waits longer, no bit differs."""

from __future__ import annotations

import os
import shutil
import signal
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from rclpy.node import Node

from armimp_bringup import graph
from armimp_bringup.config import ExperimentConfig
from armimp_bringup.orchestrator import run_experiment
from armimp_bringup.ping_pong import PingNode
from armimp_bringup.supervisor import Progress
from armimp_common.channels import CommandSubscription
from armimp_common.contract import (
    COMMANDS,
    CONTROLLER_NODE,
    ESTIMATOR_NODE,
    SIM_NODE,
    SUPERVISOR_NODE,
)
from armimp_common.spin import Spinner, run_node
from armimp_common.trial_status import Phase
from armimp_control.node import ImbicControllerNode
from armimp_driver_template.node import ExoDriver
from armimp_estimation.node import ImpedanceEstimatorNode
from armimp_estimation.results import read_summary
from armimp_ros2_control.node import Ros2ControlBridge
from armimp_sim.node import ArmSimNode
from support.fault_figures import Figures
from support.graph import CLOCK_STEPS, set_clock
from support.runs import FinishedRun

pytestmark = [pytest.mark.alone, pytest.mark.usefixtures("environment")]
stepped = pytest.mark.parametrize("step", CLOCK_STEPS)
PATIENCE = 100
"""Periods until watchdogs take the torque away, so that no stall of a busy machine wakes them."""
LIMIT = PATIENCE * 1e-3 + 0.05 + 0.2
"""After that, the longest ramp and the time that others have to be safe, torque is zero (s)."""
SHORT: dict[str, Any] = {"joints": 1, "imbic_controller": {"sequence.duration": 2.0}}
Popen = subprocess.Popen


def run(directory: Path, **options: Any) -> FinishedRun:
    hooks = {name: options.pop(name) for name in ("on_phase", "on_progress") if name in options}
    config = ExperimentConfig.model_validate({**SHORT, **options})
    return FinishedRun(directory=directory, summary=run_experiment(config, directory, **hooks))


@pytest.fixture(scope="module")
def untouched(environment: None, tmp_path_factory: pytest.TempPathFactory) -> FinishedRun:
    """What comes of it when nobody sets a clock."""
    return run(tmp_path_factory.mktemp("untouched") / "out")


@pytest.fixture
def nodes(monkeypatch: pytest.MonkeyPatch) -> list[Node]:
    """All nodes of this process, as soon as they are there."""
    nodes: list[Node] = []
    add = Spinner.add_node

    def add_node(spinner: Spinner, node: Node) -> None:
        nodes.append(node)
        add(spinner, node)

    monkeypatch.setattr(Spinner, "add_node", add_node)
    return nodes


def assert_same(finished: FinishedRun, untouched: FinishedRun) -> None:
    finished.assert_same_streams(untouched)
    assert finished.summary.problems == untouched.summary.problems
    assert finished.summary.estimators == untouched.summary.estimators


@stepped
def test_when_clocks_of_nodes_are_set_in_a_trial_expect_the_same_bits(
    untouched: FinishedRun, nodes: list[Node], tmp_path: Path, step: float
) -> None:
    names: set[str] = set()

    def on_phase(phase: Phase) -> None:
        if phase is Phase.PERTURB:
            for node in nodes:
                names.add(node.get_name())
                set_clock(node, step)

    finished = run(tmp_path / "out", on_phase=on_phase)

    assert names == {SIM_NODE, CONTROLLER_NODE, ESTIMATOR_NODE, SUPERVISOR_NODE}
    assert_same(finished, untouched)


@pytest.mark.parametrize(
    "kind",
    [
        ArmSimNode,
        ImbicControllerNode,
        ImpedanceEstimatorNode,
        ExoDriver,
        Ros2ControlBridge,
        PingNode,
    ],
)
def test_a_node_that_is_started_with_simulated_time_ends_with_one_line(
    driver_domain: int, capfd: pytest.CaptureFixture[str], kind: Any
) -> None:
    assert run_node(kind, ["node", "--ros-args", "-p", "use_sim_time:=true"]) == 2
    (line,) = capfd.readouterr().err.splitlines()
    assert line.startswith("node: parameter 'use_sim_time' cannot be true: watchdogs and ramps")


# The attack itself: clocks of whole processes are set, as far as these can see.


class WallClock:
    """The wall clock of those processes that are started with `variables`."""

    def __init__(self, library: Path, file: Path) -> None:
        self._file = file
        file.write_bytes(struct.pack("q", 0))
        self.variables = {"LD_PRELOAD": str(library), "WALL_CLOCK": str(file)}

    def set(self, step: float) -> None:
        """Set it forward (s) of what it really is, or back."""
        with self._file.open("r+b") as file:
            file.write(struct.pack("q", round(step)))


@pytest.fixture
def wall_clock(tmp_path: Path) -> WallClock:
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("there is no C compiler to make a wall clock with that can be set")
    library = tmp_path / "wall_clock.so"
    source = Path(__file__).with_name("wall_clock.c")
    command = [compiler, "-shared", "-fPIC", "-o", str(library), str(source), "-ldl"]
    subprocess.run(command, check=True)
    clock = WallClock(library, tmp_path / "clock")
    clock.set(-600.0)
    look = [sys.executable, "-c", "import time; print(time.time())"]
    environment = {**os.environ, **clock.variables}
    told = subprocess.run(look, env=environment, capture_output=True, text=True, check=True)
    assert time.time() - float(told.stdout) > 590.0
    clock.set(0.0)
    return clock


@pytest.fixture
def processes() -> dict[str, subprocess.Popen[bytes]]:
    """Processes of separate nodes, by name."""
    return {}


@pytest.fixture
def give_to(
    monkeypatch: pytest.MonkeyPatch,
    wall_clock: WallClock,
    processes: dict[str, subprocess.Popen[bytes]],
) -> Callable[[str], None]:
    """Gives the clock to one of the nodes, where each has a process."""

    def give(victim: str) -> None:
        def popen_node(command: list[str], **options: Any) -> Any:
            for name, (module,) in graph.MODULES.items():
                if module in command:
                    if name == victim:
                        options["env"] = {**options["env"], **wall_clock.variables}
                    processes[name] = Popen(command, **options)
                    return processes[name]
            return Popen(command, **options)

        monkeypatch.setattr(subprocess, "Popen", popen_node)

    return give


@pytest.mark.slow
@pytest.mark.parametrize("victim", [SIM_NODE, CONTROLLER_NODE, ESTIMATOR_NODE])
@stepped
def test_when_the_clock_of_one_process_is_set_in_lockstep_expect_the_same_bits(
    untouched: FinishedRun,
    give_to: Callable[[str], None],
    wall_clock: WallClock,
    tmp_path: Path,
    victim: str,
    step: float,
) -> None:
    give_to(victim)
    finished = run(
        tmp_path / "out",
        processes="separate",
        on_phase=lambda phase: wall_clock.set(step) if phase is Phase.PERTURB else None,
    )
    assert_same(finished, untouched)


@pytest.mark.slow
@pytest.mark.parametrize("arrangement", ["composed", "separate"])
@stepped
def test_when_the_clock_of_the_whole_run_is_set_expect_the_same_bits(
    untouched: FinishedRun, wall_clock: WallClock, tmp_path: Path, arrangement: str, step: float
) -> None:
    out, config = tmp_path / "out", tmp_path / "config.yaml"
    config.write_text("joints: 1\nimbic_controller: {sequence.duration: 2.0}\n")
    command = [sys.executable, "-m", "armimp_bringup.cli", "run", "--config", str(config)]
    command += ["--processes", arrangement, "--out", str(out)]
    with Popen(command, env={**os.environ, **wall_clock.variables}) as process:
        while process.poll() is None and not list(out.glob("bags/*/*.mcap")):
            time.sleep(0.002)
        wall_clock.set(step)
        assert process.wait(60.0) == 0

    finished = FinishedRun(directory=out, summary=read_summary(out / "summary.json"))
    assert_same(finished, untouched)


@pytest.mark.slow
@pytest.mark.parametrize("victim", [CONTROLLER_NODE, SUPERVISOR_NODE])
@stepped
def test_when_the_rig_falls_silent_after_the_clock_was_set_expect_zero_torque_in_time(
    give_to: Callable[[str], None],
    wall_clock: WallClock,
    processes: dict[str, subprocess.Popen[bytes]],
    nodes: list[Node],
    tmp_path: Path,
    figures: Figures,
    victim: str,
    step: float,
) -> None:
    """The rig is stopped in real time; the last command other than zero is the last torque."""
    give_to(victim)
    torques: list[float] = []
    silent: list[float] = []
    heard: list[CommandSubscription] = []

    def on_command(command: tuple[float, ...]) -> None:
        if any(command):
            torques.append(time.monotonic())

    def attack() -> None:
        if victim == SUPERVISOR_NODE:
            set_clock(nodes[0], step)
        wall_clock.set(step)
        time.sleep(0.3)
        silent.append(time.monotonic())
        processes[SIM_NODE].send_signal(signal.SIGSTOP)
        time.sleep(1.0)
        processes[SIM_NODE].send_signal(signal.SIGCONT)

    def on_progress(progress: Progress) -> None:
        if not heard:
            heard.append(CommandSubscription(nodes[0], COMMANDS, 1, on_command))
            threading.Thread(target=attack).start()

    patient = {"sequence.duration": 5.0, "safety.watchdog_ticks": PATIENCE}
    finished = run(
        tmp_path / "out",
        mode="realtime",
        imbic_controller=patient,
        arm_sim={"watchdog_ticks": PATIENCE},
        on_progress=on_progress,
    )

    assert not finished.summary.valid
    assert silent, finished.summary.problems
    assert torques, finished.summary.problems
    last = torques[-1] - silent[0]
    figures.add(f"clock of {victim} set, then the rig silent", last_torque=(1e3 * last, "ms"))
    assert last < LIMIT
