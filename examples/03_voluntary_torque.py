"""The person pushes, too: an estimator that ignores the loop is biased, more data do not help.

.venv/bin/python examples/03_voluntary_torque.py
"""

import numpy as np

from armimp_bringup.config import ExperimentConfig
from armimp_bringup.simulated import simulate

# Any parameter of a node can be set under its name; docs/interfaces.md lists them.
person = {"voluntary": {"rms": 0.3, "cutoff": 2.0}}
configs = [ExperimentConfig(duration=20.0, seed=seed, arm_sim=person) for seed in range(8)]

# Experiments with equal durations run side by side, sixteen of them at the price of one.
experiments = simulate(configs)
for name in ("direct", "lpm_full"):
    errors = []
    for experiment in experiments:
        stiffness = experiment.identify([name]).estimators[name].fit.mbk.K
        errors.append(100.0 * (stiffness[1, 1] / experiment.truth.K[1, 1] - 1.0))
    mean, scatter = np.mean(errors), np.std(errors, ddof=1)
    print(
        f"{name:9s} error of K22: mean {mean:+5.1f} % ± {scatter / np.sqrt(len(errors)):.1f} %, "
        f"scatter from run to run {scatter:.1f} %"
    )
