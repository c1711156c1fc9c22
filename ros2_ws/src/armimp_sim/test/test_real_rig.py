"""Transducers and drives of a real rig: each imperfection against its closed form."""

from typing import Any

import numpy as np
import pytest
from scipy import signal
from scipy.integrate import trapezoid

from armimp_common.arrays import FloatArray as Array
from armimp_sim import presets
from armimp_sim.model.arm import CuffParameters, HumanArm, MuscleParameters, ReflexParameters
from armimp_sim.model.friction import LuGre
from armimp_sim.model.robot import ActuatorParameters, PlanarChain
from armimp_sim.model.sensors import ReadingParameters, Sampling, SensorParameters
from armimp_sim.parameters import SimulatorParameters
from armimp_sim.plant import Plant
from support.plants import COMMANDS, changed, load, rig, run, state_of, stepwise, study_plant

SUBSTEPS = 20


def config(sampling: Sampling = Sampling.BEFORE_UPDATE, **torque: Any) -> SimulatorParameters:
    """The rig of the study without resolution, with this transducer."""
    sensors = SensorParameters(sampling=sampling, torque=ReadingParameters(**torque))
    return study_plant(1, sensors=sensors, substeps=SUBSTEPS)


def within() -> tuple[Array, Array]:
    """Torque on the arm at the start and the end of every step of the integration, (steps, 2)."""
    plain = config()
    fine, commands = stepwise(plain), np.repeat(COMMANDS, SUBSTEPS, axis=0)
    before = state_of(fine)
    states, ends = run(fine, commands)
    # The reading without any time passing: under the new command, before the step.
    states = np.concatenate([before, states[:-1]])
    return np.array([load(plain, *one) for one in zip(states, commands, strict=True)]), ends


def test_offset_drift_and_gain_change_the_reading_and_nothing_else() -> None:
    plain_states, plain = run(config())
    states, torques = run(config(offset=(0.5, -1.0), drift=(2.0, 0.0), gain=(1.1, 0.9)))
    seconds = 1e-3 * np.arange(1, len(COMMANDS) + 1)[:, None]

    assert np.array_equal(states, plain_states)
    expected = np.array([1.1, 0.9]) * plain + [0.5, -1.0] + seconds * [2.0, 0.0]
    assert torques == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("sampling", list(Sampling))
def test_a_delay_of_whole_periods_shows_earlier_readings(sampling: Sampling) -> None:
    _, prompt = run(config(sampling, cutoff=1e6))
    _, late = run(config(sampling, cutoff=1e6, delay=0.003))
    assert np.array_equal(late[3:], prompt[:-3])
    assert np.array_equal(late[:3], np.zeros((3, 2)))


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
    drive, torque = ActuatorParameters(bandwidth=40.0), np.array([1.0, -0.5])
    lag = drive.lag
    arm = presets.human_arm(2)
    free = changed(
        config(),
        actuators=drive,
        arm=arm.model_copy(update={"damping": (0.0,) * 4, "stiffness": (0.0,) * 4}),
        friction=LuGre(),
    )
    states, torques = run(free, np.tile(torque, (20, 1)))
    t = 1e-3 * np.arange(1, 21)[:, None]
    mass = free.mass_matrix()
    gained = torque * (t - lag * (1.0 - np.exp(-t / lag)))
    # The arm turns so little that the inertia stays what it was.
    assert states[:, 1] == pytest.approx(gained @ np.linalg.inv(mass).T, rel=1e-3)
    load = torque * (1.0 - np.exp(-t / lag))
    expected = load @ np.linalg.inv(mass).T @ arm.M.T
    assert torques == pytest.approx(expected, rel=1e-2, abs=1e-4)


SINGLE = presets.human_arm(1)
ONE = rig(
    HumanArm(
        posture=SINGLE.posture * 2,
        inertia=(*SINGLE.inertia, 0.0, 0.0, *SINGLE.inertia),
        damping=(*SINGLE.damping, 0.0, 0.0, *SINGLE.damping),
        stiffness=(*SINGLE.stiffness, 0.0, 0.0, *SINGLE.stiffness),
    ),
    PlanarChain(
        lengths=(0.0, 0.0),
        moments=(*presets.robot(1).moments, 1e-12),
        masses=(0.0, 0.0),
        centres=(0.0, 0.0),
    ),
    substeps=SUBSTEPS,
)
"""One joint without friction, which is linear: all of it has closed forms. The other one rests."""
PUSHES = np.repeat(np.random.default_rng(7).uniform(-4.0, 4.0, (30, 1)), 10, axis=0) * [1.0, 0.0]


def torques(plant: SimulatorParameters) -> tuple[Array, Array, Array, Array]:
    """Angle from the posture, velocity, torques of the drive and of the arm beside M, B, K.

    Of one joint at each tick, from states and readings by the equations of motion.
    """
    states, load = run(plant, PUSHES)
    q, v = states[:, 0, 0] - plant.arm.posture[0], states[:, 1, 0]
    M, B, K = plant.arm.inertia[0], plant.arm.damping[0], plant.arm.stiffness[0]
    passive = B * v + K * q
    if plant.actuators == ActuatorParameters():
        acceleration = (PUSHES[:, 0] - load[:, 0]) / plant.robot.moments[0]
        return q, v, PUSHES[:, 0], load[:, 0] - M * acceleration - passive
    acceleration = (load[:, 0] - passive) / M
    drive = load[:, 0] + plant.robot.moments[0] * acceleration
    return q, v, drive, np.zeros_like(q)


def test_behind_a_cuff_the_transducers_feel_arm_and_cuff_in_series() -> None:
    k, b = 1e4, 20.0
    cuff = CuffParameters(stiffness=k, damping=b)
    soft = rig(SINGLE, presets.robot(1), substeps=SUBSTEPS, cuff=cuff)
    M, B, K = SINGLE.inertia[0], SINGLE.damping[0], SINGLE.stiffness[0]
    robot = soft.robot.moments[0]
    system = [
        [0.0, 1.0, 0.0, 0.0],
        [-k / robot, -b / robot, k / robot, b / robot],
        [0.0, 0.0, 0.0, 1.0],
        [k / M, b / M, -(k + K) / M, -(b + B) / M],
    ]
    reads = [[1.0, 0.0, 0.0, 0.0], [k, b, -k, -b]]
    given = (
        np.array(system),
        np.array([[0.0], [1.0 / robot], [0.0], [0.0]]),
        reads,
        np.zeros((2, 1)),
    )
    discrete = signal.dlti(*signal.cont2discrete(given, 1e-3)[:4], dt=1e-3)
    _, expected, _ = signal.dlsim(discrete, np.append(PUSHES[:, :1], [[0.0]], axis=0))

    states, load = run(soft, PUSHES[:, :1])
    assert states[:, 0, 0] - SINGLE.posture[0] == pytest.approx(expected[1:, 0], abs=1e-8)
    assert load[:, 0] == pytest.approx(expected[1:, 1], abs=1e-5)
    assert np.max(np.abs(states[:, 0, 0] - states[:, 0, 1])) > 1e-4


def test_a_reflex_is_a_delayed_muscle_driven_by_velocity_and_stretch() -> None:
    reflex = ReflexParameters(
        velocity_gain=(0.4,), stretch_gain=(3.0,), delay=0.0303, muscle=40.0, damping_ratio=0.7
    )
    q, v, _, extra = torques(changed(ONE, reflex=reflex))
    t = 1e-3 * np.arange(1, len(q) + 1)
    excited = np.interp(t - reflex.delay, np.append(0.0, t), np.append(0.0, 0.4 * v + 3.0 * q))
    muscle = ([40.0**2], [1.0, 2.0 * 0.7 * 40.0, 40.0**2])
    _, expected, _ = signal.lsim(muscle, excited, t)
    assert extra == pytest.approx(expected, abs=1e-3 * np.max(np.abs(expected)))
    assert np.max(np.abs(expected)) > 0.1


def played(q: Array, reach: float) -> Array:
    at, found = 0.0, []
    for one in q:
        at = float(np.clip(at, one - reach, one + reach))
        found.append(one - at)
    return np.array(found)


@pytest.mark.parametrize(
    ("muscle", "expected"),
    [
        (
            {"short_range_stiffness": (5.0,), "short_range": 0.01},
            lambda q, _: 5.0 * played(q, 0.01),
        ),
        ({"cubic": -300.0}, lambda q, _: -300.0 * ONE.arm.stiffness[0] * q**3),
        ({"stiffening": 0.5}, lambda q, t: 0.5 * t * ONE.arm.stiffness[0] * q),
    ],
)
def test_muscles_depart_from_a_constant_stiffness(muscle: Any, expected: Any) -> None:
    q, _, _, extra = torques(changed(ONE, muscle=MuscleParameters(**muscle)))
    torque = expected(q, 1e-3 * np.arange(1, len(q) + 1))
    assert extra == pytest.approx(torque, abs=2e-3 * np.max(np.abs(torque)) + 1e-9)
    assert np.max(np.abs(torque)) > 0.02


def test_torque_of_a_drive_has_ripple_and_cogging_by_the_angle() -> None:
    drive = ActuatorParameters(ripple=0.05, ripple_cycles=10.0, cogging=0.2, cogging_cycles=50.0)
    q, _, torque, _ = torques(changed(ONE, actuators=drive))
    angle = q + ONE.arm.posture[0]
    expected = PUSHES[:, 0] * (1.0 + 0.05 * np.sin(10.0 * angle)) + 0.2 * np.sin(50.0 * angle)
    assert torque == pytest.approx(expected, abs=1e-9)


def test_commands_act_late_by_whole_and_parts_of_periods_and_up_to_the_limit_of_the_drive() -> None:
    drive = ActuatorParameters(delay=0.00135, limit=3.0)
    states, _ = run(changed(config(), actuators=drive))
    late = np.repeat(np.clip(COMMANDS, -3.0, 3.0), SUBSTEPS, axis=0)
    late = np.concatenate([np.zeros((27, 2)), late])[: len(late)]
    expected, _ = run(stepwise(config()), late)
    assert np.array_equal(states, expected[SUBSTEPS - 1 :: SUBSTEPS])


def test_readings_pass_cross_talk_hysteresis_hum_noise_and_limit_in_this_order() -> None:
    chain: dict[str, Any] = {
        "cross_talk": 0.1,
        "hysteresis": 0.3,
        "hum": 0.2,
        "hum_frequency": 60.0,
        "limit": 1.5,
    }
    _, plain = run(config())
    real = Plant([config(**chain)])
    noise = 0.1 * np.random.default_rng(2).standard_normal((len(COMMANDS), 1, 2, 2))
    torque, position = [], []
    for command, added in zip(COMMANDS, noise, strict=True):
        real.tick(command[None], np.zeros((1, 2)), added)
        torque.append(real.torque[0].copy())
        position.append(real.position[0] - state_of(real)[0, 0])
    mixed = plain + 0.1 * plain[:, ::-1]
    followed = mixed - np.stack([played(one, 0.15) for one in mixed.T], axis=1)
    hum = 0.2 * np.sin(2.0 * np.pi * 60.0 * 1e-3 * np.arange(1, len(COMMANDS) + 1))[:, None]
    assert torque == pytest.approx(np.clip(followed + hum + noise[:, 0, 1], -1.5, 1.5), abs=1e-9)
    assert np.max(torque) == 1.5
    assert position == pytest.approx(noise[:, 0, 0], abs=1e-12)


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
        assert np.array_equal(state_of(plant), state_of(exact))  # readings don't touch the motion
        assert np.array_equal(exact.position, state_of(exact)[:, 0])
        for read, true, resolution in (
            (plant.position, exact.position, sensors.position.resolution),
            (plant.torque, exact.torque, sensors.torque.resolution),
        ):
            counts = np.rint(read / resolution)
            assert read == pytest.approx(counts * resolution, abs=1e-15)
            assert np.all(np.abs(read - true) <= 0.5000001 * resolution)
        seen.add(float(plant.torque[0, 0]))
    assert len(seen) > 10


def test_interval_mean_torque_is_the_mean_over_the_substeps() -> None:
    sensors = SensorParameters(sampling=Sampling.INTERVAL_MEAN)
    coarse = study_plant(sensors=sensors)
    watcher, last = stepwise(coarse), np.zeros(2)
    commands = np.random.default_rng(6).uniform(-5.0, 5.0, (10, 2))
    for command, read in zip(commands, run(coarse, commands)[1], strict=True):
        before = state_of(watcher)
        within, _ = run(watcher, np.tile(command, (coarse.substeps, 1)))
        states = np.concatenate([before, within])
        torques = np.array([load(coarse, state, command) for state in states])
        mean = trapezoid(torques, dx=1.0 / coarse.substeps, axis=0)
        assert read == pytest.approx(mean, abs=1e-8)
        # Neither end of the interval would do, nor the command before.
        assert np.max(np.abs(torques[-1] - mean)) > 1e-5
        assert np.max(np.abs(load(coarse, states[0], last) - mean)) > 1e-3
        last = command
