"""The conditions of a batch side by side in one compiled loop, then the estimates of each."""

from __future__ import annotations

import itertools
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from armimp_bringup.config import ExperimentConfig
from armimp_bringup.offline import OfflineTrial, run_offline
from armimp_bringup.parameters import NodeParameters, node_parameters
from armimp_bringup.simulated import SimulatedExperiment
from armimp_bringup.study.conditions import Condition
from armimp_bringup.study.entry import StudyEntry
from armimp_bringup.study.errors import StudyError
from armimp_common.errors import ArmimpError, ConfigurationError
from armimp_common.versions import git_revision, versions
from armimp_estimation.identify import EstimatorResult
from armimp_estimation.results import TrialLedger, summarise
from armimp_sim.dynamics import WIDTH
from armimp_sim.plant import IntegrationError


@dataclass(frozen=True, kw_only=True)
class Provenance:
    """Software that the results are made with."""

    versions: Mapping[str, str]
    git_revision: str

    @classmethod
    def here(cls) -> Provenance:
        """That of this process."""
        return cls(versions=versions(), git_revision=git_revision())


@dataclass(frozen=True, kw_only=True)
class Batch:
    """Conditions to run side by side; can be pickled, and run anywhere.

    Parameters
    ----------
    base : ExperimentConfig
        Everything but levels and seed.
    conditions : tuple of Condition
        One for each lane.
    provenance : Provenance
        Of the process that asks for it.
    """

    base: ExperimentConfig
    conditions: tuple[Condition, ...]
    provenance: Provenance


@dataclass(frozen=True, kw_only=True, eq=False)
class ConditionResult:
    """The result of one condition, and its curves by name of the estimator."""

    entry: StudyEntry
    results: dict[str, EstimatorResult]

    @property
    def condition(self) -> Condition:
        """What it is the result of."""
        return self.entry.condition


def split_evenly(conditions: Sequence[Condition], workers: int) -> list[tuple[Condition, ...]]:
    """Batches that keep all workers equally busy.

    A block of :data:`armimp_sim.dynamics.WIDTH` lanes takes the same time however many of them are
    in use. So batches hold that many at most, and their number is a multiple of the workers' unless
    there are too few conditions.

    Parameters
    ----------
    conditions : sequence of Condition
        What is to be done.
    workers : int
        Batches that run at the same time.
    """
    total = len(conditions)
    if not total:
        return []
    batches = min(total, workers * -(-total // (workers * WIDTH)))
    bounds = [total * number // batches for number in range(batches + 1)]
    return [tuple(conditions[first:last]) for first, last in itertools.pairwise(bounds)]


def run_batch(batch: Batch) -> list[ConditionResult]:
    """Simulate the conditions of a batch and identify the impedance in each.

    Raises
    ------
    ConfigurationError
        If the configuration does not make an experiment.
    StudyError
        If a condition cannot be simulated or estimated, or the software here is another one.
    """
    here = versions()
    for name, version in batch.provenance.versions.items():
        if here.get(name) != version:
            raise StudyError(
                f"a worker has {name} {here.get(name)}, the study is made with {version}"
            )
    parameters = [condition_parameters(batch.base, condition) for condition in batch.conditions]
    try:
        trials = run_offline([one.rig() for one in parameters])
    except IntegrationError as error:
        names = batch.conditions
        place = str(names[0]) if len(names) == 1 else f"{names[0]} to {names[-1]}"
        raise StudyError(f"{place}: {error}") from None
    return [
        estimate_condition(batch, condition, one, of_condition)
        for condition, one, of_condition in zip(batch.conditions, parameters, trials, strict=True)
    ]


def condition_parameters(base: ExperimentConfig, condition: Condition) -> NodeParameters:
    """Parameters of the nodes in one condition.

    Raises
    ------
    ConfigurationError
        If they do not make an experiment, or an estimator does not exist.
    """
    return node_parameters(condition_config(base, condition), None)


def condition_config(base: ExperimentConfig, condition: Condition) -> ExperimentConfig:
    """Configuration of one condition: that of the study with its levels and seed."""
    return base.model_copy(
        update={
            "friction": condition.friction,
            "resolution": condition.resolution,
            "perturbation": condition.perturbation,
            "seed": condition.seed,
        }
    )


def estimate_condition(
    batch: Batch, condition: Condition, parameters: NodeParameters, trials: list[OfflineTrial]
) -> ConditionResult:
    """Identify the impedance in one condition.

    Parameters
    ----------
    batch : Batch
        What the condition belongs to.
    condition : Condition
        Levels and seed.
    parameters : NodeParameters
        Those of the condition.
    trials : list of OfflineTrial
        One for each joint.

    Raises
    ------
    ConfigurationError
        If an estimator does not exist.
    StudyError
        If the trials can't be estimated.
    """
    config = condition_config(batch.base, condition)
    experiment = SimulatedExperiment.of(config, parameters, trials)
    try:
        identification = experiment.identify(config.estimators)
    except ConfigurationError:
        raise
    except ArmimpError as error:
        raise StudyError(f"{condition}: {error}") from None
    summary = summarise(
        identification,
        {r.perturbed_joint: TrialLedger(bag=None, ticks=r.samples) for r in experiment.records},
        config=_described(batch, parameters),
        seed=condition.seed,
    )
    fields = {name: getattr(summary, name) for name in type(summary).model_fields}
    entry = StudyEntry(
        **fields,
        friction=condition.friction,
        resolution=condition.resolution,
        perturbation=condition.perturbation,
    )
    return ConditionResult(entry=entry, results=identification.estimators)


def _described(batch: Batch, parameters: NodeParameters) -> dict[str, Any]:
    """Full configuration, with the software that the study as a whole is made with."""
    described: dict[str, Any] = json.loads(parameters.estimator.bag_metadata()["config"])
    return described | {
        "versions": dict(batch.provenance.versions),
        "git_revision": batch.provenance.git_revision,
    }
