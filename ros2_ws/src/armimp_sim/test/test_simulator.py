"""The simulated rig as a device: one step for each command, and no torque after a fault."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from armimp_sim.parameters import SimulatorParameters
from armimp_sim.plant import Plant
from armimp_sim.simulator import SimulatedRig
from armimp_sim.voluntary import VoluntaryParameters, VoluntaryTorque

TICKS = 60


def parameters(*, joints: int = 2, seed: int = 1, voluntary: float = 0.0) -> SimulatorParameters:
    preset = SimulatorParameters.preset(joints=joints, seed=seed)
    return preset.model_copy(update={"voluntary": VoluntaryParameters(rms=voluntary)})


def some_commands(ticks: int = TICKS, joints: int = 2) -> NDArray[np.float64]:
    return np.random.default_rng(5).uniform(-20.0, 20.0, (ticks, joints))


def readings(rig: SimulatedRig, commands: NDArray[np.float64]) -> NDArray[np.float64]:
    """Samples after each command: (ticks, 2, n)."""
    samples = []
    for command in commands:
        rig.step(tuple(command.tolist()))
        samples.append([rig.position.copy(), rig.torque.copy()])
    return np.array(samples)


@pytest.mark.parametrize("joints", [2, 3])
def test_samples_are_those_of_the_plant_bit_for_bit(joints: int) -> None:
    given = parameters(joints=joints, voluntary=0.3)
    commands = some_commands(joints=joints)

    samples = readings(SimulatedRig(given), commands)

    plant = Plant([given.plant_config()])
    voluntary = VoluntaryTorque(given.voluntary, joints=joints, period=1e-3, seed=1)
    for command, sample in zip(commands, samples, strict=True):
        plant.tick(command[None, :], voluntary.take(1))
        np.testing.assert_array_equal(sample, [plant.position[0], plant.torque[0]])
    assert np.ptp(samples, axis=0).min() > 0.0


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("joint", [0, 1])
def test_when_a_command_is_not_finite_expect_zero_torque_the_same_tick_and_ever_after(
    value: float, joint: int
) -> None:
    commands = some_commands()
    spoiled, safe = commands.copy(), commands.copy()
    spoiled[20, joint] = value
    safe[20:] = 0.0
    rig = SimulatedRig(parameters())

    samples = readings(rig, spoiled)

    np.testing.assert_array_equal(samples, readings(SimulatedRig(parameters()), safe))
    assert not np.array_equal(samples, readings(SimulatedRig(parameters()), commands))
    assert rig.fault == f"command of joint {joint + 1} is not finite: {value}"
    assert rig.tick == TICKS


def test_voluntary_torque_follows_the_seed_and_goes_on_after_a_fault() -> None:
    commands = np.zeros((TICKS, 2))
    first = readings(SimulatedRig(parameters(voluntary=0.5)), commands)
    again = readings(SimulatedRig(parameters(voluntary=0.5)), commands)
    other = readings(SimulatedRig(parameters(voluntary=0.5, seed=2)), commands)
    faulty = SimulatedRig(parameters(voluntary=0.5))
    faulty.latch("a fault")

    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)
    np.testing.assert_array_equal(first, readings(faulty, commands))
    assert np.ptp(first[:, 1], axis=0).min() > 0.0
