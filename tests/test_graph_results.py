"""What a running experiment publishes: progress, columns as they come, and the result."""

from dataclasses import dataclass

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.context import Context
from rclpy.node import Node

from armimp_bringup.config import ExperimentConfig
from armimp_bringup.orchestrator import run_experiment
from armimp_common.pubsub import subscribe
from armimp_common.status import Level, Progress, values_of
from armimp_common.topics import RESULT, TRIAL
from armimp_estimation.alignment.assemble import Trial
from armimp_estimation.node import ImpedanceEstimatorNode
from armimp_estimation.problems import Problem
from armimp_estimation.spectra import segment_for_samples, step_of
from support.graph import free_domain, hosted
from support.processes import wait_until
from support.runs import FinishedRun
from support.telling import tell_by_samples

SHORT = ExperimentConfig(duration=2.0)


class Bystander(Node):
    """A node in the domain of an experiment that has no part in it."""

    def __init__(self, context: Context) -> None:
        super().__init__("bystander", context=context)
        self.heard: list[DiagnosticStatus] = []
        for topic in (TRIAL, RESULT):
            subscribe(self, topic, self.heard.append)


def what(message: DiagnosticStatus) -> str:
    """A message in one word and a number."""
    values = values_of(message)
    if "phase" in values:
        return f"{values['phase']} {values['trial']}"
    return str(message.name).removeprefix("impedance_estimator: ")


@dataclass(frozen=True, kw_only=True)
class Account:
    """What was seen and heard of an experiment."""

    run: FinishedRun
    heard: list[DiagnosticStatus]
    progress: list[Progress]
    estimated: list[str]
    """Statuses that the estimator heard, and columns that it published."""


@pytest.fixture(scope="module")
def account(environment: None, tmp_path_factory: pytest.TempPathFactory) -> Account:
    directory = tmp_path_factory.mktemp("run") / "out"
    domain_id = free_domain()
    progress: list[Progress] = []
    estimated: list[str] = []
    on_trial = ImpedanceEstimatorNode._on_trial
    on_finished = ImpedanceEstimatorNode._on_finished

    def heard(node: ImpedanceEstimatorNode, message: DiagnosticStatus) -> None:
        estimated.append(what(message))
        on_trial(node, message)

    def finished(node: ImpedanceEstimatorNode, trial: Trial | Problem) -> None:
        on_finished(node, trial)
        assert isinstance(trial, Trial)
        estimated.append(f"column {trial.trial}")

    with hosted(Bystander, domain_id) as bystander, pytest.MonkeyPatch.context() as patch:
        tell_by_samples(patch)
        patch.setattr(ImpedanceEstimatorNode, "_on_trial", heard)
        patch.setattr(ImpedanceEstimatorNode, "_on_finished", finished)
        result = run_experiment(SHORT, directory, domain_id=domain_id, on_progress=progress.append)
        # The trials come with the result, so that drawing need not read the bags.
        assert [len(trial.segments) for trial in result.trials] == [1, 1]
        wait_until(lambda: "impedance" in map(what, bystander.heard), "the result")
    return Account(
        run=FinishedRun(directory=directory, summary=result.summary),
        heard=bystander.heard,
        progress=progress,
        estimated=estimated,
    )


def test_columns_are_published_as_each_trial_ends_and_the_result_at_the_end(
    account: Account,
) -> None:
    heard = [what(message) for message in account.heard]

    results = [item for item in heard if not item[-1].isdigit() or item.startswith("column")]
    assert results == ["column 1", "column 2", "impedance"]
    trials = [f"{phase} {k}" for k in (1, 2) for phase in ("settle", "perturb", "rest")]
    assert [item for item in heard if item not in results] == [*trials, "done 2"]
    # The first column does not wait for the second trial. When it is delivered, and to whom, does
    # not depend on the estimator.
    order = account.estimated
    assert order.index("perturb 1") < order.index("column 1") < order.index("rest 2")


def test_published_result_is_the_stored_one(account: Account) -> None:
    summary = account.run.summary
    conclusion = next(one for one in account.heard if what(one) == "impedance")

    assert conclusion.level == bytes([Level.OK])
    values = values_of(conclusion)
    assert (values["valid"], values["problems"]) == ("true", "")
    for name, result in summary.estimators.items():
        for key in ("M", "B", "K", "M_se", "vaf"):
            published = [float(text) for text in values[f"{name}.{key}"].split()]
            assert published == np.ravel(getattr(result, key)).tolist()


def test_progress_grows_in_every_trial_and_tells_the_coherence_of_two_segments_and_more(
    account: Account,
) -> None:
    order = [(progress.trial, progress.samples) for progress in account.progress]
    assert order == sorted(order)
    assert {progress.trial for progress in account.progress} == {1, 2}
    assert len(set(order)) > 10
    assert {(one.trials, one.planned) for one in account.progress} == {(2, 2_000)}
    assert all(one.joint == one.trial for one in account.progress)
    assert account.progress[-1].rate > 0.0
    segment = segment_for_samples(2_000)
    enough = segment + step_of(segment)
    assert max(progress.samples for progress in account.progress) >= enough
    for progress in account.progress:
        told = progress.coherence_motion, progress.coherence_torque
        if progress.samples >= enough:
            assert None not in told
        assert all(value is None or 0.9 < value <= 1.0 for value in told)
