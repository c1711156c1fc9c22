"""Plants for tests, and the equations of motion in plain numpy."""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from armimp_common.arrays import FloatArray as Array
from armimp_common.topics import PERIOD
from armimp_sim import dynamics, presets
from armimp_sim.model.arm import HumanArm
from armimp_sim.model.friction import LuGre
from armimp_sim.model.robot import PlanarChain
from armimp_sim.model.sensors import SensorParameters
from armimp_sim.parameters import SimulatorParameters
from armimp_sim.plant import Plant, read
from armimp_sim.simulator import SimulatedRig

COMMANDS = np.random.default_rng(4).uniform(-5.0, 5.0, (60, 2))
"""Random commands for two joints, N·m, (ticks, 2)."""


def rig(arm: HumanArm, robot: PlanarChain, **parts: Any) -> SimulatorParameters:
    """A rig of an arm and a robot, ideal but for the other parts that are given."""
    parts = {"friction": LuGre(), "sensors": SensorParameters(), **parts}
    names = presets.JOINT_NAMES[arm.joints]
    return SimulatorParameters(joints=names, arm=arm, robot=robot, **parts)


def changed(plant: SimulatorParameters, **changes: Any) -> SimulatorParameters:
    """The rig with other parts."""
    return plant.model_copy(update=changes)


def stepwise(plant: SimulatorParameters) -> Plant:
    """A plant that is sampled after every step of the integration."""
    return Plant([changed(plant, substeps=1)], PERIOD / plant.substeps)


def state_of(plant: Plant) -> Array:
    """Exact (θ, v, z) of every lane: (lanes, 3, n), 2n with a soft cuff."""
    n, lanes = len(plant.batch.joints), len(plant.position)
    states: Array = plant.batch.w[:, : 3 * n].swapaxes(1, 2).reshape(-1, 3, n)
    return np.array(states[:lanes])


def run(rig: SimulatorParameters | Plant, commands: Array = COMMANDS) -> tuple[Array, Array]:
    """States and torque readings of each tick: (ticks, ...)."""
    plant = rig if isinstance(rig, Plant) else Plant([rig])
    states, torques = [], []
    for command in commands:
        plant.tick(command[None], np.zeros((1, command.size)))
        states.append(state_of(plant)[0])
        torques.append(plant.torque[0].copy())
    return np.array(states), np.array(torques)


def set_state(plant: Plant, state: Array) -> None:
    """Put an ideal plant of one lane into the state (θ, v, z), (3, n), and read its sensors."""
    batch = plant.batch
    batch.w[0, : state.size, 0] = state.ravel()
    dynamics.sample_now(batch)
    read(batch)


def study_plant(friction: int = 0, **changes: Any) -> SimulatorParameters:
    """The rig of the study with two joints and exact sensors."""
    parts = {"friction": presets.friction(friction, 2), "sensors": presets.sensors(0), **changes}
    return rig(presets.human_arm(2), presets.robot(2), **parts)


def some_commands(ticks: int) -> list[tuple[float, ...]]:
    """Random commands for two joints, N·m."""
    return [tuple(row) for row in np.random.default_rng(5).uniform(-20, 20, (ticks, 2)).tolist()]


def in_lockstep(
    commands: Iterable[Sequence[float]],
) -> list[tuple[int, tuple[float, ...], tuple[float, ...]]]:
    """Stamps, angles and torques that the preset rig reads before and after each command."""
    rig = SimulatedRig(SimulatorParameters.preset())
    samples = []
    for command in (None, *commands):
        if command is not None:
            rig.step(command)
        samples.append((rig.stamp_ns, tuple(rig.position.tolist()), tuple(rig.torque.tolist())))
    return samples


def random_plant(n: int) -> SimulatorParameters:
    """A plant in which no two numbers are alike and no matrix is symmetric."""
    random = np.random.default_rng(100 + n)
    masses, centres = random.uniform(0.2, 2.0, n), random.uniform(0.02, 0.3, n)
    return rig(
        HumanArm(
            posture=tuple(random.uniform(-1.0, 1.0, n)),
            inertia=tuple((0.1 * np.eye(n) + random.uniform(-0.02, 0.02, (n, n))).ravel()),
            damping=tuple(random.uniform(-1.0, 1.0, n * n)),
            stiffness=tuple(random.uniform(-9.0, 9.0, n * n)),
        ),
        PlanarChain(
            lengths=tuple(random.uniform(0.1, 0.5, n)),
            moments=tuple(masses * centres**2 + random.uniform(0.01, 0.1, n)),
            masses=tuple(masses),
            centres=tuple(centres),
        ),
        friction=LuGre(
            coulomb=tuple(random.uniform(0.4, 2.0, n)),
            static=tuple(random.uniform(2.0, 3.0, n)),
            sigma_0=tuple(random.uniform(400.0, 2000.0, n)),
            sigma_1=tuple(random.uniform(0.5, 4.0, n)),
            sigma_2=tuple(random.uniform(0.05, 0.2, n)),
            stribeck_velocity=tuple(random.uniform(0.01, 0.1, n)),
        ),
    )


def coriolis_torque(robot: PlanarChain, theta: Array, velocity: Array) -> Array:
    """C(θ, θ̇) θ̇ (n,), N·m: by Lagrange, with ∂M/∂θ_k from an imaginary step, which is exact."""
    shifted: Any = theta + 1e-30j * np.eye(theta.size)
    gradient = np.array([robot.mass_matrix(one).imag for one in shifted]) / 1e-30
    rate = np.tensordot(velocity, gradient, axes=1)
    return np.asarray(rate @ velocity - 0.5 * (gradient @ velocity) @ velocity)


def slopes(config: SimulatorParameters, state: Array, torque: Array) -> Array:
    """Derivative of θ, θ̇ and z, (3, n), under torques (n,) of drives less voluntary ones, N·m."""
    theta, v, z = state
    arm, robot = config.arm, config.robot
    law = config.friction.of_joints(v.size)
    bell = np.exp(-((v / law["stribeck_velocity"]) ** 2))
    level = law["coulomb"] + (law["static"] - law["coulomb"]) * bell
    rate = v - law["sigma_0"] * abs(v) * z / np.where(level > 0.0, level, 1.0)
    friction = law["sigma_0"] * z + law["sigma_1"] * rate + law["sigma_2"] * v
    acceleration = np.linalg.solve(
        robot.mass_matrix(theta) + arm.M,
        torque
        - coriolis_torque(robot, theta, v)
        - friction
        - arm.B @ v
        - arm.K @ (theta - arm.theta_0),
    )
    return np.stack([v, acceleration, rate])


def load(
    config: SimulatorParameters, state: Array, command: Array, voluntary: Array | float = 0.0
) -> Array:
    """Torque on the arm (n,), N·m, in a state under commands and voluntary torques (n,), N·m."""
    arm, (theta, velocity, _) = config.arm, state
    acceleration = slopes(config, state, command - voluntary)[1]
    total: Array = (
        arm.M @ acceleration + arm.B @ velocity + arm.K @ (theta - arm.theta_0) + voluntary
    )
    return total
