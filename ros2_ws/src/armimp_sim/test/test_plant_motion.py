"""Motion of the plant against closed forms and conservation laws."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from armimp_sim.model.arm import HumanArm
from armimp_sim.model.friction import LuGre
from armimp_sim.plant import Plant, PlantConfig
from support.plants import kinetic_energy, one_joint, random_plant

Array = NDArray[np.float64]

PERIOD = 1e-3


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
    damping = 2.0 * ratio * omega * inertia
    joint = one_joint(inertia=inertia, damping=damping, stiffness=stiffness, substeps=20)
    plant = Plant([joint])
    states = _course(plant, np.full((1500, 1), torque))
    t = np.arange(1, 1501) * PERIOD
    damped = omega * np.sqrt(1.0 - ratio**2)
    decay = np.exp(-ratio * omega * t)
    shape = 1.0 - decay * (np.cos(damped * t) + ratio * omega / damped * np.sin(damped * t))
    assert states[:, 0, 0] == pytest.approx(torque / stiffness * shape, abs=1e-11)


def _frictionless_chain(n: int) -> PlantConfig:
    random = np.random.default_rng(n)
    root = random.normal(size=(2, n, n))
    inertia, stiffness = root @ root.transpose(0, 2, 1)
    arm = HumanArm(
        posture=random.uniform(-1.0, 1.0, n),
        inertia=0.01 * inertia + 0.005 * np.eye(n),
        damping=np.zeros((n, n)),
        stiffness=stiffness,
    )
    return random_plant(n, arm=arm, friction=(LuGre.none(),) * n)


def _energy(config: PlantConfig, state: Array) -> float:
    theta, velocity, _ = state
    stretch = theta - config.arm.posture
    kinetic = kinetic_energy(config.robot, theta, velocity)
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
    kinetic = [kinetic_energy(config.robot, state[0], state[1]) for state in states]
    assert np.ptp(kinetic) > 0.1 * np.mean(energies)
    assert np.ptp(states[:, 0], axis=0).max() > 0.5
