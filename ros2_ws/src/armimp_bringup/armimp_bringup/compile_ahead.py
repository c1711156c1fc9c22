"""Compiles plant and law in parallel, for the first run of its kind on a machine.

numba compiles one function at a time in a process, and both take about equally long. So another
process (``python -m armimp_bringup.compile_ahead PARAMETERS``) compiles the plant; this process and
the nodes then take it from the cache.
"""

from __future__ import annotations

import subprocess
import sys
from contextlib import suppress

import numpy as np

from armimp_bringup.parameters import NodeParameters
from armimp_common.compiled import cache_folder
from armimp_control.laws.law import compile_law
from armimp_sim.parameters import SimulatorParameters
from armimp_sim.plant import Plant, tick


def compile_ahead(parameters: NodeParameters) -> None:
    """Compile what a run with these parameters calls, unless it is in the cache already."""
    rig, folder = parameters.simulator, cache_folder(tick)
    # All rigs of one name have the same types, and so the same machine code.
    name = f"{'ideal' if rig.ideal else 'real'}-{len(rig.joints)}{'-soft' if rig.soft else ''}"
    if folder is None or (mark := folder / f"compiled-{name}").exists():
        return
    plant = subprocess.Popen(
        [sys.executable, "-m", __spec__.name, rig.model_dump_json()],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,  # if it fails there, a node compiles it and shows the failure
        start_new_session=True,  # Ctrl-C is for the parent
    )
    try:
        law = parameters.controller
        compile_law(law.control_law(), law.safety)
        law.signal(0, trial=1, ticks=1)
    finally:
        failed = plant.wait()
    with suppress(OSError):  # as on a full disk: the next run comes here again, which is quick
        if not failed:
            mark.touch()


if __name__ == "__main__":
    _plant = Plant([SimulatorParameters.model_validate_json(sys.argv[1])])
    _plant.tick(np.zeros_like(_plant.position), np.zeros_like(_plant.position))
