"""An estimator of your own beside the existing ones, on simulated records or on bags.

.venv/bin/python examples/08_own_estimator.py
.venv/bin/python examples/08_own_estimator.py results/example/bags/*

To have it on the command line and in the node, see docs/extending.md.
"""

import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from armimp_bringup.config import ExperimentConfig
from armimp_bringup.offline import simulate
from armimp_bringup.offline_estimate import estimate_bags
from armimp_estimation.estimators.estimate import Estimator, ImpedanceEstimate
from armimp_estimation.estimators.welch import WelchSiso
from armimp_estimation.trial import TrialData


@dataclass(frozen=True, kw_only=True)
class WelchShifted:
    """The paper's estimator with torques advanced by half a sample (docs/theory.md, 4)."""

    name: str = "welch_shifted"

    def estimate(self, trials: Sequence[TrialData]) -> ImpedanceEstimate:
        """Estimate from n trials in any order, one for each joint."""
        found = WelchSiso().estimate(trials)
        delay = 0.5 / trials[0].record.rate
        shift = np.exp(2j * np.pi * found.f * delay)
        return replace(found, name=self.name, Z=found.Z * shift, T=found.T * shift)


estimators: list[str | Estimator] = ["welch_siso", WelchShifted()]
if bags := [Path(argument) for argument in sys.argv[1:]]:
    result = estimate_bags(bags, estimators)
    print(*result.notes, sep="\n", end="\n" if result.notes else "")
    assert result.curves, result.summary.problems
    viscosities = {name: np.array(one.B) for name, one in result.summary.estimators.items()}
    truth = result.summary.truth
else:
    (experiment,) = simulate([ExperimentConfig(duration=50.0)])
    found = experiment.identify(estimators)
    viscosities = {name: one.fit.mbk.B for name, one in found.estimators.items()}
    truth = experiment.truth

for name, viscosity in viscosities.items():
    values = ", ".join(f"{value:.4f}" for value in viscosity.ravel())
    print(f"{name:13s} B = {values} N·m·s/rad")
if truth is not None:
    print("truth         B =", ", ".join(f"{b:.4f}" for b in truth.B.ravel()), "N·m·s/rad")
