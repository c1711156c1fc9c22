"""How accurate each element is, beside its size and what the transducers can resolve of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from armimp_bringup.study.entry import StudyEntry
from armimp_bringup.study.verdict import Quantity, relative_error, scaled_error, targets
from armimp_estimation.mbk import MBK
from armimp_estimation.report.result import setting

FloatArray = NDArray[np.float64]

LETTERS: Final = ("M", "B", "K")
_QUANTILE: Final = 1.96
_BAND: Final = (0.122, 15.0)  # Hz
_Error: TypeAlias = Callable[[StudyEntry, str, str, int, int], float]


@dataclass(frozen=True, kw_only=True, eq=False)
class ElementErrors:
    """Errors of one matrix by one estimator.

    Attributes
    ----------
    letter : str
        M, B or K.
    true : ndarray, shape (n, n)
        True values, SI units.
    size : ndarray, shape (n, n)
        ``|X_ij| / sqrt(|X_ii X_jj|)``, %.
    relative, scaled : ndarray, shape (n, n)
        Largest error of all conditions without its sign, %.
    covered : float
        Share of all errors that are within 1.96 standard errors.
    yardstick : float
        Relative error that is allowed with two joints, %; NaN for estimators without targets.
    """

    letter: str
    true: FloatArray
    size: FloatArray
    relative: FloatArray
    scaled: FloatArray
    covered: float
    yardstick: float

    @property
    def beyond(self) -> NDArray[np.bool_]:
        """Elements whose relative error is larger than the yardstick."""
        return ~(self.relative <= self.yardstick)


def element_errors(
    entries: Sequence[StudyEntry], estimator: str, letter: str
) -> ElementErrors | None:
    """Errors of a matrix over all conditions; None without a truth."""
    truth = entries[0].truth
    if truth is None:
        return None
    n = entries[0].joints
    true = np.array(getattr(truth, letter), dtype=np.float64)
    diagonal = np.abs(np.diag(true))
    with np.errstate(divide="ignore", invalid="ignore"):
        size = 100.0 * np.abs(true) / np.sqrt(np.outer(diagonal, diagonal))
    found = np.array([getattr(e.estimators[estimator], letter) for e in entries])
    errors = np.array([getattr(e.estimators[estimator], f"{letter}_se") for e in entries])
    quantity: Quantity = "B error" if letter == "B" else "M, K error"
    return ElementErrors(
        letter=letter,
        true=true,
        size=size,
        relative=_largest(entries, estimator, letter, relative_error, n),
        scaled=_largest(entries, estimator, letter, scaled_error, n),
        covered=float(np.mean(np.abs(found - true) <= _QUANTILE * errors)),
        yardstick=targets(2).get(estimator, {}).get(quantity, np.nan),
    )


def inertia_vaf(truth: MBK) -> FloatArray:
    """VAF of an estimate that has the true M but neither B nor K, over the band of the study, %.

    Returns
    -------
    ndarray, shape (n, n)
        NaN where an element of the impedance is zero.
    """
    f = np.linspace(*_BAND, 200)
    whole = truth.impedance(f)
    nothing = np.zeros_like(truth.M)
    left = whole - MBK(M=truth.M, B=nothing, K=nothing).impedance(f)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.sum(np.abs(left) ** 2, axis=2) / np.sum(np.abs(whole) ** 2, axis=2)
    return np.asarray(100.0 * (1.0 - share), dtype=np.float64)


def _largest(
    entries: Sequence[StudyEntry], estimator: str, letter: str, error: _Error, n: int
) -> FloatArray:
    return np.array(
        [
            [max(abs(error(e, estimator, letter, i, k)) for e in entries) for k in range(n)]
            for i in range(n)
        ]
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Resolvable:
    """What the torque transducers can see in the least favourable condition of a study.

    Attributes
    ----------
    count : float
        Resolution of the transducers, N·m.
    peak : ndarray, shape (n,)
        Of the perturbations, N·m.
    stiffness_torque : ndarray, shape (n, n)
        Largest static torque that ``K_ik`` can make: the perturbed joint k gives way by no more
        than ``peak_k / (K_rd,k + K_kk)`` then; N·m.
    """

    count: float
    peak: FloatArray
    stiffness_torque: FloatArray


def resolvable(entries: Sequence[StudyEntry]) -> Resolvable | None:
    """Torques beside the resolution, at the smallest perturbation and the coarsest resolution.

    None if the study has no quantised torque, or its configuration does not tell.
    """
    entry = max(entries, key=lambda one: (one.resolution, -one.perturbation))
    count = setting(entry.config, "arm_sim", "sensors.torque_resolution")
    peak = setting(entry.config, "imbic_controller", "perturbation.peak")
    target = setting(entry.config, "imbic_controller", "target.stiffness")
    if entry.truth is None or not isinstance(count, float) or count <= 0.0:
        return None
    if not (isinstance(peak, list) and isinstance(target, list)):
        return None
    stiffness = np.array(entry.truth.K, dtype=np.float64)
    peaks = np.array(peak, dtype=np.float64)
    deflection = peaks / (np.array(target, dtype=np.float64) + np.diag(stiffness))
    return Resolvable(
        count=count, peak=peaks, stiffness_torque=np.abs(stiffness) * np.abs(deflection)
    )
