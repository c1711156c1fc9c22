"""Are the standard errors of M, B and K honest? How often their intervals hold the truth."""

from __future__ import annotations

from dataclasses import dataclass

from armimp_bringup.config import ExperimentConfig
from armimp_bringup.offline import simulate
from research.cells import ErrorPlan, Levels, Run
from research.coverage_figure import coverage_figure
from research.coverage_statistics import NOMINAL, TARGET, Cell
from research.coverage_tables import in_words, print_cells
from research.decomposition_trials import relative_errors, with_voluntary
from research.options import InvestigationOptions
from research.writing import present


@dataclass(frozen=True, kw_only=True)
class CoveragePlan(ErrorPlan):
    """The simulations to run."""

    levels: tuple[Levels, ...] = ((1, 1, 2), (3, 3, 3), (0, 3, 1), (3, 3, 1))
    seeds: str = "0:200"
    estimators: tuple[str, ...] = ("lpm_full", "welch_siso")


def run_coverage(plan: CoveragePlan, workers: int | None = None) -> list[Cell]:
    """Simulate and estimate all of a plan, see :meth:`research.cells.ErrorPlan.runs`."""

    def work(base: ExperimentConfig, seeds: tuple[int, ...]) -> list[Run]:
        """Relative errors and relative standard errors of M, B and K of each run."""
        found: list[Run] = []
        for voluntary in plan.voluntary:
            for experiment in simulate(with_voluntary(base, voluntary, seeds)):
                for name, one in experiment.identify(plan.estimators).estimators.items():
                    errors, stated = relative_errors(one.fit, experiment.truth)
                    found.append((voluntary, name, errors, stated))
        return found

    return [
        Cell(levels=levels, voluntary=voluntary, estimator=estimator, errors=errors, stated=stated)
        for levels, voluntary, estimator, errors, stated in plan.runs(work, workers)
    ]


def investigate(options: InvestigationOptions, plan: CoveragePlan | None = None) -> int:
    """Write and print how often the intervals hold the truth; returns exit status 0."""
    chosen = (plan or CoveragePlan()).with_seeds(options)
    cells = run_coverage(chosen, options.workers)
    sentences = in_words(cells)
    result = {
        **chosen.described(),
        "nominal": NOMINAL,
        "target": list(TARGET),
        "units": "bias, spread and standard errors in % of sqrt(|X_ii X_jj|)",
        "in_words": sentences,
        "cells": [cell.described() for cell in cells],
    }
    rows = [row for cell in cells for row in cell.rows()]
    if present(options, "coverage", result, rows, lambda: {"coverage": coverage_figure(cells)}):
        print_cells(cells)
        print("\n".join(sentences))
    return 0
