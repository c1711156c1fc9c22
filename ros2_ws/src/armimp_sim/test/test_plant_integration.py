"""Accuracy and stability of the integration, against scipy at tight tolerance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from armimp_common.errors import ArmimpError, ConfigurationError
from armimp_sim.model.friction import LuGre
from armimp_sim.plant import RK4_RADIUS, IntegrationError, Plant, PlantConfig
from support.plants import slopes, study_plant

Array = NDArray[np.float64]
START = np.array([[1.3, 0.9], [4.0, -7.0], [0.0, 0.0]])
TORQUE = np.array([1.5, -2.0])


def _exact(config: PlantConfig, start: Array, torque: Array, duration: float) -> Array:
    solution = solve_ivp(
        lambda _, state: slopes(config, state.reshape(3, -1), torque).ravel(),
        (0.0, duration),
        start.ravel(),
        method="DOP853",
        rtol=1e-12,
        atol=1e-14,
    )
    assert solution.success
    final: Array = solution.y[:, -1].reshape(3, -1)
    return final


def test_error_falls_with_the_fourth_power_of_the_step() -> None:
    period = 0.04
    exact = _exact(study_plant(), START, TORQUE, period)[:2]
    errors = []
    for substeps in (1, 2, 4, 8):
        plant = Plant([replace(study_plant(), period=period, substeps=substeps)])
        plant.set_state(START[None])
        plant.tick(TORQUE[None], np.zeros((1, 2)))
        errors.append(np.max(np.abs(plant.state()[0, :2] - exact)))
    orders = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    assert orders == pytest.approx([4.0, 4.0, 4.0], abs=0.25)


@pytest.mark.parametrize("friction", [0, 3])
def test_trajectory_agrees_with_scipy(friction: int) -> None:
    config = study_plant(friction)
    plant = Plant([config])
    plant.set_state(START[None])
    expected = START
    # Sliding, stopping and turning back: the bristles bend both ways.
    for torque, ticks in ((TORQUE, 60), (np.array([-25.0, 15.0]), 80), (np.zeros(2), 60)):
        for _ in range(ticks):
            plant.tick(torque[None], np.zeros((1, 2)))
        expected = _exact(config, expected, torque, ticks * config.period)
        state = plant.state()[0]
        assert state[0] == pytest.approx(expected[0], abs=1e-8)
        assert state[1] == pytest.approx(expected[1], abs=1e-6)
        if friction:
            assert state[2] == pytest.approx(expected[2], abs=1e-9)
            assert np.max(np.abs(state[2])) > 1e-4


def test_coarsest_accepted_step_is_stable_and_no_step_beyond_the_limit_is_accepted() -> None:
    law = LuGre(coulomb=2.0, static=2.5, sigma_0=2000.0, sigma_1=1000.0, sigma_2=0.0)
    config = replace(study_plant(), friction=(law, law))
    fastest = 1000.0 / np.min(np.linalg.eigvals(config.mass_matrix()).real)  # σ1 over inertia
    accepted = []
    for substeps in range(4, 40):
        try:
            accepted.append(replace(config, substeps=substeps))
        except ConfigurationError:
            assert fastest * config.period / substeps > 0.98 * RK4_RADIUS
    coarsest = accepted[0]
    assert 4 < coarsest.substeps < 39
    assert fastest * coarsest.step < RK4_RADIUS
    plant = Plant([coarsest])
    for _ in range(100):
        plant.tick(np.full((1, 2), 0.1), np.zeros((1, 2)))
    assert np.max(np.abs(plant.state()[0, 1])) < 1e-3


def _sliding(speed: float) -> Plant:
    config = study_plant(3)
    plant = Plant([replace(config, substeps=10)])
    state = np.zeros((1, 3, 2))
    state[0, 0], state[0, 1, 1] = config.arm.posture, speed
    plant.set_state(state)
    return plant


def test_speed_beyond_the_stability_of_the_bristles_is_reported_instead_of_blowing_up() -> None:
    plant = _sliding(30.0)
    with pytest.raises(IntegrationError, match=r"h·σ0\|v\|/g\(v\) = \d+.* below 2\.7") as caught:
        plant.tick(np.zeros((1, 2)), np.zeros((1, 2)))
    assert "\n" not in str(caught.value)
    assert isinstance(caught.value, ArmimpError)


@pytest.mark.parametrize("shape", [(2,), (1, 3), (1, 1), (2, 2)])
def test_inputs_of_another_shape_are_refused(shape: tuple[int, ...]) -> None:
    plant, good = Plant([study_plant()]), np.zeros((1, 2))
    with pytest.raises(ValueError, match="must both be"):
        plant.tick(np.zeros(shape), good)
    with pytest.raises(ValueError, match="must both be"):
        plant.tick(good, np.zeros(shape))
