"""LuGre friction in the plant: sliding, sticking, and what lies between."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from armimp_common.errors import ConfigurationError
from armimp_sim import presets
from armimp_sim.model.friction import LuGre
from armimp_sim.plant import Plant
from support.plants import one_joint

Array = NDArray[np.float64]
LAW = presets.friction(3, 2)[0]
VELOCITIES = [0.002, 0.005, 0.01, 0.03, 0.5, 3.0]


def _sliding(v: Array) -> Array:
    """Friction at constant velocities, rad/s: g(v)·sign(v) + σ2 v, N·m."""
    bell = np.exp(-((v / LAW.stribeck_velocity) ** 2))
    level = LAW.coulomb + (LAW.static - LAW.coulomb) * bell
    return np.asarray(level * np.sign(v) + LAW.sigma_2 * v)


def _load(plant: Plant, torques: Array) -> tuple[float, float, float]:
    """Apply torques tick by tick and return θ, v and z."""
    for torque in torques:
        plant.tick(np.array([[torque]]), np.zeros((1, 1)))
    theta, velocity, bristle = plant.state()[0, :, 0]
    return float(theta), float(velocity), float(bristle)


@pytest.mark.parametrize("direction", [-1.0, 1.0])
@pytest.mark.parametrize("speed", VELOCITIES)
def test_at_constant_speed_friction_is_the_steady_state_law(speed: float, direction: float) -> None:
    velocity, damping = speed * direction, 200.0
    # Damping steeper than the Stribeck slope makes the balance at this speed a stable one.
    plant = Plant([one_joint(LAW, inertia=1.0, damping=damping, substeps=20)])
    friction = float(_sliding(np.array(velocity)))
    _, reached, bristle = _load(plant, np.full(20_000, friction + damping * velocity))
    assert reached == pytest.approx(velocity, rel=1e-6)
    level = 2.0 + 0.5 * np.exp(-((speed / 0.01) ** 2))
    assert bristle == pytest.approx(direction * level / 2000.0, rel=1e-4)


def test_bristles_without_a_friction_level_are_refused() -> None:
    with pytest.raises(ConfigurationError, match=r"sigma_0 = 400\.0 needs a positive"):
        LuGre(coulomb=0.0, static=0.5, sigma_0=400.0, sigma_1=0.0, sigma_2=0.0)
