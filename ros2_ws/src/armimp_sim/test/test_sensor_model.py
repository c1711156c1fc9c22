"""Transducers and drives of a real rig: each imperfection against its closed form."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import signal

from armimp_common.errors import ConfigurationError
from armimp_sim import presets
from armimp_sim.model.arm import HumanArm
from armimp_sim.model.friction import LuGre
from armimp_sim.model.sensors import Sampling
from armimp_sim.parameters import SimulatorParameters
from armimp_sim.plant import Plant, PlantConfig
from armimp_sim.simulator import SimulatedRig

Array = NDArray[np.float64]
SUBSTEPS = 20
COMMANDS = np.random.default_rng(4).uniform(-5.0, 5.0, (60, 2))


def config(
    sampling: Sampling = Sampling.BEFORE_UPDATE, *, actuator_lag: float = 0.0, **torque: Any
) -> PlantConfig:
    changed = {f"torque_{name}": value for name, value in torque.items()}
    return PlantConfig(
        arm=presets.human_arm(2),
        robot=presets.robot(2),
        friction=presets.friction(1, 2),
        sensors=presets.sensors(0, sampling).model_copy(update=changed),
        actuator_lag=actuator_lag,
        substeps=SUBSTEPS,
    )


def run(plants: PlantConfig | list[PlantConfig], commands: Array = COMMANDS) -> tuple[Array, Array]:
    """States and torque readings of each tick: (ticks, [lanes,] ...)."""
    configs = plants if isinstance(plants, list) else [plants]
    plant = Plant(configs)
    states, torques = [], []
    for command in commands:
        both = np.tile(command, (len(configs), 1))
        plant.tick(both, np.zeros_like(both))
        states.append(plant.state())
        torques.append(plant.torque.copy())
    if isinstance(plants, list):
        return np.array(states), np.array(torques)
    return np.array(states)[:, 0], np.array(torques)[:, 0]


def within(commands: Array = COMMANDS) -> tuple[Array, Array]:
    """Torque on the arm at the start and the end of every step of the integration, (steps, 2)."""
    plain = config()
    fine = Plant([replace(plain, period=plain.step, substeps=1)])
    starts, ends = [], []
    for command in commands:
        for _ in range(SUBSTEPS):
            # The reading without any time passing: under the new command, before the step.
            starts.append(_torque_at(plain, fine.state(), command))
            fine.tick(command[None], np.zeros((1, 2)))
            ends.append(fine.torque[0].copy())
    return np.array(starts), np.array(ends)


def _torque_at(plain: PlantConfig, state: Array, command: Array) -> Array:
    theta, velocity, bristle = state[0]
    arm, robot = plain.arm, plain.robot
    passive = arm.damping @ velocity + arm.stiffness @ (theta - arm.posture)
    friction = np.empty(2)
    for i, law in enumerate(plain.friction):
        scale = law.coulomb + (law.static - law.coulomb) * np.exp(
            -((velocity[i] / law.stribeck_velocity) ** 2)
        )
        slope = velocity[i] - law.sigma_0 * abs(velocity[i]) * bristle[i] / scale
        friction[i] = law.sigma_0 * bristle[i] + law.sigma_1 * slope + law.sigma_2 * velocity[i]
    acceleration = np.linalg.solve(
        robot.mass_matrix(theta) + arm.inertia,
        command - robot.coriolis_torque(theta, velocity) - friction - passive,
    )
    total: Array = arm.inertia @ acceleration + passive
    return total


def test_without_imperfections_nothing_stands_between_torque_and_reading() -> None:
    assert Plant([config(gain=(1.0, 1.0), offset=(0.0, 0.0))]).sensor_lanes is None


def test_offset_drift_and_gain_change_the_reading_and_nothing_else() -> None:
    plain_states, plain = run(config())
    states, torques = run(config(offset=(0.5, -1.0), drift=(2.0, 0.0), gain=(1.1, 0.9)))
    seconds = 1e-3 * np.arange(1, len(COMMANDS) + 1)[:, None]

    assert np.array_equal(states, plain_states)
    expected = np.array([1.1, 0.9]) * plain + [0.5, -1.0] + seconds * [2.0, 0.0]
    assert torques == pytest.approx(expected, abs=1e-12)


def test_the_first_reading_is_the_offset() -> None:
    plant = Plant([config(offset=(0.5, -1.0), delay=0.003, cutoff=100.0)])
    assert plant.torque[0] == pytest.approx([0.5, -1.0], abs=1e-12)


@pytest.mark.parametrize("sampling", list(Sampling))
def test_a_delay_of_whole_periods_shows_earlier_readings(sampling: Sampling) -> None:
    _, prompt = run(config(sampling, cutoff=1e6))
    _, late = run(config(sampling, cutoff=1e6, delay=0.003))
    assert np.array_equal(late[3:], prompt[:-3])
    assert np.array_equal(late[:3], np.zeros((3, 2)))


def test_a_delay_within_the_period_shows_the_torque_of_that_step() -> None:
    _, ends = within()
    _, late = run(config(delay=0.00125))  # 25 of 20 steps in a period
    place = SUBSTEPS * np.arange(2, len(COMMANDS) + 1) - 25 - 1
    assert late[1:] == pytest.approx(ends[place], abs=1e-11)


def test_the_mean_of_the_interval_is_that_of_all_its_steps() -> None:
    starts, ends = within()
    _, means = run(config(Sampling.INTERVAL_MEAN, offset=(1.0,)))
    steps = 0.5 * (starts + ends).reshape(len(COMMANDS), SUBSTEPS, 2)
    assert means - 1.0 == pytest.approx(steps.mean(axis=1), abs=1e-11)


@pytest.mark.parametrize("order", [1, 2, 4])
def test_the_low_pass_is_the_butterworth_filter_of_the_torque(order: int) -> None:
    starts, ends = within()
    _, filtered = run(config(cutoff=150.0, order=order))
    # The torque is a line within each step and jumps between them: a line from jump to jump in
    # steps a thousand times as fine.
    h, fine = 1e-3 / SUBSTEPS, 1e-9
    times = (h * np.arange(len(ends)))[:, None] + [fine, h - fine]
    values = np.stack([starts, ends], axis=1).reshape(-1, 2)
    system = signal.butter(order, 2.0 * np.pi * 150.0, analog=True, output="ba")
    grid = np.arange(0.0, len(COMMANDS) * 1e-3 + 1e-12, h / 40)
    for joint in range(2):
        torque = np.interp(grid, times.ravel(), values[:, joint])
        _, expected, _ = signal.lsim(system, torque, grid)
        at_ticks = expected[SUBSTEPS * 40 :: SUBSTEPS * 40]
        assert filtered[: len(at_ticks), joint] == pytest.approx(at_ticks, abs=2e-3)
    assert np.max(np.abs(filtered - run(config())[1])) > 0.1


def test_a_drive_that_lags_follows_the_command_exponentially() -> None:
    """On a rig that is inertia only, velocity is the integral of the torque of the drives."""
    lag, torque = 0.004, np.array([1.0, -0.5])
    nothing = np.zeros((2, 2))
    arm = presets.human_arm(2)
    free = replace(
        config(actuator_lag=lag),
        arm=HumanArm(posture=arm.posture, inertia=arm.inertia, damping=nothing, stiffness=nothing),
        friction=(LuGre.none(), LuGre.none()),
    )
    states, torques = run(free, np.tile(torque, (20, 1)))
    t = 1e-3 * np.arange(1, 21)[:, None]
    mass = free.mass_matrix()
    gained = torque * (t - lag * (1.0 - np.exp(-t / lag)))
    # The arm turns so little that the inertia stays what it was.
    assert states[:, 1] == pytest.approx(gained @ np.linalg.inv(mass).T, rel=1e-3)
    load = torque * (1.0 - np.exp(-t / lag))
    expected = load @ np.linalg.inv(mass).T @ arm.inertia.T
    assert torques == pytest.approx(expected, rel=1e-2, abs=1e-4)


@pytest.mark.slow
def test_lanes_with_different_imperfections_give_the_bits_that_they_give_alone() -> None:
    lanes = [
        config(delay=0.0021, offset=(0.3,)),
        config(cutoff=200.0, order=2),
        config(actuator_lag=0.001, drift=(0.0, 1.0)),
    ]
    states, torques = run(lanes)
    for lane, one in enumerate(lanes):
        alone_states, alone = run([one])
        assert np.array_equal(states[:, lane], alone_states[:, 0])
        assert np.array_equal(torques[:, lane], alone[:, 0])


def test_a_plant_that_is_put_back_has_forgotten_its_past() -> None:
    imperfect = config(delay=0.0021, offset=(0.3,), cutoff=200.0, drift=(1.0,), actuator_lag=0.001)
    used, fresh = Plant([imperfect]), Plant([imperfect])
    start = used.state()
    for command in COMMANDS[:10]:
        used.tick(command[None], np.zeros((1, 2)))
    used.set_state(start)
    assert np.array_equal(used.torque, fresh.torque)
    for command in COMMANDS[:10]:
        for plant in (used, fresh):
            plant.tick(command[None], np.zeros((1, 2)))
        assert np.array_equal(used.torque, fresh.torque)


def test_the_rig_of_the_node_has_them_too() -> None:
    parameters = SimulatorParameters.preset()
    sensors = parameters.sensors.model_copy(update={"torque_offset": (0.5, -0.2)})
    rig = SimulatedRig(parameters.model_copy(update={"sensors": sensors}))
    assert rig.torque == pytest.approx([0.5, -0.2])


def test_a_vector_that_does_not_fit_the_joints_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="torque_drift has 3 values, needs 1 or 2"):
        config(drift=(1.0, 2.0, 3.0))
