"""The law against a plain transcription of its equations, and its behaviour at the edges."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pytest
from numpy.typing import NDArray

from armimp_control.laws import TargetParameters
from armimp_control.laws.imbic import ImbicConfig
from armimp_control.laws.law import Controller
from support.laws import torque_only, within_torque

Array = NDArray[np.float64]
PERIOD, GAMMA = 1e-3, 70.0


def _config(n: int = 2, dither: float = 0.0) -> ImbicConfig:
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
    return ImbicConfig(target=target, model_inertia=model_inertia, gamma=GAMMA, period=PERIOD)


@dataclass
class Transcription:
    """Equations 4 to 8 as they stand in the design, with whole histories instead of a memory.

    The target of a joint that has been locked since tick j is θ_rd plus what is left of its
    distance at that tick, plus the dither.
    """

    config: ImbicConfig
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
        change = c.model_inertia @ (u + GAMMA * (ideal_velocity - velocity) - delayed_acceleration)
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
    config = _config(n, dither)
    controller, expected = (
        Controller(config, safety=torque_only(limit)),
        Transcription(config, limit),
    )
    random = np.random.default_rng(10 + n)
    theta = config.target_posture + random.uniform(-1e-4, 1e-4, n)
    saturated = 0
    for tick in range(200):
        perturbed = (tick // 60) % n  # roles change hands now and then
        controller.perturb_joint(perturbed)
        theta = theta + 1e-5 * random.normal(size=n)
        tau_h = random.uniform(-3.0, 3.0, n)
        tau_delta = np.where(np.arange(n) == perturbed, random.uniform(-9.0, 9.0), 0.0)
        clipped = controller.tick(theta, tau_h, tau_delta)
        command = expected.tick(theta, tau_h, tau_delta, perturbed)
        assert controller.command == pytest.approx(command, rel=1e-9, abs=1e-9)
        assert clipped == (n if np.max(np.abs(command)) == limit else 0)
        saturated += clipped
    # Unlimited it never clips; limited it does, but leaves the limit again.
    assert (saturated == 0) if limit > 100.0 else (20 < saturated < 200 * n - 20)


@pytest.mark.parametrize("shape", [(1,), (3,), (1, 2)])
@pytest.mark.parametrize("which", [0, 1, 2])
def test_inputs_of_another_shape_are_refused(which: int, shape: tuple[int, ...]) -> None:
    controller = Controller(_config(), safety=torque_only(80.0))
    inputs = [np.zeros(2), np.zeros(2), np.zeros(2)]
    inputs[which] = np.zeros(shape)
    with pytest.raises(ValueError, match=r"must all be \(2,\)"):
        controller.tick(*inputs)
