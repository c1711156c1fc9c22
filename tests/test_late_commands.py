"""Commands that act late, or not at all in their period: how much the experiment tolerates.

Rig and controller without ROS, on a clock that is moved by hand, so the machine does not matter.
"""

from collections.abc import Mapping

import numpy as np
import pytest
from pydantic import JsonValue

from armimp_bringup.config import ExperimentConfig
from armimp_bringup.offline import simulate
from armimp_bringup.parameters import NodeParameters, node_parameters
from armimp_common.arrays import FloatArray
from armimp_common.realtime import Pacer, TimingLimits
from armimp_common.status import Phase, TrialStatus
from armimp_common.topics import PERIOD, PERIOD_NS
from armimp_control.trial_sequencer import TrialSequencer
from armimp_estimation.fit import Calibration
from armimp_estimation.identify import Identification, identify
from armimp_estimation.mbk import MBK
from armimp_estimation.metadata import Metadata
from armimp_estimation.trial import TrialData
from armimp_sim.simulator import RealtimeSimulator, SimulatedRig
from support.synthetic_trials import made_record, worst_errors

pytestmark = pytest.mark.slow

DEFAULT: Mapping[str, JsonValue] = {}
BORNE: Mapping[int, Mapping[str, JsonValue]] = {
    0: DEFAULT,
    1: DEFAULT,
    2: DEFAULT,
    3: {"law.gamma": 30.0, "target.lock_frequency": 30.0},
}
"""Settings by periods of delay."""
LONGEST = 3
"""Most periods in a row for which a command is late."""
ACCURACY = {"VAF": 99.7, "M": 0.02, "B": 0.02, "K": 0.02}
"""What `lpm_full` has to reach in each element: VAF (%), relative errors."""


def assert_accurate(found: Identification, truth: MBK) -> None:
    """Check that `lpm_full` meets :data:`ACCURACY`, and that the result is valid."""
    result = found.estimators["lpm_full"]
    assert found.valid, found.problems
    assert result.vaf is not None
    assert result.vaf.min() >= ACCURACY["VAF"]
    for name, error in worst_errors(result.fit.mbk, truth).items():
        assert error <= ACCURACY[name], name


@pytest.mark.parametrize("delay", BORNE)
def test_with_the_settings_of_the_documents_late_commands_cost_no_accuracy(delay: int) -> None:
    changes: dict[str, JsonValue] = {"known.command_delay": delay, **BORNE[delay]}
    late: dict[str, JsonValue] = {"actuators.delay": delay * PERIOD}
    (experiment,) = simulate([ExperimentConfig(arm_sim=late, imbic_controller=changes)])
    limit = experiment.parameters.controller.safety.torque_limit
    assert max(np.max(np.abs(np.array(one.command))) for one in experiment.records) < limit
    assert_accurate(experiment.identify(("lpm_full",)), experiment.truth)


class ClosedLoop:
    """Controller and rig, without anything between them but what a test puts there."""

    def __init__(self, parameters: NodeParameters) -> None:
        self._parameters = parameters
        self._statuses: list[TrialStatus] = []
        self.controller = TrialSequencer(parameters.controller, self._statuses.append)
        self.rig = SimulatedRig(parameters.simulator)
        self._ticks: list[list[FloatArray]] = []

    def answer(self) -> tuple[float, ...] | None:
        """Answer the present sample by a command (n,), N·m; None once the experiment is over."""
        control, sample = self.controller, [self.rig.position.copy(), self.rig.torque.copy()]
        control.answer(len(self._ticks) * PERIOD_NS, *(values.tolist() for values in sample))
        self._ticks.append([control.tau_delta.copy(), *sample, control.command.copy()])
        return None if control.finished else tuple(control.command.tolist())

    def assert_accurate(self) -> None:
        assert self.controller.fault == ""
        perturbation, position, torque, command = np.moveaxis(np.array(self._ticks), 0, 2)
        trials = []
        for status in self._statuses:
            if status.phase is Phase.PERTURB and status.start_ns is not None:
                first = status.start_ns // PERIOD_NS
                span = np.s_[:, first : first + status.ticks]
                told = {"trial": status.trial, "perturbed_joint": status.joint}
                arrays = (position[span], torque[span], perturbation[span])
                trials.append(TrialData.of(made_record(*arrays, command=command[span], **told)))
        arm = self._parameters.simulator.arm
        truth = MBK(M=arm.M, B=arm.B, K=arm.K)
        known = Metadata(truth=truth, calibration=Calibration())
        assert_accurate(identify(trials, ("lpm_full",), known), truth)


def test_with_as_many_missed_commands_as_are_allowed_the_accuracy_is_still_there() -> None:
    limit = TimingLimits().max_missed_share
    loop = ClosedLoop(node_parameters(ExperimentConfig(mode="realtime"), None))
    now = [0]
    pacer = Pacer(now=lambda: now[0], sleep=lambda _: None)
    paced = RealtimeSimulator(loop.rig, lambda: None, pacer)
    rng = np.random.default_rng(8)
    waiting: list[tuple[float, ...]] = []
    late_for = tick = 0
    paced.begin()
    while (answer := loop.answer()) is not None:
        # One command in time at least between two runs of missed ones, for the watchdog's sake.
        in_time = not waiting
        waiting.append(answer)
        if in_time and rng.random() < limit / ((1 + LONGEST) / 2):
            late_for = int(rng.integers(1, LONGEST + 1))
        now[0] = tick * PERIOD_NS + 300_000
        if late_for:
            late_for -= 1
        else:
            for command in waiting:
                paced.command(command)
            waiting.clear()
        tick += 1
        now[0] = tick * PERIOD_NS
        paced.advance(tick)
    assert loop.rig.fault == ""
    figures = paced.figures()
    assert 0.8 * limit < figures.missed / figures.ticks < 1.2 * limit
    loop.assert_accurate()
