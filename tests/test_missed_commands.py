"""As many missed commands as a valid run in real time may have: the accuracy is still there.

The rig and the controller of the real-time mode, without ROS, on a clock that is moved by hand. So
the result does not depend on the machine.
"""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from armimp_bringup.config import ExperimentConfig
from armimp_bringup.parameters import node_parameters
from armimp_common.realtime import Pacer, TimingLimits
from armimp_common.status import TrialStatus
from armimp_common.topics import PERIOD_NS
from armimp_control.trial_sequencer import TrialSequencer
from armimp_estimation.identify import Identification
from armimp_sim.realtime_simulator import RealtimeSimulator
from armimp_sim.simulator import SimulatedRig
from support.closed_loop import assert_accurate, identified

pytestmark = pytest.mark.slow

Vector = NDArray[np.float64]
LONGEST = 3
"""Most periods in a row for which a command is late."""


def run(missed_share: float) -> tuple[Identification, float]:
    """Run the default experiment with so many missed commands; also tell how many there were."""
    parameters = node_parameters(ExperimentConfig(mode="realtime"), None)
    statuses: list[TrialStatus] = []
    experiment = TrialSequencer(parameters.controller, statuses.append)
    rig = SimulatedRig(parameters.simulator)
    now = [0]
    samples: list[tuple[Vector, Vector]] = []
    paced = RealtimeSimulator(
        rig,
        lambda: samples.append((rig.position.copy(), rig.torque.copy())),
        Pacer(PERIOD_NS, now=lambda: now[0], sleep=lambda _: None),
    )
    rng = np.random.default_rng(8)
    perturbation: list[Vector] = []
    commands: list[Vector] = []
    waiting: list[tuple[float, ...]] = []
    late_for = 0
    paced.begin()
    for tick in range(10**6):
        theta, tau_h = samples[-1]
        experiment.answer(tick * PERIOD_NS, theta.tolist(), tau_h.tolist())
        perturbation.append(experiment.tau_delta.copy())
        commands.append(experiment.command.copy())
        if experiment.finished:
            break
        # One command in time at least between two runs of missed ones, for the watchdog's sake.
        in_time = not waiting
        waiting.append(tuple(experiment.command.tolist()))
        if in_time and rng.random() < missed_share / ((1 + LONGEST) / 2):
            late_for = int(rng.integers(1, LONGEST + 1))
        now[0] = tick * PERIOD_NS + 300_000
        if late_for:
            late_for -= 1
        else:
            for command in waiting:
                paced.command(command)
            waiting.clear()
        now[0] = (tick + 1) * PERIOD_NS
        paced.advance(tick + 1)
    assert experiment.fault == ""
    assert rig.fault == ""
    found = identified(
        parameters,
        statuses,
        perturbation=perturbation,
        position=[theta for theta, _ in samples],
        torque=[tau_h for _, tau_h in samples],
        command=commands,
    )
    figures = paced.figures()
    return found, figures.missed / figures.ticks


def test_with_as_many_missed_commands_as_are_allowed_the_accuracy_is_still_there() -> None:
    limit = TimingLimits().max_missed_share

    found, missed_share = run(limit)

    assert 0.8 * limit < missed_share < 1.2 * limit
    assert_accurate(found)
