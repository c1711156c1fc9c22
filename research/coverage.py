"""Are the standard errors of M, B and K honest? How often their intervals hold the truth."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from armimp_bringup.config import ExperimentConfig
from armimp_bringup.offline import simulate
from armimp_bringup.study.conditions import parse_seeds
from armimp_bringup.terminal import display
from armimp_common.errors import ConfigurationError
from armimp_common.topics import NS_PER_S, PERIOD_NS
from armimp_estimation.spectra import WelchConfig
from research.coverage_figure import coverage_figure
from research.coverage_statistics import NOMINAL, TARGET, Cell
from research.coverage_tables import in_words, print_cells
from research.decomposition_trials import (
    estimate,
    in_blocks,
    in_threads,
    matrices,
    scales,
    with_voluntary,
)
from research.options import InvestigationOptions
from research.writing import (
    figure_style,
    to_json,
    write_figure,
    write_tables,
)

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class CoveragePlan:
    """What is simulated."""

    base: ExperimentConfig = field(
        default_factory=lambda: ExperimentConfig(arm_sim={"substeps": 20})
    )
    """Everything but seed, levels and voluntary torque. The plant takes steps of 0.05 ms: those of
    0.01 ms, the default, find the same in twice the time."""
    levels: tuple[tuple[int, int, int], ...] = ((1, 1, 2), (3, 3, 3), (0, 3, 1), (3, 3, 1))
    """Of friction, resolution and perturbation."""
    seeds: str = "0:200"
    """As for :func:`armimp_bringup.study.conditions.parse_seeds`."""
    voluntary: tuple[float, ...] = (0.3, 0.0)
    """Rms of the voluntary torque, N·m."""
    estimators: tuple[str, ...] = ("lpm_full", "welch_siso")


@dataclass(frozen=True, kw_only=True)
class _Setting:
    """What all runs of a cell have in common."""

    levels: tuple[int, int, int]
    voluntary: float
    estimator: str


@dataclass(frozen=True, kw_only=True)
class _Task:
    """Runs that are simulated side by side."""

    base: ExperimentConfig
    levels: tuple[int, int, int]
    voluntary: float
    estimators: tuple[str, ...]
    seeds: tuple[int, ...]

    def __call__(self) -> list[tuple[_Setting, FloatArray, FloatArray]]:
        """Relative errors and relative standard errors of M, B and K of each run."""
        levels = dict(zip(("friction", "resolution", "perturbation"), self.levels, strict=True))
        configs = with_voluntary(self.base.model_copy(update=levels), self.voluntary, self.seeds)
        welch = WelchConfig.for_samples(round(self.base.duration * NS_PER_S / PERIOD_NS))
        found = []
        for experiment in simulate(configs):
            true = matrices(experiment.truth)
            for name, run in estimate(experiment, self.estimators, welch).items():
                setting = _Setting(levels=self.levels, voluntary=self.voluntary, estimator=name)
                stated = np.stack((run.fit.M_se, run.fit.B_se, run.fit.K_se))
                errors = matrices(run.fit.mbk) - true
                found.append((setting, errors / scales(true), stated / scales(true)))
        return found


def run_coverage(plan: CoveragePlan, workers: int | None = None) -> list[Cell]:
    """Simulate and estimate all of a plan.

    Returns
    -------
    list of Cell
        By estimator, voluntary torque and levels, in the order of the plan.

    Raises
    ------
    ConfigurationError, ArmimpError
        If there are fewer than two seeds, the plan does not make experiments, or they cannot be
        simulated or estimated.
    """
    seeds = parse_seeds(plan.seeds)
    if len(seeds) < 2:
        raise ConfigurationError(f"--seeds {plan.seeds}: one seed is too few to tell a share")
    tasks = [
        _Task(
            base=plan.base,
            levels=levels,
            voluntary=voluntary,
            estimators=plan.estimators,
            seeds=block,
        )
        for voluntary in plan.voluntary
        for levels in plan.levels
        for block in in_blocks(seeds)
    ]
    found: dict[_Setting, list[tuple[FloatArray, FloatArray]]] = {}
    for runs in in_threads(_Task.__call__, tasks, workers):
        for setting, errors, stated in runs:
            found.setdefault(setting, []).append((errors, stated))
    return [
        Cell(
            levels=setting.levels,
            voluntary=setting.voluntary,
            estimator=setting.estimator,
            errors=np.stack([errors for errors, _ in runs]),
            stated=np.stack([stated for _, stated in runs]),
        )
        for setting, runs in sorted(
            found.items(), key=lambda item: plan.estimators.index(item[0].estimator)
        )
    ]


def investigate(options: InvestigationOptions, plan: CoveragePlan | None = None) -> int:
    """Count how often the intervals hold the truth, write ``coverage.*`` and print the shares.

    Parameters
    ----------
    options : InvestigationOptions
    plan : CoveragePlan, optional
        By default 200 seeds of 50 s trials in four conditions, with and without voluntary torque.

    Returns
    -------
    int
        Exit status 0, whatever the shares are: this is a measurement.

    Raises
    ------
    ArmimpError
        As :func:`run_coverage`, or if a file can't be written.
    """
    chosen = plan if plan is not None else CoveragePlan()
    if options.seeds is not None:
        chosen = replace(chosen, seeds=options.seeds)
    cells = run_coverage(chosen, options.workers)
    sentences = in_words(cells)
    result = {
        "schema": 1,
        "experiment": chosen.base.model_dump(
            mode="json", exclude={"seed", "estimators", "friction", "resolution", "perturbation"}
        ),
        "seeds": chosen.seeds,
        "nominal": NOMINAL,
        "target": list(TARGET),
        "units": "bias, spread and standard errors in % of sqrt(|X_ii X_jj|)",
        "in_words": sentences,
        "cells": [cell.described() for cell in cells],
    }
    write_tables(options.out, "coverage", result, [row for cell in cells for row in cell.rows()])
    display().phase("drawing")
    with figure_style():
        write_figure(options.out, "coverage", coverage_figure(cells))
    display().close()
    if options.json:
        print(to_json(result))
    else:
        print_cells(cells)
        for sentence in sentences:
            print(sentence)
    return 0
