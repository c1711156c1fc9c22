"""Benefit of the decomposition under voluntary torque and coupled inputs, at equal recording time.

Every estimator gets n trials of the same length from every seed. ``mimo`` gets trials of its own,
in which all joints are perturbed at once, with the same peaks as one by one.
"""

from __future__ import annotations

from dataclasses import dataclass

from armimp_bringup.config import ExperimentConfig
from armimp_bringup.offline import simulate
from armimp_bringup.study import parse_seeds
from armimp_common.topics import RATE
from armimp_estimation.spectra import segment_for_samples
from research.cells import Plan
from research.decomposition_figures import decomposition_figures
from research.decomposition_outcomes import Cell, Outcome
from research.decomposition_statistics import (
    OCTAVES,
)
from research.decomposition_tables import cell_rows, print_cells
from research.decomposition_trials import (
    JOINT_BY_JOINT,
    MIMO,
    all_at_once,
    estimate,
    in_blocks,
    in_threads,
    with_voluntary,
)
from research.options import InvestigationOptions
from research.writing import present


@dataclass(frozen=True, kw_only=True)
class DecompositionPlan(Plan):
    """The simulations to run."""

    seeds: str = "0:32"
    voluntary: tuple[float, ...] = (0.0, 0.1, 0.3, 1.0)
    """Rms of the voluntary torque, N·m; the first is the reference of the others."""
    correlations: tuple[float, ...] = (0.0, 0.5, 0.8, 0.9, 0.95)
    """Correlations of the perturbations when all joints are perturbed at once."""
    coupled_at: float = 0.3
    """Voluntary torque of the runs with correlated perturbations, N·m rms."""


@dataclass(frozen=True, kw_only=True)
class _Task:
    """Runs that are simulated side by side; without a correlation they are joint by joint."""

    base: ExperimentConfig
    seeds: tuple[int, ...]
    voluntary: float
    correlation: float | None

    def __call__(self) -> list[Outcome]:
        configs = with_voluntary(self.base, self.voluntary, self.seeds)
        if self.correlation is None:
            experiments = simulate(configs)
        else:
            experiments = all_at_once(configs, self.correlation)
        names = JOINT_BY_JOINT if self.correlation is None else (MIMO,)
        segment = segment_for_samples(round(self.base.duration * RATE))
        return [
            Outcome.of(experiment, run, self.voluntary, self.correlation)
            for experiment in experiments
            for run in estimate(experiment, names, segment).values()
        ]


def run_decomposition(plan: DecompositionPlan, workers: int | None = None) -> list[Cell]:
    """Simulate and estimate all of a plan.

    Raises
    ------
    ConfigurationError, ArmimpError
        If the plan does not make experiments, or they cannot be simulated or estimated.
    """
    seeds = parse_seeds(plan.seeds)
    conditions: list[tuple[float, float | None]] = [
        (voluntary, correlation) for voluntary in plan.voluntary for correlation in (None, 0.0)
    ]
    conditions += [(plan.coupled_at, one) for one in plan.correlations]
    conditions = list(dict.fromkeys(conditions))
    tasks = [
        _Task(base=plan.base, seeds=block, voluntary=voluntary, correlation=correlation)
        for voluntary, correlation in conditions
        for block in in_blocks(seeds)
    ]
    found: dict[tuple[float, float | None, str], list[Outcome]] = {}
    for outcomes in in_threads(_Task.__call__, tasks, workers):
        for one in outcomes:
            found.setdefault((one.voluntary, one.correlation, one.estimator), []).append(one)
    relaxed = plan.voluntary[0]
    return [
        Cell.of(
            outcomes,
            None if voluntary == relaxed else found.get((relaxed, correlation, estimator)),
        )
        for (voluntary, correlation, estimator), outcomes in found.items()
    ]


def investigate(options: InvestigationOptions, plan: DecompositionPlan | None = None) -> int:
    """Write and print errors of each estimator; returns exit status 0."""
    chosen = (plan or DecompositionPlan()).with_seeds(options)
    cells = run_decomposition(chosen, options.workers)
    result = {
        **chosen.described(),
        "octaves_hz": list(OCTAVES),
        "units": "errors of M, B, K in % of sqrt(|X_ii X_jj|), of Z in % of |Z_ij|",
        "cells": [cell.described() for cell in cells],
    }
    if present(
        options,
        "decomposition",
        result,
        cell_rows(cells),
        lambda: decomposition_figures(cells, chosen.coupled_at),
    ):
        print_cells(cells)
    return 0
