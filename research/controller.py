"""Cost of a control law in chatter and in accuracy.

Three parameters of the law with an observer are varied, one at a time around the defaults: how fast
the observer follows unknown torques, the gain Γ, and the natural frequency of locked joints.
Time-delay estimation serves as the reference. All settings get the same perturbations.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from armimp_bringup.config import ExperimentConfig, Overrides
from armimp_bringup.offline import SimulatedExperiment, simulate
from armimp_bringup.parameters import node_parameters
from armimp_bringup.study import parse_seeds
from armimp_common.arrays import FloatArray
from armimp_common.errors import ArmimpError, ConfigurationError
from research.cells import LETTERS, Levels, Plan
from research.controller_figures import controller_figure
from research.decomposition_trials import in_threads
from research.options import InvestigationOptions
from research.writing import present, print_table

WALK, GAMMA, LOCK = "walk", "gamma", "lock"
PARAMETERS: Final[Mapping[str, str]] = {
    WALK: "unknown torques / default",
    GAMMA: "Γ (rad/s)",
    LOCK: "ω of locked joints (rad/s)",
}
"""Parameters that are varied, and their labels."""
REFERENCE: Final = "tde"


@dataclass(frozen=True, kw_only=True)
class ControllerPlan(Plan):
    """The simulations to run."""

    VARIED = frozenset()

    base: ExperimentConfig = field(
        default_factory=lambda: ExperimentConfig(
            internal_model="observer", arm_sim={"substeps": 20}
        )
    )
    seeds: str = "0:2"
    levels: tuple[Levels, ...] = (
        (0, 0, 1),
        (1, 3, 1),
        (3, 1, 1),
        (3, 3, 1),
        (3, 3, 3),
    )
    """Levels of friction, resolution and perturbation."""
    values: Mapping[str, tuple[float, ...]] = field(
        default_factory=lambda: {
            WALK: (0.1, 0.3, 1.0, 3.0),
            GAMMA: (50.0, 100.0, 200.0),
            LOCK: (60.0, 90.0, 120.0, 180.0),
        }
    )
    """Values of the parameters."""


def settings(plan: ControllerPlan) -> list[tuple[str, float]]:
    """Return parameter and value of each setting; the reference comes first."""
    varied = [(name, value) for name, values in plan.values.items() for value in values]
    return [(REFERENCE, 0.0), *varied]


def changed(base: ExperimentConfig, setting: tuple[str, float]) -> ExperimentConfig:
    """Return the configuration of a setting.

    Raises
    ------
    ConfigurationError
        If there is no such parameter to vary.
    """
    name, value = setting
    if name == REFERENCE:
        return base.model_copy(update={"internal_model": "tde"})
    law = node_parameters(base, None).controller.law
    changes: dict[str, Overrides] = {
        WALK: {
            "law.perturbed_walk": [value * one for one in law.perturbed_walk],
            "law.locked_walk": [value * one for one in law.locked_walk],
        },
        GAMMA: {"law.gamma": value},
        LOCK: {"target.lock_frequency": value},
    }
    if name not in changes:
        raise ConfigurationError(f"cannot vary {name!r}, only {', '.join(changes)}")
    overrides = {**base.imbic_controller, **changes[name]}
    return base.model_copy(update={"imbic_controller": overrides})


def measure(experiment: SimulatedExperiment) -> dict[str, float]:
    """Return chatter, motion of locked joints and accuracy of one experiment; errors in %."""
    found = experiment.identify(experiment.config.estimators)
    records, truth = experiment.records, experiment.truth
    commands = [one.command for one in records if one.command is not None]
    row = {
        "command_step": _steps(commands),
        "torque_step": _steps([one.torque for one in records]),
        "largest_command": max(float(np.max(np.abs(one))) for one in commands),
        "bias_bound": 100.0 * max(float(np.max(one.bias_bound)) for one in found.trials),
        "lock_ratio": max(
            float(ratio)
            for one in found.trials
            for joint, ratio in enumerate(one.lock_ratio)
            if joint != one.k - 1
        ),
    }
    for name, result in found.estimators.items():
        assert result.vaf is not None
        row[f"{name}_vaf"] = float(np.min(result.vaf))
        row[f"{name}_coherence"] = float(np.min(result.coherence.derived.mean(axis=-1)))
        for letter in LETTERS:
            error = getattr(result.fit.mbk, letter) / getattr(truth, letter) - 1.0
            row[f"{name}_{letter}"] = 100.0 * float(np.max(np.abs(error)))
    return row


def worst(rows: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Return the worst of each value over the seeds."""
    floors = ("_vaf", "_coherence")
    return {
        name: (min if name.endswith(floors) else max)(row[name] for row in rows) for name in rows[0]
    }


def run_controller(plan: ControllerPlan, workers: int | None = None) -> list[dict[str, Any]]:
    """Simulate and estimate all of a plan; return a row for each setting and level.

    A setting that the stability check refuses, or whose runs the safety limiter stops, has a row
    with the reason and without values.
    """
    cells = list(itertools.product(settings(plan), plan.levels))
    seeds = parse_seeds(plan.seeds)

    def work(block: tuple[tuple[tuple[str, float], Levels], ...]) -> list[Any]:
        return [(cell, _cell(plan.base, *cell, seeds)) for cell in block]

    done = in_threads(work, [(cell,) for cell in cells], workers)
    found = {cell: row for results in done for cell, row in results}
    return [found[cell] for cell in cells]


def _cell(
    base: ExperimentConfig,
    setting: tuple[str, float],
    levels: Levels,
    seeds: Sequence[int],
) -> dict[str, Any]:
    friction, resolution, perturbation = levels
    at = {"friction": friction, "resolution": resolution, "perturbation": perturbation}
    row: dict[str, Any] = {"parameter": setting[0], "value": setting[1], **at, "refused": ""}
    try:
        config = changed(base.model_copy(update=at), setting)
        experiments = simulate([config.model_copy(update={"seed": seed}) for seed in seeds])
    except ArmimpError as error:
        return {**row, "refused": str(error)}
    return {**row, **worst([measure(one) for one in experiments])}


def _steps(signals: Sequence[FloatArray]) -> float:
    """Rms change from tick to tick."""
    return float(np.sqrt(np.mean([np.mean(np.diff(one, axis=1) ** 2) for one in signals])))


def investigate(options: InvestigationOptions, plan: ControllerPlan | None = None) -> int:
    """Write and print what each setting leads to; returns exit status 0."""
    chosen = (plan or ControllerPlan()).with_seeds(options)
    rows = run_controller(chosen, options.workers)
    shown = [row for row in rows if not row["refused"]]
    result = {
        **chosen.described(),
        "schema": 2,
        "rows": rows,
    }
    if not present(
        options,
        "controller",
        result,
        shown,
        lambda: {"controller": controller_figure(shown, PARAMETERS, REFERENCE)},
    ):
        return 0
    columns = [name for name in shown[0] if name not in {"parameter", "value", "refused"}]
    for parameter, value in settings(chosen):
        of_setting = [
            row for row in shown if (row["parameter"], row["value"]) == (parameter, value)
        ]
        print_table(
            f"{PARAMETERS.get(parameter, parameter)} {value:g}; worst of all seeds, errors in %",
            columns,
            [[f"{row[name]:.4g}" for name in columns] for row in of_setting],
        )
    for row in rows:
        if row["refused"]:
            print(f"refused: {row['parameter']} {row['value']:g}: {row['refused']}")
    return 0
