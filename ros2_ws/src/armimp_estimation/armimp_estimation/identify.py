"""The whole identification: trials in; matrices, scores and a verdict out."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armimp_common.errors import ConfigurationError
from armimp_estimation import scores, verdict
from armimp_estimation.estimate import Estimator, ImpedanceEstimate
from armimp_estimation.fit import MBKFit, fit_mbk
from armimp_estimation.frf import frf_matrix, order_trials
from armimp_estimation.mbk import MBK
from armimp_estimation.registry import make_estimator
from armimp_estimation.settings import IdentifyConfig
from armimp_estimation.trial import TrialData

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class EstimatorResult:
    """What one estimator found, and how well.

    Attributes
    ----------
    estimate : ImpedanceEstimate
        Impedance over frequency.
    fit : MBKFit
        M, B, K with standard errors and R².
    vaf : ndarray, shape (n, n), or None
        Variance accounted for, %, if the truth is known.
    coherence : Coherences
        Over frequency.
    """

    estimate: ImpedanceEstimate
    fit: MBKFit
    vaf: FloatArray | None
    coherence: scores.Coherences

    @property
    def coherence_derived(self) -> FloatArray:
        """Band mean of the derived coherence, shape (n, n)."""
        return scores.band_mean(self.coherence.derived)

    @property
    def coherence_torque(self) -> FloatArray:
        """Band mean of ``γ²(τΔ_k, τ_i)``, shape (n, n)."""
        return scores.band_mean(self.coherence.torque)

    @property
    def coherence_motion(self) -> FloatArray:
        """Band mean of ``γ²(τΔ_k, θ_k)``, shape (n,)."""
        return scores.band_mean(self.coherence.motion)


@dataclass(frozen=True, kw_only=True, eq=False)
class TrialScores:
    """Quality of locking in one trial.

    Attributes
    ----------
    trial : int
        Number of the trial, 1-based.
    joint : int
        Perturbed joint k, 0-based.
    lock_ratio : ndarray, shape (n,)
        ``rms(θ_i) / rms(θ_k)``, 1 at k.
    bias_bound : ndarray, shape (n,)
        Share of each torque that motion of locked joints explains, see
        :func:`armimp_estimation.scores.bias_bound`.
    """

    trial: int
    joint: int
    lock_ratio: FloatArray
    bias_bound: FloatArray


@dataclass(frozen=True, kw_only=True, eq=False)
class Identification:
    """Result of an identification.

    Attributes
    ----------
    joint_names : tuple of str
        Names of the n joints.
    trials : tuple of TrialScores
        In order of the perturbed joint.
    estimators : dict of str to EstimatorResult
        By name, in the order asked for.
    effective_averages : float
        Number of independent averages of the spectra (of the shortest trial).
    coherence_significance : float
        Coherence below which signals count as unrelated.
    problems : tuple of str
        What is wrong with the result, in words.
    truth : MBK or None
        True matrices, if known.
    """

    joint_names: tuple[str, ...]
    trials: tuple[TrialScores, ...]
    estimators: dict[str, EstimatorResult]
    effective_averages: float
    coherence_significance: float
    problems: tuple[str, ...]
    truth: MBK | None

    @property
    def valid(self) -> bool:
        """Whether there is no problem."""
        return not self.problems


def identify(
    trials: Sequence[TrialData],
    estimators: Sequence[str | Estimator],
    truth: MBK | None = None,
    config: IdentifyConfig | None = None,
) -> Identification:
    """Estimate the impedance matrix and judge the result.

    Parameters
    ----------
    trials : sequence of TrialData
        One for each joint, in any order.
    estimators : sequence of str or Estimator
        Names from :func:`armimp_estimation.registry.estimator_names`, or estimators of one's own.
    truth : MBK, optional
        True matrices, for the VAF only; they have no part in the verdict.
    config : IdentifyConfig, optional
        Options.

    Raises
    ------
    ConfigurationError
        If no estimator is asked for, or an unknown one, or the truth is of another size.
    DataError
        If a joint has no trial or the data cannot be estimated.
    """
    options = config if config is not None else IdentifyConfig()
    workers = [make_estimator(one, options) if isinstance(one, str) else one for one in estimators]
    distinct = {worker.name for worker in workers}
    if not workers or len(distinct) != len(workers):
        raise ConfigurationError(
            f"estimators must be distinct, at least one: {[worker.name for worker in workers]}"
        )
    ordered = order_trials(trials)
    names = ordered[0].record.joint_names
    if truth is not None and truth.joints != len(names):
        raise ConfigurationError(f"truth is of {truth.joints} joints, the data of {len(names)}")

    spectra = [trial.spectra for trial in ordered]
    frf = frf_matrix(spectra)
    averages = min(trial.spectra.effective_averages for trial in spectra)
    level = scores.coherence_significance(averages, options.limits.significance)
    locks = np.stack([scores.lock_ratio(trial.record) for trial in ordered], axis=1)
    bounds = scores.bias_bound(frf)
    results = {}
    of_estimates: list[str] = []
    for worker in workers:
        estimate = worker.estimate(ordered)
        results[worker.name] = result = EstimatorResult(
            estimate=estimate,
            fit=fit_mbk(estimate, options.fit),
            vaf=None if truth is None else scores.vaf(estimate, truth),
            coherence=scores.Coherences.of(spectra, estimate),
        )
        of_estimates += verdict.judge_estimate(
            worker.name, result.coherence_derived, result.fit.r2, options.limits
        )
    first = next(iter(results.values()))
    problems = verdict.judge_locking(names, locks, bounds, options.limits)
    problems += verdict.judge_coherence(
        names, first.coherence_motion, first.coherence_torque, level
    )
    problems += of_estimates
    return Identification(
        joint_names=names,
        trials=tuple(
            TrialScores(
                trial=trial.record.trial,
                joint=k,
                lock_ratio=locks[:, k].copy(),
                bias_bound=bounds[:, k].copy(),
            )
            for k, trial in enumerate(ordered)
        ),
        estimators=results,
        effective_averages=averages,
        coherence_significance=level,
        problems=tuple(problems),
        truth=truth,
    )
