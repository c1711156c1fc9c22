"""Compiles the simulated rig and the controller, as processes side by side would each do it."""

from __future__ import annotations

import numpy as np

from armimp_bringup.offline import run_offline
from armimp_bringup.parameters import Rig
from armimp_control import presets as control_presets
from armimp_control.laws.law import Controller
from armimp_control.perturbation import JointPrior
from armimp_control.sequence import SequenceParameters
from armimp_sim import presets as sim_presets
from armimp_sim.plant import Plant, PlantConfig
from armimp_sim.voluntary import VoluntaryParameters
from support.safety import torque_only


def brief_rig(*, joints: int = 2, friction: int = 2, level: int = 3, seed: int = 1) -> Rig:
    """A rig with an experiment of less than a second, in which everything takes part."""
    arm, robot = sim_presets.human_arm(joints), sim_presets.robot(joints)
    return Rig(
        joint_names=sim_presets.JOINT_NAMES[joints],
        plant=PlantConfig(
            arm=arm,
            robot=robot,
            friction=sim_presets.friction(friction, joints),
            sensors=sim_presets.sensors(level),
        ),
        voluntary=VoluntaryParameters(rms=0.2),
        controller=control_presets.imbic(robot.mass_matrix(arm.posture), arm.posture),
        # In so short a perturbation, scaled to its peak, joints are faster than in a long one.
        safety=torque_only(80.0),
        perturbation=control_presets.perturbation(level, joints),
        priors=(JointPrior(arm=(0.2, 0.7, 8.0), target=(0.2, 2.0, 10.0)),) * joints,
        sequence=SequenceParameters(duration=0.4, settle=0.05, rest=0.06),
        seed=seed,
    )


def main() -> None:
    """Compile what most tests need."""
    run_offline([brief_rig()])
    run_offline([brief_rig(), brief_rig(seed=2)])
    run_offline([brief_rig(joints=3)])
    still = np.zeros((1, 1))
    Plant([brief_rig(joints=1).plant]).tick(still, still)
    arm = sim_presets.human_arm(2)
    inertia = sim_presets.robot(2).mass_matrix(arm.posture)
    law = Controller(control_presets.imbic(inertia, arm.posture), safety=torque_only(80.0))
    law.tick(arm.posture, np.zeros(2), np.zeros(2))
    law.release()
    law.continue_ramp(1)


if __name__ == "__main__":
    main()
