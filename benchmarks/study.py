"""How fast the study runs: plant and law in one lane and in many, estimates, and the whole."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from armimp_bringup.bench import Measured, available_cores
from armimp_bringup.config import ExperimentConfig
from armimp_bringup.offline import run_offline, simulate
from armimp_bringup.parameters import NodeParameters, node_parameters
from armimp_bringup.study import Condition, select_conditions
from armimp_bringup.study.engine import (
    condition_config,
    estimate_condition,
    split_evenly,
)
from armimp_common.versions import software
from armimp_control.sequence import SequenceParameters
from armimp_sim.dynamics import WIDTH
from benchmarks.shortest import shortest

TRIAL = 50.0
"""Length of the trials of the study, s."""
TARGET = 20.0
"""Largest time for all conditions with two trials each on two cores, s."""
_REPEATS = 5
_SETTLE = _REST = 0.05
_SCALAR, _BATCH = 1.0, 2.0  # s of each trial that are simulated


def time_study(tell: Callable[[str], None]) -> list[Measured]:
    """Measure the study engine after compilation; takes about ten seconds.

    Parameters
    ----------
    tell : callable
        Told what is being measured.
    """
    base = ExperimentConfig(duration=TRIAL)
    conditions = select_conditions([], "0")
    rigs = [node_parameters(condition_config(base, one), None) for one in conditions[:WIDTH]]
    cores = available_cores()
    tell("compiling")
    for lanes in (1, WIDTH):
        run_offline([_shortened(rig, 0.01) for rig in rigs[:lanes]])
    tell("one trial at a time")
    scalar = _per_trial(rigs[:1], _SCALAR)
    tell(f"{WIDTH} trials side by side")
    batch = _per_trial(rigs, _BATCH)
    tell(f"the same on {cores} cores at once")
    loaded = _per_trial(rigs, _BATCH, threads=cores)
    tell("estimates")
    estimate = _per_estimate(base, conditions[-1])
    trials = len(conditions) * base.joints
    # A block takes its time whether or not all its lanes are in use.
    blocks = -(-len(split_evenly(conditions, cores)) // cores)
    simulated = blocks * WIDTH * base.joints * loaded
    estimated = len(conditions) * estimate / cores
    return [
        Measured(label="50 s trial, one lane, per core", value=scalar, unit="s"),
        Measured(label=f"50 s trial, {WIDTH} lanes, per core", value=batch, unit="s"),
        Measured(label="one lane over many", value=scalar / batch),
        Measured(
            label=f"50 s trial, {WIDTH} lanes, all cores busy, per core",
            value=loaded,
            unit="s",
        ),
        Measured(
            label=f"estimates of one condition ({', '.join(base.estimators)})",
            value=estimate,
            unit="s",
        ),
        Measured(
            label=f"study of {trials} trials on {cores} cores, extrapolated",
            value=simulated + estimated,
            unit="s",
            limit=TARGET,
        ),
    ]


def _shortened(rig: NodeParameters, duration: float) -> NodeParameters:
    sequence = SequenceParameters(duration=duration, settle=_SETTLE, rest=_REST)
    return replace(rig, controller=rig.controller.model_copy(update={"sequence": sequence}))


def _per_trial(rigs: Sequence[NodeParameters], duration: float, *, threads: int = 1) -> float:
    """Time of one core for a trial of full length, s."""
    short = [_shortened(rig, duration) for rig in rigs]
    simulated = (_SETTLE + duration + _REST) * len(rigs[0].controller.joints) * len(rigs)
    return shortest(lambda: run_offline(short), _REPEATS, threads) / simulated * TRIAL


def _per_estimate(base: ExperimentConfig, condition: Condition) -> float:
    """Time for all estimates of a condition, s."""
    here, (experiment,) = software(), simulate([condition_config(base, condition)])
    return shortest(lambda: estimate_condition(here, condition, experiment), _REPEATS)
