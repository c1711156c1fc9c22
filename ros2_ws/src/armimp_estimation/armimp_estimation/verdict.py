"""Judgement of an identification in words, from what a rig can measure (never from the truth)."""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from armimp_common.errors import ConfigurationError

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Limits:
    """What a valid result has to meet.

    Parameters
    ----------
    lock_ratio : float
        Largest motion of a locked joint relative to the perturbed one. Good locking stays below
        0.006, apart from the controller's dither, with which it reaches 0.013 for the coarsest
        encoders; at 0.02 the bias of off-diagonal elements may reach several per cent.
    bias_bound : float
        Largest share of a torque that motion of locked joints explains, band mean, see
        :func:`armimp_estimation.scores.bias_bound`. Good locking stays below 0.03.
    coherence_derived : float
        Smallest band mean of the derived coherence.
    r2 : float
        Smallest coefficient of determination of the M-B-K fit.
    significance : float
        Probability with which unrelated signals may pass as coherent; sets the level that band
        means of the ordinary coherences with the perturbation have to exceed.
    """

    lock_ratio: float = 0.02
    bias_bound: float = 0.1
    coherence_derived: float = 0.9
    r2: float = 0.95
    significance: float = 0.05

    def __post_init__(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            if not 0.0 < value < 1.0:
                raise ConfigurationError(f"limit {item.name} must be in (0, 1), got {value!r}")


def judge_locking(
    names: Sequence[str], lock_ratio: FloatArray, bias_bound: FloatArray, limits: Limits
) -> list[str]:
    """Problems with joints that were to be held still.

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
                problems.append(
                    f"{locked} was not held still while {perturbed} was perturbed: it moved by "
                    f"{100 * lock_ratio[i, k]:.3g} % of it (limit {100 * limits.lock_ratio:.3g} %)"
                )
            if not bias_bound[i, k] <= limits.bias_bound:
                moving = locked if i != k else "the locked joints"
                problems.append(
                    f"motion of {moving} while {perturbed} was perturbed explains "
                    f"{100 * bias_bound[i, k]:.3g} % of the torque of {locked} (limit "
                    f"{100 * limits.bias_bound:.3g} %): element ({i + 1}, {k + 1}) may be biased "
                    "as much"
                )
    return problems


def judge_coherence(
    names: Sequence[str], motion: FloatArray, torque: FloatArray, level: float
) -> list[str]:
    """Problems with signals that do not answer the perturbation.

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
    for k, perturbed in enumerate(names):
        if not motion[k] > level:
            problems.append(
                f"motion of {perturbed} does not follow its perturbation: mean coherence "
                f"{motion[k]:.3g} is not significant (level {level:.3g})"
            )
        for i, name in enumerate(names):
            if not torque[i, k] > level:
                problems.append(
                    f"torque of {name} does not follow the perturbation of {perturbed}: mean "
                    f"coherence {torque[i, k]:.3g} is not significant (level {level:.3g})"
                )
    return problems


def judge_estimate(
    estimator: str, coherence_derived: FloatArray, r2: FloatArray, limits: Limits
) -> list[str]:
    """Problems with the elements of one estimate; both arrays have shape (n, n)."""
    problems = []
    for i, k in np.ndindex(r2.shape):
        element = f"{estimator}: element ({i + 1}, {k + 1})"
        if not coherence_derived[i, k] >= limits.coherence_derived:
            problems.append(
                f"{element} has a mean derived coherence of {coherence_derived[i, k]:.3g} "
                f"(limit {limits.coherence_derived:.3g})"
            )
        if not r2[i, k] >= limits.r2:
            problems.append(
                f"{element} does not look like M s² + B s + K: R² is {r2[i, k]:.3g} "
                f"(limit {limits.r2:.3g})"
            )
    return problems
