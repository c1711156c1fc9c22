"""What the sensors tell: resolution and instant of sampling."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import trapezoid

from armimp_sim import presets
from armimp_sim.model.sensors import Sampling
from armimp_sim.plant import Plant
from support.plants import load, stepwise, study_plant


@pytest.mark.parametrize("level", [1, 2, 3])
def test_plant_reads_whole_counts_of_its_exact_state(level: int) -> None:
    sensors = presets.sensors(level)
    exact = Plant([study_plant(1)])
    plant = Plant([study_plant(1, sensors=sensors)])
    command = np.array([[3.0, -2.0]])
    seen = set()
    for _ in range(100):
        exact.tick(command, np.zeros((1, 2)))
        plant.tick(command, np.zeros((1, 2)))
        assert np.array_equal(plant.state(), exact.state())  # readings don't touch the motion
        assert np.array_equal(exact.position, exact.state()[:, 0])
        for read, true, resolution in (
            (plant.position, exact.position, sensors.position.resolution),
            (plant.torque, exact.torque, sensors.torque.resolution),
        ):
            counts = np.rint(read / resolution)
            assert read == pytest.approx(counts * resolution, abs=1e-15)
            assert np.all(np.abs(read - true) <= 0.5000001 * resolution)
        seen.add(float(plant.torque[0, 0]))
    assert len(seen) > 10


def test_torque_before_update_is_that_under_the_command_still_in_force() -> None:
    config = study_plant()
    plant = Plant([config])
    commands = np.random.default_rng(5).uniform(-5.0, 5.0, (20, 2))
    for command in commands:
        plant.tick(command[None], np.zeros((1, 2)))
        state = plant.state()[0]
        assert plant.torque[0] == pytest.approx(load(config, state, command), abs=1e-11)


def test_interval_mean_torque_is_the_mean_over_the_substeps() -> None:
    coarse = study_plant(sensors=presets.sensors(0, Sampling.INTERVAL_MEAN))
    plant, watcher = Plant([coarse]), stepwise(coarse)
    commands = np.random.default_rng(6).uniform(-5.0, 5.0, (10, 2))
    last = np.zeros(2)
    for command in commands:
        states = [watcher.state()[0]]
        for _ in range(coarse.substeps):
            watcher.tick(command[None], np.zeros((1, 2)))
            states.append(watcher.state()[0])
        plant.tick(command[None], np.zeros((1, 2)))
        torques = np.array([load(coarse, state, command) for state in states])
        mean = trapezoid(torques, dx=1.0 / coarse.substeps, axis=0)
        assert plant.torque[0] == pytest.approx(mean, abs=1e-8)
        # Neither end of the interval would do, nor the command before.
        assert np.max(np.abs(torques[-1] - mean)) > 1e-5
        assert np.max(np.abs(load(coarse, states[0], last) - mean)) > 1e-3
        last = command
