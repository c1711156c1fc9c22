"""The law on the plant: targets shown, joints held, also from afar, and stops that do not push."""

from collections.abc import Callable
from typing import Literal

import numpy as np
import pytest

from armimp_bringup.config import ExperimentConfig
from armimp_bringup.offline import run_offline, simulate
from armimp_bringup.parameters import node_parameters
from armimp_common.arrays import FloatArray as Array
from armimp_common.topics import PERIOD
from armimp_control import presets as control_presets
from armimp_control.laws import Law
from armimp_control.laws.law import Controller
from armimp_control.safety_limiter import SafetyParameters
from armimp_sim import presets as sim_presets
from armimp_sim.parameters import SimulatorParameters
from armimp_sim.plant import Plant
from support.laws import preset_law, torque_only
from support.plants import study_plant

TORQUE_ONLY = torque_only(80.0)


def _law(plant: SimulatorParameters, internal_model: control_presets.InternalModel = "tde") -> Law:
    posture = plant.arm.theta_0
    return preset_law(plant.robot.mass_matrix(posture), posture, internal_model)


def _run(
    plant_config: SimulatorParameters,
    law: Law,
    tau_delta: Array,
    joint: int,
    safety: SafetyParameters = TORQUE_ONLY,
    stop: tuple[int, Callable[[Controller], object]] | None = None,
) -> Array:
    """Deflections, torques on the arm and commands (3, n, N) under ``tau_delta`` (N,).

    `stop` is a tick and what the controller is made to do then.
    """
    plant, controller = Plant([plant_config]), Controller(law, safety=safety)
    controller.perturb_joint(joint)
    record = np.zeros((3, law.joints, tau_delta.size))
    still, push = np.zeros((1, law.joints)), np.zeros(law.joints)
    for k, value in enumerate(tau_delta):
        push[joint] = value
        record[0, :, k] = plant.position[0] - plant_config.arm.theta_0
        record[1, :, k] = plant.torque[0]
        if stop is not None and k == stop[0]:
            stop[1](controller)
        controller.sample[:] = plant.position[0], plant.torque[0], push
        controller.compute()
        record[2, :, k] = controller.command
        plant.tick(controller.command[None, :], still)
    return record


_TOLERANCES = ((0.5, 0.005), (3.0, 0.03), (15.0, 0.15))
_REALISED: list[tuple[control_presets.InternalModel, int, float, float]] = [
    *(("tde", friction, *one) for friction in (0, 3) for one in _TOLERANCES),
    *(("observer", 0, *one) for one in _TOLERANCES),
    # An observer that lets the arm rest takes longer to find friction that has reversed.
    *(("observer", 3, *one) for one in (_TOLERANCES[0], (3.0, 0.05))),
]


@pytest.mark.parametrize("joint", [0, 1])
@pytest.mark.parametrize(("internal_model", "friction", "frequency", "tolerance"), _REALISED)
def test_perturbed_joint_shows_its_target_impedance_in_spite_of_friction(
    internal_model: control_presets.InternalModel,
    friction: int,
    frequency: float,
    tolerance: float,
    joint: int,
) -> None:
    """The delay of one tick costs accuracy in proportion to frequency."""
    plant = study_plant(friction, substeps=50)
    law = _law(plant, internal_model)
    t = np.arange(4000) * PERIOD
    tau_delta = 2.0 * np.sin(2.0 * np.pi * frequency * t)
    position, torque, _ = _run(plant, law, tau_delta, joint)
    # Whole periods after the onset has died down.
    s = 2j * np.pi * frequency
    demodulator = np.exp(-s * t[2000:])
    net = (tau_delta[2000:] - torque[joint, 2000:]) @ demodulator
    shown = net / (position[joint, 2000:] @ demodulator)
    target = law.target
    asked = (target.inertia[joint] * s + target.damping[joint]) * s + target.stiffness[joint]
    assert abs(shown / asked - 1.0) < tolerance


@pytest.mark.parametrize("internal_model", ["tde", "observer"])
@pytest.mark.parametrize("joint", [0, 1])
@pytest.mark.parametrize("friction", [0, 3])
def test_locked_joint_holds_still_beside_the_perturbed_one(
    friction: int, joint: int, internal_model: control_presets.InternalModel
) -> None:
    plant = study_plant(friction, substeps=50)
    t = np.arange(3000) * PERIOD
    tau_delta = 9.0 * np.sin(2.0 * np.pi * 2.0 * t)
    position, torque, _ = _run(plant, _law(plant, internal_model), tau_delta, joint)
    moved = np.std(position, axis=1)
    assert moved[joint] > 0.05
    assert moved[1 - joint] < 1e-3 * moved[joint]
    # It is not for want of load: the arm pulls at the locked joint through its coupling.
    assert np.std(torque[1 - joint]) > 0.1


@pytest.mark.slow
@pytest.mark.parametrize(("friction", "level"), [(0, 3), (3, 1), (3, 3)])
def test_with_an_observer_drives_can_follow_and_the_arm_feels_little(
    friction: int, level: int
) -> None:
    def steps(internal_model: Literal["observer", "tde"], delay: float = 0) -> tuple[float, float]:
        """Changes of commands and of torques on the arm from tick to tick, rms, N·m."""
        config = ExperimentConfig(
            friction=friction,
            perturbation=level,
            duration=2.0,
            internal_model=internal_model,
            arm_sim={"actuators.delay": delay},
        )
        records = simulate([config])[0].records
        changes = [np.diff([np.array(one.command), one.torque], axis=2) for one in records]
        command, torque = np.sqrt(np.mean(np.square(changes), axis=(0, 2, 3)))
        return float(command), float(torque)

    for delay in (0.0, PERIOD):
        command, torque = steps("observer", delay)
        assert command <= 1.0
        assert torque <= 0.35
    reference, felt = steps("tde")
    assert reference > 15.0
    assert felt > 5.0


# --- What a stop does to the arm: the way to zero torque must not push it -----------------------

AFTER = 150
"""Ticks that are watched after the stop."""


def _fastest(friction: int, resolution: int, stop_tick: int, ramp_time: float) -> tuple[float, ...]:
    """Largest speed of a joint in the 50 ms before a stop, and after it, rad/s; 0 s: at once."""
    config = study_plant(friction, sensors=sim_presets.sensors(resolution))
    safety = control_presets.safety(2, 9.0).model_copy(update={"ramp_time": ramp_time})
    nodes = node_parameters(ExperimentConfig(), None)
    signal = nodes.controller.signal(0, trial=1, ticks=stop_tick)
    stop = stop_tick, Controller.stop if ramp_time > 0.0 else Controller.cut
    tau_delta = np.append(signal, np.zeros(AFTER))
    theta, _, command = _run(config, _law(config, "observer"), tau_delta, 0, safety, stop)
    assert not command[:, -1].any()
    speed = np.abs(theta[:, 5:] - theta[:, :-5]).max(axis=0) / 5e-3
    return float(speed[stop_tick - 50 : stop_tick - 4].max()), float(speed[stop_tick - 4 :].max())


@pytest.mark.slow
@pytest.mark.parametrize("ramp_time", [0.0, control_presets.safety(2, 9.0).ramp_time])
@pytest.mark.parametrize(("friction", "resolution"), [(0, 3), (3, 3), (3, 1)])
def test_after_a_stop_the_arm_is_hardly_faster_than_it_was_in_a_trial(
    friction: int, resolution: int, ramp_time: float
) -> None:
    pairs = [_fastest(friction, resolution, tick, ramp_time) for tick in range(2000, 2600, 37)]
    before, after = np.max(pairs, axis=0)
    assert after < 1.3 * before


# --- A joint that is far from its posture by the time it gets locked ----------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "duration", "voluntary"),
    [
        # At 0.037 rad: a target that jumps asks for about the torque limit, M̄ ω² times that.
        (119, 50.0, 0.3),
        # At −0.069 rad.
        (0, 20.0, 1.0),
    ],
    ids=["at the limit", "beyond it"],
)
def test_joint_is_locked_from_afar_without_a_clip_and_held_in_its_posture(
    seed: int, duration: float, voluntary: float
) -> None:
    config = ExperimentConfig(
        friction=3,
        resolution=3,
        perturbation=3,
        seed=seed,
        duration=duration,
        arm_sim={"voluntary.rms": voluntary, "substeps": 20},
    )
    rig = node_parameters(config, None)
    first, second = run_offline([rig])[0]
    for trial in (first, second):
        assert trial.command is not None
        assert np.max(np.abs(trial.command)) < rig.controller.safety.torque_limit
        assert np.max(np.abs(np.diff(trial.command))) < rig.controller.safety.rate_limit * 1e-3
    target = rig.controller.target.posture
    # The joint is far off at the end of the first trial already, a rest before it gets locked.
    assert abs(first.position[0, -1] - target[0]) > 0.01
    assert np.max(np.abs(second.position[0] - target[0])) < 1e-3
