"""Dither of locked joints: the rows of the role, and the motion that a joint makes of it."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from armimp_control.laws import APPROACH, DITHER, DITHER_ANGLE
from armimp_control.laws.imbic import ImbicConfig
from armimp_control.laws.law import Controller
from support.safety import torque_only

Array = NDArray[np.float64]
PERIOD = 1e-3
INERTIA = 0.5
TONES = (35.0, 54.25)
AMPLITUDE = 1e-4


def _config(*, model: float = INERTIA, frequency: float = 100.0, ratio: float = 1.0) -> ImbicConfig:
    return ImbicConfig(
        target_posture=np.array([0.3, -0.2]),
        target_inertia=np.array([0.2, 0.1]),
        target_damping=np.array([2.0, 1.0]),
        target_stiffness=np.array([10.0, 10.0]),
        model_inertia=model * np.eye(2),
        lock_frequency=frequency,
        lock_damping_ratio=ratio,
        lock_dither=AMPLITUDE,
    )


def _target(config: ImbicConfig, hertz: float) -> complex:
    """``(s² + 2ζωs + ω²)/ω²`` of a locked joint, from its motion to that of its target."""
    s, omega = 2j * np.pi * hertz, config.lock_frequency
    return (s**2 + 2.0 * config.lock_damping_ratio * omega * s + omega**2) / omega**2


def _sampled(config: ImbicConfig, hertz: float) -> complex:
    """From the target of a locked joint to its motion, exactly, for pure inertia.

    The law as it stands in the design with 1/z for a tick, and a torque that is held between ticks.
    """
    z = np.exp(2j * np.pi * hertz * PERIOD)
    speed = (1.0 - 1.0 / z) / PERIOD
    plant = PERIOD**2 / (2.0 * INERTIA) * (z + 1.0) / (z - 1.0) ** 2
    loop = plant * config.model_inertia[0, 0] / (1.0 - 1.0 / z)
    feedback = 1.0 + config.gamma / speed
    omega = config.lock_frequency
    pull = 2.0 * config.lock_damping_ratio * omega * speed + omega**2
    closed = 1.0 + loop * (feedback * pull + config.gamma * speed + speed**2)
    return complex(loop * feedback * omega**2 / closed)


def _motion(config: ImbicConfig, ticks: int) -> Array:
    """Distance (ticks,) of the locked first joint, of pure inertia, from its posture, rad."""
    controller = Controller(config, safety=torque_only(1e9))
    controller.perturb_joint(1)
    theta, velocity = config.target_posture.copy(), np.zeros(2)
    path = np.zeros(ticks)
    for tick in range(ticks):
        path[tick] = theta[0] - config.target_posture[0]
        controller.tick(theta, np.zeros(2), np.zeros(2))
        acceleration = controller.command / INERTIA
        theta = theta + PERIOD * velocity + 0.5 * PERIOD**2 * acceleration
        velocity = velocity + PERIOD * acceleration
    return path


def _amplitudes(path: Array) -> Array:
    """Amplitudes of the two sines in the second half of a path, where nothing else is left."""
    ticks = np.arange(path.size)[path.size // 2 :]
    angles = 2.0 * np.pi * PERIOD * np.outer(ticks, TONES)
    waves = np.hstack([np.cos(angles), np.sin(angles)])
    found = np.linalg.lstsq(waves, path[ticks], rcond=None)[0]
    assert np.max(np.abs(waves @ found - path[ticks])) < 1e-6 * AMPLITUDE
    amplitudes: Array = np.hypot(found[:2], found[2:])
    return amplitudes


@pytest.mark.parametrize("ratio", [0.7, 1.0])
@pytest.mark.parametrize("frequency", [50.0, 100.0, 200.0])
def test_rows_of_the_role_are_those_of_the_closed_form(frequency: float, ratio: float) -> None:
    config = _config(frequency=frequency, ratio=ratio)
    rows = config.role(1)
    between = np.sqrt(TONES[0] * TONES[1])
    assert rows[DITHER] == pytest.approx([AMPLITUDE * abs(_target(config, between)), 0.0])
    assert rows[DITHER_ANGLE] == pytest.approx([2.0 * np.pi * 35.0 * PERIOD] * 2)
    assert rows[APPROACH] == pytest.approx([np.exp(-0.02)] * 2)


@pytest.mark.parametrize("model", [0.6 * INERTIA, INERTIA])
@pytest.mark.parametrize("frequency", [50.0, 100.0, 200.0])
def test_joint_moves_by_the_sampled_response_to_its_target(model: float, frequency: float) -> None:
    config = _config(model=model, frequency=frequency)
    asked = config.role(1)[DITHER, 0]
    expected = [asked * abs(_sampled(config, hertz)) for hertz in TONES]
    assert _amplitudes(_motion(config, 4000)) == pytest.approx(expected, rel=1e-5)
