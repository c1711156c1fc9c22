"""The experiment tick by tick on a simulated rig that is less obliging, for tests."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from armimp_bringup.parameters import NodeParameters
from armimp_common.status import Phase, TrialStatus
from armimp_common.topics import NS_PER_S, PERIOD_NS
from armimp_estimation.identify import Identification, identify
from armimp_estimation.mbk import MBK
from armimp_estimation.record import TrialRecord
from armimp_estimation.trial import TrialData

Samples = Sequence[NDArray[np.float64]]
ACCURACY = {"VAF": 99.7, "M": 0.02, "B": 0.02, "K": 0.02}
"""What `lpm_full` has to reach in each element: VAF (%), relative errors."""


def identified(
    parameters: NodeParameters,
    statuses: Sequence[TrialStatus],
    *,
    perturbation: Samples,
    position: Samples,
    torque: Samples,
    command: Samples,
) -> Identification:
    """Identify the simulated arm by `lpm_full`.

    Parameters
    ----------
    parameters : of the nodes
    statuses : what the experiment announced
    perturbation, position, torque, command : (n,) of all ticks since the start, N·m, rad, N·m, N·m
    """
    trials = []
    for status in statuses:
        if status.phase is not Phase.PERTURB or status.start_ns is None:
            continue
        first = status.start_ns // PERIOD_NS
        span = slice(first, first + status.ticks)
        record = TrialRecord(
            trial=status.trial,
            perturbed_joint=status.joint,
            rate=NS_PER_S / PERIOD_NS,
            joint_names=parameters.simulator.joints,
            perturbation=np.array(perturbation[span]).T,
            position=np.array(position[span]).T,
            torque=np.array(torque[span]).T,
            command=np.array(command[span]).T,
            start_ns=status.start_ns,
            seed=status.seed,
        )
        trials.append(TrialData.from_record(record))
    arm = parameters.simulator.human_arm()
    truth = MBK(M=arm.inertia, B=arm.damping, K=arm.stiffness)
    return identify(trials, ("lpm_full",), truth)


def assert_accurate(found: Identification) -> None:
    """Check that `lpm_full` meets :data:`ACCURACY`, and that the result is valid."""
    result, truth = found.estimators["lpm_full"], found.truth
    assert found.valid, found.problems
    assert truth is not None
    assert result.vaf is not None
    assert result.vaf.min() >= ACCURACY["VAF"]
    for name in ("M", "B", "K"):
        error = getattr(result.fit.mbk, name) / getattr(truth, name) - 1.0
        assert np.abs(error).max() <= ACCURACY[name], name
