"""Simulate an experiment without ROS, estimate the impedance, and compare it with the truth.

.venv/bin/python examples/01_simulate_and_estimate.py
"""

from armimp_bringup.config import ExperimentConfig
from armimp_bringup.offline import simulate

# Friction, sensor resolution and perturbation are at level 3 by default, as in `armimp run`.
config = ExperimentConfig(duration=20.0, seed=1)
(experiment,) = simulate([config])

# One record for each trial, with arrays of shape (joints, samples) in rad and N·m.
for record in experiment.records:
    motion = 1e3 * record.position.std(axis=1)
    print(f"trial {record.trial} perturbs {record.joint_names[record.perturbed_joint]}:")
    for name, one in zip(record.joint_names, motion, strict=True):
        print(f"  rms motion of {name} {one:.3f} mrad")

result = experiment.identify(["lpm_full"])
fit = result.estimators["lpm_full"].fit
for letter, found, error in zip("MBK", fit.values, fit.errors, strict=True):
    unit = {"M": "kg·m²", "B": "N·m·s/rad", "K": "N·m/rad"}[letter]
    true = getattr(experiment.truth, letter)
    for i, k in ((0, 0), (0, 1), (1, 0), (1, 1)):
        print(
            f"{letter}{i + 1}{k + 1} = {found[i, k]:.5f} ± {error[i, k]:.5f} {unit}, "
            f"true {true[i, k]:.5f}"
        )
print("valid" if result.valid else f"not valid: {result.problems}")
