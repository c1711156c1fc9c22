"""A joint that gets locked away from its posture goes there smoothly."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from armimp_control.laws.imbic import ImbicConfig
from armimp_control.laws.law import Controller
from support.safety import torque_only

Array = NDArray[np.float64]
PERIOD = 1e-3
INERTIA, MODEL = 0.5, 0.4
FREQUENCY, APPROACH = 100.0, 0.05
POSTURE = np.array([0.3, -0.2])


def _config() -> ImbicConfig:
    return ImbicConfig(
        target_posture=POSTURE,
        target_inertia=np.array([0.2, 0.1]),
        target_damping=np.array([2.0, 1.0]),
        target_stiffness=np.array([10.0, 10.0]),
        model_inertia=MODEL * np.eye(2),
        lock_frequency=FREQUENCY,
        lock_approach=APPROACH,
    )


def _locked(config: ImbicConfig, distance: float, ticks: int) -> tuple[Array, Array]:
    """Distance from the posture and command (ticks,) of pure inertia that is locked at tick 0."""
    controller = Controller(config, safety=torque_only(1e9))
    controller.perturb_joint(1)
    theta, velocity = POSTURE + np.array([distance, 0.0]), np.zeros(2)
    path, command = np.zeros(ticks), np.zeros(ticks)
    for tick in range(ticks):
        path[tick] = theta[0] - POSTURE[0]
        controller.tick(theta, np.zeros(2), np.zeros(2))
        command[tick] = controller.command[0]
        acceleration = controller.command / INERTIA
        theta = theta + PERIOD * velocity + 0.5 * PERIOD**2 * acceleration
        velocity = velocity + PERIOD * acceleration
    return path, command


def test_target_decays_with_its_time_constant() -> None:
    """Read from a joint that is held away from its posture, whatever the command."""
    config, distance, ticks = _config(), 0.1, 100
    controller = Controller(config, safety=torque_only(1e9))
    controller.perturb_joint(1)
    theta = POSTURE + np.array([distance, 0.0])
    commands = [0.0]
    for _ in range(ticks):
        controller.tick(theta, np.zeros(2), np.zeros(2))
        commands.append(controller.command[0])
    decayed = distance * np.exp(-PERIOD * np.arange(ticks) / APPROACH)
    u = FREQUENCY**2 * (decayed - distance)
    change = MODEL * (u + config.gamma * PERIOD * np.cumsum(u))
    assert np.diff(commands) == pytest.approx(change, rel=1e-9)


def test_joint_follows_the_decay_to_its_posture_within_the_torque_of_the_closed_form() -> None:
    """With x = d·e^(−t/T) as input, the acceleration of the stiff target is at most d/T² + dω/(eT).

    That is the decay's own, d/T², through a low-pass without overshoot, and the impulse response of
    the low-pass, at most ω/e, times the step −d/T of the target's velocity at the start.
    """
    distance = 0.1
    path, command = _locked(_config(), distance, 1000)
    largest = INERTIA * distance * (1.0 / APPROACH**2 + FREQUENCY / (np.e * APPROACH))
    assert np.max(np.abs(command)) < largest < 0.1 * INERTIA * FREQUENCY**2 * distance * 1.5
    # Behind the target by its delay, 2ζ/ω, and ahead of nothing.
    time = PERIOD * np.arange(path.size)
    behind = distance * np.exp(-(time - 2.0 / FREQUENCY) / APPROACH)
    late = (time > 0.15) & (time < 0.4)
    assert path[late] == pytest.approx(behind[late], rel=0.2)
    assert np.abs(path[-1]) < 1e-6 * distance
    assert np.min(path) > -1e-3 * distance
