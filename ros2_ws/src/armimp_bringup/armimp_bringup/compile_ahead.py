"""Compiles plant and law side by side, for the first run on a machine.

numba compiles one function at a time in a process, and the two take about as long as each other. So
the plant is compiled by another process (``python -m armimp_bringup.compile_ahead PARAMETERS``),
from whose cache this one and the nodes take it.
"""

from __future__ import annotations

import subprocess
import sys

import numpy as np

from armimp_bringup.parameters import NodeParameters
from armimp_common.compiled import is_cached
from armimp_control.laws.law import Controller
from armimp_control.perturbation import perturbation
from armimp_sim.parameters import SimulatorParameters
from armimp_sim.plant import Plant, tick


def compile_ahead(parameters: NodeParameters) -> None:
    """Compile what a run of these parameters calls, unless this machine has compiled it before."""
    if is_cached(tick):
        return
    plant = subprocess.Popen(
        [sys.executable, "-m", __spec__.name, parameters.simulator.model_dump_json()],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,  # what fails there is compiled, and fails, in a node
        start_new_session=True,  # Ctrl-C is for the parent
    )
    try:
        _compile_law(parameters)
    finally:
        plant.wait()


def _compile_law(parameters: NodeParameters) -> None:
    rig = parameters.rig()
    controller = Controller(rig.controller, safety=rig.safety)
    controller.compute()
    controller.stop()
    controller.continue_ramp(1)
    perturbation(rig.perturbation, joint=0, trial=1, ticks=1, seed=rig.seed)


def _compile_plant(parameters: SimulatorParameters) -> None:
    plant = Plant([parameters.plant_config()])
    nothing = np.zeros_like(plant.position)
    plant.tick(nothing, nothing)


if __name__ == "__main__":
    _compile_plant(SimulatorParameters.model_validate_json(sys.argv[1]))
