"""Try a control law in plain Python against the simulated rig, sample by sample.

.venv/bin/python examples/09_prototype_a_law.py

The law locks joints by a PD controller, and feeds the torque reading of a locked joint forward, so
that the arm has less effect on it. That helps a little; the coupling through the robot's own
inertia remains. A law that proves useful moves into the controller: see docs/extending.md.
"""

import numpy as np
from numpy.typing import NDArray

from armimp_bringup.config import ExperimentConfig
from armimp_bringup.parameters import NodeParameters, node_parameters
from armimp_common.topics import PERIOD
from armimp_control.laws import DAMPING, STIFFNESS
from armimp_control.laws.pd import Pd
from armimp_sim.plant import Plant

SAMPLES = 5_000


class Law:
    """PD locking with a share of the measured torque fed forward."""

    def __init__(self, parameters: NodeParameters, *, share: float) -> None:
        of = parameters.controller
        self.law = Pd(target=of.target, law=of.law, known=of.known)
        self.share = share
        self.before = self.law.target_posture

    def command(
        self, theta: NDArray[np.float64], tau_h: NDArray[np.float64], joint: int
    ) -> NDArray[np.float64]:
        """Torques (n,), N·m, from angles (rad) and torques (N·m); `joint`, from 0, is compliant."""
        stiffness, damping = self.law.role(joint)[[STIFFNESS, DAMPING]]
        velocity = (theta - self.before) / PERIOD
        self.before = theta.copy()
        held = np.arange(theta.size) != joint
        away = theta - self.law.target_posture
        command: NDArray[np.float64] = -stiffness * away - damping * velocity
        command += self.share * held * tau_h
        return command


parameters = node_parameters(ExperimentConfig(friction=1, resolution=1), None)
for share in (0.0, 0.8):
    ratios = []
    for joint in (0, 1):
        law = Law(parameters, share=share)
        plant = Plant([parameters.simulator])
        tau_delta = np.zeros((SAMPLES, 2))
        signal = parameters.controller.signal(joint, trial=joint + 1, ticks=SAMPLES)
        tau_delta[:, joint] = signal
        angles = np.empty((SAMPLES, 2))
        for k in range(SAMPLES):
            angles[k] = plant.position[0]
            command = law.command(plant.position[0], plant.torque[0], joint) + tau_delta[k]
            plant.tick(command[None, :], np.zeros((1, 2)))
        motion = angles.std(axis=0)
        ratios.append(motion[1 - joint] / motion[joint])
    print(f"share {share:.1f}: lock ratios {ratios[0]:.3f} and {ratios[1]:.3f}; limit 0.02")
