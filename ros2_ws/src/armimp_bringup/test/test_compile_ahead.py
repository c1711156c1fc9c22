"""The first run on a machine: plant and law are compiled beforehand, side by side."""

import os
from pathlib import Path

import pytest

from support.processes import run_python

PROGRAM = """
import numpy as np
from armimp_bringup.compile_ahead import compile_ahead
from armimp_bringup.config import ExperimentConfig
from armimp_bringup.parameters import node_parameters
from armimp_common.compiled import on_compiling
from armimp_control.trial_sequencer import TrialSequencer
from armimp_sim.simulator import SimulatedRig

compiled = []
for rig in ("paper", "realistic"):
    parameters = node_parameters(ExperimentConfig(duration=2.0, rig=rig), None)
    compile_ahead(parameters)
    compiled.clear()
    on_compiling(lambda: compiled.append("a function"))
    sequencer = TrialSequencer(parameters.controller, print)
    simulated = SimulatedRig(parameters.simulator)
    sequencer.answer(simulated.stamp_ns, simulated.position.tolist(), simulated.torque.tolist())
    simulated.step(sequencer.command.tolist())
    assert not compiled, rig
"""


@pytest.mark.slow
def test_after_compiling_ahead_a_run_compiles_nothing(tmp_path: Path) -> None:
    run_python("-c", PROGRAM, env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)})
