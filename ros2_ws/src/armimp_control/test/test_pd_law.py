"""Plain PD locking, the negative control: its equations, edges, stability, and choice."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from armimp_common.errors import ConfigurationError
from armimp_common.schema import build, flatten
from armimp_control.laws.imbic import ImbicConfig
from armimp_control.laws.law import Controller
from armimp_control.laws.pd import PdConfig
from armimp_control.parameters import ControllerParameters
from armimp_control.stability import check_stability, spectral_radius
from support.safety import torque_only, within_torque

Array = NDArray[np.float64]
ROBOT = np.array([[0.3543, 0.1909], [0.1909, 0.1800]])
ARM = np.array([[0.187, 0.084], [0.079, 0.060]])
POSTURE = np.array([1.0945, 1.3484])
PERIOD = 1e-3
COUNT = 2.0 * np.pi / 51200  # of the coarsest encoder


def _config(n: int = 2, *, frequency: float = 25.0) -> PdConfig:
    random = np.random.default_rng(n)
    return PdConfig(
        target_posture=random.uniform(-1.0, 1.0, n),
        target_damping=random.uniform(1.0, 3.0, n),
        target_stiffness=random.uniform(5.0, 15.0, n),
        inertia=random.uniform(0.1, 0.4, n),
        frequency=frequency,
        damping_ratio=0.8,
    )


def _rig_config(*, frequency: float = 25.0) -> PdConfig:
    """Gains for the rig with two joints."""
    return PdConfig(
        target_posture=POSTURE,
        target_damping=np.array([2.0, 1.0]),
        target_stiffness=np.array([10.0, 10.0]),
        inertia=np.diag(ROBOT).copy(),
        frequency=frequency,
    )


def _parameters(**changes: Any) -> ControllerParameters:
    preset = ControllerParameters.preset(
        joints=("shoulder", "elbow"), posture=POSTURE, robot_inertia=ROBOT, arm_inertia=ARM
    )
    return build(ControllerParameters, {**flatten(preset), **changes})


# --- the law ---------------------------------------------------------------------------------


@pytest.mark.parametrize("limit", [1e9, 4.0])
@pytest.mark.parametrize("n", [1, 2, 3, 7])
def test_locked_joints_are_held_by_stiffness_and_damping_and_the_perturbed_one_by_its_target(
    n: int, limit: float
) -> None:
    config = _config(n)
    controller = Controller(config, safety=torque_only(limit))
    random = np.random.default_rng(10 + n)
    last = theta = config.target_posture + 0.01
    saturated = 0
    for tick in range(200):
        perturbed = (tick // 20) % n
        controller.perturb_joint(perturbed)
        tau_delta = np.where(np.arange(n) == perturbed, random.uniform(-9.0, 9.0), 0.0)
        clipped = controller.tick(theta, random.normal(size=n), tau_delta)
        expected = np.zeros(n)
        for i in range(n):
            stiffness = 25.0**2 * config.inertia[i]
            damping = 2.0 * 0.8 * 25.0 * config.inertia[i]
            if i == perturbed:
                stiffness, damping = config.target_stiffness[i], config.target_damping[i]
            velocity = (theta[i] - last[i]) / PERIOD
            expected[i] = stiffness * (config.target_posture[i] - theta[i]) - damping * velocity
        expected = within_torque(expected + tau_delta, limit)
        assert controller.command == pytest.approx(expected, rel=1e-9, abs=1e-9)
        assert clipped == (n if np.max(np.abs(expected)) == limit else 0)
        saturated += clipped
        last, theta = theta, theta + 1e-4 * random.normal(size=n)
    assert (saturated == 0) if limit > 100.0 else (saturated > 0)


# --- the configuration -----------------------------------------------------------------------


def test_law_of_the_study_is_the_default_and_one_parameter_chooses_the_other() -> None:
    assert isinstance(_parameters().law_config(), ImbicConfig)
    chosen = _parameters(**{"law.kind": "pd"})
    law = chosen.law_config()
    assert isinstance(law, PdConfig)
    assert law.inertia == pytest.approx(np.diag(ROBOT))
    assert (law.frequency, law.damping_ratio, law.period) == (25.0, 1.0, 1e-3)
    for name in ("target_posture", "target_damping", "target_stiffness"):
        assert np.array_equal(getattr(law, name), getattr(_parameters().imbic_config(), name))
    tuned = _parameters(**{"law.pd_frequency": 40.0, "law.pd_damping_ratio": 0.7}).pd_config()
    assert (tuned.frequency, tuned.damping_ratio) == (40.0, 0.7)


# --- sampled stability -----------------------------------------------------------------------


def _sizes(config: PdConfig, perturbed: int, ticks: int) -> Array:
    """Largest acceleration (ticks,) after a push, of a rig of pure inertia under the law."""
    controller = Controller(config, safety=torque_only(1e300))
    controller.perturb_joint(perturbed)
    inverse = np.linalg.inv(ROBOT + ARM)
    theta, velocity, push = POSTURE.copy(), np.zeros(2), np.array([1.0, 1.0])
    sizes = np.zeros(ticks)
    for tick in range(ticks):
        controller.tick(theta, np.zeros(2), np.zeros(2))
        acceleration = inverse @ (controller.command + push)
        theta = theta + PERIOD * velocity + 0.5 * PERIOD**2 * acceleration
        velocity = velocity + PERIOD * acceleration
        push = np.zeros(2)
        sizes[tick] = np.max(np.abs(acceleration))
    return sizes


@pytest.mark.parametrize("perturbed", [0, 1])
@pytest.mark.parametrize("frequency", [25.0, 100.0, 500.0, 600.0])
def test_spectral_radius_is_the_growth_of_the_loop(frequency: float, perturbed: int) -> None:
    config = _rig_config(frequency=frequency)
    radius = spectral_radius(config, perturbed=perturbed, robot_inertia=ROBOT, arm_inertia=ARM)
    sizes = _sizes(config, perturbed, 6000 if radius < 1.0 else 400)
    if radius < 1.0:
        assert np.max(sizes[5000:]) < 1e-3 * np.max(sizes[:10])
    else:
        growth = (np.max(sizes[350:]) / np.max(sizes[250:300])) ** 0.01
        assert growth == pytest.approx(radius, rel=2e-3)


def test_gains_near_the_edge_give_a_warning_and_beyond_it_are_refused() -> None:
    near = check_stability(_rig_config(frequency=240.0), robot_inertia=ROBOT, arm_inertia=ARM)
    assert any("commands that act 1 ms later the loop would be" in w for w in near)
    with pytest.raises(ConfigurationError, match=r"locked, motion grows by .* as light"):
        check_stability(_rig_config(frequency=250.0), robot_inertia=ROBOT, arm_inertia=ARM)
    with pytest.raises(ConfigurationError, match=r"joint 1 is perturbed, motion grows by .* 1\.\d"):
        check_stability(_rig_config(frequency=500.0), robot_inertia=ROBOT, arm_inertia=ARM)
    with pytest.raises(ConfigurationError, match="motion grows by a factor of"):
        _parameters(**{"law.kind": "pd", "law.pd_frequency": 500.0}).check()
    # The same numbers do not matter to the other law.
    _parameters(**{"law.pd_frequency": 500.0}).check()


def test_with_the_coarsest_encoders_the_locked_rig_stays_within_a_count() -> None:
    config = _rig_config()
    controller = Controller(config, safety=torque_only(80.0))
    inverse = np.linalg.inv(ROBOT + ARM)
    theta, velocity = POSTURE + np.array([0.01, -0.01]), np.zeros(2)
    controller.role[:] = config.role(0)
    controller.role[:, 0] = config.role(1)[:, 0]  # both locked
    late, torque = [], []
    for tick in range(4000):
        controller.tick(np.round(theta / COUNT) * COUNT, np.zeros(2), np.zeros(2))
        acceleration = inverse @ controller.command
        theta = theta + PERIOD * velocity + 0.5 * PERIOD**2 * acceleration
        velocity = velocity + PERIOD * acceleration
        if tick >= 2000:
            late.append(theta - POSTURE)
            torque.append(controller.command.copy())
    assert np.max(np.abs(late)) < 1.5 * COUNT
    # Chatter of a single count is about what the drives lose to friction at its highest level.
    assert np.max(np.abs(torque)) < 3.0
