"""The laws against plain transcriptions of their equations, and their behaviour at the edges."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
import pytest

from armimp_common.arrays import FloatArray as Array
from armimp_common.errors import ConfigurationError
from armimp_control.laws import (
    ANGLE_GAIN,
    DISTURBANCE_GAIN,
    INERTIA_MODEL,
    NO_JOINT,
    VELOCITY_GAIN,
    Law,
    LawParameters,
    TargetParameters,
)
from armimp_control.laws.imbic import Imbic
from armimp_control.laws.law import Controller
from armimp_control.laws.pd import Pd
from armimp_control.rig import KnownParameters, RigDynamics
from armimp_control.stability import check_stability, spectral_radius
from support.laws import (
    ARM,
    POSTURE,
    ROBOT,
    knowing,
    preset_law,
    torque_only,
    with_law,
    within_torque,
)

PERIOD, GAMMA = 1e-3, 70.0
COUNT = 2.0 * np.pi / 51200


class Transcription(Protocol):
    """Equations as they stand on the page."""

    def tick(self, theta: Array, tau_h: Array, tau_delta: Array, perturbed: int) -> Array:
        """Return the command (n,), N·m."""


def assert_law(
    config: Law,
    expected: Transcription,
    limit: float,
    perturbed: Callable[[int], int],
    precision: float = 1e-9,
) -> None:
    """Check that a law commands what is expected, whichever joint is perturbed at each tick."""
    n = config.joints
    controller = Controller(config, safety=torque_only(limit))
    random = np.random.default_rng(10 + n)
    theta = config.target_posture + random.uniform(-1e-4, 1e-4, n)
    saturated = 0
    for tick in range(200):
        joint = perturbed(tick)
        controller.perturb_joint(joint)
        theta = theta + 1e-5 * random.normal(size=n)
        tau_h = random.uniform(-3.0, 3.0, n)
        tau_delta = np.where(np.arange(n) == joint, random.uniform(-9.0, 9.0), 0.0)
        controller.sample[:] = theta, tau_h, tau_delta
        clipped = controller.compute()
        command = expected.tick(theta, tau_h, tau_delta, joint)
        assert controller.command == pytest.approx(command, rel=precision, abs=precision)
        assert clipped == (n if np.max(np.abs(command)) == limit else 0)
        saturated += clipped
    # Unlimited it never clips; limited it does, but leaves the limit again.
    assert (saturated == 0) if limit > 100.0 else (20 < saturated < 200 * n - 20)


def _delayed(n: int = 2, dither: float = 0.0) -> Law:
    random = np.random.default_rng(n)
    target = TargetParameters(
        posture=tuple(random.uniform(-1.0, 1.0, n)),
        inertia=tuple(random.uniform(0.1, 0.3, n)),
        damping=tuple(random.uniform(1.0, 3.0, n)),
        stiffness=tuple(random.uniform(5.0, 15.0, n)),
        lock_frequency=90.0,
        lock_damping_ratio=0.8,
        lock_approach=0.02,
        lock_dither=dither,
        lock_dither_frequency=30.0,
    )
    model_inertia = 0.1 * np.eye(n) + random.uniform(-0.03, 0.03, (n, n))
    law = LawParameters(
        internal_model="tde", model_inertia=tuple(model_inertia.ravel()), gamma=GAMMA
    )
    return Imbic(target=target, law=law, known=_known(np.eye(n)))


def _known(robot: Array) -> KnownParameters:
    """A robot (n, n), kg·m², without an arm."""
    flat = tuple(robot.ravel())
    return KnownParameters(robot_inertia=flat, arm_inertia=(0.0,) * len(flat))


@dataclass
class DelayedEquations:
    """Equations 4 to 8 as they stand in the design, with whole histories instead of a memory.

    The target of a joint that has been locked since tick j is θ_rd plus what is left of its
    distance at that tick, plus the dither.
    """

    config: Law
    limit: float
    positions: list[Array] = field(default_factory=list)
    perturbed: list[int] = field(default_factory=list)
    accelerations: list[Array] = field(default_factory=list)
    sent: list[Array] = field(default_factory=list)

    def tick(self, theta: Array, tau_h: Array, tau_delta: Array, perturbed: int) -> Array:
        c, n = self.config, theta.size
        if not self.positions:
            self.positions = [theta.copy(), theta.copy()]
            self.sent = [np.zeros(n)]
        self.positions.append(theta.copy())
        now, last, before = self.positions[-1], self.positions[-2], self.positions[-3]
        self.perturbed.append(perturbed)
        velocity = (now - last) / PERIOD
        delayed_acceleration = (now - 2.0 * last + before) / PERIOD**2
        u = np.zeros(n)
        for i in range(n):
            inertia = c.target.inertia[i]
            if i == perturbed:
                damping, stiffness, felt = c.target.damping[i], c.target.stiffness[i], tau_h[i]
            else:
                damping, stiffness, felt = 2 * 0.8 * 90.0 * inertia, 90.0**2 * inertia, 0.0
            deflection = theta[i] - (c.target.posture[i] if i == perturbed else self.goal(i))
            u[i] = (tau_delta[i] - felt - damping * velocity[i] - stiffness * deflection) / inertia
        self.accelerations.append(u)
        ideal_velocity = PERIOD * np.sum(self.accelerations, axis=0)
        change = c.model(0)[INERTIA_MODEL] @ (
            u + GAMMA * (ideal_velocity - velocity) - delayed_acceleration
        )
        self.sent.append(within_torque(self.sent[-1] + change, self.limit))
        return self.sent[-1]

    def goal(self, joint: int) -> float:
        """Target of a locked joint, rad."""
        c, ticks = self.config, len(self.perturbed) - 1
        yielding = [tick for tick, k in enumerate(self.perturbed) if k == joint]
        since = yielding[-1] + 1 if yielding else 0
        rest = float(c.target.posture[joint])
        distance = float(self.positions[since + 2][joint]) - rest
        approach = distance * np.exp(-PERIOD * (ticks - since) / 0.02)
        # Amplitude of the target for a joint that follows as a low-pass of 90 rad/s, ζ = 0.8.
        s = 2j * np.pi * 30.0 * np.sqrt(1.55)
        amplitude = c.target.lock_dither * abs(s**2 + 2 * 0.8 * 90.0 * s + 90.0**2) / 90.0**2
        angle = 2.0 * np.pi * 30.0 * PERIOD * ticks
        return float(rest + approach + amplitude * (np.sin(angle) + np.sin(1.55 * angle)))


@pytest.mark.parametrize("dither", [0.0, 2e-4])
@pytest.mark.parametrize("limit", [1e9, 6.0])
@pytest.mark.parametrize("n", [1, 2, 3, 7])
def test_law_is_that_of_the_design(n: int, limit: float, dither: float) -> None:
    config = _delayed(n, dither)
    # Roles change hands now and then.
    assert_law(config, DelayedEquations(config, limit), limit, lambda tick: (tick // 60) % n)


def _observed(n: int = 2, delay: int = 0) -> Law:
    """Default law, which knows that commands act so many periods late."""
    robot, posture = ROBOT, POSTURE
    if n != 2:
        root = np.random.default_rng(n).normal(size=(n, n))
        robot, posture = 0.05 * root @ root.T + 0.2 * np.eye(n), np.zeros(n)
    return knowing(preset_law(robot, posture, "observer"), command_delay=delay)


class ObserverEquations:
    """The equations with matrices, for one perturbed joint."""

    def __init__(self, config: Law, perturbed: int, limit: float) -> None:
        self.config, self.limit, self.delay = config, limit, config.known.command_delay
        self.model = config.model(perturbed)
        self.locked = np.arange(config.joints) != perturbed
        target, omega = config.target, config.target.lock_frequency
        self.damping = np.where(self.locked, 2.0 * omega, np.divide(target.damping, target.inertia))
        stiffness = np.divide(target.stiffness, target.inertia)
        self.stiffness = np.where(self.locked, omega**2, stiffness)
        zero = np.zeros(config.joints)
        self.angle = self.start = self.ideal = self.velocity = self.unknown = zero
        self.sent = [zero] * self.delay
        self.ticks = 0

    def tick(self, theta: Array, tau_h: Array, tau_delta: Array, _: int) -> Array:
        config, inertia = self.config, self.model[INERTIA_MODEL]
        if self.ticks:
            acting = self.sent[-1 - self.delay] - tau_h
            known = np.linalg.inv(inertia) @ acting + self.unknown
            self.angle = self.angle + PERIOD * self.velocity + 0.5 * PERIOD**2 * known
            self.velocity = self.velocity + PERIOD * known
            error = theta - self.angle
            self.angle = self.angle + self.model[ANGLE_GAIN] @ error
            self.velocity = self.velocity + self.model[VELOCITY_GAIN] @ error
            self.unknown = self.unknown + self.model[DISTURBANCE_GAIN] @ error
        else:
            self.angle, self.start = theta.copy(), theta - config.target_posture
        approach = self.start * np.exp(-self.ticks * PERIOD / 0.05)
        goal = config.target_posture + self.locked * approach
        push = np.where(self.locked, 0.0, (tau_delta - tau_h) / config.target.inertia)
        u = push - self.damping * self.velocity - self.stiffness * (self.angle - goal)
        self.ideal = self.ideal + PERIOD * u
        wanted = u + config.law.gamma * (self.ideal - self.velocity) - self.unknown
        command = inertia @ wanted + tau_h
        self.sent.append(within_torque(command, self.limit))
        self.ideal = self.ideal + PERIOD * np.linalg.inv(inertia) @ (self.sent[-1] - command)
        self.ticks += 1
        return self.sent[-1]


@pytest.mark.parametrize("limit", [1e9, 4.0])
@pytest.mark.parametrize(
    ("n", "perturbed", "delay"), [(1, 0, 0), (2, 0, 0), (2, 1, 1), (2, 1, 20), (4, 2, 3)]
)
def test_law_with_observer_is_that_of_its_equations(
    n: int, perturbed: int, delay: int, limit: float
) -> None:
    config = _observed(n, delay)
    equations = ObserverEquations(config, perturbed, limit)
    assert_law(config, equations, limit, lambda _: perturbed, precision=1e-7)


def test_gains_are_those_that_the_riccati_recursion_comes_to() -> None:
    law = with_law(
        preset_law(ROBOT, POSTURE),
        encoder_resolution=COUNT,
        perturbed_walk=(0.4, 0.2),
        locked_walk=(0.02, 0.01),
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
    found = law.model(0)[ANGLE_GAIN:].reshape(6, 2)
    assert found == pytest.approx(gain, rel=1e-6, abs=1e-9 * np.max(np.abs(gain)))


@pytest.mark.parametrize(("joint", "speed"), [(0, 0.5), (0, 0.8), (1, 1.0), (1, 1.5)])
def test_a_fast_joint_that_gets_locked_comes_to_rest_though_commands_are_clipped(
    joint: int, speed: float
) -> None:
    """It would swing ever faster if the ideal velocity were integrated on while clipped.

    It would do so, too, if clipping took torque from one joint alone.
    """
    controller = Controller(_observed(), safety=torque_only(9.0))
    controller.perturb_joint(joint)
    inverse = np.linalg.inv(ROBOT + ARM)
    theta, velocity, acceleration = POSTURE.copy(), np.zeros(2), np.zeros(2)
    velocity[joint] = speed
    clipped = 0
    for tick in range(1000):
        if tick == 5:
            controller.perturb_joint(1 - joint)
        controller.sample[:2] = theta, ARM @ acceleration
        clipped += controller.compute()
        acceleration = inverse @ controller.command
        theta = theta + PERIOD * velocity + 0.5 * PERIOD**2 * acceleration
        velocity = velocity + PERIOD * acceleration
        assert np.max(np.abs(theta - POSTURE)) < 0.2
    assert clipped > 10
    assert abs(velocity[joint]) < 1e-3


def test_defaults_bear_one_late_period_and_any_arm_within_a_factor_of_three() -> None:
    for delay in (0, 1):
        assert check_stability(_observed(delay=delay)) == ()
    with pytest.raises(ConfigurationError, match=r"grows by .* act 2 periods late"):
        check_stability(_observed(delay=2))
    # An observer that does not know of the delay makes a heavy arm swing.
    late = RigDynamics(command_delay=1)
    assert spectral_radius(_observed(), late, perturbed=NO_JOINT, arm=3.0) > 1.001


def _plain(n: int) -> Law:
    random = np.random.default_rng(n)
    target = TargetParameters(
        posture=tuple(random.uniform(-1.0, 1.0, n)),
        inertia=(1.0,) * n,
        damping=tuple(random.uniform(1.0, 3.0, n)),
        stiffness=tuple(random.uniform(5.0, 15.0, n)),
    )
    robot = np.diag(random.uniform(0.1, 0.4, n))
    law = LawParameters(model_inertia=(), pd_frequency=25.0, pd_damping_ratio=0.8)
    return Pd(target=target, law=law, known=_known(robot))


@dataclass
class PdEquations:
    """Stiffness and damping of each joint: of its target if it is perturbed, else of its lock."""

    config: Law
    limit: float
    last: Array | None = None

    def tick(self, theta: Array, _: Array, tau_delta: Array, perturbed: int) -> Array:
        c = self.config
        velocity = (theta - (theta if self.last is None else self.last)) / PERIOD
        inertia = np.diag(np.reshape(c.known.robot_inertia, (theta.size, theta.size)))
        stiffness, damping = 25.0**2 * inertia, 2.0 * 0.8 * 25.0 * inertia
        stiffness[perturbed] = c.target.stiffness[perturbed]
        damping[perturbed] = c.target.damping[perturbed]
        self.last = theta
        command = stiffness * (c.target_posture - theta) - damping * velocity + tau_delta
        return within_torque(command, self.limit)


@pytest.mark.parametrize("limit", [1e9, 4.0])
@pytest.mark.parametrize("n", [1, 2, 3, 7])
def test_locked_joints_are_held_by_stiffness_and_damping_and_the_perturbed_one_by_its_target(
    n: int, limit: float
) -> None:
    config = _plain(n)
    assert_law(config, PdEquations(config, limit), limit, lambda tick: (tick // 20) % n)
