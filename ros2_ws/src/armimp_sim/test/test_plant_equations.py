"""Equations of motion: the chain against mechanics, the compiled plant against numpy."""

from __future__ import annotations

import numpy as np
import pytest

from armimp_sim import dynamics
from armimp_sim.plant import Plant
from support.plants import coriolis_torque, load, random_chain, random_plant

JOINTS = range(1, 8)
"""A plant of each size is compiled for itself."""


@pytest.mark.parametrize("n", JOINTS)
def test_coriolis_torque_follows_from_the_mass_matrix_by_lagrange(n: int) -> None:
    chain, h = random_chain(n), 1e-5
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
    computed = coriolis_torque(chain, theta, velocity)
    assert computed == pytest.approx(expected, rel=1e-8, abs=1e-8)
    # Ṁ − 2C is skew: the Coriolis torque does no work beyond the change of inertia.
    assert velocity @ computed == pytest.approx(0.5 * velocity @ rate @ velocity, abs=1e-8)
    if n > 1:
        assert np.max(np.abs(computed)) > 0.01


@pytest.mark.parametrize(
    "n", [2, *(pytest.param(n, marks=pytest.mark.slow) for n in JOINTS if n != 2)]
)
def test_torque_on_the_arm_is_that_of_the_equations_of_motion(n: int) -> None:
    config = random_plant(n)
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
        expected = load(config, state, command, voluntary)
        scale = float(np.max(np.abs(expected)))
        assert plant.torque[0] == pytest.approx(expected, abs=1e-11 * scale)
