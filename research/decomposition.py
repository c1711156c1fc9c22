"""What decomposition buys: voluntary torque and coupled inputs, with equal recording time.

Every estimator gets n trials of the same length from every seed. ``mimo`` gets trials of its own,
in which all joints are perturbed at once, with the peaks that they have one by one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armimp_bringup.config import ExperimentConfig
from armimp_bringup.simulated import SimulatedExperiment, simulate
from armimp_bringup.study.conditions import parse_seeds
from armimp_bringup.terminal import leave_terminal, phase
from armimp_common.topics import NS_PER_S, PERIOD_NS
from armimp_estimation.estimators.estimate import ImpedanceEstimate
from armimp_estimation.fit import fit_mbk
from armimp_estimation.spectra import WelchConfig
from research.decomposition_figures import decomposition_figures
from research.decomposition_statistics import (
    OCTAVES,
    Mean,
    octave_errors,
    root_mean_square,
)
from research.decomposition_tables import cell_rows, print_cells
from research.decomposition_trials import (
    JOINT_BY_JOINT,
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
from research.options import InvestigationOptions
from research.writing import (
    figure_style,
    to_json,
    write_figure,
    write_tables,
)

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class DecompositionPlan:
    """What is simulated.

    Parameters
    ----------
    base : everything but seed and voluntary torque. The plant takes steps of 0.05 ms, since the
        default of 0.01 ms would need five times as long.
    seeds : as for :func:`armimp_bringup.study.conditions.parse_seeds`
    voluntary : rms of the voluntary torque, N·m; the first is what the others are compared with
    correlations : of the perturbations when all joints are perturbed at once
    coupled_at : voluntary torque of the runs with correlated perturbations, N·m rms
    """

    base: ExperimentConfig = field(
        default_factory=lambda: ExperimentConfig(arm_sim={"substeps": 20})
    )
    seeds: str = "0:32"
    voluntary: tuple[float, ...] = (0.0, 0.1, 0.3, 1.0)
    correlations: tuple[float, ...] = (0.0, 0.5, 0.8, 0.9, 0.95)
    coupled_at: float = 0.3


@dataclass(frozen=True, kw_only=True)
class _Task:
    """Runs that are simulated side by side; a correlation of None is joint by joint."""

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
        welch = WelchConfig.for_samples(round(self.base.duration * NS_PER_S / PERIOD_NS))
        return [
            Outcome.of(experiment, run, self.voluntary, self.correlation)
            for experiment in experiments
            for run in estimate(experiment, names, welch).values()
        ]


@dataclass(frozen=True, kw_only=True, eq=False)
class Outcome:
    """Errors of one estimator in one run.

    Attributes
    ----------
    voluntary, correlation, estimator, seed : which; without correlated inputs None
    errors : (3, n, n) of M, B and K, relative to ``sqrt(|X_ii X_jj|)``
    standard_errors : likewise, those that the estimator itself states
    octaves : (n, n, octaves) of Z, relative to each true value
    estimate, truth : of Z and of M, B and K
    coherence, inflation, condition : of the inputs: band means of the largest coherence and
        inflation of variance, and the worst condition number; NaN joint by joint
    """

    voluntary: float
    correlation: float | None
    estimator: str
    seed: int
    errors: FloatArray
    standard_errors: FloatArray
    octaves: NDArray[np.complex128]
    estimate: ImpedanceEstimate
    truth: FloatArray
    coherence: float
    inflation: float
    condition: float

    @classmethod
    def of(
        cls, experiment: SimulatedExperiment, run: Run, voluntary: float, correlation: float | None
    ) -> Outcome:
        """What is kept of a run."""
        true = matrices(experiment.truth)
        errors_ = np.stack((run.fit.M_se, run.fit.B_se, run.fit.K_se))
        coherence, inflation, condition = np.nan, np.nan, np.nan
        if run.coupling is not None:
            n = len(true[0])
            pairs = run.coupling.coherence[~np.eye(n, dtype=bool)]
            coherence = float(np.mean(np.max(pairs, axis=0)))
            inflation = float(np.mean(np.max(run.coupling.inflation, axis=0)))
            condition = float(np.max(run.coupling.condition))
        return cls(
            voluntary=voluntary,
            correlation=correlation,
            estimator=run.estimator,
            seed=run.seed,
            errors=(matrices(run.fit.mbk) - true) / scales(true),
            standard_errors=errors_ / scales(true),
            octaves=octave_errors(run.estimate, experiment.truth),
            estimate=run.estimate,
            truth=true,
            coherence=coherence,
            inflation=inflation,
            condition=condition,
        )

    def errors_weighted_as(self, other: Outcome) -> FloatArray:
        """Errors of M, B and K with the variances, and so the weights, of another outcome."""
        fit = fit_mbk(replace(self.estimate, variance=other.estimate.variance))
        errors: FloatArray = (matrices(fit.mbk) - self.truth) / scales(self.truth)
        return errors


@dataclass(frozen=True, kw_only=True, eq=False)
class Cell:
    """One estimator in one condition, over all seeds.

    Attributes
    ----------
    voluntary, correlation, estimator : which
    total : errors of M, B and K
    shift : what the voluntary torque adds to them, run by run: errors minus those with the same
        seed, and so the same perturbation, without it, but equal weights; None without such runs
    reweighted : what it adds by the weights of the fit alone, which go to where it is weak: of the
        runs without it, errors with the weights of those with it minus their own
    octaves, octaves_shift : likewise for Z, with real and imaginary parts stacked as first axis
    stated : (3, n, n) root mean square of the standard errors that the estimator states
    coherence, inflation, condition : means of those of :class:`Outcome`; worst condition
    """

    voluntary: float
    correlation: float | None
    estimator: str
    total: Mean
    shift: Mean | None
    reweighted: Mean | None
    octaves: Mean
    octaves_shift: Mean | None
    stated: FloatArray
    coherence: float
    inflation: float
    condition: float

    @property
    def biased(self) -> bool:
        """Whether voluntary torque shifts M, B, K or Z by more than chance."""
        shifts = (self.shift, self.octaves_shift)
        return any(one is not None and one.significant for one in shifts)

    @classmethod
    def of(cls, outcomes: Sequence[Outcome], reference: Sequence[Outcome] | None) -> Cell:
        """From the outcomes of all seeds, and those without voluntary torque, in equal order."""
        errors = np.array([one.errors for one in outcomes])
        octaves = np.array([_parts(one) for one in outcomes])
        shift, reweighted, octaves_shift = None, None, None
        if reference is not None:
            alike = np.array(
                [b.errors_weighted_as(a) for a, b in zip(outcomes, reference, strict=True)]
            )
            shift = Mean.of(errors - alike)
            reweighted = Mean.of(alike - np.array([one.errors for one in reference]))
            octaves_shift = Mean.of(octaves - np.array([_parts(one) for one in reference]))
        first = outcomes[0]
        return cls(
            voluntary=first.voluntary,
            correlation=first.correlation,
            estimator=first.estimator,
            total=Mean.of(errors),
            shift=shift,
            reweighted=reweighted,
            octaves=Mean.of(octaves),
            octaves_shift=octaves_shift,
            stated=root_mean_square(np.array([o.standard_errors for o in outcomes]), (0,)),
            coherence=float(np.mean([one.coherence for one in outcomes])),
            inflation=float(np.mean([one.inflation for one in outcomes])),
            condition=float(np.max([one.condition for one in outcomes])),
        )

    def described(self) -> dict[str, Any]:
        """As it stands in the JSON file; errors in %."""
        return {
            "estimator": self.estimator,
            "voluntary_rms": self.voluntary,
            "correlation": self.correlation,
            "runs": self.total.runs,
            "errors": _described(self.total),
            "shift": _described(self.shift),
            "reweighted": _described(self.reweighted),
            "stated_standard_error": (100.0 * self.stated).tolist(),
            "octaves": _described(self.octaves),
            "octaves_shift": _described(self.octaves_shift),
            "biased_by_voluntary_torque": None if self.shift is None else self.biased,
            "input_coherence": self.coherence,
            "variance_inflation": self.inflation,
            "worst_condition_number": self.condition,
        }


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
    """Compare the estimators, write ``decomposition.*`` and print what was found.

    Parameters
    ----------
    options : InvestigationOptions
    plan : DecompositionPlan, optional
        By default 32 seeds of 50 s trials at the default levels.

    Returns
    -------
    int
        Exit status 0.

    Raises
    ------
    ArmimpError
        As :func:`run_decomposition`, or if a file can't be written.
    """
    chosen = plan if plan is not None else DecompositionPlan()
    if options.seeds is not None:
        chosen = replace(chosen, seeds=options.seeds)
    cells = run_decomposition(chosen, options.workers)
    result = {
        "schema": 1,
        "experiment": chosen.base.model_dump(mode="json", exclude={"seed", "estimators"}),
        "seeds": chosen.seeds,
        "octaves_hz": list(OCTAVES),
        "units": "errors of M, B, K in % of sqrt(|X_ii X_jj|), of Z in % of |Z_ij|",
        "cells": [cell.described() for cell in cells],
    }
    write_tables(options.out, "decomposition", result, cell_rows(cells))
    phase("drawing")
    with figure_style():
        for name, figure in decomposition_figures(cells, chosen.coupled_at).items():
            write_figure(options.out, name, figure)
    leave_terminal()
    if options.json:
        print(to_json(result))
    else:
        print_cells(cells)
    return 0


def _parts(outcome: Outcome) -> FloatArray:
    """Real and imaginary parts of the errors of Z, where there are any; (2, n, n, octaves)."""
    octaves = outcome.octaves[..., np.isfinite(outcome.octaves[0, 0])]
    return np.stack((octaves.real, octaves.imag))


def _described(mean: Mean | None) -> dict[str, Any] | None:
    if mean is None:
        return None
    return {
        "bias": (100.0 * mean.bias).tolist(),
        "uncertainty": (100.0 * mean.uncertainty).tolist(),
        "spread": (100.0 * mean.spread).tolist(),
        "z": mean.z.tolist(),
        "critical_z": mean.critical,
        "significant": mean.significant,
    }
