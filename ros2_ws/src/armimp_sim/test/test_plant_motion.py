"""Motion of the plant against closed forms and conservation laws."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from armimp_sim.model.arm import HumanArm
from armimp_sim.model.friction import LuGre
from armimp_sim.model.robot import PlanarChain
from armimp_sim.model.sensors import SensorParameters
from armimp_sim.plant import Plant, PlantConfig

Array = NDArray[np.float64]

IDEAL = SensorParameters()
PERIOD = 1e-3


def _single(*, inertia: float, damping: float, stiffness: float) -> PlantConfig:
    """One joint whose inertia is shared by arm and robot."""
    return PlantConfig(
        arm=HumanArm(
            posture=np.array([0.4]),
            inertia=np.array([[0.3 * inertia]]),
            damping=np.array([[damping]]),
            stiffness=np.array([[stiffness]]),
        ),
        robot=PlanarChain(
            lengths=np.array([0.3]),
            moments=np.array([0.7 * inertia]),
            masses=np.array([0.0]),
            centres=np.array([0.0]),
        ),
        friction=(LuGre.none(),),
        sensors=IDEAL,
        period=PERIOD,
        substeps=20,
    )


def _course(plant: Plant, commands: Array, voluntary: Array | None = None) -> Array:
    """States (ticks, 3, n) after every command (ticks, n)."""
    if voluntary is None:
        voluntary = np.zeros_like(commands)
    states = []
    for command, disturbance in zip(commands, voluntary, strict=True):
        plant.tick(command[None, :], disturbance[None, :])
        states.append(plant.state()[0])
    return np.array(states)


@pytest.mark.parametrize("ratio", [0.05, 0.7])
def test_damped_step_response_follows_the_closed_form(ratio: float) -> None:
    inertia, stiffness, torque = 0.2, 8.0, 1.5
    omega = np.sqrt(stiffness / inertia)
    plant = Plant(
        [_single(inertia=inertia, damping=2.0 * ratio * omega * inertia, stiffness=stiffness)]
    )
    states = _course(plant, np.full((1500, 1), torque))
    t = np.arange(1, 1501) * PERIOD
    damped = omega * np.sqrt(1.0 - ratio**2)
    decay = np.exp(-ratio * omega * t)
    shape = 1.0 - decay * (np.cos(damped * t) + ratio * omega / damped * np.sin(damped * t))
    assert states[:, 0, 0] == pytest.approx(0.4 + torque / stiffness * shape, abs=1e-11)


def _frictionless_chain(n: int) -> PlantConfig:
    random = np.random.default_rng(n)
    root = random.normal(size=(2, n, n))
    inertia, stiffness = root @ root.transpose(0, 2, 1)
    masses, centres = random.uniform(0.3, 1.0, n), random.uniform(0.05, 0.2, n)
    return PlantConfig(
        arm=HumanArm(
            posture=random.uniform(-1.0, 1.0, n),
            inertia=0.01 * inertia + 0.005 * np.eye(n),
            damping=np.zeros((n, n)),
            stiffness=stiffness,
        ),
        robot=PlanarChain(
            lengths=random.uniform(0.2, 0.4, n),
            moments=masses * centres**2 + random.uniform(0.01, 0.05, n),
            masses=masses,
            centres=centres,
        ),
        friction=(LuGre.none(),) * n,
        sensors=IDEAL,
    )


def _energy(config: PlantConfig, state: Array) -> float:
    theta, velocity, _ = state
    stretch = theta - config.arm.posture
    kinetic = config.robot.kinetic_energy(theta, velocity)
    return float(
        kinetic
        + 0.5 * velocity @ config.arm.inertia @ velocity
        + 0.5 * stretch @ config.arm.stiffness @ stretch
    )


@pytest.mark.parametrize("n", [2, 3, pytest.param(7, marks=pytest.mark.slow)])
def test_without_friction_and_damping_energy_is_conserved(n: int) -> None:
    config = _frictionless_chain(n)
    plant = Plant([config])
    random = np.random.default_rng(10 + n)
    start = np.zeros((1, 3, n))
    start[0, 0] = config.arm.posture + random.uniform(-0.5, 0.5, n)
    start[0, 1] = random.uniform(-6.0, 6.0, n)
    plant.set_state(start)
    states = _course(plant, np.zeros((300, n)))
    energies = [_energy(config, state) for state in states]
    assert energies == pytest.approx([_energy(config, start[0])] * 300, rel=1e-10)
    # The test says something only if energy changes hands and the chain bends.
    kinetic = [config.robot.kinetic_energy(state[0], state[1]) for state in states]
    assert np.ptp(kinetic) > 0.1 * np.mean(energies)
    assert np.ptp(states[:, 0], axis=0).max() > 0.5
