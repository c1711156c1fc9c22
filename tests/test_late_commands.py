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

DEFAULT = {"model": 1.0, "gamma": 100.0, "lock": 100.0}
BORNE: Mapping[int, Mapping[str, float]] = {
    0: DEFAULT,
    1: {"model": 0.75, "gamma": 100.0, "lock": 100.0},
    2: {"model": 0.4, "gamma": 50.0, "lock": 50.0},
}
"""By periods of delay: factor on M̄, Γ (rad/s), and ω of locked joints (rad/s)."""


def told(delay: int, settings: Mapping[str, float]) -> NodeParameters:
    """Parameters of a controller that knows of the delay (periods)."""
    model = node_parameters(ExperimentConfig(), None).controller.law.model_inertia
    changes: dict[str, JsonValue] = {
        "known.command_delay": delay,
        "law.model_inertia": [settings["model"] * value for value in model],
        "law.gamma": settings["gamma"],
        "target.lock_frequency": settings["lock"],
    }
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
