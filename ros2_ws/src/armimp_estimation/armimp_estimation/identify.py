"""The whole identification: trials in; matrices, scores and a verdict out."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from pydantic import Field

from armimp_common.arrays import FloatArray
from armimp_common.errors import ConfigurationError
from armimp_estimation import scores, verdict
from armimp_estimation.arm_models import ModelFit, fit_models
from armimp_estimation.estimators.estimate import Estimator, ImpedanceEstimate
from armimp_estimation.estimators.registry import make_estimators
from armimp_estimation.fit import MBKFit, fit_impedance
from armimp_estimation.frf import frf_matrix, order_trials
from armimp_estimation.hold_correction import update_jump
from armimp_estimation.json_model import JsonModel, Number, Vector
from armimp_estimation.metadata import Metadata
from armimp_estimation.nonlinearity import Deviation, judge_linearity
from armimp_estimation.plausibility import judge_angles, mixed_channels, other_postures
from armimp_estimation.problems import Problem, ProblemCode, Severity, problem
from armimp_estimation.record import TrialRecord
from armimp_estimation.robot_balance import RobotBalance, RobotResponses, in_order
from armimp_estimation.signal_quality import judge_signals
from armimp_estimation.systematics import RESOLVED_SHARE, lost_motion
from armimp_estimation.torque_timing import TorqueTiming
from armimp_estimation.transducers import judge_answers, judge_balance, judge_unexplained
from armimp_estimation.trial import TrialData, segment_for
from armimp_estimation.verdict import Verdict
from armimp_estimation.weighted_fit import WeightedFit

_FOLLOWED = 2.0
"""Assumption: error of Z(f) behind an undeclared filter, in what M, B and K leave of Z, as they
follow the filter in part; or what those of the lowest part of the band leave, if that is more."""


@dataclass(frozen=True, kw_only=True, eq=False)
class EstimatorResult:
    """Result of one estimator, with its scores."""

    estimate: ImpedanceEstimate
    """Impedance over frequency."""
    fit: MBKFit
    """M, B, K with standard errors and R²."""
    vaf: FloatArray | None
    """Variance accounted for, %, if the truth is known; shape (n, n)."""
    coherence: scores.Coherences
    """Coherences over frequency."""
    coherence_limit: float
    """Band mean of the coherence that unrelated signals hardly ever exceed."""
    models: dict[str, ModelFit]
    """Models of the arm that were fitted in addition to M, B and K, by name."""

    def with_doubts(
        self,
        shifts: Sequence[FloatArray],
        gains: FloatArray,
        scales: FloatArray,
        *,
        may_be_filtered: bool,
    ) -> EstimatorResult:
        """Return the result with what is in doubt of its sensors and its arm in its errors.

        Parameters
        ----------
        shifts : sequence of ndarray, shape (3, n, n)
            Changes of M, B and K, one standard error each.
        gains : ndarray, shape (n, n)
            Relative standard errors of gains and cross-talk: row i is the transducer, column l the
            joint whose torque it may show.
        scales : ndarray, shape (n,)
            Relative standard errors of whole columns, as of all torques of a trial.
        may_be_filtered : bool
            Whether nobody declared how torques are read, or they don't balance the commands. An arm
            that is not M, B and K can then not be told from one that is, behind a filter: the
            difference is an error of Z(f).
        """
        fit, noise, changes = self.fit.with_doubts(shifts), self.estimate.noise.copy(), []
        # An element that is near 0 by chance would otherwise get next to no error.
        found = np.copysign(np.hypot(fit.values, fit.errors), fit.values)
        for i, row in np.argwhere(gains):
            shift = np.zeros_like(found)
            shift[:, i] = gains[i, row] * found[:, row]
            changes.append(shift)
            noise[i] += np.abs(gains[i, row] * self.estimate.Z[row]) ** 2
        if may_be_filtered and not fit.of_form:
            problem = WeightedFit(estimate=self.estimate)
            followed = self.estimate.Z - problem.impedance(fit.values)
            beyond = followed + problem.impedance(problem.below()[0])
            noise += np.maximum(np.abs(_FOLLOWED * followed), np.abs(beyond)) ** 2
        for column in np.flatnonzero(scales):
            shift = np.zeros_like(found)
            shift[:, :, column] = scales[column] * found[:, :, column]
            changes.append(shift)
            noise[:, column] += np.abs(scales[column] * self.estimate.Z[:, column]) ** 2
        estimate = replace(self.estimate, noise=noise)
        return replace(self, fit=fit.with_doubts(changes), estimate=estimate)


class TrialScores(JsonModel):
    """How the robot locked joints, and yielded to the perturbation, in one trial."""

    k: int
    """Perturbed joint, from 1."""
    lock_ratio: Vector
    """Motion of each joint, within the band and caused by the perturbation, relative to that of
    joint k, for which it is 1."""
    bias_bound: Vector
    """Share of each torque that motion of locked joints explains."""
    realisation: Number = math.nan
    """Deviation of the robot from the target impedance of joint k, relative; null where the law or
    its target is not known."""
    realisation_ci: Vector = Field(default_factory=lambda: [math.nan, math.nan])
    """Lower and upper end of its 95 % interval."""
    stiffness_changes: dict[str, Vector] = Field(default_factory=dict)
    """Share by which the stiffness of joint k changes, and its standard error: from rest to the rms
    angle (``amplitude``) and from begin to end (``time``), if the trial is long enough."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Identification:
    """Result of an identification."""

    joint_names: tuple[str, ...]
    """Names of the n joints."""
    trials: tuple[TrialScores, ...]
    """Scores of the trials, in the order of the perturbed joints."""
    estimators: dict[str, EstimatorResult]
    """Results by name of the estimator, in the order asked for."""
    problems: tuple[Problem, ...]
    """What is wrong with the result, and what was found and corrected."""
    balance: RobotBalance | None = None
    """Identified dynamics of the robot itself, if commands are known."""

    @property
    def deciding(self) -> tuple[str, ...]:
        """Estimators that decide whether the result is valid: those without bias, else all."""
        return _deciding(self.estimators)

    @property
    def verdict(self) -> Verdict:
        """Whether Z(f), and whether M, B and K, can be trusted."""
        return Verdict.of(self.problems, *self.deciding)

    @property
    def valid(self) -> bool:
        """Whether both verdicts are good."""
        return self.verdict.parameters


def _deciding(results: Mapping[str, EstimatorResult]) -> tuple[str, ...]:
    unbiased = [name for name, one in results.items() if one.estimate.unbiased]
    return tuple(unbiased or results)


def identify_records(
    trials: Sequence[Sequence[TrialRecord]],
    estimators: Sequence[str | Estimator],
    known: Metadata,
) -> Identification:
    """Identify the impedance from the intact stretches of each trial and their metadata.

    Welch segments have the length that suits the shortest trial; for the rest see :func:`identify`.
    """
    trials = [[replace(one, reading=known.reading) for one in parts] for parts in trials]
    segment = segment_for(trials)
    data = [TrialData.of(*one, segment=segment) for one in trials]
    return identify(data, estimators, known)


def identify(
    trials: Sequence[TrialData],
    estimators: Sequence[str | Estimator],
    known: Metadata | None = None,
) -> Identification:
    """Estimate the impedance matrix and judge the result.

    Parameters
    ----------
    trials : sequence of TrialData
        One for each joint, in any order.
    estimators : sequence of str or Estimator
        Names from :mod:`armimp_estimation.estimators.registry`, or custom estimators.
    known : Metadata, optional
        What is known beside the records, which know themselves how their torques were read. True
        matrices are for the VAF only; they have no part in the verdict.

    Raises
    ------
    ConfigurationError
        If no estimator is asked for, one twice, or an unknown one, or the truth has another size.
    DataError
        If a joint has no trial or the data cannot be estimated.
    """
    known = known or Metadata()
    workers = make_estimators(estimators)
    ordered = order_trials(trials)
    names = ordered[0].record.joint_names
    if (truth := known.truth) is not None and truth.joints != len(names):
        raise ConfigurationError(f"truth is of {truth.joints} joints, the data of {len(names)}")

    responses = RobotResponses.of([trial.record for trial in ordered])
    order = tuple(range(len(names))) if responses is None else responses.order()
    ordered = tuple(in_order(trial, order) for trial in ordered)
    frf = frf_matrix(ordered)
    level = max(scores.coherence_of_chance(trial.spectra) for trial in ordered)
    for trial in ordered:
        scores.require_motion(trial.record)
    locks = scores.lock_ratio(ordered, frf)
    bounds = scores.bias_bound(frf)
    results: dict[str, EstimatorResult] = {}
    records = [trial.record for trial in ordered]
    for worker in workers:
        found = worker.estimate(ordered)
        estimate, fit = fit_impedance(found, known.calibration)
        models = fit_models(known.arm_model, found, fit, known.calibration)
        results[worker.name] = EstimatorResult(
            estimate=estimate,
            fit=fit,
            vaf=None if truth is None else scores.vaf(estimate, truth),
            coherence=scores.Coherences.of(ordered, estimate),
            coherence_limit=level,
            models=models,
        )
    deciding = _deciding(results)
    best = results[deciding[0]]
    problems = list(verdict.judge_band(trials[0].f, ordered[0].f))
    for trial in ordered:
        problems += [*trial.problems, *judge_angles(trial.record), *judge_signals(trial.record)]
    problems += verdict.judge_order(names, locks)
    problems += verdict.judge_trials(records)
    motion, torque = best.coherence.motion.mean(axis=-1), best.coherence.torque.mean(axis=-1)
    problems += verdict.judge_coherence(names, motion, torque, level)
    if verdict.SINGLE in results:
        problems += verdict.judge_locking(names, locks, bounds)
    postures = np.stack([record.position.mean(axis=1) for record in records])
    apart = float(np.max(np.ptp(postures, axis=0)))
    for name, one in results.items():
        problems += verdict.judge_estimate(
            names, one.estimate, one.fit, records[0].reading, apart=apart, decides=name in deciding
        )
        problems += verdict.judge_models(name, one.models)
    if known.calibration.assumed:
        parts = ("gain", "cross_talk", "angle")
        assumed = {one: 100.0 * getattr(known.calibration, one) for one in parts}
        problems.append(problem(ProblemCode.CALIBRATION_ASSUMED, severity=Severity.NOTE, **assumed))
    hold = best.estimate.hold if best.estimate.unbiased else update_jump(records)
    balance = (
        None
        if responses is None
        else responses.balance(order, hold, best.fit, known.calibration, apart)
    )
    unbalanced, gains, scales = judge_balance(
        names, balance, best.fit, known.calibration, known.robot_of(len(names))
    )
    doubts: list[FloatArray] = []
    deviating: Sequence[Mapping[str, Deviation]] = [{} for _ in records]
    if best.estimate.unbiased:
        linear = judge_linearity(
            best.estimate.posed or records,
            best.estimate,
            best.fit,
            hold,
            resolved=np.all(lost_motion(records)[0] < RESOLVED_SHARE, axis=0),
            linearity=known.calibration.linearity,
        )
        of_postures, changes = other_postures(records, best.fit, apart)
        problems += [*linear.problems, *of_postures]
        doubts += [*linear.doubts, *changes]
        gains, deviating = np.hypot(gains, np.diag(linear.gain)), linear.own
        noise = best.estimate.noise + linear.noise
        results[deciding[0]] = replace(best, estimate=replace(best.estimate, noise=noise))
        if known.calibration.assumed:
            doubts += mixed_channels(best.fit, known.calibration)
    problems += [*unbalanced, *judge_answers(names, records, balance, best.fit)]
    realised = scores.realisation(best.estimate, known.target)
    reading = records[0].reading
    undeclared = reading.timing is TorqueTiming.UNKNOWN and reading.prompt
    unexplained = list(judge_unexplained(names, balance, best.fit))
    problems += unexplained
    return Identification(
        joint_names=names,
        trials=tuple(
            TrialScores(
                k=k + 1,
                lock_ratio=locks[:, k].tolist(),
                bias_bound=bounds[:, k].tolist(),
                realisation=realised[k, 0],
                realisation_ci=realised[k, 1:].tolist(),
                stiffness_changes={
                    name: [one.share, one.error]
                    for name, one in deviating[k].items()
                    if name in ("amplitude", "time")
                },
            )
            for k in range(len(names))
        ),
        estimators={
            name: one.with_doubts(
                doubts, gains, scales, may_be_filtered=undeclared or bool(unexplained)
            )
            for name, one in results.items()
        },
        problems=tuple(problems),
        balance=balance,
    )
