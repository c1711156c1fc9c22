"""Judgement of an identification, from what a rig can measure (never from the truth).

Noise is no problem: intervals tell of it. What would make a number wrong is. `Summary.verdict_on`
says valid where no problem is left.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from armimp_common.errors import ConfigurationError
from armimp_estimation.arm_models import ModelFit, supported
from armimp_estimation.estimators.estimate import ImpedanceEstimate
from armimp_estimation.fit import MBKFit
from armimp_estimation.plausibility import judge_matrices
from armimp_estimation.problems import Concern, Problem, ProblemCode, Severity
from armimp_estimation.torque_timing import TorqueReading

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Limits:
    """What a valid result has to meet."""

    lock_ratio: float = 0.02
    """Largest motion of a locked joint, within the band and caused by the perturbation, relative to
    the perturbed one; it biases ``welch_siso``. At 0.02 the bias of off-diagonal elements may reach
    several per cent."""
    bias_bound: float = 0.1
    """Largest share of a torque that motion of locked joints explains, band mean, see
    :func:`armimp_estimation.scores.bias_bound`. Good locking stays below 0.03."""
    significance: float = 0.05
    """Probability with which unrelated signals may pass as coherent; sets the level that band means
    of the ordinary coherences with the perturbation have to exceed."""

    def __post_init__(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            if not 0.0 < value < 1.0:
                raise ConfigurationError(f"limit {item.name} must be in (0, 1), got {value!r}")


_NOTICED = 5.0
_CORNER = 0.03
"""Corner of a high-pass, Hz, below which what it does is small enough for the standard errors."""
_SUREST = 1e-6
"""Standard error below which no delay is known, s."""
SINGLE = "welch_siso"
"""The estimator that takes locked joints as still."""
_CLEARLY = 2.0
"""Another joint moves this many times as much as the perturbed one."""


def judge_locking(
    names: Sequence[str], lock_ratio: FloatArray, bias_bound: FloatArray, limits: Limits
) -> list[Problem]:
    """Problems with joints that were to be held still; they concern ``welch_siso`` alone.

    Derived coherence stays near 1 when locking fails, since a joint that gives way still answers
    the perturbation coherently; so locking is judged by the motion itself.

    Parameters
    ----------
    names : sequence of str
        Joint names.
    lock_ratio, bias_bound : ndarray, shape (n, n)
        Row i is the locked, column k the perturbed joint.
    limits : Limits
        Limits.
    """
    problems = []
    for k, perturbed in enumerate(names):
        for i, locked in enumerate(names):
            # Comparisons are written so that NaN fails.
            if i != k and not lock_ratio[i, k] <= limits.lock_ratio:
                values: dict[str, float | int | str] = {
                    "name": locked,
                    "perturbed": perturbed,
                    "percent": 100.0 * float(lock_ratio[i, k]),
                    "limit": 100.0 * limits.lock_ratio,
                }
                problems.append(
                    Problem(code=ProblemCode.LOCK_RATIO, estimator=SINGLE, values=values)
                )
            if not bias_bound[i, k] <= limits.bias_bound:
                values = {
                    "name": locked,
                    "moving": locked if i != k else "the locked joints",
                    "perturbed": perturbed,
                    "percent": 100.0 * float(bias_bound[i, k]),
                    "limit": 100.0 * limits.bias_bound,
                    "element": f"({i + 1}, {k + 1})",
                }
                problems.append(
                    Problem(code=ProblemCode.LOCK_BIAS, estimator=SINGLE, values=values)
                )
    return problems


def judge_order(names: Sequence[str], lock_ratio: FloatArray) -> list[Problem]:
    """Problems with angles that are not those of the joints which are perturbed.

    A joint may move more than the one that is perturbed, if it is lighter and gives way. But what
    they store and lose would be negative if each of two joints moved more while the other one is
    perturbed, or more of them in a circle.

    Parameters
    ----------
    names : sequence of str
        Joint names.
    lock_ratio : ndarray, shape (n, n)
        Row i is the joint that moves, column k the perturbed one.
    """
    if np.isnan(lock_ratio).any():
        return []
    most = np.argmax(lock_ratio, axis=0).tolist()
    moved = [k for k, most_moved in enumerate(most) if most_moved != k]
    clear = (np.max(lock_ratio, axis=0)[moved] > _CLEARLY).all()
    if not moved or not clear or len(set(most)) < len(names):
        return []
    values: dict[str, float | int | str] = {
        "perturbed": ", ".join(names[k] for k in moved),
        "moving": ", ".join(names[most[k]] for k in moved),
    }
    return [Problem(code=ProblemCode.SENSORS_PERMUTED, values=values)]


def judge_band(f: FloatArray, perturbed: FloatArray) -> list[Problem]:
    """Say on which band an estimate rests if the perturbation has no power in a part of it.

    Parameters
    ----------
    f : ndarray, shape (n_freq,)
        Frequencies of the whole band, Hz.
    perturbed : ndarray, shape (m,)
        Those of them at which all joints were perturbed.
    """
    if perturbed.size == f.size:
        return []
    values: dict[str, float | int | str] = {
        "low": float(perturbed[0]),
        "high": float(perturbed[-1]),
        "percent": 100.0 * perturbed.size / f.size,
    }
    return [Problem(code=ProblemCode.BAND_NARROWED, severity=Severity.NOTE, values=values)]


def judge_coherence(
    names: Sequence[str], motion: FloatArray, torque: FloatArray, level: float
) -> list[Problem]:
    """Problems with perturbed joints that do not answer the perturbation.

    Parameters
    ----------
    names : sequence of str
        Joint names.
    motion : ndarray, shape (n,)
        Mean coherence of perturbation k with the angle of joint k.
    torque : ndarray, shape (n, n)
        Mean coherence of perturbation k with the torque of joint i.
    level : float
        Coherence that counts as significant.
    """
    problems = []
    for k, name in enumerate(names):
        for stream, coherence in (("motion", motion[k]), ("torque", torque[k, k])):
            if not coherence > level:
                values: dict[str, float | int | str] = {
                    "stream": stream,
                    "name": name,
                    "perturbed": name,
                    "coherence": float(coherence),
                    "level": level,
                }
                problems.append(Problem(code=ProblemCode.NO_RESPONSE, values=values))
    return problems


def judge_estimate(
    names: Sequence[str],
    estimate: ImpedanceEstimate,
    fit: MBKFit,
    reading: TorqueReading,
    *,
    decides: bool,
) -> list[Problem]:
    """Problems with one estimate and its fit.

    Parameters
    ----------
    names : sequence of str
        Joint names.
    estimate : ImpedanceEstimate
        The impedance.
    fit : MBKFit
        M, B and K.
    reading : TorqueReading
        When torques were read, as far as that was told.
    decides : bool
        Whether the verdict is about it. Beside others, what is known of its bias is known roughly,
        and lack of fit says no more than that.
    """
    problems = judge_matrices(estimate.name, names, fit)
    for i, k in np.ndindex(fit.lack.shape):
        if decides and not fit.lack[i, k] <= fit.lack_limit:
            problems.append(
                Problem(
                    code=ProblemCode.LACK_OF_FIT,
                    concern=Concern.PARAMETERS,
                    estimator=estimate.name,
                    values={
                        "element": f"({i + 1}, {k + 1})",
                        "lack": float(fit.lack[i, k]),
                        "limit": fit.lack_limit,
                    },
                )
            )
    if not estimate.unbiased:
        return problems
    corner, error = fit.high_pass
    if abs(corner) > max(_CORNER, _NOTICED * error):
        passed: dict[str, float | int | str] = {
            "passed": "torques" if corner > 0.0 else "angles",
            "corner": abs(corner),
            "error": error,
        }
        code = ProblemCode.HIGH_PASSED
        problems.append(Problem(code=code, estimator=estimate.name, values=passed))
    delay = fit.delay
    if delay is not None and abs(delay.delay) > _NOTICED * max(delay.error, _SUREST):
        values: dict[str, float | int | str] = {
            "delay_ms": 1e3 * delay.delay,
            "error_ms": 1e3 * delay.error,
        }
        code = ProblemCode.DELAY_CORRECTED
        if delay.refuted and reading != TorqueReading():
            code, values = ProblemCode.TIMING_REFUTED, {**values, "declared": reading.sentence}
        problems.append(
            Problem(code=code, severity=Severity.NOTE, estimator=estimate.name, values=values)
        )
    return problems


def judge_models(estimator: str, models: Sequence[ModelFit]) -> list[Problem]:
    """Say which model the data support in the place of M, B and K, or that none of them does.

    Parameters
    ----------
    estimator : str
        Name of the estimator.
    models : sequence of ModelFit
        Those that were fitted.
    """
    if not models:
        return []
    best = supported(models)
    if best is None:
        code = ProblemCode.NO_MODEL
        values: dict[str, float | int | str] = {
            "models": ", ".join(one.model.name for one in models)
        }
    else:
        code = ProblemCode.MODEL_OFFERED
        values = {
            "model": best.model.name,
            "equation": best.model.equation,
            "lack": float(np.max(best.lack)),
            "text": best.text,
        }
    note = Problem(code=code, severity=Severity.NOTE, estimator=estimator, values=values)
    return [note]
