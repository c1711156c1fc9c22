"""Let all estimators work on the same records, and see how far each is from the truth.

.venv/bin/python examples/02_compare_estimators.py
"""

import numpy as np

from armimp_bringup.config import ExperimentConfig
from armimp_bringup.offline import simulate
from armimp_estimation.estimators.registry import ESTIMATORS

(experiment,) = simulate([ExperimentConfig(duration=50.0, perturbation=1)])
result = experiment.identify([*ESTIMATORS])

print("estimator    worst VAF, %   largest error of M, B, K, %")
for name, one in result.estimators.items():
    errors = [
        100.0 * np.max(np.abs(getattr(one.fit.mbk, letter) / getattr(experiment.truth, letter) - 1))
        for letter in "MBK"
    ]
    assert one.vaf is not None  # the truth is known
    print(f"{name:12s} {one.vaf.min():12.3f}   " + "  ".join(f"{error:6.2f}" for error in errors))
