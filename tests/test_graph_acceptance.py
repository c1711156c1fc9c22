"""The paper's estimator meets its targets: every element, in trials of 50 s."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike

from armimp_bringup.config import ExperimentConfig
from armimp_bringup.offline import run_offline
from armimp_bringup.parameters import node_parameters
from armimp_common.topics import NS_PER_S, PERIOD_NS
from armimp_estimation.identify import identify
from armimp_estimation.mbk import MBK
from armimp_estimation.record import TrialRecord
from armimp_estimation.trial import TrialData
from support.runs import Run

pytestmark = pytest.mark.slow


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What the targets speak of; lists or arrays (n, n)."""

    found: Any
    truth: MBK
    vaf: ArrayLike | None
    r2: ArrayLike
    coherence_derived: ArrayLike

    def assert_accurate(self) -> None:
        assert self.vaf is not None
        assert np.min(self.vaf) >= 99.5
        assert np.min(self.r2) >= 0.99
        assert np.min(self.coherence_derived) >= 0.985
        for name, tolerance in (("M", 0.03), ("B", 0.08), ("K", 0.03)):
            true = getattr(self.truth, name)
            error = (np.array(getattr(self.found, name)) - true) / true
            assert np.abs(error).max() <= tolerance, f"{name}: {error}"


def offline(**levels: int) -> Outcome:
    """The same experiment without the graph, which gives the same samples to the last bit."""
    parameters = node_parameters(ExperimentConfig.model_validate(levels), None)
    names = parameters.simulator.joints
    arm = parameters.simulator.human_arm()
    truth = MBK(M=arm.inertia, B=arm.damping, K=arm.stiffness)
    trials = [
        TrialData.from_record(
            TrialRecord(
                trial=trial.joint + 1,
                perturbed_joint=trial.joint,
                rate=NS_PER_S / PERIOD_NS,
                joint_names=names,
                perturbation=trial.perturbation,
                position=trial.position,
                torque=trial.torque,
                start_ns=trial.first_tick * PERIOD_NS,
                seed=1,
            )
        )
        for trial in run_offline([parameters.rig()])[0]
    ]
    identification = identify(trials, ["welch_siso"], truth)
    assert identification.problems == ()
    result = identification.estimators["welch_siso"]
    return Outcome(
        found=result.fit.mbk,
        truth=truth,
        vaf=result.vaf,
        r2=result.fit.r2,
        coherence_derived=result.coherence_derived,
    )


def test_default_experiment_through_the_graph(run: Run) -> None:
    summary = run(duration=50.0).summary

    assert summary.problems == []
    assert [(trial.ticks, trial.lost) for trial in summary.trials] == [(50_000, 0)] * 2
    for trial in summary.trials:
        assert min(trial.lock_ratio) <= 0.005
    assert summary.truth is not None
    result = summary.estimators["welch_siso"]
    Outcome(
        found=result,
        truth=summary.truth.mbk(),
        vaf=result.vaf,
        r2=result.r2,
        coherence_derived=result.coherence_derived,
    ).assert_accurate()


@pytest.mark.parametrize(
    "levels",
    [{"friction": 0, "resolution": 0, "perturbation": 1}, {"joints": 3}],
    ids=str,
)
def test_other_levels_and_arms(levels: dict[str, int]) -> None:
    offline(**levels).assert_accurate()
