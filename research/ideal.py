"""Verdicts on ideal runs of the project's own rig, none of which a check should refuse.

Prints false refusals, the largest lack of fit and imbalance of gain, and the coverage of the 95 %
intervals of M, B and K, over the 48 conditions of the study.
"""

from __future__ import annotations

import collections

import numpy as np

from armimp_bringup.config import ExperimentConfig
from armimp_bringup.study import select_conditions
from armimp_bringup.study.engine import condition_config
from armimp_estimation.fit import Calibration
from armimp_estimation.transducers import imbalance
from research.cells import LETTERS
from research.decomposition_trials import ESTIMATOR, identified
from research.options import InvestigationOptions


def investigate(options: InvestigationOptions) -> int:
    """Print the distributions; returns exit status 0: this is a measurement."""
    only = [options.only] if options.only else []
    conditions = select_conditions(only, options.seeds or "0:1")
    base = ExperimentConfig()
    refused: collections.Counter[str] = collections.Counter()
    covered: dict[tuple[int, int, int], list[np.ndarray]] = collections.defaultdict(list)
    lacks, gains = [], []
    runs = identified([condition_config(base, one) for one in conditions], options.workers)
    for condition, (experiment, found) in zip(conditions, runs, strict=True):
        result = found.estimators[ESTIMATOR]
        truth = np.stack([getattr(experiment.truth, n) for n in LETTERS])
        errors = (result.fit.values - truth) / result.fit.errors
        key = (condition.friction, condition.resolution, condition.perturbation)
        covered[key].append(errors)
        lacks.append((float(np.max(result.fit.lack)), str(condition)))
        line = f"{condition}: lack {np.max(result.fit.lack):.2f}"
        if found.balance is not None:
            share, error = map(np.diag, imbalance(found.balance, result.fit, Calibration())[:2])
            gains.append((float(np.max(np.abs(share))), str(condition)))
            M = found.balance.M
            line += f" imbalance {share.round(3)} ± {error.round(3)} M_r {M.round(3).tolist()}"
        if result.fit.delay is not None:
            delay = result.fit.delay
            line += f" delay {1e6 * delay.measured:.1f} ± {1e6 * delay.measured_error:.1f} µs"
            line += f" -> {1e6 * delay.delay:.1f} ± {1e6 * delay.error:.1f}"
        se = np.max(result.fit.errors / np.abs(truth), axis=(1, 2))
        line += " se% " + " ".join(f"{100 * one:.2f}" for one in se)
        line += " worst " + " ".join(f"{np.max(np.abs(one)):.2f}" for one in errors)
        print(line)
        for problem in found.problems:
            refused[f"{problem.severity.value} {problem.code.value}"] += 1
            print("     ", problem)
    print(f"{len(lacks)} runs, problems: {dict(refused)}")
    print("largest lack of fit:", sorted(lacks)[-3:])
    print("largest imbalance of gain:", sorted(gains)[-3:])
    everything = np.array([one for errors in covered.values() for one in errors])
    for row, name in enumerate(LETTERS):
        inside = np.abs(everything[:, row]) < 1.96
        print(f"coverage of {name}: {100 * inside.mean():.1f} %, by element", end=" ")
        print((100 * inside.mean(axis=0)).round(1).tolist())
    for key, errors in covered.items():
        shares = [(np.abs(np.array(errors)[:, row]) < 1.96).mean() for row in range(3)]
        if min(shares) < 0.8:
            print(key, "covers", [f"{100 * one:.0f} %" for one in shares])
    return 0
