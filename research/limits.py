"""How far the estimators are from the accuracy that noise allows, the Cramér-Rao bound."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from armimp_bringup.config import ExperimentConfig
from armimp_bringup.offline import SimulatedExperiment, simulate
from armimp_bringup.parameters import node_parameters
from armimp_bringup.study.conditions import parse_seeds
from armimp_bringup.terminal import display
from armimp_common.errors import ConfigurationError
from armimp_common.topics import NS_PER_S, PERIOD_NS
from armimp_estimation.spectra import WelchConfig
from armimp_sim.voluntary import power_spectrum
from research.cramer_rao import (
    SensorNoise,
    cramer_rao_bound,
    error_covariance,
    motion_in_band,
)
from research.decomposition_trials import (
    estimate,
    in_blocks,
    in_threads,
    matrices,
    scales,
    with_voluntary,
)
from research.limits_figure import limits_figure
from research.limits_statistics import Cell
from research.limits_tables import in_words, print_cells
from research.options import InvestigationOptions
from research.writing import (
    figure_style,
    to_json,
    write_figure,
    write_tables,
)

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class LimitsPlan:
    """What is simulated."""

    base: ExperimentConfig = field(
        default_factory=lambda: ExperimentConfig(arm_sim={"substeps": 20})
    )
    """Everything but seed, levels and voluntary torque. The plant takes steps of 0.05 ms: those of
    0.01 ms, the default, find the same in twice the time."""
    levels: tuple[tuple[int, int, int], ...] = (
        *((0, 1, 3), (1, 1, 2), (3, 1, 3)),
        *((3, 3, 3), (0, 3, 1), (3, 3, 1)),
    )
    """Of friction, resolution and perturbation."""
    seeds: str = "0:64"
    """As for :func:`armimp_bringup.study.conditions.parse_seeds`."""
    voluntary: tuple[float, ...] = (0.3, 0.0)
    """Rms of the voluntary torque, N·m."""
    estimators: tuple[str, ...] = ("lpm_full", "welch_full", "welch_siso")


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
    voluntary: tuple[float, ...]
    estimators: tuple[str, ...]
    seeds: tuple[int, ...]

    def __call__(self) -> list[tuple[_Setting, FloatArray, FloatArray]]:
        """Relative errors and relative bounds of M, B and K of each run."""
        levels = dict(zip(("friction", "resolution", "perturbation"), self.levels, strict=True))
        base = self.base.model_copy(update=levels)
        welch = WelchConfig.for_samples(round(self.base.duration * NS_PER_S / PERIOD_NS))
        relaxed = simulate(with_voluntary(base, 0.0, self.seeds))
        found = []
        for torque in self.voluntary:
            experiments = simulate(with_voluntary(base, torque, self.seeds)) if torque else relaxed
            for experiment, quiet in zip(experiments, relaxed, strict=True):
                true = matrices(experiment.truth)
                bound = bound_of(experiment, quiet, (welch.f_low, welch.f_high)) / scales(true)
                for name, run in estimate(experiment, self.estimators, welch).items():
                    setting = _Setting(levels=self.levels, voluntary=torque, estimator=name)
                    found.append((setting, (matrices(run.fit.mbk) - true) / scales(true), bound))
        return found


def bound_of(
    experiment: SimulatedExperiment, quiet: SimulatedExperiment, band: tuple[float, float]
) -> FloatArray:
    """Cramér-Rao bound of one experiment.

    Parameters
    ----------
    experiment : whose sensors and voluntary torque make the noise
    quiet : the same with a relaxed arm, whose motion is used; see
        :mod:`research.cramer_rao`
    band : lowest and highest frequency, Hz

    Returns
    -------
    (3, n, n) NDArray
        Standard deviations of M, B and K, in kg·m², N·m·s/rad and N·m/rad.

    Raises
    ------
    DataError
        If the experiments do not make a bound.
    """
    simulator = node_parameters(experiment.config, None).simulator
    noise = SensorNoise.of_rounding(
        angle=simulator.sensors.position.resolution, torque=simulator.sensors.torque.resolution
    )
    f, motion = motion_in_band(quiet.records, band)
    disturbance = power_spectrum(simulator.voluntary, f, PERIOD_NS / NS_PER_S)
    samples = quiet.records[0].samples
    covariance = error_covariance(experiment.truth, f, samples, noise, disturbance)
    return cramer_rao_bound(f, motion, covariance)


def run_limits(plan: LimitsPlan, workers: int | None = None) -> list[Cell]:
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
        raise ConfigurationError(f"--seeds {plan.seeds}: one seed is too few to tell an rms error")
    tasks = [
        _Task(
            base=plan.base,
            levels=levels,
            voluntary=plan.voluntary,
            estimators=plan.estimators,
            seeds=block,
        )
        for levels in plan.levels
        for block in in_blocks(seeds)
    ]
    found: dict[_Setting, list[tuple[FloatArray, FloatArray]]] = {}
    for runs in in_threads(_Task.__call__, tasks, workers):
        for setting, errors, bounds in runs:
            found.setdefault(setting, []).append((errors, bounds))
    return [
        Cell(
            levels=setting.levels,
            voluntary=setting.voluntary,
            estimator=setting.estimator,
            errors=np.stack([errors for errors, _ in runs]),
            bounds=np.stack([bounds for _, bounds in runs]),
        )
        for setting in (
            _Setting(levels=levels, voluntary=torque, estimator=name)
            for name in plan.estimators
            for torque in plan.voluntary
            for levels in plan.levels
        )
        for runs in (found[setting],)
    ]


def investigate(options: InvestigationOptions, plan: LimitsPlan | None = None) -> int:
    """Compare errors with the bound, write ``limits.*`` and print the ratios.

    Parameters
    ----------
    options : InvestigationOptions
    plan : LimitsPlan, optional
        By default 64 seeds of 50 s trials in six conditions, with and without voluntary torque.

    Returns
    -------
    int
        Exit status 0, whatever the ratios are: this is a measurement.

    Raises
    ------
    ArmimpError
        As :func:`run_limits`, or if a file can't be written.
    """
    chosen = plan if plan is not None else LimitsPlan()
    if options.seeds is not None:
        chosen = replace(chosen, seeds=options.seeds)
    cells = run_limits(chosen, options.workers)
    sentences = in_words(cells)
    result = {
        "schema": 1,
        "experiment": chosen.base.model_dump(
            mode="json", exclude={"seed", "estimators", "friction", "resolution", "perturbation"}
        ),
        "seeds": chosen.seeds,
        "units": "bound, errors, bias and spread in % of sqrt(|X_ii X_jj|)",
        "in_words": sentences,
        "cells": [cell.described() for cell in cells],
    }
    write_tables(options.out, "limits", result, [row for cell in cells for row in cell.rows()])
    display().phase("drawing")
    with figure_style():
        write_figure(options.out, "limits", limits_figure(cells))
    display().close()
    if options.json:
        print(to_json(result))
    else:
        print_cells(cells)
        for sentence in sentences:
            print(sentence)
    return 0
