"""Verdict on an identification, from what a rig can measure (never from the truth).

Noise is not a problem, as the intervals include it; anything that makes a number wrong is one. A
result is valid if it has no errors: :meth:`Verdict.of`. The problems are found by the functions
below, and by `plausibility`, `signal_quality`, `nonlinearity`, `transducers` and, in a recording,
`alignment`. `names` are those of the n joints; comparisons are written so that NaN is a problem.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import permutations, product
from typing import Any

import numpy as np

from armimp_common.arrays import FloatArray
from armimp_estimation.arm_models import ModelFit, supported
from armimp_estimation.estimators.estimate import ImpedanceEstimate
from armimp_estimation.fit import MBKFit
from armimp_estimation.json_model import JsonModel
from armimp_estimation.plausibility import judge_matrices
from armimp_estimation.problems import Concern, Problem, ProblemCode, Severity, problem
from armimp_estimation.record import TrialRecord
from armimp_estimation.signal_quality import followed, spectrum_by_bins
from armimp_estimation.torque_timing import TorqueReading, TorqueTiming

LOCK_RATIO = 0.02
"""Largest motion of a locked joint, within the band and caused by the perturbation, relative to the
perturbed one; it biases ``welch_siso``. At this limit the bias of off-diagonal elements may reach
several per cent."""
BIAS_BOUND = 0.1
"""Largest share of a torque that motion of locked joints explains, band mean, see
:func:`armimp_estimation.scores.bias_bound`. Good locking stays below 0.03."""
UNEVEN = 0.05
"""Largest share of a torque at the lines of a multisine that no linear arm explains. Linear arms
beside friction and coarse encoders stay below 0.01; arms with play in the cuffs have 0.07 to 0.5.
"""
_NOTICED = 5.0  # standard errors beyond which a delay or the corner of a high-pass is reported
_CORNER = 0.03
"""Corner of a high-pass, Hz, below which its effect is small enough for the standard errors."""
_SUREST = 1e-6
"""Least standard error that any delay is taken to have, s."""
SINGLE = "welch_siso"
"""The estimator that takes locked joints as still."""
_CLEARLY, _IMPOSSIBLY = 2.0, 10.0
"""Ratio of the motion of another joint to that of the perturbed one that is clearly too large, and
that is too large for any arm."""
_AS_MUCH, _FOLLOWS = 0.1, 0.5
"""Motion or torque of a joint relative to that in its own trial, and coherence with the
perturbation of its own trial, from which on a channel belongs to that trial."""


def faults(problems: Iterable[Problem], *estimators: str) -> list[Problem]:
    """Errors due to which the numbers of these estimators can't be trusted."""
    errors = (one for one in problems if one.severity is Severity.ERROR)
    return [one for one in errors if one.estimator in ("", *estimators)]


class Verdict(JsonModel):
    """Whether Z(f), and whether M, B and K, are right within their intervals."""

    impedance: bool
    parameters: bool

    @classmethod
    def of(cls, problems: Iterable[Problem], *estimators: str) -> Verdict:
        """Judge whether the numbers of estimators can be trusted; never if there is none."""
        found = [one.concern for one in faults(problems, *estimators)]
        trusted = bool(estimators)
        return cls(
            impedance=trusted and Concern.IMPEDANCE not in found, parameters=trusted and not found
        )


def judge_locking(
    names: Sequence[str], lock_ratio: FloatArray, bias_bound: FloatArray
) -> Iterator[Problem]:
    """Find joints that were not held still; these problems concern ``welch_siso`` alone.

    Derived coherence stays near 1 when locking fails, since a joint that gives way still responds
    coherently to the perturbation; so locking is judged by the motion itself. Both scores have the
    shape (n, n), with row i of the locked and column k of the perturbed joint.
    """
    for (k, perturbed), (i, locked) in product(enumerate(names), repeat=2):
        if i != k and not lock_ratio[i, k] <= LOCK_RATIO:
            yield problem(
                ProblemCode.LOCK_RATIO,
                estimator=SINGLE,
                name=locked,
                perturbed=perturbed,
                percent=100.0 * float(lock_ratio[i, k]),
                limit=100.0 * LOCK_RATIO,
            )
        if not bias_bound[i, k] <= BIAS_BOUND:
            yield problem(
                ProblemCode.LOCK_BIAS,
                estimator=SINGLE,
                name=locked,
                moving=locked if i != k else "the locked joints",
                perturbed=perturbed,
                percent=100.0 * float(bias_bound[i, k]),
                limit=100.0 * BIAS_BOUND,
                element=f"({i + 1}, {k + 1})",
            )


def judge_order(names: Sequence[str], lock_ratio: FloatArray) -> Iterator[Problem]:
    """Find angles in another order than the perturbations.

    A joint that is lighter and gives way may move more than the perturbed one. But the energy that
    joints store and lose would be negative if each of two joints moved more while the other one is
    perturbed, or several joints in a cycle. And no joint that is held moves ten times as much: that
    is the perturbed one, in a trial whose angles are in another order. `lock_ratio` has the shape
    (n, n), with row i of the joint that moves and column k of the perturbed one.
    """
    if np.isnan(lock_ratio).any():
        return
    most = np.argmax(lock_ratio, axis=0).tolist()
    moved = [k for k, most_moved in enumerate(most) if most_moved != k]
    ratios = np.max(lock_ratio, axis=0)[moved]
    cycle = (ratios > _CLEARLY).all() and len(set(most)) == len(names)
    if moved and (cycle or (ratios > _IMPOSSIBLY).any()):
        perturbed = ", ".join(names[k] for k in moved)
        moving = ", ".join(names[most[k]] for k in moved)
        yield problem(ProblemCode.SENSORS_PERMUTED, perturbed=perturbed, moving=moving)


def judge_trials(records: Sequence[TrialRecord]) -> Iterator[Problem]:
    """Find channels that belong to another trial, as where axes are exchanged.

    Such an angle or torque follows the perturbation of another trial instead of that of its own.
    `records` are the trials, one for each joint, in order.
    """
    samples = min(record.samples for record in records)
    pushes = [
        spectrum_by_bins(record.perturbation[k, :samples]) for k, record in enumerate(records)
    ]
    for (k, record), (i, other) in permutations(enumerate(records), 2):
        for stream, readings in record.readings.items():
            seen = readings[i]
            if np.std(seen) < _AS_MUCH * np.std(other.readings[stream][i]):
                continue
            shown = spectrum_by_bins(seen[:samples])
            answers = [followed(pushes[one], shown) for one in (k, i)]
            here, elsewhere = (float(share @ power / np.sum(power)) for share, power, _ in answers)
            if elsewhere > _FOLLOWS and here < 0.5 * elsewhere:
                yield problem(
                    ProblemCode.TRIALS_MIXED,
                    trial=record.trial,
                    perturbed=record.joint_names[k],
                    name=record.joint_names[i],
                    other=other.trial,
                )
                break


def judge_band(f: FloatArray, perturbed: FloatArray) -> Iterator[Problem]:
    """Note on which frequencies an estimate rests if the perturbation lacks power at some.

    Parameters
    ----------
    f : ndarray, shape (n_freq,)
        Frequencies of the whole band, Hz.
    perturbed : ndarray, shape (m,)
        Those at which all joints were perturbed, Hz.
    """
    if perturbed.size < f.size:
        yield problem(
            ProblemCode.BAND_NARROWED,
            severity=Severity.NOTE,
            low=float(perturbed[0]),
            high=float(perturbed[-1]),
            percent=100.0 * perturbed.size / f.size,
        )


def judge_coherence(
    names: Sequence[str], motion: FloatArray, torque: FloatArray, level: float
) -> Iterator[Problem]:
    """Find perturbed joints whose motion or torque does not follow the perturbation.

    Parameters
    ----------
    motion : ndarray, shape (n,)
        Mean coherence of perturbation k with the angle of joint k.
    torque : ndarray, shape (n, n)
        Mean coherence of perturbation k with the torque of joint i.
    level : float
        Coherence that counts as significant.
    """
    for k, name in enumerate(names):
        for stream, coherence in (("motion", motion[k]), ("torque", torque[k, k])):
            if not coherence > level:
                yield problem(
                    ProblemCode.NO_RESPONSE,
                    stream=stream,
                    name=name,
                    perturbed=name,
                    coherence=float(coherence),
                    level=level,
                )


def judge_estimate(
    names: Sequence[str],
    estimate: ImpedanceEstimate,
    fit: MBKFit,
    reading: TorqueReading,
    *,
    apart: float,
    decides: bool,
) -> Iterator[Problem]:
    """Find problems of one estimate and its fit.

    Parameters
    ----------
    reading : TorqueReading
        Instant of the torque readings, as far as it was declared.
    apart : float
        Distance between the postures of the trials, rad.
    decides : bool
        Whether the verdict is about this estimate. The bias of others is known only roughly, and
        their lack of fit shows no more than that.
    """
    name = estimate.name
    yield from judge_matrices(names, estimate, fit, apart)
    for i, k in np.ndindex(fit.lack.shape):
        if decides and not fit.lack[i, k] <= fit.lack_limit:
            yield problem(
                ProblemCode.LACK_OF_FIT,
                concern=Concern.PARAMETERS,
                estimator=name,
                element=f"({i + 1}, {k + 1})",
                lack=float(fit.lack[i, k]),
                limit=fit.lack_limit,
            )
    for joint, share in zip(names, estimate.uneven, strict=False):
        if share > UNEVEN:
            about: dict[str, Any] = {"name": joint, "percent": 100.0 * share}
            yield problem(ProblemCode.RESPONSE_UNEVEN, estimator=name, **about)
    if not estimate.unbiased:
        return
    corner, error = fit.high_pass
    if abs(corner) > max(_CORNER, _NOTICED * error):
        about = {"passed": "torques" if corner > 0.0 else "angles"}
        about |= {"corner": abs(corner), "error": error}
        yield problem(ProblemCode.HIGH_PASSED, estimator=name, **about)
    delay = fit.delay
    if delay is not None and abs(delay.delay) > _NOTICED * max(delay.error, _SUREST):
        values: dict[str, Any] = {"delay_ms": 1e3 * delay.delay, "error_ms": 1e3 * delay.error}
        code = ProblemCode.DELAY_CORRECTED
        if delay.refuted and (reading.timing is not TorqueTiming.UNKNOWN or not reading.prompt):
            code, values = ProblemCode.TIMING_REFUTED, {**values, "declared": reading.sentence}
        yield problem(code, severity=Severity.NOTE, estimator=name, **values)
    for joint, late in zip(names, fit.lateness, strict=True):
        if late.any():
            about = {"name": joint, "delay_ms": 1e3 * float(np.max(late))}
            yield problem(ProblemCode.SEEMS_LATE, severity=Severity.NOTE, estimator=name, **about)


def judge_models(estimator: str, models: Mapping[str, ModelFit]) -> Iterator[Problem]:
    """Note which model was declared, or is supported, instead of M, B and K, or that none is.

    `models` are those that were fitted to the estimate of the `estimator`, by name.
    """
    if not models:
        return
    name = supported(models)
    values: dict[str, Any] = {"models": ", ".join(models)}
    code = ProblemCode.NO_MODEL
    if name is not None:
        best = models[name]
        code = ProblemCode.MODEL_DECLARED if best.declared else ProblemCode.MODEL_OFFERED
        values = {"model": name, "equation": best.equation}
        values |= {"lack": float(np.max(best.lack_of_fit)), "text": best.text}
    yield problem(code, severity=Severity.NOTE, estimator=estimator, **values)
