"""Equations of motion: the chain against mechanics, the compiled plant against numpy."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from armimp_sim import dynamics
from armimp_sim.model.arm import HumanArm
from armimp_sim.model.friction import LuGre
from armimp_sim.model.robot import PlanarChain
from armimp_sim.model.sensors import SensorParameters
from armimp_sim.plant import Plant, PlantConfig

Array = NDArray[np.float64]
JOINTS = range(1, 8)
"""A plant of each size is compiled for itself."""


def _chain(n: int, seed: int = 0) -> PlanarChain:
    random = np.random.default_rng([n, seed])
    masses, centres = random.uniform(0.2, 2.0, n), random.uniform(0.02, 0.3, n)
    return PlanarChain(
        lengths=random.uniform(0.1, 0.5, n),
        moments=masses * centres**2 + random.uniform(0.01, 0.1, n),
        masses=masses,
        centres=centres,
    )


@pytest.mark.parametrize("n", JOINTS)
def test_coriolis_torque_follows_from_the_mass_matrix_by_lagrange(n: int) -> None:
    chain, h = _chain(n), 1e-5
    random = np.random.default_rng(n)
    theta, velocity = random.uniform(-np.pi, np.pi, n), random.uniform(-3.0, 3.0, n)
    gradient = np.array(
        [
            (chain.mass_matrix(theta + h * axis) - chain.mass_matrix(theta - h * axis)) / (2.0 * h)
            for axis in np.eye(n)
        ]
    )  # ∂M/∂θ_k
    rate = np.tensordot(velocity, gradient, axes=1)
    expected = rate @ velocity - 0.5 * np.einsum("kij,i,j->k", gradient, velocity, velocity)
    computed = chain.coriolis_torque(theta, velocity)
    assert computed == pytest.approx(expected, rel=1e-8, abs=1e-8)
    # Ṁ − 2C is skew: the Coriolis torque does no work beyond the change of inertia.
    assert velocity @ computed == pytest.approx(0.5 * velocity @ rate @ velocity, abs=1e-8)
    if n > 1:
        assert np.max(np.abs(computed)) > 0.01


def _random_plant(n: int) -> PlantConfig:
    """A plant in which no two numbers are alike and no matrix is symmetric."""
    random = np.random.default_rng(100 + n)
    return PlantConfig(
        arm=HumanArm(
            posture=random.uniform(-1.0, 1.0, n),
            inertia=0.1 * np.eye(n) + random.uniform(-0.02, 0.02, (n, n)),
            damping=random.uniform(-1.0, 1.0, (n, n)),
            stiffness=random.uniform(-9.0, 9.0, (n, n)),
        ),
        robot=_chain(n, seed=1),
        friction=tuple(
            LuGre(
                coulomb=random.uniform(0.4, 2.0),
                static=random.uniform(2.0, 3.0),
                sigma_0=random.uniform(400.0, 2000.0),
                sigma_1=random.uniform(0.5, 4.0),
                sigma_2=random.uniform(0.05, 0.2),
                stribeck_velocity=random.uniform(0.01, 0.1),
            )
            for _ in range(n)
        ),
        sensors=SensorParameters(),
    )


def _acceleration(config: PlantConfig, state: Array, command: Array, voluntary: Array) -> Array:
    theta, velocity, bristle = state
    friction = []
    for law, v, z in zip(config.friction, velocity, bristle, strict=True):
        level = float(law.level(np.array(v)))
        rate = v - law.sigma_0 * abs(v) * z / level
        friction.append(law.sigma_0 * z + law.sigma_1 * rate + law.sigma_2 * v)
    arm = config.arm
    torque = (
        command
        - config.robot.coriolis_torque(theta, velocity)
        - np.array(friction)
        - arm.damping @ velocity
        - arm.stiffness @ (theta - arm.posture)
        - voluntary
    )
    return np.linalg.solve(config.robot.mass_matrix(theta) + arm.inertia, torque)


@pytest.mark.parametrize(
    "n", [2, *(pytest.param(n, marks=pytest.mark.slow) for n in JOINTS if n != 2)]
)
def test_torque_on_the_arm_is_that_of_the_equations_of_motion(n: int) -> None:
    config = _random_plant(n)
    plant = Plant([config])
    rows = plant.batch.reshape(-1, n)
    random = np.random.default_rng(n)
    for _ in range(20):
        # Slow and fast, stuck and sliding.
        velocity = random.normal(size=n) * 10.0 ** random.uniform(-3.0, 1.0, n)
        state = np.stack(
            [random.uniform(-np.pi, np.pi, n), velocity, random.uniform(-2e-3, 2e-3, n)]
        )
        command, voluntary = random.uniform(-20.0, 20.0, (2, n))
        rows[dynamics.COMMAND], rows[dynamics.VOLUNTARY] = command, voluntary
        plant.set_state(state[None])
        arm = config.arm
        expected = (
            arm.inertia @ _acceleration(config, state, command, voluntary)
            + arm.damping @ velocity
            + arm.stiffness @ (state[0] - arm.posture)
            + voluntary
        )
        scale = float(np.max(np.abs(expected)))
        assert plant.torque[0] == pytest.approx(expected, abs=1e-11 * scale)


@pytest.mark.parametrize("n", [2, 3])
def test_velocity_gained_in_a_short_period_is_acceleration_times_period(n: int) -> None:
    random = np.random.default_rng(40 + n)
    config = _random_plant(n)
    brief = PlantConfig(
        arm=config.arm,
        robot=config.robot,
        friction=config.friction,
        sensors=config.sensors,
        period=1e-8,
        substeps=1,
    )
    plant = Plant([brief])
    state = random.uniform(-1.0, 1.0, (3, n)) * np.array([[1.0], [2.0], [1e-3]])
    command, voluntary = random.uniform(-20.0, 20.0, (2, n))
    plant.set_state(state[None])
    plant.tick(command[None], voluntary[None])
    gained = (plant.state()[0, 1] - state[1]) / 1e-8
    expected = _acceleration(config, state, command, voluntary)
    assert gained == pytest.approx(expected, rel=1e-4, abs=1e-3)
