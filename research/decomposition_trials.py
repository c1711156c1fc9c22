"""Many experiments of both kinds side by side: joint by joint, and all joints at once."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Final, TypeVar

import numpy as np
from pydantic import JsonValue

from armimp_bringup.bench import available_cores
from armimp_bringup.config import ExperimentConfig
from armimp_bringup.offline import SimulatedExperiment, run_offline, simulate
from armimp_bringup.parameters import NodeParameters, node_parameters
from armimp_bringup.study.engine import Backend
from armimp_bringup.terminal import display
from armimp_common.arrays import FloatArray
from armimp_common.errors import ConfigurationError
from armimp_common.status import Phase
from armimp_control.sequence import Segment, timetable
from armimp_estimation import scores
from armimp_estimation.estimators.estimate import ImpedanceEstimate
from armimp_estimation.estimators.registry import make_estimators
from armimp_estimation.fit import MBKFit, fit_impedance
from armimp_estimation.identify import Identification
from armimp_estimation.mbk import MBK
from armimp_estimation.record import TrialRecord
from armimp_estimation.trial import TrialData
from armimp_sim.dynamics import WIDTH
from research.direct import Direct
from research.mimo import InputCoupling, estimate_mimo

Work = TypeVar("Work")
Result = TypeVar("Result")

ESTIMATOR: Final = "lpm_full"
"""Estimator of the studies of verdicts."""
DIRECT: Final = Direct()
JOINT_BY_JOINT: Final = (DIRECT.name, "welch_siso", "welch_full", ESTIMATOR)
MIMO: Final = "mimo"
ESTIMATORS: Final = (*JOINT_BY_JOINT, MIMO)

# Far beyond what happens. The default limits are made for one compliant joint: if all seven are,
# the others move every joint, too, commands saturate and the last joint gets too fast.
_LIMITS_FOR_ALL_AT_ONCE: Final[dict[str, JsonValue]] = {
    "safety.position_limit": [10.0],
    "safety.velocity_limit": [1000.0],
    "safety.torque_limit": 300.0,
    "safety.rate_limit": 1e6,
    "safety.power_limit": 1e6,
}


@dataclass(frozen=True, kw_only=True, eq=False)
class Run:
    """Result of one estimator from one experiment."""

    estimator: str
    seed: int
    estimate: ImpedanceEstimate
    fit: MBKFit
    """Impedance over frequency, and M, B and K."""
    vaf: FloatArray
    """(n, n) %."""
    seconds: float
    """Wall time from the records to the fit, s."""
    coupling: InputCoupling | None = None
    """Coupling of the inputs; for the estimator ``mimo`` only."""


def all_at_once(
    configs: Sequence[ExperimentConfig], correlation: float = 0.0
) -> list[SimulatedExperiment]:
    """Simulate experiments of n trials of the same length that perturb all joints at once.

    The limits of the safety limiter are too wide to act on them.

    Parameters
    ----------
    configs : as for :func:`armimp_bringup.offline.simulate`
    correlation : of the perturbations of any two joints

    Raises
    ------
    ConfigurationError, IntegrationError
        As :func:`simulate`, and if there are no perturbations with this correlation.
    """
    free = [
        one.model_copy(
            update={"imbic_controller": {**one.imbic_controller, **_LIMITS_FOR_ALL_AT_ONCE}}
        )
        for one in configs
    ]
    parameters = [node_parameters(one, None) for one in free]
    mixing = [input_mixing(one.controller.perturbation.peak, correlation) for one in parameters]
    n = configs[0].joints
    trials = run_together(parameters, trials=n, mixing=mixing if correlation else None)
    return [
        SimulatedExperiment(config=config, parameters=one, records=tuple(of_config))
        for config, one, of_config in zip(free, parameters, trials, strict=True)
    ]


def input_mixing(peak: Sequence[float], correlation: float) -> FloatArray:
    """Return the matrix that correlates independent perturbations, and keeps their power.

    It is ``P L P⁻¹``, with P = diag(peak) and the Cholesky factor L of the correlation matrix.

    Parameters
    ----------
    peak : (n,) peaks of the perturbations, N·m
    correlation : that of any two of them

    Raises
    ------
    ConfigurationError
        If it is not between 0 and 1, the latter excluded.
    """
    if not 0.0 <= correlation < 1.0:
        raise ConfigurationError(
            f"correlation of the perturbations must be at least 0 and below 1, got {correlation}"
        )
    n = len(peak)
    root = np.linalg.cholesky((1.0 - correlation) * np.eye(n) + correlation)
    mixing: FloatArray = np.array(peak)[:, None] * root / np.array(peak)
    return mixing


def estimate(
    experiment: SimulatedExperiment, estimators: Sequence[str], segment: int
) -> dict[str, Run]:
    """Estimate the impedance from one experiment, each estimator from the records alone.

    Parameters
    ----------
    experiment : SimulatedExperiment
    estimators : names; :data:`MIMO` for experiments with all joints at once, and no other
    segment : samples of the segments of averaged spectra

    Raises
    ------
    ConfigurationError, DataError
        If there is no such estimator, or the records do not suit it.
    """
    runs = {}
    for name in estimators:
        begun = time.perf_counter()
        coupling = None
        if name == MIMO:
            # No coupling is refused, as its effect is what the study measures.
            found = estimate_mimo(experiment.records, segment, largest_condition=np.inf)
            impedance, coupling = found.impedance, found.coupling
        else:
            known = experiment.known
            data = [
                TrialData.of(replace(one, reading=known.reading), segment=segment)
                for one in experiment.records
            ]
            (estimator,) = make_estimators([DIRECT if name == DIRECT.name else name])
            impedance = estimator.estimate(data)
        impedance, fit = fit_impedance(impedance)
        runs[name] = Run(
            estimator=name,
            seed=experiment.config.seed,
            estimate=impedance,
            fit=fit,
            vaf=scores.vaf(impedance, experiment.truth),
            seconds=time.perf_counter() - begun,
            coupling=coupling,
        )
    return runs


def with_voluntary(
    base: ExperimentConfig, rms: float, seeds: Sequence[int]
) -> list[ExperimentConfig]:
    """Configurations with a voluntary torque, N·m rms; one for each seed."""
    person = {**base.arm_sim, "voluntary.rms": rms}
    return [base.model_copy(update={"arm_sim": person, "seed": seed}) for seed in seeds]


def in_threads(
    work: Callable[[Work], Result], tasks: Sequence[Work], workers: int | None
) -> Iterator[Result]:
    """Yield the results of the tasks in their order; most of the time is spent without the GIL."""

    def numbered(task: tuple[int, Work]) -> tuple[int, Result]:
        return task[0], work(task[1])

    count = workers or available_cores()
    ready = Backend(ThreadPoolExecutor(count), count).run(numbered, enumerate(tasks))
    early: dict[int, Result] = {}
    due = 0
    display().progress(0, len(tasks), things="batches")
    for done, (number, result) in enumerate(ready, 1):
        display().progress(done, len(tasks), things="batches")
        early[number] = result
        while due in early:
            yield early.pop(due)
            due += 1


def in_blocks(runs: Sequence[Work]) -> list[tuple[Work, ...]]:
    """Split runs into groups that take the compiled loop no longer than one run."""
    starts = range(0, len(runs), WIDTH)
    return [tuple(itertools.islice(runs, start, start + WIDTH)) for start in starts]


def identified(
    configs: Sequence[ExperimentConfig], workers: int | None
) -> Iterator[tuple[SimulatedExperiment, Identification]]:
    """Yield simulated experiments in their order, each with the result of `ESTIMATOR`."""

    def work(
        block: tuple[ExperimentConfig, ...],
    ) -> list[tuple[SimulatedExperiment, Identification]]:
        return [(one, one.identify([ESTIMATOR])) for one in simulate(block)]

    return itertools.chain.from_iterable(in_threads(work, in_blocks(configs), workers))


def scales(truth: FloatArray) -> FloatArray:
    """Return the scale of errors of each element of M, B or K: ``sqrt(|X_ii X_jj|)``.

    Relative to themselves, small elements off the diagonal have large errors that hardly matter.

    Parameters
    ----------
    truth : (..., n, n)

    Returns
    -------
    (..., n, n) NDArray
        In the units of the truth.
    """
    diagonal = np.sqrt(np.abs(np.diagonal(truth, axis1=-2, axis2=-1)))
    scale: FloatArray = diagonal[..., :, None] * diagonal[..., None, :]
    return scale


def matrices(mbk: MBK) -> FloatArray:
    """M, B and K in one array, shape (3, n, n)."""
    return np.stack((mbk.M, mbk.B, mbk.K))


def relative_errors(fit: MBKFit, truth: MBK) -> tuple[FloatArray, FloatArray]:
    """Return errors of M, B and K and those that the fit states, (3, n, n), both over `scales`."""
    true, stated = matrices(truth), fit.errors
    return (matrices(fit.mbk) - true) / scales(true), stated / scales(true)


def run_together(
    experiments: Sequence[NodeParameters],
    *,
    trials: int = 1,
    mixing: Sequence[FloatArray] | None = None,
) -> list[list[TrialRecord]]:
    """Run, side by side, trials in which every joint is compliant and perturbed at once.

    The perturbation of each joint in the first trial is that of its own trial in
    :func:`armimp_bringup.offline.run_offline`; those of further trials are independent of them.

    Parameters
    ----------
    experiments : as for :func:`armimp_bringup.offline.run_offline`
    trials : their number, one after the other
    mixing : for each experiment, if given, an (n, n) matrix that makes τ_Δ out of these
        perturbations; off its diagonal it couples the inputs

    Returns
    -------
    list of list of TrialRecord
        For each experiment, its trials in order.
    """
    laws = [one.controller for one in experiments]
    n = len(laws[0].joints)

    def signals(segment: Segment) -> tuple[FloatArray, int | None]:
        tau_delta = np.zeros((segment.ticks, len(laws), n))
        if segment.phase is Phase.PERTURB:
            for (lane, one), joint in itertools.product(enumerate(laws), range(n)):
                trial = segment.joint * n + joint + 1
                signal = one.signal(joint, trial=trial, ticks=segment.ticks)
                tau_delta[:, lane, joint] = signal
            for lane, matrix in enumerate(mixing or ()):
                tau_delta[:, lane] = tau_delta[:, lane] @ matrix.T
        return tau_delta, None

    segments = timetable(laws[0].sequence, joints=trials, tare=laws[0].tare)
    return run_offline(experiments, segments, signals)
