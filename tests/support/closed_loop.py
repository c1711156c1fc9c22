"""The experiment tick by tick on a simulated rig that is less obliging, for tests."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from armimp_bringup.parameters import NodeParameters
from armimp_common.status import Phase, TrialStatus
from armimp_common.topics import PERIOD_NS
from armimp_control.trial_sequencer import TrialSequencer
from armimp_estimation.identify import identify
from armimp_estimation.mbk import MBK
from armimp_estimation.trial import TrialData
from armimp_sim.simulator import SimulatedRig
from support.synthetic_trials import made_record, worst_errors

ACCURACY = {"VAF": 99.7, "M": 0.02, "B": 0.02, "K": 0.02}
"""What `lpm_full` has to reach in each element: VAF (%), relative errors."""


class ClosedLoop:
    """Controller and rig, without anything between them but what a test puts there."""

    def __init__(self, parameters: NodeParameters) -> None:
        self._parameters = parameters
        self._statuses: list[TrialStatus] = []
        self.controller = TrialSequencer(parameters.controller, self._statuses.append)
        self.rig = SimulatedRig(parameters.simulator)
        self._ticks: list[list[NDArray[np.float64]]] = []

    def answer(self) -> tuple[float, ...] | None:
        """Answer the present sample by a command (n,), N·m; None once the experiment is over."""
        control, sample = self.controller, [self.rig.position.copy(), self.rig.torque.copy()]
        control.answer(len(self._ticks) * PERIOD_NS, *(values.tolist() for values in sample))
        self._ticks.append([control.tau_delta.copy(), *sample, control.command.copy()])
        return None if control.finished else tuple(control.command.tolist())

    def assert_accurate(self) -> None:
        """Check that `lpm_full` meets :data:`ACCURACY`, and that the result is valid."""
        assert self.controller.fault == ""
        perturbation, position, torque, command = np.moveaxis(np.array(self._ticks), 0, 2)
        trials = []
        for status in self._statuses:
            if status.phase is not Phase.PERTURB or status.start_ns is None:
                continue
            first = status.start_ns // PERIOD_NS
            span = np.s_[:, first : first + status.ticks]
            told = {"trial": status.trial, "perturbed_joint": status.joint}
            record = made_record(position[span], torque[span], perturbation[span], **told)
            trials.append(TrialData.of(replace(record, command=command[span])))
        arm = self._parameters.simulator.arm
        truth = MBK(M=arm.M, B=arm.B, K=arm.K)
        found = identify(trials, ("lpm_full",), truth)
        result = found.estimators["lpm_full"]
        assert found.valid, found.problems
        assert result.vaf is not None
        assert result.vaf.min() >= ACCURACY["VAF"]
        for name, error in worst_errors(result.fit.mbk, truth).items():
            assert error <= ACCURACY[name], name
