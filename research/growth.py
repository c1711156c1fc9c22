"""Cost of more joints: accuracy, transfer functions, time, and the length of record needed.

Every method gets n trials of the same length from every seed; those for ``mimo`` perturb all joints
in each.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

from armimp_bringup.config import ExperimentConfig
from armimp_bringup.offline import SimulatedExperiment, simulate
from armimp_bringup.study import parse_seeds
from armimp_estimation.spectra import segment_for_samples
from research.cells import Plan
from research.decomposition_trials import (
    ESTIMATORS,
    MIMO,
    all_at_once,
    estimate,
    in_blocks,
    in_threads,
    with_voluntary,
)
from research.growth_figures import growth_figure
from research.growth_outcomes import Cell, Outcome
from research.options import InvestigationOptions
from research.writing import present, print_table

JOINT_BY_JOINT: Final = ("welch_siso", "lpm_full")


@dataclass(frozen=True, kw_only=True)
class GrowthPlan(Plan):
    """The simulations to run."""

    VARIED = Plan.VARIED | {"joints"}

    base: ExperimentConfig = field(
        default_factory=lambda: ExperimentConfig(arm_sim={"substeps": 10})
    )
    """The plant takes steps of 0.1 ms: with those of 0.01 ms, the default, simulations of seven
    joints take five times as long."""
    joints: tuple[int, ...] = (2, 3, 4, 5, 6, 7)
    """Numbers of joints."""
    seeds: str = "0:8"
    voluntary: tuple[float, ...] = (0.0, 0.03)
    """Rms of the voluntary torque of every joint, N·m."""
    target: float = 0.01
    """Standard error to be reached, rms over the elements of M, B and of K, relative to
    ``sqrt(|X_ii X_jj|)``."""


@dataclass(frozen=True, kw_only=True)
class _Task:
    """Runs that are simulated side by side."""

    configs: tuple[ExperimentConfig, ...]
    together: bool

    def __call__(self) -> list[Outcome]:
        of_kind = all_at_once if self.together else simulate
        names = (MIMO,) if self.together else JOINT_BY_JOINT
        return [
            outcome
            for experiment in of_kind(self.configs)
            for outcome in _outcomes(experiment, names)
        ]


def run_growth(plan: GrowthPlan, workers: int | None = None) -> list[Cell]:
    """Simulate and estimate all of a plan.

    Raises
    ------
    ConfigurationError, ArmimpError
        If the plan does not make experiments, or they cannot be simulated or estimated.
    """
    seeds = parse_seeds(plan.seeds)
    tasks = []
    # The largest come first, so that no thread is left with one at the end.
    for joints in sorted(plan.joints, reverse=True):
        base = plan.base.model_copy(update={"joints": joints})
        configs = [one for rms in plan.voluntary for one in with_voluntary(base, rms, seeds)]
        tasks += [
            _Task(configs=block, together=together)
            for together in (False, True)
            for block in in_blocks(configs)
        ]
    found: dict[tuple[float, int, str], dict[int, list[Outcome]]] = {}
    for outcomes in in_threads(_Task.__call__, tasks, workers):
        for one in outcomes:
            of_method = found.setdefault((one.voluntary, one.joints, one.estimator), {})
            of_method.setdefault(one.samples, []).append(one)
    return [
        Cell.of(of_length[max(of_length)], of_length[min(of_length)], plan.target)
        for _, of_length in sorted(
            found.items(), key=lambda item: (*item[0][:2], ESTIMATORS.index(item[0][2]))
        )
    ]


def investigate(options: InvestigationOptions, plan: GrowthPlan | None = None) -> int:
    """Write and print what was found with each number of joints; returns exit status 0."""
    chosen = (plan or GrowthPlan()).with_seeds(options)
    cells = run_growth(chosen, options.workers)
    rows = [cell.described() for cell in cells]
    result = {
        **chosen.described(),
        "target_percent": 100.0 * chosen.target,
        "units": "bias, spread and worst in % of sqrt(|X_ii X_jj|), worst_relative in % of |X_ij|",
        "cells": rows,
    }
    if present(
        options, "growth", result, rows, lambda: {"growth": growth_figure(cells, chosen.target)}
    ):
        _print(cells, chosen)
    return 0


def _outcomes(experiment: SimulatedExperiment, names: Sequence[str]) -> Iterator[Outcome]:
    """Yield outcomes of whole trials and of their first halves, with segments of equal length."""
    samples = experiment.records[0].samples
    segment = segment_for_samples(samples)
    for length in (samples, samples // 2):
        shortened = _shortened(experiment, length)
        for run in estimate(shortened, names, segment).values():
            yield Outcome.of(shortened, run)


def _print(cells: Sequence[Cell], plan: GrowthPlan) -> None:
    count = len(parse_seeds(plan.seeds))
    for rms in plan.voluntary:
        print_table(
            f"voluntary torque {rms:g} N·m rms, {count} seeds; errors of M, B and K in % of "
            "sqrt(|X_ii X_jj|)",
            (
                *("n", "estimator", "VAF %", "worst", "bias M", "B", "K", "spread M", "B", "K"),
                *("recorded s", "needed s", "responses", "estimation s"),
            ),
            [
                (
                    f"{cell.joints}",
                    cell.estimator,
                    f"{cell.vaf:.3f}",
                    f"{cell.worst_vaf:.3f}",
                    *(f"{100.0 * value:.2f}" for value in (*cell.bias, *cell.spread)),
                    f"{cell.joints * cell.duration:.0f}",
                    f"{cell.needed:.3g}",
                    f"{cell.responses}",
                    f"{cell.seconds:.2f}",
                )
                for cell in cells
                if cell.voluntary == rms
            ],
            "bias and spread: rms over the elements; needed: recording for a spread of "
            f"{100.0 * plan.target:g} %\nof M, B and K; responses: estimated at once",
        )


def _shortened(experiment: SimulatedExperiment, samples: int) -> SimulatedExperiment:
    """Return the experiment as if each trial had ended after this many samples."""
    records = tuple(
        replace(
            one,
            perturbation=one.perturbation[:, :samples],
            position=one.position[:, :samples],
            torque=one.torque[:, :samples],
            command=None if one.command is None else one.command[:, :samples],
        )
        for one in experiment.records
    )
    return replace(experiment, records=records)
