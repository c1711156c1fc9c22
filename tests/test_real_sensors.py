"""The experiment with sensors and drives of a real rig, without ROS: what calibration is worth."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from armimp_bringup.config import ExperimentConfig
from armimp_bringup.offline import run_offline, simulate
from armimp_bringup.parameters import NodeParameters, node_parameters
from armimp_common.status import Phase, TrialStatus
from armimp_common.topics import PERIOD_NS
from armimp_control.trial_sequencer import TrialSequencer
from armimp_estimation.metadata import Metadata
from armimp_estimation.torque_timing import TorqueReading, TorqueTiming
from armimp_sim.simulator import SimulatedRig
from support.synthetic_trials import worst_errors

TARE = {"tare": {"duration": 0.6, "wait": 0.4}}
OFFSET, DRIFT = [0.8, -0.5], [0.02, -0.01]
DURATION = 20.0


def chosen(
    sensors: Mapping[str, Any] | None = None,
    *,
    lag: float = 0.0,
    duration: float = DURATION,
    **levels: Any,
) -> ExperimentConfig:
    """An experiment with the given `sensors.torque.…`."""
    config = {
        "duration": duration,
        "arm_sim": {
            "sensors": {"torque": sensors or {}},
            "actuators": {"bandwidth": 0.5 / np.pi / lag if lag else 0.0},
        },
        "imbic_controller": TARE,
        **levels,
    }
    return ExperimentConfig.model_validate(config)


CASES: dict[str, ExperimentConfig] = {
    "prompt": chosen(),
    "offset and drift": chosen({"offset": OFFSET, "drift": DRIFT}),
    "delay": chosen({"delay": 0.002}),
    "filter": chosen({"cutoff": 200.0}),
    "lag": chosen(lag=0.001),
    "everything": chosen(
        {"offset": OFFSET, "drift": DRIFT, "delay": 0.0017, "cutoff": 200.0}, lag=0.0003
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_what_is_known_of_the_sensors_costs_no_accuracy(name: str) -> None:
    (experiment,) = simulate([CASES[name]])
    result = experiment.identify(["lpm_full"]).estimators["lpm_full"]
    found = worst_errors(result.fit.mbk, experiment.truth)
    assert found["M"] < 0.004
    assert found["B"] < 0.006
    assert found["K"] < 0.006
    assert result.vaf is not None
    assert np.min(result.vaf) > 99.9


@pytest.mark.slow
def test_node_and_study_take_the_same_tare_and_give_the_same_bits() -> None:
    sensors = {"offset": OFFSET, "drift": [0.4, 0.2], "noise": 0.005}
    config = chosen(sensors, duration=10.0, rig="realistic", internal_model="observer")
    calm = {**config.arm_sim, "voluntary": {"rms": 0.02}}  # or there is no tare
    case = node_parameters(config.model_copy(update={"arm_sim": calm}), None)
    short = {"duration": 0.2, "settle": 0.05, "rest": 0.5}
    controller = case.controller.model_copy(
        update={"sequence": case.controller.sequence.model_copy(update=short)}
    )
    case = NodeParameters(simulator=case.simulator, controller=controller, estimator=case.estimator)
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
