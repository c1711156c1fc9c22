"""Verdicts on rigs and arms that are drawn at random, each with one class of mismatch.

The classes are those of :mod:`research.truth`; everything that a class leaves at its default is
drawn: rate, arm, robot, sensors, law, friction, perturbation and voluntary torque.
"""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor
from dataclasses import fields, replace
from multiprocessing import get_context
from typing import Any

import numpy as np

from armimp_bringup.study import parse_seeds
from research.independent_rig import Mismatch
from research.options import InvestigationOptions
from research.truth import Outcome, cases, judge, names_like, outcome, tabulate


def drawn(name: str, seed: int) -> Mismatch:
    """Return the mismatch of a class on a rig and an arm that are drawn by a seed."""
    mismatch = cases()[name][1]
    rng = np.random.default_rng([seed, len(name)])

    def about(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    rate = float(rng.choice([500.0, 1000.0, 1000.0, 2000.0]))
    found: dict[str, Any] = {
        "rate": rate,
        "duration": float(rng.choice([30.0, 50.0, 80.0])),
        "level": about(0.4, 2.0),
        "robot": about(0.4, 3.0),
        "inertia": about(0.4, 3.0),
        "damping": about(0.4, 3.0),
        "stiffness": about(0.4, 5.0),
        "torque_noise": about(5e-4, 0.02),
        "angle_step": about(5e-6, 2e-4),
        "torque_step": about(1e-3, 0.02),
        "viscosity": about(0.02, 0.5),
        "lock": about(40.0, min(180.0, rate / 8.0)),
        "cutoff": float(rng.choice([15.0, 20.0, 30.0])),
        "waveform": str(rng.choice(["noise", "noise", "multisine"])),
        "calibrated": bool(rng.random() < 0.5),
    }
    if rng.random() < 0.6:
        found |= {"friction": about(0.03, 0.5), "stick": about(2e-3, 0.02)}
    if rng.random() < 0.6:
        found["voluntary"] = about(0.03, 0.5)
    if mismatch.readings is not None:
        # Changes of the arrays are made for the default rate and duration.
        del found["rate"], found["duration"]
    usual = Mismatch()
    own = {
        one.name for one in fields(usual) if getattr(mismatch, one.name) != getattr(usual, one.name)
    }
    return replace(mismatch, **{key: value for key, value in found.items() if key not in own})


def _outcome(name: str, seed: int) -> Outcome:
    return outcome(drawn(name, seed), seed)


def investigate(options: InvestigationOptions) -> int:
    """As :func:`research.truth.investigate`, with one class for each seed."""
    given = options.seeds or "0:300"
    seeds = parse_seeds(given)
    names = names_like(options.only)
    chosen = [names[int(np.random.default_rng([7, seed]).integers(len(names)))] for seed in seeds]
    by_name: dict[str, list[Outcome]] = {}
    with ProcessPoolExecutor(options.workers, mp_context=get_context("spawn")) as pool:
        for name, found in zip(chosen, pool.map(_outcome, chosen, seeds), strict=True):
            by_name.setdefault(name, []).append(found)
    rows = [judge(name, outcomes) for name, outcomes in by_name.items()]
    tabulate(options, "rigs", f"{len(seeds)} rigs and arms drawn at random", given, rows)
    return 0
