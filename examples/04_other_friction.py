"""Give the simulated rig the friction of another one, joint by joint.

.venv/bin/python examples/04_other_friction.py

LuGre's six numbers hold simpler models, too: with static = coulomb and sigma_1 = 0 it is Dahl's,
with sigma_0 = 0 it is viscous. For other equations see docs/extending.md.
"""

from armimp_bringup.config import ExperimentConfig
from armimp_bringup.offline import simulate
from armimp_sim.model.friction import LuGre

dahl = LuGre(coulomb=(1.5,), static=(1.5,), sigma_0=(1500.0,))
rigs = {
    "none": LuGre(),
    "dahl": dahl.scaled([1.0, 0.5]),
    "viscous": LuGre(sigma_2=(0.8,)),
}

for name, law in rigs.items():
    # Beyond the Stribeck velocity bristles slide at the Coulomb level.
    joints = law.of_joints(2)
    at_speed = joints["coulomb"] + joints["sigma_2"]
    config = ExperimentConfig(duration=10.0, arm_sim={"friction": law.model_dump(mode="json")})
    (experiment,) = simulate([config])
    result = experiment.identify(["lpm_full"])
    found = result.estimators["lpm_full"].fit.mbk.B[1, 1]
    print(
        f"{name:8s} {at_speed[0]:.2f} and {at_speed[1]:.2f} N·m at 1 rad/s: "
        f"B22 = {found:.4f} N·m·s/rad, true {experiment.truth.B[1, 1]:.4f}; "
        f"{'valid' if result.valid else result.problems}"
    )
