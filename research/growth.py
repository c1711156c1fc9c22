"""What more joints cost: accuracy, transfer functions, time, and the length of record needed.

Every method gets n trials of the same length from every seed; ``mimo`` has all joints perturbed in
each of them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from armimp_bringup.config import ExperimentConfig
from armimp_bringup.simulated import SimulatedExperiment, simulate
from armimp_bringup.study.conditions import parse_seeds
from armimp_bringup.terminal import leave_terminal, phase
from armimp_common.topics import NS_PER_S, PERIOD_NS
from armimp_estimation.spectra import WelchConfig
from research.decomposition_statistics import Mean, root_mean_square
from research.decomposition_trials import (
    ESTIMATORS,
    MIMO,
    Run,
    all_at_once,
    estimate,
    in_blocks,
    in_threads,
    matrices,
    scales,
    with_voluntary,
)
from research.growth_figures import growth_figure
from research.options import InvestigationOptions
from research.writing import (
    figure_style,
    print_table,
    to_json,
    write_figure,
    write_tables,
)

FloatArray = NDArray[np.float64]

JOINT_BY_JOINT: Final = ("welch_siso", "lpm_full")
LETTERS: Final = ("M", "B", "K")


@dataclass(frozen=True, kw_only=True)
class GrowthPlan:
    """What is simulated.

    Parameters
    ----------
    base : everything but the seed and the number of joints. The plant takes steps of 0.1 ms, since
        the default of 0.01 ms would need ten times as long.
    joints : numbers of joints
    seeds : as for :func:`armimp_bringup.study.conditions.parse_seeds`
    voluntary : rms of the voluntary torque of every joint, N·m
    target : standard error to be reached, rms over the elements of M, B and of K, relative to
        ``sqrt(|X_ii X_jj|)``
    """

    base: ExperimentConfig = field(
        default_factory=lambda: ExperimentConfig(arm_sim={"substeps": 10})
    )
    joints: tuple[int, ...] = (2, 3, 4, 5, 6, 7)
    seeds: str = "0:8"
    voluntary: tuple[float, ...] = (0.0, 0.03)
    target: float = 0.01


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


@dataclass(frozen=True, kw_only=True, eq=False)
class Outcome:
    """What is kept of a run: which it is, errors of (M, B, K), VAF (%), wall time (s).

    ``voluntary`` is the torque, N·m rms.
    ``errors`` are relative to ``sqrt(|X_ii X_jj|)``, ``relative`` to each element itself.
    """

    joints: int
    voluntary: float
    estimator: str
    samples: int
    errors: FloatArray
    relative: FloatArray
    vaf: FloatArray
    seconds: float

    @classmethod
    def of(cls, experiment: SimulatedExperiment, run: Run) -> Outcome:
        """From one run."""
        true = matrices(experiment.truth)
        errors = matrices(run.fit.mbk) - true
        return cls(
            joints=experiment.truth.joints,
            voluntary=float(str(experiment.config.arm_sim["voluntary.rms"])),
            estimator=run.estimator,
            samples=experiment.records[0].samples,
            errors=errors / scales(true),
            relative=errors / np.abs(true),
            vaf=run.vaf,
            seconds=run.seconds,
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class Cell:
    """One estimator with one number of joints, over all seeds.

    Attributes
    ----------
    joints, voluntary, estimator : which
    duration : length of each of the n trials, s
    vaf, worst_vaf : mean and smallest of all elements and seeds, %
    bias, spread : (3,) of M, B and K, rms over the elements, relative to ``sqrt(|X_ii X_jj|)``
    worst : (3,) largest error of all elements and seeds, likewise
    worst_relative : (3,) the same relative to each element itself
    exponent : (3,) by which the spread falls with the length of the record, from the first half of
        each trial to the whole; 0.5 where errors are noise that averages out
    needed : length of all n trials together at which the spread of M, B and K is at the target, s,
        if it falls with the square root of the length. A bias does not fall.
    responses : transfer functions that are estimated together
    seconds : median wall time of an estimate, s
    """

    joints: int
    voluntary: float
    estimator: str
    duration: float
    vaf: float
    worst_vaf: float
    bias: FloatArray
    spread: FloatArray
    worst: FloatArray
    worst_relative: FloatArray
    exponent: FloatArray
    needed: float
    responses: int
    seconds: float

    @classmethod
    def of(cls, whole: Sequence[Outcome], half: Sequence[Outcome], target: float) -> Cell:
        """From the outcomes of all seeds for whole trials and for their first halves."""
        first = whole[0]
        n, duration = first.joints, first.samples * PERIOD_NS / NS_PER_S
        errors = np.array([one.errors for one in whole])
        relative = np.array([one.relative for one in whole])
        bias, spread = _over_elements(errors)
        _, of_half = _over_elements(np.array([one.errors for one in half]))
        vaf = np.array([one.vaf for one in whole])
        return cls(
            joints=n,
            voluntary=first.voluntary,
            estimator=first.estimator,
            duration=duration,
            vaf=float(np.mean(vaf)),
            worst_vaf=float(np.min(vaf)),
            bias=bias,
            spread=spread,
            worst=np.max(np.abs(errors), axis=(0, 2, 3)),
            worst_relative=np.max(np.abs(relative), axis=(0, 2, 3)),
            exponent=np.log2(of_half / spread),
            needed=n * duration * float(np.max((spread / target) ** 2)),
            responses=2 * n * n if first.estimator == MIMO else 2 * n,
            seconds=float(np.median([one.seconds for one in whole])),
        )

    def described(self) -> dict[str, Any]:
        """As it stands in the JSON file; errors in %."""
        return {
            "joints": self.joints,
            "voluntary_rms": self.voluntary,
            "estimator": self.estimator,
            "trials": self.joints,
            "trial_s": self.duration,
            "recording_s": self.joints * self.duration,
            "responses_at_once": self.responses,
            "estimation_s": self.seconds,
            "vaf": self.vaf,
            "worst_vaf": self.worst_vaf,
            **{
                f"{what}_{letter}": (factor * values[number])
                for what, factor, values in (
                    ("bias", 100.0, self.bias),
                    ("spread", 100.0, self.spread),
                    ("worst", 100.0, self.worst),
                    ("worst_relative", 100.0, self.worst_relative),
                    ("exponent", 1.0, self.exponent),
                )
                for number, letter in enumerate(LETTERS)
            },
            "recording_needed_s": self.needed,
        }


def run_growth(plan: GrowthPlan, workers: int | None = None) -> list[Cell]:
    """Simulate and estimate all of a plan.

    Raises
    ------
    ConfigurationError, ArmimpError
        If the plan does not make experiments, or they cannot be simulated or estimated.
    """
    seeds = parse_seeds(plan.seeds)
    tasks = []
    # The largest first, so that no thread is left with it at the end.
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
    """Compare the methods, write ``growth.*`` and print what was found.

    Parameters
    ----------
    options : InvestigationOptions
    plan : GrowthPlan, optional
        By default two to seven joints, 8 seeds, 50 s trials at the default levels.

    Returns
    -------
    int
        Exit status 0.

    Raises
    ------
    ArmimpError
        As :func:`run_growth`, or if a file can't be written.
    """
    chosen = plan if plan is not None else GrowthPlan()
    if options.seeds is not None:
        chosen = replace(chosen, seeds=options.seeds)
    cells = run_growth(chosen, options.workers)
    rows = [cell.described() for cell in cells]
    result = {
        "schema": 1,
        "experiment": chosen.base.model_dump(mode="json", exclude={"seed", "joints", "estimators"}),
        "seeds": chosen.seeds,
        "target_percent": 100.0 * chosen.target,
        "units": "bias, spread and worst in % of sqrt(|X_ii X_jj|), worst_relative in % of |X_ij|",
        "cells": rows,
    }
    write_tables(options.out, "growth", result, rows)
    phase("drawing")
    with figure_style():
        write_figure(options.out, "growth", growth_figure(cells, chosen.target))
    leave_terminal()
    if options.json:
        print(to_json(result))
    else:
        _print(cells, chosen)
    return 0


def _outcomes(experiment: SimulatedExperiment, names: Sequence[str]) -> Iterator[Outcome]:
    """Of whole trials and of their first halves, by the same segments."""
    samples = experiment.records[0].samples
    welch = WelchConfig.for_samples(samples)
    for length in (samples, samples // 2):
        shortened = experiment.shortened(length)
        for run in estimate(shortened, names, welch).values():
            yield Outcome.of(shortened, run)


def _over_elements(errors: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Bias and spread of M, B and K, rms over their elements."""
    mean = Mean.of(errors)
    return root_mean_square(mean.bias, (1, 2)), root_mean_square(mean.spread, (1, 2))


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
