"""Many simulated experiments at once, for the investigations."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from armimp_bringup.benchmarks import available_cores
from armimp_bringup.config import ExperimentConfig
from armimp_bringup.study.backends import Threads
from armimp_bringup.study.conditions import Condition
from armimp_bringup.study.engine import Batch, ConditionResult, Provenance, split_evenly


def monte_carlo(
    base: ExperimentConfig,
    conditions: Sequence[Condition],
    *,
    workers: int | None = None,
    on_progress: Callable[[int, int], None] = lambda done, total: None,
) -> dict[Condition, ConditionResult]:
    """Simulate the conditions and identify the impedance in each.

    Parameters
    ----------
    base : ExperimentConfig
        Everything but the levels and the seed.
    conditions : sequence of Condition
        Each once.
    workers : int, optional
        Threads; by default one per core.
    on_progress : callable
        Takes the conditions done, and all of them.

    Returns
    -------
    dict of Condition to ConditionResult
        In the order of the conditions, whatever the number of workers.

    Raises
    ------
    ConfigurationError
        If the configuration does not make an experiment.
    StudyError
        If a condition cannot be simulated or estimated.
    """
    backend = Threads(workers if workers is not None else available_cores())
    provenance = Provenance.here()
    batches = [
        Batch(base=base, conditions=part, provenance=provenance)
        for part in split_evenly(conditions, backend.workers)
    ]
    found: dict[Condition, ConditionResult] = {}
    for results in backend.run(batches):
        found.update({result.condition: result for result in results})
        on_progress(len(found), len(conditions))
    return {condition: found[condition] for condition in conditions}
