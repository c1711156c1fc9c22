"""The law with an observer as its internal model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from armimp_common.errors import ConfigurationError
from armimp_control.laws import ANGLE_GAIN, DISTURBANCE_GAIN, VELOCITY_GAIN
from armimp_control.laws.imbic import ImbicConfig, Observer
from armimp_control.laws.law import Controller
from armimp_control.stability import RigDynamics, check_stability
from support.laws import ARM, POSTURE, ROBOT, preset_law, torque_only, within_torque

Array = NDArray[np.float64]
PERIOD = 1e-3
COUNT = 2.0 * np.pi / 51200


def _config(n: int = 2, delay: int = 0) -> ImbicConfig:
    """Default law, which knows that commands act so many periods late."""
    robot, posture = ROBOT, POSTURE
    if n != 2:
        root = np.random.default_rng(n).normal(size=(n, n))
        robot, posture = 0.05 * root @ root.T + 0.2 * np.eye(n), np.zeros(n)
    config = preset_law(robot, posture, "observer")
    assert config.observer is not None
    return replace(config, observer=replace(config.observer, delay=delay))


def _plain(config: ImbicConfig, samples: Array, perturbed: int, limit: float) -> Array:
    """Commands (ticks, n) by the equations as they stand on the page, with matrices.

    ``samples`` (ticks, 3, n) are θ, τ_h and τ_Δ.
    """
    model, inertia = config.model(perturbed), config.model_inertia
    locked = np.arange(config.joints) != perturbed
    target, omega = config.target, config.target.lock_frequency
    damping = np.where(locked, 2.0 * omega, np.divide(target.damping, target.inertia))
    stiffness = np.where(locked, omega**2, np.divide(target.stiffness, target.inertia))
    angle, velocity, unknown = (
        samples[0, 0].copy(),
        np.zeros(config.joints),
        np.zeros(config.joints),
    )
    ideal = np.zeros(config.joints)
    assert config.observer is not None
    delay = config.observer.delay
    sent: list[Array] = [np.zeros(config.joints)] * delay
    start = samples[0, 0] - config.target_posture
    for tick, (theta, tau_h, tau_delta) in enumerate(samples):
        if tick:
            known = np.linalg.inv(inertia) @ (sent[-1 - delay] - tau_h) + unknown
            angle = angle + PERIOD * velocity + 0.5 * PERIOD**2 * known
            velocity = velocity + PERIOD * known
            error = theta - angle
            angle = angle + model[ANGLE_GAIN] @ error
            velocity = velocity + model[VELOCITY_GAIN] @ error
            unknown = unknown + model[DISTURBANCE_GAIN] @ error
        goal = config.target_posture + locked * start * np.exp(-tick * PERIOD / 0.05)
        push = np.where(locked, 0.0, (tau_delta - tau_h) / target.inertia)
        u = push - damping * velocity - stiffness * (angle - goal)
        ideal = ideal + PERIOD * u
        command = inertia @ (u + config.gamma * (ideal - velocity) - unknown) + tau_h
        sent.append(within_torque(command, limit))
        ideal = ideal + PERIOD * np.linalg.inv(inertia) @ (sent[-1] - command)
    return np.array(sent[delay:])


@pytest.mark.parametrize("limit", [1e9, 4.0])
@pytest.mark.parametrize(
    ("n", "perturbed", "delay"), [(1, 0, 0), (2, 0, 0), (2, 1, 1), (2, 1, 20), (4, 2, 3)]
)
def test_law_with_observer_is_that_of_its_equations(
    n: int, perturbed: int, delay: int, limit: float
) -> None:
    config = _config(n, delay)
    random = np.random.default_rng(n)
    samples = random.uniform(-1.0, 1.0, (150, 3, n))
    samples[:, 0] = config.target_posture + 1e-4 * np.cumsum(samples[:, 0], axis=0)
    samples[:, 2] *= np.arange(n) == perturbed
    controller = Controller(config, safety=torque_only(limit))
    controller.perturb_joint(perturbed)
    expected = _plain(config, samples, perturbed, limit)
    for (theta, tau_h, tau_delta), command in zip(samples, expected, strict=True):
        controller.tick(theta, tau_h, tau_delta)
        assert controller.command == pytest.approx(command, rel=1e-7, abs=1e-7)
    assert (np.max(np.abs(expected)) == limit) == (limit < 100.0)


def test_gains_are_those_that_the_riccati_recursion_comes_to() -> None:
    observer = Observer(
        resolution=COUNT, perturbed=np.array([0.4, 0.2]), locked=np.array([0.02, 0.01])
    )
    inverse, unit, none = np.linalg.inv(ROBOT), np.eye(2), np.zeros((2, 2))
    step = np.block(
        [
            [unit, PERIOD * unit, -0.5 * PERIOD**2 * inverse],
            [none, unit, -PERIOD * inverse],
            [none, none, unit],
        ]
    )
    noise = np.diag([0.0, 0.0, 0.0, 0.0, 0.4**2, 0.01**2])
    covariance = np.diag([1e-6, 1e-6, 1e-2, 1e-2, 1.0, 1.0])
    for _ in range(3000):
        covariance = step @ covariance @ step.T + noise
        gain = covariance[:, :2] @ np.linalg.inv(covariance[:2, :2] + COUNT**2 / 12.0 * unit)
        covariance = covariance - gain @ covariance[:2]
    gain[4:] = -inverse @ gain[4:]
    found = observer.gains(inverse, np.array([False, True]), PERIOD).reshape(6, 2)
    assert found == pytest.approx(gain, rel=1e-6, abs=1e-9 * np.max(np.abs(gain)))


@pytest.mark.parametrize(("joint", "speed"), [(0, 0.5), (0, 0.8), (1, 1.0), (1, 1.5)])
def test_a_fast_joint_that_gets_locked_comes_to_rest_though_commands_are_clipped(
    joint: int, speed: float
) -> None:
    """It would be thrown about ever faster with an ideal velocity that goes on meanwhile.

    Likewise if one joint alone got less torque than it is asked for.
    """
    controller = Controller(_config(), safety=torque_only(9.0))
    controller.perturb_joint(joint)
    inverse = np.linalg.inv(ROBOT + ARM)
    theta, velocity, acceleration = POSTURE.copy(), np.zeros(2), np.zeros(2)
    velocity[joint] = speed
    clipped = 0
    for tick in range(1000):
        if tick == 5:
            controller.perturb_joint(1 - joint)
        clipped += controller.tick(theta, ARM @ acceleration, np.zeros(2))
        acceleration = inverse @ controller.command
        theta = theta + PERIOD * velocity + 0.5 * PERIOD**2 * acceleration
        velocity = velocity + PERIOD * acceleration
        assert np.max(np.abs(theta - POSTURE)) < 0.2
    assert clipped > 10
    assert abs(velocity[joint]) < 1e-3


def test_defaults_bear_one_late_period_and_any_arm_within_a_factor_of_three() -> None:
    def check(known: int, delay: int) -> tuple[str, ...]:
        return check_stability(
            _config(delay=known),
            robot_inertia=ROBOT,
            arm_inertia=ARM,
            dynamics=RigDynamics(command_delay=delay),
        )

    for delay in (0, 1):
        assert check(delay, delay) == ()
    with pytest.raises(ConfigurationError, match=r"grows by .* act 2 periods late"):
        check(2, 2)
    # An observer that does not know of the delay makes a heavy arm swing.
    with pytest.raises(ConfigurationError, match=r"locked, .* an arm 3 times as heavy, with comm"):
        check(0, 1)
