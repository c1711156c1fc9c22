"""The experiment on a rig whose commands act some periods late, with settings that bear it."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping

import pytest
from pydantic import JsonValue

from armimp_bringup.config import ExperimentConfig
from armimp_bringup.parameters import NodeParameters, node_parameters
from armimp_common.errors import ConfigurationError
from armimp_common.status import TrialStatus
from armimp_common.topics import PERIOD_NS
from armimp_control.trial_sequencer import TrialSequencer
from armimp_estimation.identify import Identification
from armimp_sim.simulator import SimulatedRig
from support.closed_loop import assert_accurate, identified

pytestmark = pytest.mark.slow

DEFAULT: Mapping[str, JsonValue] = {}
BORNE: Mapping[int, Mapping[str, JsonValue]] = {
    0: DEFAULT,
    1: DEFAULT,
    2: {"law.gamma": 50.0, "target.lock_frequency": 50.0},
}
"""Settings by periods of delay."""


def told(delay: int, settings: Mapping[str, JsonValue]) -> NodeParameters:
    """Parameters of a controller that knows of the delay (periods)."""
    changes: dict[str, JsonValue] = {"known.command_delay": delay, **settings}
    return node_parameters(ExperimentConfig(imbic_controller=changes), None)


def run(parameters: NodeParameters, delay: int) -> tuple[Identification, int]:
    """Run an experiment; also tell how many commands were clipped."""
    statuses: list[TrialStatus] = []
    experiment = TrialSequencer(parameters.controller, statuses.append)
    rig = SimulatedRig(parameters.simulator)
    under_way = deque([(0.0,) * rig.position.size] * delay)
    perturbation, position, torque, command = [], [], [], []
    for tick in range(10**6):
        position.append(rig.position.copy())
        torque.append(rig.torque.copy())
        experiment.answer(tick * PERIOD_NS, position[-1].tolist(), torque[-1].tolist())
        perturbation.append(experiment.tau_delta.copy())
        command.append(experiment.command.copy())
        if experiment.finished:
            break
        under_way.append(tuple(experiment.command.tolist()))
        rig.step(under_way.popleft())
    assert experiment.fault == ""
    found = identified(
        parameters,
        statuses,
        perturbation=perturbation,
        position=position,
        torque=torque,
        command=command,
    )
    return found, sum(experiment.clipped.values())


@pytest.mark.parametrize("delay", BORNE)
def test_with_the_settings_of_the_documents_late_commands_cost_no_accuracy(delay: int) -> None:
    found, clips = run(told(delay, BORNE[delay]), delay)
    assert clips == 0
    assert_accurate(found)


@pytest.mark.parametrize("delay", [2, 3])
def test_commands_that_are_too_late_for_the_default_settings_are_refused(delay: int) -> None:
    with pytest.raises(ConfigurationError, match=f"grows by .* act {delay} periods late"):
        told(delay, DEFAULT)
