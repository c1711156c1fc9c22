import dataclasses
import functools

import numpy as np
import pytest
from scipy import signal

import armimp
from armimp_common.arrays import FloatArray
from armimp_common.schema import row_by_row
from armimp_estimation.estimators.welch import multiply
from armimp_estimation.fit import Calibration
from armimp_estimation.hold_correction import answers_to_rounding
from armimp_estimation.identify import Identification, identify
from armimp_estimation.mbk import MBK
from armimp_estimation.metadata import Metadata
from armimp_estimation.problems import ProblemCode
from armimp_estimation.record import TrialRecord
from armimp_estimation.trial import TrialData
from armimp_sim.presets import human_arm, robot
from support import known
from support.problems import codes, having
from support.synthetic_trials import (
    TWO_JOINT_ARM,
    SyntheticConfig,
    made_record,
    off,
    synthetic_trial,
)

LOOP = SyntheticConfig(rate=500.0, samples=10_000, lock_stiffness=1500.0)
ROBOT = MBK(
    M=np.array([[0.25, 0.05], [0.05, 0.05]]),
    B=np.diag([0.1, 0.05]),
    K=np.zeros((2, 2)),
)
UNDECLARED, EXACT = Calibration.undeclared(), Calibration()
COMPUTED, UNBALANCED = ProblemCode.TORQUE_FROM_COMMAND, ProblemCode.TORQUE_UNBALANCED


def recorded(robot: MBK, gains: FloatArray, noise: float = 0.005) -> list[TrialRecord]:
    """Trials of an arm in a robot without friction, with commands held between samples.

    Torques, N·m, are multiplied by gains and have white noise.
    """
    rng, records = np.random.default_rng(1), []
    for joint in range(2):
        record = synthetic_trial(TWO_JOINT_ARM, joint, LOOP, 1)
        f = np.asarray(np.fft.rfftfreq(record.samples, 1.0 / record.rate), dtype=np.float64)
        moved = multiply(robot.impedance(f), np.fft.rfft(record.position)[:, None])[:, 0]
        hold = np.exp(-1j * np.pi * f / record.rate) * np.sinc(f / record.rate)
        command = np.fft.irfft((moved + np.fft.rfft(record.torque)) / hold, record.samples)
        beside = noise * rng.standard_normal(record.torque.shape)
        torque = gains[:, None] * record.torque + beside
        records.append(dataclasses.replace(record, torque=torque, command=command))
    return records


def identified(records: list[TrialRecord], calibration: Calibration = UNDECLARED) -> Identification:
    trials = [TrialData.of(one) for one in records]
    return identify(trials, ("lpm_full",), Metadata(calibration=calibration))


@pytest.mark.parametrize("calibration", [UNDECLARED, EXACT], ids=["undeclared", "declared"])
@pytest.mark.parametrize(("falling", "noise"), [(-2.0, 0.005), (2.0, 0.005), (-2.0, 1.0)])
def test_gravity_of_the_robot_is_no_proof_against_a_transducer(
    falling: float, noise: float, calibration: Calibration
) -> None:
    heavy = dataclasses.replace(ROBOT, K=falling * np.array([[2.0, 1.0], [1.0, 1.0]]))
    result = identified(recorded(heavy, np.ones(2), noise), calibration)
    assert result.valid, result.problems
    assert off(result.estimators["lpm_full"].fit).max() < 3.5


@pytest.mark.parametrize("gains", [(1.0, 1.25), (0.8, 1.0), (1.25, 1.25)])
def test_with_gravity_a_wrong_gain_is_refused_with_its_size_and_error(
    gains: tuple[float, float],
) -> None:
    heavy = dataclasses.replace(ROBOT, K=-np.array([[2.0, 1.0], [1.0, 1.0]]))
    result = identified(recorded(heavy, np.array(gains)))
    found = {str(one.values["name"]): one.values for one in having(result.problems, UNBALANCED)}
    for name, gain in zip(result.joint_names, gains, strict=True):
        assert (name in found) == (gain != 1.0)
        if name in found:
            share, error = float(found[name]["share"]), float(found[name]["error"])
            assert 0.0 < error < 0.1
            assert share == pytest.approx(gain, abs=3.5 * error)


def test_commands_in_another_order_than_the_joints_are_put_in_order() -> None:
    records = recorded(ROBOT, np.ones(2))
    swapped = [dataclasses.replace(one, command=known(one.command)[::-1]) for one in records]
    result = identified(swapped)
    assert result.valid, result.problems
    assert ProblemCode.COMMANDS_PERMUTED in codes(result.problems)
    told, given = (known(one.balance).M for one in (result, identified(records)))
    np.testing.assert_allclose(told, given, rtol=1e-9)


def test_where_brakes_hold_the_other_joints_commands_tell_nothing_of_transducers() -> None:
    records = recorded(ROBOT, np.ones(2))
    for k, record in enumerate(records):
        command = known(record.command) * (np.arange(2) == k)[:, None]
        records[k] = dataclasses.replace(record, command=command)
    result = identified(records)
    assert result.valid, result.problems
    assert result.balance is None


def test_torques_that_are_the_commands_of_the_drives_leave_a_robot_of_no_inertia() -> None:
    rng, records = np.random.default_rng(3), recorded(ROBOT, np.ones(2))
    for k, record in enumerate(records):
        command = known(record.command)
        noise = 0.01 * np.std(command) * rng.standard_normal(command.shape)
        records[k] = dataclasses.replace(record, torque=np.roll(command, 1, axis=1) + noise)
    result = identified(records)
    assert not result.verdict.impedance
    assert ProblemCode.ROBOT_INERTIA_IMPOSSIBLE in codes(result.problems)


@pytest.mark.parametrize(
    ("gain", "uncertainty", "refused"),
    [(1.0, 0.0, False), (0.75, 0.05, True), (0.9, 0.05, False), (0.9, 0.01, True)],
)
def test_a_gain_that_commands_and_torques_share_is_refused_where_the_robot_is_known_well_enough(
    gain: float, uncertainty: float, *, refused: bool
) -> None:
    records = recorded(ROBOT, np.full(2, gain))
    records = [dataclasses.replace(one, command=gain * np.array(one.command)) for one in records]
    robot = {"robot_inertia": row_by_row(ROBOT.M), "robot_inertia_uncertainty": uncertainty}
    declared = Metadata.model_validate({"calibration": EXACT, **robot})
    result = identify([TrialData.of(one) for one in records], ("lpm_full",), declared)
    assert (ProblemCode.ROBOT_INERTIA_UNLIKE in codes(result.problems)) == refused
    assert result.valid == (not refused)


def pulsed(friction: float) -> TrialRecord:
    """Trial of one joint with Coulomb friction, N·m, pushed for 50 ms and left for 250 ms."""
    rate, substeps, mass, viscosity, stiffness = 1000.0, 5, 0.15, 0.65, 8.0
    rng, samples = np.random.default_rng(3), 20_000
    pushes = np.zeros((samples // 300 + 1, 300))
    pushes[:, :50] = 6.0 * rng.choice([-1.0, 1.0], (len(pushes), 1))
    force = pushes.ravel()[:samples]
    angle, speed, step = 0.0, 0.0, 1.0 / (rate * substeps)
    values = np.zeros((3, samples))
    for k in range(samples):
        command = force[k] - 10.0 * angle - 1.0 * speed
        values[:, k] = angle, 0.0, command
        for part in range(substeps):
            passive = viscosity * speed + stiffness * angle
            free = speed + step * (command - passive) / (2.0 * mass)
            held = step * friction / (2.0 * mass)
            changed = np.sign(free) * max(abs(free) - held, 0.0)
            if part == 0:
                values[1, k] = mass * (changed - speed) / step + passive
            speed = changed
            angle += step * speed
    position, torque, command = values[:, None] + 1e-4 * rng.standard_normal((3, 1, samples))
    return made_record(position, torque, force[None], rate=rate, command=command)


@pytest.mark.parametrize("friction", [0.3, 1.0])
def test_friction_of_a_joint_that_is_pushed_and_then_rests_is_no_gain(friction: float) -> None:
    result = identified([pulsed(friction)])
    assert UNBALANCED not in codes(result.problems)
    balance = known(result.balance)
    assert balance.K[0, 0] < -4.0 * balance.K_se[0, 0], "it looks like a gain above 1"


def test_a_gain_above_one_of_a_single_joint_leaves_the_robot_a_negative_viscosity() -> None:
    record = pulsed(friction=0.0)
    result = identified([dataclasses.replace(record, torque=1.5 * record.torque)])
    (found,) = having(result.problems, UNBALANCED)
    assert float(found.values["share"]) == pytest.approx(1.5, abs=0.1)
    assert 0.0 < float(found.values["error"]) < 0.1


@functools.cache
def simulated(law: str = "tde", noise: float = 0.05) -> TrialRecord:
    """Trial of one joint whose law feeds back rounded torques, whose errors have that noise."""
    sensors = {"sensors.torque.resolution": noise * 12.0**0.5}
    recording = armimp.simulate(
        joints=1, duration=20.0, seed=1, friction=0, internal_model=law, arm_sim=sensors
    )
    return recording.trials[0]


def modelled(share: float) -> TrialRecord:
    """A trial whose torques are the commands less what a model with a share of inertia takes."""
    record = simulated()
    smooth = signal.butter(2, 40.0, fs=record.rate, output="sos")
    speed = np.gradient(signal.sosfiltfilt(smooth, record.position), 1.0 / record.rate, axis=1)
    taken = share * robot(1).moments[0] * np.gradient(speed, 1.0 / record.rate, axis=1)
    noise = 0.01 * np.random.default_rng(5).standard_normal(speed.shape)
    torque = np.roll(known(record.command), 1, axis=1) - taken - 0.1 * speed + noise
    return dataclasses.replace(record, torque=torque)


@pytest.mark.parametrize("share", [0.8, 0.9])
def test_a_torque_that_is_computed_from_the_command_is_refused(share: float) -> None:
    result = identified([modelled(share)])
    (found,) = having(result.problems, COMPUTED)
    assert not result.verdict.impedance
    assert float(found.values["percent"]) == pytest.approx(100.0, abs=30.0)
    assert float(found.values["most"]) < 60.0


@pytest.mark.parametrize(("law", "noise"), [("tde", 0.01), ("observer", 0.05)])
def test_a_law_that_feeds_noisy_torques_back_computes_none(law: str, noise: float) -> None:
    record = simulated(law, noise)
    assert COMPUTED not in codes(identified([record]).problems)
    answers, errors = answers_to_rounding([record])
    arm = human_arm(1).inertia[0]
    at_once = arm / (arm + robot(1).moments[0])
    np.testing.assert_array_less(np.abs(answers - [0.0, at_once]), 4.0 * errors)
    assert errors.max() < 0.1


@pytest.mark.parametrize("late", [2, 3, 5, 7, 10])
def test_commands_that_are_recorded_periods_late_compute_no_torque(late: int) -> None:
    record = simulated()
    command = np.roll(known(record.command), late, axis=1)
    assert COMPUTED not in codes(
        identified([dataclasses.replace(record, command=command)]).problems
    )


def test_where_angles_tell_nothing_of_commands_no_torque_is_said_to_be_computed() -> None:
    record = modelled(0.8)
    fine = record.position + 1e-6 * np.random.default_rng(1).standard_normal(record.position.shape)
    assert COMPUTED not in codes(identified([dataclasses.replace(record, position=fine)]).problems)


@pytest.mark.parametrize("unit", [0.102, 9.81, 100.0])
def test_torques_in_another_unit_than_the_commands_are_refused(unit: float) -> None:
    result = identified(recorded(ROBOT, np.full(2, unit)))
    told = {ProblemCode.TORQUE_UNBALANCED, ProblemCode.TORQUES_CROSS}
    if unit == 100.0:  # which nobody could tell from any other large number
        told = {ProblemCode.COMMANDS_UNRELATED}
    assert not result.verdict.impedance
    assert told & set(codes(result.problems))


def test_commands_of_other_trials_confirm_nothing_and_refute_nothing() -> None:
    records = recorded(ROBOT, np.ones(2))
    noise = np.random.default_rng(2).standard_normal(records[0].torque.shape)
    foreign = [dataclasses.replace(one, command=noise) for one in records]
    result = identified(foreign)
    assert result.valid
    noted = having(result.problems, ProblemCode.GAIN_UNCONFIRMED)
    assert len(noted) == 2
