"""How the choice of the controller's parameters limits accuracy.

Four parameters of the law are varied, each alone around the defaults: the internal model M̄ as a
multiple of M_r(θ_0), the gain Γ, the natural frequency of locked joints, and their dither. All
settings get the same seeds, so the same perturbations and voluntary torques.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np

from armimp_bringup.config import ExperimentConfig, Overrides
from armimp_bringup.offline import OfflineTrial, run_offline
from armimp_bringup.parameters import NodeParameters, node_parameters
from armimp_bringup.study.conditions import Condition, parse_seeds
from armimp_bringup.study.engine import Batch, condition_config, estimate_condition, software
from armimp_bringup.terminal import leave_terminal, phase
from armimp_common.errors import ConfigurationError, DataError
from armimp_sim.plant import IntegrationError
from research.controller_figures import controller_figure
from research.controller_outcomes import Cell, Outcome, Place, Setting
from research.controller_tables import print_cells
from research.decomposition_trials import in_blocks, in_threads
from research.options import InvestigationOptions
from research.writing import (
    figure_style,
    to_json,
    write_figure,
    write_tables,
)

MODEL, GAMMA, LOCK, DITHER = "model_factor", "gamma", "lock_frequency", "lock_dither"
PARAMETERS: Final[Mapping[str, str]] = {
    MODEL: "M̄ / M_r",
    GAMMA: "Γ (rad/s)",
    LOCK: "ω of locked joints (rad/s)",
    DITHER: "dither (counts)",
}
"""What is varied, and how it is called."""


@dataclass(frozen=True, kw_only=True)
class ControllerPlan:
    """What is simulated.

    Parameters
    ----------
    base : everything but seed, perturbation level and what is varied. The plant takes steps of
        0.05 ms, since the default of 0.01 ms would need five times as long.
    seeds : as for :func:`armimp_bringup.study.conditions.parse_seeds`
    places : levels of the perturbation, and voluntary torques of every joint
    values : what the parameters are set to; a value that is the default is not run twice
    """

    base: ExperimentConfig = field(
        default_factory=lambda: ExperimentConfig(arm_sim={"substeps": 20})
    )
    seeds: str = "0:8"
    places: tuple[Place, ...] = (
        Place(perturbation=1, voluntary=0.0),
        Place(perturbation=3, voluntary=0.0),
        Place(perturbation=3, voluntary=0.3),
    )
    values: Mapping[str, tuple[float, ...]] = field(
        default_factory=lambda: {
            MODEL: (0.2, 0.3, 0.4, 0.6, 0.8, 1.0),
            GAMMA: (25.0, 50.0, 100.0, 200.0, 400.0),
            LOCK: (25.0, 50.0, 100.0, 200.0, 300.0),
            DITHER: (0.0, 0.35, 0.7, 1.05, 1.4),
        }
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Findings:
    """Result of the investigation.

    Attributes
    ----------
    defaults : value of every parameter
    cells : by setting, place and estimator
    refused : settings that the configuration does not accept, and why
    """

    defaults: Mapping[str, float]
    cells: tuple[Cell, ...]
    refused: Mapping[Setting, str]


@dataclass(frozen=True, kw_only=True)
class _Lane:
    """One experiment; ``base`` holds the setting and the voluntary torque."""

    setting: Setting
    place: Place
    base: ExperimentConfig
    condition: Condition

    def parameters(self) -> NodeParameters:
        return node_parameters(condition_config(self.base, self.condition), None)


def run_controller(plan: ControllerPlan, workers: int | None = None) -> Findings:
    """Simulate and estimate all of a plan.

    Raises
    ------
    ConfigurationError
        If the plan does not make experiments with the default controller.
    ArmimpError
        If they cannot be estimated.
    """
    preset = node_parameters(plan.base, None)
    defaults = default_values(preset)
    seeds = parse_seeds(plan.seeds)
    lanes: list[_Lane] = []
    refused: dict[Setting, str] = {}
    for setting in settings(plan, defaults):
        changed = {**plan.base.imbic_controller, **overrides(setting, preset)}
        base = plan.base.model_copy(update={"imbic_controller": changed})
        try:
            node_parameters(base, None)
        except ConfigurationError as error:
            if setting.parameter is None:
                raise
            refused[setting] = str(error)
            continue
        lanes += _lanes(plan, setting, base, seeds)
    found: dict[tuple[Setting, Place, str], list[Outcome]] = {}
    lost: dict[tuple[Setting, Place], int] = {}
    here = software()

    def work(block: tuple[_Lane, ...]) -> list[tuple[_Lane, list[Outcome]]]:
        return [
            (lane, _outcomes(lane, trials, here) if trials else [])
            for lane, trials in _simulated(block)
        ]

    for results in in_threads(work, in_blocks(lanes), workers):
        for lane, outcomes in results:
            key = lane.setting, lane.place
            lost[key] = lost.get(key, 0) + (not outcomes)
            for one in outcomes:
                found.setdefault((*key, one.estimator), []).append(one)
    cells = tuple(
        Cell.of(setting, place, name, found.get((setting, place, name), []), count)
        for (setting, place), count in lost.items()
        for name in plan.base.estimators
    )
    return Findings(defaults=defaults, cells=cells, refused=refused)


def default_values(preset: NodeParameters) -> dict[str, float]:
    """What the parameters are set to by default, in the units of :data:`PARAMETERS`."""
    law, target = preset.controller.law, preset.controller.target
    return {
        MODEL: law.model_inertia[0] / preset.controller.known.robot_inertia[0],
        GAMMA: law.gamma,
        LOCK: target.lock_frequency,
        DITHER: target.lock_dither / _count(preset),
    }


def settings(plan: ControllerPlan, defaults: Mapping[str, float]) -> list[Setting]:
    """All settings, the default one first and once."""
    return [
        Setting(),
        *(
            Setting(parameter=name, value=value)
            for name, values in plan.values.items()
            for value in values
            if not np.isclose(value, defaults[name])
        ),
    ]


def overrides(setting: Setting, preset: NodeParameters) -> Overrides:
    """Parameters of the controller node that make up a setting.

    Raises
    ------
    ConfigurationError
        If there is no such parameter to vary.
    """
    value = setting.value
    if setting.parameter is None:
        return {}
    if setting.parameter == MODEL:
        robot = preset.controller.known.robot_inertia
        return {"law.model_inertia": [value * inertia for inertia in robot]}
    if setting.parameter == GAMMA:
        return {"law.gamma": value}
    if setting.parameter == LOCK:
        return {"target.lock_frequency": value}
    if setting.parameter == DITHER:
        return {"target.lock_dither": value * _count(preset)}
    raise ConfigurationError(
        f"controller: cannot vary {setting.parameter!r}, only {', '.join(PARAMETERS)}"
    )


def investigate(options: InvestigationOptions, plan: ControllerPlan | None = None) -> int:
    """Vary the parameters, write ``controller.*`` and print what was found.

    Parameters
    ----------
    options : InvestigationOptions
    plan : ControllerPlan, optional
        By default 8 seeds of 50 s trials at friction and resolution level 3.

    Returns
    -------
    int
        Exit status 0.

    Raises
    ------
    ArmimpError
        As :func:`run_controller`, or if a file can't be written.
    """
    chosen = plan if plan is not None else ControllerPlan()
    if options.seeds is not None:
        chosen = replace(chosen, seeds=options.seeds)
    findings = run_controller(chosen, options.workers)
    rows = [cell.described() for cell in findings.cells]
    result: dict[str, Any] = {
        "schema": 1,
        "experiment": chosen.base.model_dump(mode="json", exclude={"seed", "perturbation"}),
        "seeds": chosen.seeds,
        "defaults": dict(findings.defaults),
        "units": "errors in % of |X_ij|, model_factor in M_r, gamma and lock_frequency in rad/s, "
        "lock_dither in counts of the encoder, commands in N·m",
        "refused": [
            {"parameter": setting.parameter, "value": setting.value, "reason": reason}
            for setting, reason in findings.refused.items()
        ],
        "cells": rows,
    }
    write_tables(options.out, "controller", result, rows)
    phase("drawing")
    with figure_style():
        figure = controller_figure(findings.cells, findings.defaults, PARAMETERS)
        write_figure(options.out, "controller", figure)
    leave_terminal()
    if options.json:
        print(to_json(result))
    else:
        print_cells(findings.cells, findings.refused, PARAMETERS, len(parse_seeds(chosen.seeds)))
    return 0


def _lanes(
    plan: ControllerPlan, setting: Setting, base: ExperimentConfig, seeds: Sequence[int]
) -> Iterator[_Lane]:
    for place in plan.places:
        person = {**base.arm_sim, "voluntary.rms": place.voluntary}
        for seed in seeds:
            yield _Lane(
                setting=setting,
                place=place,
                base=base.model_copy(update={"arm_sim": person}),
                condition=Condition(
                    seed=seed,
                    friction=base.friction,
                    resolution=base.resolution,
                    perturbation=place.perturbation,
                ),
            )


def _simulated(block: Sequence[_Lane]) -> list[tuple[_Lane, list[OfflineTrial]]]:
    """Trials of each lane; none if its safety gate stopped it or it went astray."""
    try:
        trials = run_offline([lane.parameters().rig() for lane in block])
    except (DataError, IntegrationError):
        if len(block) == 1:
            return [(block[0], [])]
        # It is not said which lane it was.
        half = len(block) // 2
        return [*_simulated(block[:half]), *_simulated(block[half:])]
    return list(zip(block, trials, strict=True))


def _outcomes(lane: _Lane, trials: list[OfflineTrial], here: Mapping[str, Any]) -> list[Outcome]:
    batch = Batch(base=lane.base, conditions=(lane.condition,), software=here)
    result = estimate_condition(batch, lane.condition, lane.parameters(), trials)
    return [Outcome.of(result.entry, name, trials) for name in lane.base.estimators]


def _count(preset: NodeParameters) -> float:
    """One count of the encoders, rad.

    Raises
    ------
    ConfigurationError
        If they are not quantised.
    """
    resolution = preset.simulator.plant_config().sensors.encoder_resolution
    if not resolution > 0.0:
        raise ConfigurationError("controller: dither in counts needs a resolution level above 0")
    return resolution
