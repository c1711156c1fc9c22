"""The experiment with sensors and drives of a real rig, without ROS: what calibration is worth."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from armimp_bringup.config import ExperimentConfig
from armimp_bringup.offline import run_offline
from armimp_bringup.parameters import node_parameters
from armimp_common.status import Phase, TrialStatus
from armimp_common.topics import PERIOD_NS
from armimp_control.trial_sequencer import TrialSequencer
from armimp_estimation.metadata import Metadata
from armimp_estimation.torque_timing import TorqueReading, TorqueTiming
from armimp_sim.simulator import SimulatedRig


@pytest.mark.slow
def test_node_and_study_take_the_same_tare_and_give_the_same_bits() -> None:
    config = ExperimentConfig.model_validate(
        {
            "rig": "realistic",
            "internal_model": "observer",
            "arm_sim": {
                "sensors.torque": {"offset": [0.8, -0.5], "drift": [0.4, 0.2], "noise": 0.005},
                "actuators.bandwidth": 0.0,
                "voluntary.rms": 0.02,  # or there is no tare
            },
            "imbic_controller": {
                "tare": {"duration": 0.6, "wait": 0.4},
                "sequence": {"duration": 0.2, "settle": 0.05, "rest": 0.5},
            },
        }
    )
    case = node_parameters(config, None)
    (trials,) = run_offline([case])

    statuses: list[TrialStatus] = []
    experiment, rig = TrialSequencer(case.controller, statuses.append), SimulatedRig(case.simulator)
    torques, commands = [], []
    while not experiment.finished:
        torques.append(rig.torque.copy())
        experiment.answer(rig.stamp_ns, tuple(rig.position.tolist()), tuple(rig.torque.tolist()))
        commands.append(experiment.command.copy())
        rig.step(tuple(experiment.command.tolist()))

    for trial in trials:
        first = trial.start_ns // PERIOD_NS
        ticks = slice(first, first + 200)
        assert np.array_equal(trial.torque, np.array(torques[ticks]).T)
        assert trial.command is not None
        assert np.array_equal(trial.command, np.array(commands[ticks]).T)
    tares = [one.tare for one in statuses if one.phase is Phase.PERTURB]
    # The readings were taken 0.7 s into the trial on average.
    assert tares[0] == pytest.approx((0.8 + 0.28, -0.5 + 0.14), abs=0.03)
    assert tares[1][0] - tares[0][0] == pytest.approx(0.4 * 1.75, abs=0.03)


def test_the_estimator_knows_what_is_simulated_unless_it_is_told_otherwise() -> None:
    sensors = {"sensors": {"torque": {"delay": 0.0015, "cutoff": 150.0, "order": 2}}}
    # Slow enough for a loop that is told of readings as late as that.
    slow = {"target": {"lock_frequency": 50.0}, "law": {"gamma": 50.0}}
    values = {
        "arm_sim": {**sensors, "actuators": {"bandwidth": 800.0}},
        "imbic_controller": slow,
    }

    def known(**more: Any) -> TorqueReading:
        config = ExperimentConfig.model_validate({**values, **more})
        return Metadata.of(node_parameters(config, None).estimator.bag_metadata()).reading

    prompt = TorqueReading(timing=TorqueTiming.BEFORE_UPDATE)
    everything = TorqueReading(
        timing=prompt.timing,
        delay=0.0015,
        cutoff=150.0,
        order=2,
        actuator_lag=1.0 / (2.0 * np.pi * 800.0),
    )
    assert known() == everything
    assert known(torque_delay=0.001) == everything.model_copy(update={"delay": 0.001})
    assert known(torque_delay=0.0) == everything.model_copy(update={"delay": 0.0})
    blind = {"torque": {"delay": 0.0, "cutoff": 0.0, "actuator_lag": 0.0}}
    assert known(impedance_estimator=blind) == prompt


@pytest.mark.parametrize("joints", [1, pytest.param(7, marks=pytest.mark.slow)])
def test_the_realistic_rig_can_be_simulated_and_controlled_with_any_number_of_joints(
    joints: int,
) -> None:
    values = {"rig": "realistic", "internal_model": "observer", "joints": joints}
    case = node_parameters(ExperimentConfig.model_validate(values), None)
    assert case.simulator.soft
    case.controller.check()
