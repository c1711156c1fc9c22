"""What a stop does to the arm: the way to zero torque must not push it."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from armimp_control import presets as control_presets
from armimp_control.laws.law import Controller
from armimp_control.perturbation import perturbation
from armimp_sim import presets as sim_presets
from armimp_sim.plant import Plant
from support.laws import preset_law
from support.plants import study_plant

pytestmark = pytest.mark.slow

AFTER = 150
"""Ticks that are watched after the stop."""


def _fastest(
    friction: int,
    resolution: int,
    stop_tick: int,
    ramp_time: float,
    law: control_presets.LawName = "observer",
) -> tuple[float, ...]:
    """Largest speed of a joint in the 50 ms before a stop, and after it, rad/s; 0 s: at once."""
    config = study_plant(friction, sensors=sim_presets.sensors(resolution))
    plant, arm, robot = Plant([config]), config.arm, config.robot
    controller = Controller(
        preset_law(robot.mass_matrix(arm.theta_0), arm.theta_0, law),
        safety=control_presets.safety(2, 9.0).model_copy(update={"ramp_time": ramp_time}),
    )
    signal = perturbation(
        control_presets.perturbation(3, 2), joint=0, trial=1, ticks=stop_tick, seed=1
    )
    theta: NDArray[np.float64] = np.zeros((stop_tick + AFTER, 2))
    tau_delta, still = np.zeros(2), np.zeros((1, 2))
    for k in range(stop_tick + AFTER):
        tau_delta[0] = signal[k] if k < stop_tick else 0.0
        if k == stop_tick:
            if ramp_time > 0.0:
                controller.stop()
            else:
                controller.cut()
        controller.tick(plant.position[0], plant.torque[0], tau_delta)
        theta[k] = plant.position[0]
        plant.tick(controller.command[None, :], still)
    assert not controller.command.any()
    speed = np.abs(theta[5:] - theta[:-5]).max(axis=1) / 5e-3
    return float(speed[stop_tick - 50 : stop_tick - 4].max()), float(speed[stop_tick - 4 :].max())


STOPS = range(2000, 2600, 37)


@pytest.mark.parametrize("ramp_time", [0.0, control_presets.safety(2, 9.0).ramp_time])
@pytest.mark.parametrize(("friction", "resolution"), [(0, 3), (3, 3), (3, 1)])
def test_after_a_stop_the_arm_is_hardly_faster_than_it_was_in_a_trial(
    friction: int, resolution: int, ramp_time: float
) -> None:
    pairs = [_fastest(friction, resolution, tick, ramp_time) for tick in STOPS]
    before, after = np.max(pairs, axis=0)
    assert after < 1.3 * before


def test_ramp_of_fifty_milliseconds_pushes_on_with_a_peak_of_chatter_if_the_law_chatters() -> None:
    laws: tuple[tuple[control_presets.LawName, bool], ...] = (("observer", False), ("tde", True))
    for law, pushes in laws:
        pairs = [_fastest(0, 3, tick, 0.05, law) for tick in STOPS]
        before, after = np.max(pairs, axis=0)
        assert bool(after > 1.5 * before) is pushes
