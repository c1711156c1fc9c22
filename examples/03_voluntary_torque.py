"""Voluntary torque biases an estimator that ignores the closed loop, and more data do not help.

.venv/bin/python examples/03_voluntary_torque.py
"""

import numpy as np

from armimp_bringup.config import ExperimentConfig
from armimp_bringup.offline import simulate

# Any parameter of a node can be set under its name; docs/interfaces.md lists them.
configs = [
    ExperimentConfig(duration=20.0, seed=seed, arm_sim={"voluntary": {"rms": 0.5, "cutoff": 2.0}})
    for seed in range(24)
]

# Experiments of one duration run side by side, eight of them in little more time than one.
experiments = simulate(configs)
results = [experiment.identify(["direct", "lpm_full"]) for experiment in experiments]
true = experiments[0].truth.B[0, 0]

for name in ("direct", "lpm_full"):
    found = np.array([result.estimators[name].fit.mbk.B[0, 0] for result in results])
    errors = 100.0 * (found / true - 1.0)
    scatter = np.std(errors, ddof=1)
    print(
        f"{name:9s} error of B11: mean {np.mean(errors):+5.1f} % "
        f"± {scatter / np.sqrt(errors.size):.1f} %, scatter from run to run {scatter:.1f} %"
    )
