"""The wall clock is set while an experiment runs: nothing waits longer, no bit differs."""

import os
import shutil
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
import yaml

from armimp_common.executor import run_node
from armimp_common.topics import CONTROLLER_NODE, ESTIMATOR_NODE, SIM_NODE, SUPERVISOR_NODE
from armimp_control.node import ImbicControllerNode
from armimp_driver_template.node import ExoDriver
from armimp_estimation.node import ImpedanceEstimatorNode
from armimp_estimation.summary import read_summary
from armimp_ros2_control.node import Ros2ControlBridge
from armimp_sim.node import ArmSimNode
from benchmarks.ping_pong import PingNode
from support.fault_figures import Figures
from support.graph import CLOCK_STEPS
from support.processes import permitted_priority
from support.runs import FinishedRun

pytestmark = pytest.mark.usefixtures("environment")
PATIENCE = 40
"""Periods until watchdogs take the torque away: enough that no stall of the machine does."""
LIMIT = 0.2
"""Time after the last sample by which torque must be zero (s): a requirement of safety."""
SHORT = {"duration": 2.0}


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

PROGRAM = "clock_attack"
TARGETS = {
    "composed": "",
    "separate": "",
    CONTROLLER_NODE: "armimp_control.node",
    SIM_NODE: f"{PROGRAM} --ros-args",
    ESTIMATOR_NODE: "armimp_estimation.node",
    SUPERVISOR_NODE: f"{PROGRAM} run",
}
"""Whose clock is set: all processes of an arrangement, or the one with this command line."""


@pytest.fixture(scope="module")
def wall_clock(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Library with a wall clock that can be set."""
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("there is no C compiler to make a wall clock with that can be set")
    library = tmp_path_factory.mktemp("wall_clock") / "wall_clock.so"
    source = Path(__file__).with_name("wall_clock.c")
    command = [compiler, "-shared", "-fPIC", "-o", str(library), str(source), "-ldl"]
    subprocess.run(command, check=True)
    return library


def attack(
    directory: Path,
    wall_clock: Path,
    target: str,
    step: float,
    config: Mapping[str, Any],
    **variables: str,
) -> int:
    """Run an experiment during which a clock is set, and return its exit status."""
    seen, settings = (directory / name for name in ("seen", "config.yaml"))
    settings.write_text(yaml.safe_dump(dict(config)))
    processes = "composed" if target == "composed" else "separate"
    (directory / "clock").write_bytes(bytes(8))
    environment = {
        **os.environ,
        "LD_PRELOAD": str(wall_clock),
        "PYTHONPATH": str(Path(__file__).parent),
        "WALL_CLOCK": str(directory / "clock"),
        "WALL_CLOCK_OF": TARGETS[target],
        "WALL_CLOCK_SEEN": str(seen),
        "CLOCK_STEP": str(round(step)),
        **variables,
    }
    command = [sys.executable, "-m", PROGRAM, "run", "--config", str(settings)]
    command += ["--processes", processes, "--out", str(directory / "out")]
    status = subprocess.run(command, env=environment, timeout=120.0, check=False).returncode
    told = len(set(seen.read_text().split())) if seen.exists() else 0
    assert told >= (4 if target == "separate" else 1), "the clock was not set"
    return status


@pytest.mark.slow
@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("step", CLOCK_STEPS)
def test_when_the_clock_is_set_in_lockstep_expect_the_same_bits(
    composed: FinishedRun, wall_clock: Path, tmp_path: Path, target: str, step: float
) -> None:
    assert attack(tmp_path, wall_clock, target, step, SHORT, CLOCK_TICK="1500") == 0

    summary = read_summary(tmp_path / "out" / "summary.json")
    FinishedRun(directory=tmp_path / "out", summary=summary).assert_same_streams(composed)
    assert summary.problems == composed.summary.problems
    assert summary.estimators == composed.summary.estimators


@pytest.mark.alone
@pytest.mark.slow
@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("step", CLOCK_STEPS)
def test_when_the_rig_falls_silent_after_the_clock_was_set_expect_zero_torque_in_time(
    wall_clock: Path, tmp_path: Path, figures: Figures, target: str, step: float
) -> None:
    """Torque is zero when the drives of the rig have received it."""
    config = {
        "mode": "realtime",
        "joints": 1,
        "priority": permitted_priority(),
        "imbic_controller": {"sequence.duration": 5.0, "safety.watchdog_ticks": PATIENCE},
        "arm_sim": {"watchdog_ticks": PATIENCE},
    }
    log = tmp_path / "log"
    status = attack(tmp_path, wall_clock, target, step, config, CLOCK_TICK="50", RIG_LOG=str(log))

    assert status == 1
    problems = read_summary(tmp_path / "out" / "summary.json").problems
    assert any("no sensor sample arrived any more" in str(one) for one in problems), problems
    noted = [(float(line.split()[0]), line.split()[1]) for line in log.read_text().splitlines()]
    (silent,) = [moment for moment, what in noted if what == "sample"]
    last = max(moment for moment, what in noted if what == "torque")
    safe = min(moment for moment, what in noted if what == "zero" and moment > last)
    figures.add(
        f"clock set ({target}), then the rig silent",
        zero_torque_after=(1e3 * (safe - silent), "ms"),
    )
    assert safe - silent < LIMIT
