"""Trials side by side: each gives the bits that it gives alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from armimp_common.errors import ConfigurationError
from armimp_sim.model.friction import LuGre
from armimp_sim.model.sensors import ReadingParameters, Sampling, SensorParameters
from armimp_sim.plant import Plant, PlantConfig
from support.plants import random_plant

Array = NDArray[np.float64]
TICKS = 40


def _config(n: int, lane: int) -> PlantConfig:
    """Another arm, robot, friction and resolution in every lane."""
    resolutions = (ReadingParameters(resolution=scale * lane) for scale in (1e-5, 1e-3))
    position, torque = resolutions
    changes = {} if lane else {"friction": (LuGre.none(),) * n}
    sensors = SensorParameters(position=position, torque=torque)
    return random_plant(n, lane, sensors=sensors, substeps=20, **changes)


def _run(n: int, lanes: Sequence[int]) -> tuple[Array, Array, Array]:
    """Exact states and readings, (lanes, ticks, ...), of a batch under random torques."""
    plant = Plant([_config(n, lane) for lane in lanes])
    commands = np.stack(
        [np.random.default_rng([9, lane]).uniform(-9.0, 9.0, (TICKS, 2, n)) for lane in lanes],
        axis=2,
    )
    states, positions, torques = [], [], []
    for command, voluntary in commands:
        plant.tick(command, 0.1 * voluntary)
        states.append(plant.state())
        positions.append(plant.position.copy())
        torques.append(plant.torque.copy())
    return np.stack(states, 1), np.stack(positions, 1), np.stack(torques, 1)


@pytest.mark.parametrize(
    ("n", "lanes"),
    # A plant of each number of joints is compiled for itself.
    [(2, 5), (2, 19), *(pytest.param(n, 3, marks=pytest.mark.slow) for n in (1, 3, 7))],
)
def test_lane_gives_the_same_bits_alone_and_beside_others(n: int, lanes: int) -> None:
    together = _run(n, range(lanes))
    for lane in range(lanes):
        alone = _run(n, [lane])
        for one, many in zip(alone, together, strict=True):
            assert np.array_equal(one[0], many[lane])
    # Lanes do differ, so that none can stand in for another.
    assert len(np.unique(together[0][:, -1, 0, 0])) == lanes


def test_lanes_that_disagree_in_time_or_shape_are_refused() -> None:
    one = _config(2, 1)
    for other in (
        _config(3, 1),
        replace(one, substeps=21),
        replace(one, period=2e-3),
        replace(one, sensors=one.sensors.model_copy(update={"sampling": Sampling.INTERVAL_MEAN})),
    ):
        with pytest.raises(ConfigurationError, match="lanes must agree"):
            Plant([one, other])
