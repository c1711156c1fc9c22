"""Errors of an estimator in one run, and in one condition over all seeds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armimp_bringup.offline import SimulatedExperiment
from armimp_common.arrays import BoolArray, FloatArray
from armimp_estimation.estimators.estimate import ImpedanceEstimate
from armimp_estimation.fit import fit_mbk
from armimp_estimation.mbk import MBK
from research.decomposition_statistics import (
    Mean,
    octave_errors,
    root_mean_square,
)
from research.decomposition_trials import Run, relative_errors


@dataclass(frozen=True, kw_only=True, eq=False)
class Outcome:
    """Errors of one estimator in one run."""

    voluntary: float
    correlation: float | None
    estimator: str
    seed: int
    """Which run it is; the correlation is None for trials joint by joint."""
    errors: FloatArray
    """(3, n, n) of M, B and K, relative to ``sqrt(|X_ii X_jj|)``."""
    standard_errors: FloatArray
    """(3, n, n) that the estimator itself states, on the same scale."""
    octaves: NDArray[np.complex128]
    """(n, n, octaves) of Z, relative to each true value."""
    estimate: ImpedanceEstimate
    truth: MBK
    """Estimate of Z, and true M, B and K."""
    coherence: float
    inflation: float
    condition: float
    """Coupling of the inputs: band means of the largest coherence and variance inflation, and the
    worst condition number; NaN joint by joint."""

    @classmethod
    def of(
        cls, experiment: SimulatedExperiment, run: Run, voluntary: float, correlation: float | None
    ) -> Outcome:
        """Return what is kept of a run."""
        errors, stated = relative_errors(run.fit, experiment.truth)
        coherence, inflation, condition = np.nan, np.nan, np.nan
        if run.coupling is not None:
            n = experiment.truth.joints
            pairs = run.coupling.coherence[~np.eye(n, dtype=bool)]
            coherence = float(np.mean(np.max(pairs, axis=0)))
            inflation = float(np.mean(np.max(run.coupling.inflation, axis=0)))
            condition = float(np.max(run.coupling.condition))
        return cls(
            voluntary=voluntary,
            correlation=correlation,
            estimator=run.estimator,
            seed=run.seed,
            errors=errors,
            standard_errors=stated,
            octaves=octave_errors(run.estimate, experiment.truth),
            estimate=run.estimate,
            truth=experiment.truth,
            coherence=coherence,
            inflation=inflation,
            condition=condition,
        )

    def errors_weighted_as(self, other: Outcome) -> FloatArray:
        """Errors of M, B and K if fitted with the variances, and so weights, of another outcome."""
        ours, given = self.estimate, other.estimate
        # Each estimate leaves out frequencies at which motion doesn't exceed the noise.
        ours, given = _common(ours, given), _common(given, ours)
        # Without the fields from which the fit would recompute the noise.
        alike = replace(
            ours,
            noise=given.noise,
            systematics=given.systematics,
            covariance=None,
            disturbance=None,
            inverse=None,
        )
        return relative_errors(fit_mbk(alike), self.truth)[0]


def _common(estimate: ImpedanceEstimate, other: ImpedanceEstimate) -> ImpedanceEstimate:
    """Restrict an estimate to the frequencies that another one has, too.

    Frequencies on either side of a gap count as neighbours.
    """
    kept = np.isin(estimate.f, other.f)
    cut: dict[str, Any] = {
        field.name: value[..., kept]
        for field in fields(estimate)
        if isinstance(value := getattr(estimate, field.name), np.ndarray)
    }
    systematics = tuple(one[..., kept] for one in estimate.systematics)
    return replace(estimate, systematics=systematics, **cut)


@dataclass(frozen=True, kw_only=True, eq=False)
class Cell:
    """One estimator in one condition, over all seeds."""

    voluntary: float
    correlation: float | None
    estimator: str
    total: Mean
    """Errors of M, B and K."""
    shift: Mean | None
    """What voluntary torque adds to them, run by run: errors minus those without it at the same
    seed, and so with the same perturbation, and with equal weights; None without such runs."""
    reweighted: Mean | None
    """What it adds through the weights of the fit alone, which shift to where it is weak: errors of
    the runs without it, fitted with the weights of the runs with it, minus their own errors."""
    octaves: Mean
    octaves_shift: Mean | None
    """Likewise for Z, with real and imaginary parts stacked as first axis."""
    stated: FloatArray
    """(3, n, n) root mean square of the standard errors that the estimator states."""
    coherence: float
    inflation: float
    condition: float
    """Means of those of :class:`Outcome`; the worst for the condition number."""

    @property
    def biased(self) -> bool:
        """Whether voluntary torque shifts M, B, K or Z by more than chance."""
        shifts = (self.shift, self.octaves_shift)
        return any(one is not None and one.significant for one in shifts)

    @classmethod
    def of(cls, outcomes: Sequence[Outcome], reference: Sequence[Outcome] | None) -> Cell:
        """Combine outcomes of all seeds with those without voluntary torque, in the same order."""
        errors = np.array([one.errors for one in outcomes])
        known = [np.isfinite(one.octaves[0, 0]) for one in (*outcomes, *(reference or ()))]
        covered = np.all(known, axis=0)
        octaves = np.array([_parts(one, covered) for one in outcomes])
        shift, reweighted, octaves_shift = None, None, None
        if reference is not None:
            alike = np.array(
                [b.errors_weighted_as(a) for a, b in zip(outcomes, reference, strict=True)]
            )
            shift = Mean.of(errors - alike)
            reweighted = Mean.of(alike - np.array([one.errors for one in reference]))
            octaves_shift = Mean.of(octaves - np.array([_parts(one, covered) for one in reference]))
        first = outcomes[0]
        return cls(
            voluntary=first.voluntary,
            correlation=first.correlation,
            estimator=first.estimator,
            total=Mean.of(errors),
            shift=shift,
            reweighted=reweighted,
            octaves=Mean.of(octaves),
            octaves_shift=octaves_shift,
            stated=root_mean_square(np.array([o.standard_errors for o in outcomes]), (0,)),
            coherence=float(np.mean([one.coherence for one in outcomes])),
            inflation=float(np.mean([one.inflation for one in outcomes])),
            condition=float(np.max([one.condition for one in outcomes])),
        )

    def described(self) -> dict[str, Any]:
        """As it stands in the JSON file; errors in %."""
        return {
            "estimator": self.estimator,
            "voluntary_rms": self.voluntary,
            "correlation": self.correlation,
            "runs": self.total.runs,
            "errors": _described(self.total),
            "shift": _described(self.shift),
            "reweighted": _described(self.reweighted),
            "stated_standard_error": (100.0 * self.stated).tolist(),
            "octaves": _described(self.octaves),
            "octaves_shift": _described(self.octaves_shift),
            "biased_by_voluntary_torque": None if self.shift is None else self.biased,
            "input_coherence": self.coherence,
            "variance_inflation": self.inflation,
            "worst_condition_number": self.condition,
        }


def _parts(outcome: Outcome, covered: BoolArray) -> FloatArray:
    """Real and imaginary parts of the errors of Z in `covered` octaves; (2, n, n, octaves)."""
    octaves = outcome.octaves[..., covered]
    return np.stack((octaves.real, octaves.imag))


def _described(mean: Mean | None) -> dict[str, Any] | None:
    if mean is None:
        return None
    return {
        "bias": (100.0 * mean.bias).tolist(),
        "uncertainty": (100.0 * mean.uncertainty).tolist(),
        "spread": (100.0 * mean.spread).tolist(),
        "z": mean.z.tolist(),
        "critical_z": mean.critical,
        "significant": mean.significant,
    }
