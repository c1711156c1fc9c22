"""How a run grows with the number of joints and with the length of its trials."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from statistics import median

from armimp_bringup.bench import Measured
from armimp_bringup.config import load_config
from armimp_bringup.offline_estimate import estimate_bags
from armimp_bringup.parameters import node_parameters
from armimp_common.topics import RATE
from armimp_control.trial_sequencer import TrialSequencer
from armimp_estimation.parameters import EstimatorParameters
from armimp_sim.simulator import SimulatedRig
from benchmarks.command_run import COMMAND, MB, run_command
from benchmarks.shortest import shortest

CASES: tuple[tuple[int, float], ...] = ((2, 10.0), (3, 10.0), (7, 10.0), (2, 25.0), (2, 50.0))
"""Joints, and length of each trial in s."""
_REPEATS = 3


def measure_growth(tell: Callable[[str], None]) -> list[Measured]:
    """Measure composed runs with more joints and longer trials; takes one to two minutes.

    Parameters
    ----------
    tell : callable
        Told what is being measured.

    Raises
    ------
    GraphError
        If a run has no result.
    """
    return [one for joints, seconds in CASES for one in _case(joints, seconds, tell)]


def _case(joints: int, seconds: float, tell: Callable[[str], None]) -> list[Measured]:
    what = f"{joints} joints, {seconds:g} s"
    tell(f"{what}: run")
    _compile(joints)
    with tempfile.TemporaryDirectory() as folder:
        directory = Path(folder) / "out"
        options = ("--joints", str(joints), "--duration", str(seconds))
        run = run_command(directory, *options, watch_memory=True)
        for problem in run.summary.problems:
            tell(f"{what}: {problem}")
        bags = sorted((directory / "bags").iterdir())
        size = sum(path.stat().st_size for bag in bags for path in bag.iterdir())
        tell(f"{what}: estimate")
        names = EstimatorParameters().estimators
        estimate = shortest(lambda: estimate_bags(bags, names), _REPEATS)
    figures = [
        ("ticks per second", RATE * median(one.rtf for one in run.summary.trials), "1/s"),
        ("run outside of its trials", run.outside, "s"),
        ("largest resident size", run.peaks[COMMAND] / MB, "MB"),
        ("bag of a trial", size / len(bags) / MB, "MB"),
        ("from bag to result, each trial", estimate / len(bags), "s"),
    ]
    return [
        Measured(label=f"{what}: {label}", value=value, unit=unit) for label, value, unit in figures
    ]


def _compile(joints: int) -> None:
    """Compile everything that depends on the number of joints, so that no run has to."""
    parameters = node_parameters(load_config(None, {"joints": joints}), None)
    TrialSequencer(parameters.controller, lambda _: None)
    SimulatedRig(parameters.simulator)
