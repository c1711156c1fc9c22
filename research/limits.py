"""How far the estimators are from the accuracy that noise allows, the Cramér-Rao bound."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import signal

from armimp_bringup.config import ExperimentConfig
from armimp_bringup.offline import SimulatedExperiment, simulate
from armimp_bringup.parameters import node_parameters
from armimp_common.arrays import FloatArray
from armimp_common.topics import RATE
from armimp_sim.voluntary import VoluntaryParameters, band_filter
from research.cells import ErrorPlan, Levels, Run
from research.cramer_rao import (
    SensorNoise,
    cramer_rao_bound,
    error_covariance,
    motion_in_band,
)
from research.decomposition_trials import (
    estimate,
    matrices,
    relative_errors,
    scales,
    with_voluntary,
)
from research.limits_figure import limits_figure
from research.limits_statistics import Cell
from research.limits_tables import in_words, print_cells
from research.options import InvestigationOptions
from research.writing import present


@dataclass(frozen=True, kw_only=True)
class LimitsPlan(ErrorPlan):
    """The simulations to run."""

    levels: tuple[Levels, ...] = (
        *((0, 1, 3), (1, 1, 2), (3, 1, 3)),
        *((3, 3, 3), (0, 3, 1), (3, 3, 1)),
    )
    seeds: str = "0:64"
    estimators: tuple[str, ...] = ("lpm_full", "welch_full", "welch_siso")


def power_spectrum(config: VoluntaryParameters, f: FloatArray) -> FloatArray:
    """Return the power spectrum of voluntary torque d; its mean over all frequencies is var(d).

    Parameters
    ----------
    config : VoluntaryParameters
    f : (n_freq,) Hz

    Returns
    -------
    (n_freq,) NDArray
        (N·m)², two-sided.
    """
    power = np.zeros_like(f)
    for rms, edges, _ in config.bands():
        sos, passed = band_filter(edges)
        _, response = signal.freqz_sos(sos, worN=f, fs=RATE)
        power += np.abs(rms / passed * response) ** 2
    return power


def bound_of(experiment: SimulatedExperiment, quiet: SimulatedExperiment) -> FloatArray:
    """Cramér-Rao bound of one experiment.

    Parameters
    ----------
    experiment : its sensors and voluntary torque are the noise
    quiet : the same with a relaxed arm; its motion is used, see
        :mod:`research.cramer_rao`

    Returns
    -------
    (3, n, n) NDArray
        Standard deviations of M, B and K, relative to ``sqrt(|X_ii X_jj|)``.

    Raises
    ------
    DataError
        If the experiments do not make a bound.
    """
    simulator = node_parameters(experiment.config, None).simulator
    noise = SensorNoise.of_rounding(
        angle=simulator.sensors.position.resolution, torque=simulator.sensors.torque.resolution
    )
    f, motion = motion_in_band(quiet.records)
    disturbance = power_spectrum(simulator.voluntary, f)
    samples = quiet.records[0].samples
    covariance = error_covariance(experiment.truth, f, samples, noise, disturbance)
    scale = scales(matrices(experiment.truth))
    return np.asarray(cramer_rao_bound(f, motion, covariance) / scale)


def run_limits(plan: LimitsPlan, workers: int | None = None) -> list[Cell]:
    """Simulate and estimate all of a plan, see :meth:`research.cells.ErrorPlan.runs`."""

    def work(base: ExperimentConfig, seeds: tuple[int, ...]) -> list[Run]:
        """Relative errors and relative bounds of M, B and K of each run."""
        relaxed = simulate(with_voluntary(base, 0.0, seeds))
        found: list[Run] = []
        for torque in plan.voluntary:
            experiments = simulate(with_voluntary(base, torque, seeds)) if torque else relaxed
            for experiment, quiet in zip(experiments, relaxed, strict=True):
                bound = bound_of(experiment, quiet)
                for name, run in estimate(experiment, plan.estimators, plan.segment).items():
                    errors, _ = relative_errors(run.fit, experiment.truth)
                    found.append((torque, name, errors, bound))
        return found

    return [
        Cell(levels=levels, voluntary=voluntary, estimator=estimator, errors=errors, bounds=bounds)
        for levels, voluntary, estimator, errors, bounds in plan.runs(work, workers)
    ]


def investigate(options: InvestigationOptions, plan: LimitsPlan | None = None) -> int:
    """Write and print errors over the bound; returns exit status 0, whatever they are."""
    chosen = (plan or LimitsPlan()).with_seeds(options)
    cells = run_limits(chosen, options.workers)
    sentences = in_words(cells)
    result = {
        **chosen.described(),
        "units": "bound, errors, bias and spread in % of sqrt(|X_ii X_jj|)",
        "in_words": sentences,
        "cells": [cell.described() for cell in cells],
    }
    rows = [row for cell in cells for row in cell.rows()]
    if present(options, "limits", result, rows, lambda: {"limits": limits_figure(cells)}):
        print_cells(cells)
        print("\n".join(sentences))
    return 0
