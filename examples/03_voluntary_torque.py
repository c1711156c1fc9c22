"""Voluntary torque biases an estimator that ignores the closed loop, and more data do not help.

.venv/bin/python examples/03_voluntary_torque.py
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from armimp_bringup.config import ExperimentConfig
from armimp_bringup.offline import simulate
from armimp_estimation.estimators.estimate import ImpedanceEstimate
from armimp_estimation.estimators.welch import WelchSiso
from armimp_estimation.trial import TrialData


@dataclass(frozen=True, kw_only=True)
class Direct:
    """From the measured angle straight to the measured torques, as if there were no loop."""

    name: str = "direct"

    def estimate(self, trials: Sequence[TrialData]) -> ImpedanceEstimate:
        """Estimate from n trials in the order of their joints."""
        columns = []
        for trial in trials:
            angle, torque = trial.position_channel(trial.joint), trial.torque_channel(0)
            columns.append(trial.spectra.matrix[angle, torque:] / trial.spectra.power(angle))
        return replace(WelchSiso().estimate(trials), name=self.name, Z=np.stack(columns, axis=1))


# Any parameter of a node can be set under its name; docs/interfaces.md lists them.
configs = [
    ExperimentConfig(duration=20.0, seed=seed, arm_sim={"voluntary": {"rms": 0.5, "cutoff": 2.0}})
    for seed in range(24)
]

# Experiments of one duration run side by side, eight of them in little more time than one.
experiments = simulate(configs)
results = [experiment.identify([Direct(), "lpm_full"]) for experiment in experiments]
true = experiments[0].truth.B[0, 0]

for name in ("direct", "lpm_full"):
    found = np.array([result.estimators[name].fit.mbk.B[0, 0] for result in results])
    errors = 100.0 * (found / true - 1.0)
    scatter = np.std(errors, ddof=1)
    print(
        f"{name:9s} error of B11: mean {np.mean(errors):+5.1f} % "
        f"± {scatter / np.sqrt(errors.size):.1f} %, scatter from run to run {scatter:.1f} %"
    )
