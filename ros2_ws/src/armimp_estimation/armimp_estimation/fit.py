"""Inertia, viscosity and stiffness from an impedance estimate, by weighted least squares.

Where it is uncertain when torques were read, a common delay d of all torques relative to the angles
is a parameter, too. To first order ``Z(ω) = Z_0(ω) (1 - jωd)``. Its part ``-jωd·(-Mω²) = jω³ M d``
is unlike any M, B and K, so the data determine d. They do not determine whether the whole torque is
late, or only the inertial part ``-Mω²``, which jumps with the commands. The two differ by
``jωd (K + jωB)``, which looks like viscosity and inertia. Half of that is corrected, half is the
standard error of the correction, in addition to the prior uncertainty of the reading instant.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain, product

import numpy as np

from armimp_common.arrays import ComplexArray, FloatArray
from armimp_common.errors import ConfigurationError
from armimp_estimation.estimators.estimate import ImpedanceEstimate
from armimp_estimation.json_model import JsonModel, Number
from armimp_estimation.mbk import MBK
from armimp_estimation.unfitted_terms import (
    errors_by_tension,
    hidden_terms,
    high_pass,
    squared_changes,
)
from armimp_estimation.weighted_fit import WeightedFit, lack_limit, lack_of_fit, r_squared, roots
from armimp_estimation.weights import real_sums, root_of

_REFUTED = 4.0
"""Standard errors by which a fitted delay refutes the prior."""
_BEYOND_CHANCE = 3.0
"""Standard errors from which on a single torque or angle seems late."""
_SUREST = 20e-6
"""Least standard error of the prior of the delay in that test, s."""
_LATEST = 0.02
"""Delay that no drive, filter or clock exceeds, s: what seems to be later is not a delay."""
_ITERATIONS = 3
_ORDERS = (2, 3, 4, 5)


@dataclass(frozen=True, kw_only=True)
class Calibration:
    """Calibration errors of torque transducers and encoders, the same for all joints.

    Parameters
    ----------
    gain : float
        Relative standard error of the gain of each torque transducer.
    cross_talk : float
        Standard error of the share of each other joint's torque that a transducer shows.
    angle : float
        Relative standard error of the scale of each encoder at the posture.
    linearity : float or None
        Standard error of each torque from hysteresis and all other nonlinearity of transducers,
        N·m; None if it is unknown, so that it has to be found from the records.
    assumed : bool
        Whether gain, cross-talk or angle was assumed, as it was not declared.

    Raises
    ------
    ConfigurationError
        If a standard error is negative, or a relative one is above 1.
    """

    gain: float = 0.0
    cross_talk: float = 0.0
    angle: float = 0.0
    linearity: float | None = None
    assumed: bool = False

    def __post_init__(self) -> None:
        for name in ("gain", "cross_talk", "angle"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise ConfigurationError(
                    f"uncertainty of {name} must be 0 to 1, got {getattr(self, name)!r}"
                )
        if self.linearity is not None and not 0.0 <= self.linearity < math.inf:
            raise ConfigurationError(
                f"uncertainty of linearity must not be negative, got {self.linearity!r}"
            )

    @classmethod
    def undeclared(cls) -> Calibration:
        """Values assumed for a laboratory: 1 % for gain and for cross-talk, 1.5 % for angles."""
        return cls(gain=0.01, cross_talk=0.01, angle=0.015, assumed=True)

    def shares(self, n: int) -> FloatArray:
        """Standard errors of the share of each torque that each transducer shows, (n, n)."""
        own = np.eye(n)
        return np.asarray(self.gain * own + self.cross_talk * (1.0 - own))

    def effects(self, Z: ComplexArray) -> tuple[ComplexArray, ...]:
        """Independent errors: ``g Z_ij`` and ``c Z_lj`` of a row i, ``a Z_ij`` of a column j.

        There is one for each gain, each joint l whose torque a transducer i may also show, and each
        scale of an encoder, which all torques have in common. No shape of Z over frequency reveals
        them, so they count in neither weights nor lack of fit.
        """
        own = np.eye(len(Z))[:, :, None, None]
        sizes = [self.gain] + [self.cross_talk] * (len(Z) - 1)
        rows = [size * own * np.roll(Z, -l, axis=0) for l, size in enumerate(sizes) if size > 0.0]
        columns = self.angle * np.swapaxes(own, 1, 2) * Z if self.angle > 0.0 else ()
        return (*chain(*rows), *columns)


class CommonDelay(JsonModel):
    """Common delay of all torques relative to the angles, beyond what the estimator knew of."""

    delay: Number
    """Delay that was corrected, s."""
    error: Number
    """Its standard error, s."""
    measured: Number
    """Delay that the data alone give, s."""
    measured_error: Number
    """Standard error of that, s."""
    refuted: bool = False
    """Whether that contradicts what was declared."""

    @property
    def held(self) -> float:
        """Share of a true delay that is left uncorrected, as the prior shrinks the fitted one."""
        if not self.error < self.measured_error:
            return 0.0
        return 1.0 - (self.error / self.measured_error) ** 2


@dataclass(frozen=True, kw_only=True, eq=False)
class MBKFit:
    """Fitted parameters, their standard errors and the quality of the fit.

    If only m of the n columns were estimated, m takes the place of the second n in all shapes.

    Attributes
    ----------
    values : ndarray, shape (3, n, n)
        M, B and K, in kg·m², N·m·s/rad and N·m/rad.
    r2 : ndarray, shape (n, n)
        Coefficient of determination, see :func:`armimp_estimation.weighted_fit.r_squared`.
    lack : ndarray, shape (n, n)
        Lack of fit, see :func:`armimp_estimation.weighted_fit.lack_of_fit`.
    lack_limit : float
        Lack of fit that chance alone does not exceed: 2, or more for few frequencies.
    delay : CommonDelay or None
        Delay that was fitted and corrected, if the estimate leaves it open.
    covariance : ndarray, shape (3n², 3n²)
        Covariance of all parameters: those of M row by row, then B, then K.
    high_pass : tuple of float
        Corner of a high-pass that torques passed and angles did not, and its standard error, Hz; to
        first order. The corner is negative if angles passed it.
    lateness : ndarray, shape (n, n)
        Delays, s, by which torques or angles seem late, though not all alike or not quite as delays
        make them; 0 where none is beyond what is unknown.
    functionals : ndarray, shape (n, n, 3, n_freq)
        Rows b of ``(M, B, K) = Re Σ_f conj(b_f) Z_f`` for each element.
    """

    values: FloatArray
    r2: FloatArray
    covariance: FloatArray
    lack: FloatArray
    lack_limit: float
    functionals: ComplexArray
    lateness: FloatArray
    delay: CommonDelay | None = None
    high_pass: tuple[float, float] = (0.0, math.inf)

    @cached_property
    def mbk(self) -> MBK:
        """The fitted matrices, of all n columns."""
        M, B, K = self.values
        return MBK(M=M, B=B, K=K)

    @property
    def of_form(self) -> bool:
        """Whether all elements are of the form M, B and K, beside noise."""
        return bool((self.lack <= self.lack_limit).all())

    @property
    def errors(self) -> FloatArray:
        """Their standard errors, SI units, shape (3, n, n)."""
        return roots(self.covariance).reshape(self.values.shape)

    @property
    def late(self) -> float:
        """Delay of the torques that was corrected, s; 0 if none was fitted."""
        return 0.0 if self.delay is None else self.delay.delay

    def of_row(self, joint: int, change: ComplexArray) -> FloatArray:
        """Change of M, B and K, (3, n), by a change of one row of the impedance, (n, n_freq)."""
        return np.asarray(real_sums(self.functionals[joint], change[:, None]).T)

    def with_doubts(self, shifts: Sequence[FloatArray]) -> MBKFit:
        """Return the fit with changes of M, B and K, (3, n, n), as further standard errors."""
        doubts = np.reshape(shifts, (-1, self.values.size))
        return replace(self, covariance=self.covariance + doubts.T @ doubts)


def fit_mbk(estimate: ImpedanceEstimate) -> MBKFit:
    """Fit ``Z_ij(jω) = K - M ω² + jω B`` to each element; see :func:`fit_impedance`."""
    return fit_impedance(estimate)[1]


def fit_impedance(
    estimate: ImpedanceEstimate,
    calibration: Calibration | None = None,
) -> tuple[ImpedanceEstimate, MBKFit]:
    """Fit ``Z_ij(jω) = K - M ω² + jω B`` to each element, and a delay that is common to all.

    The real part gives M and K, the imaginary part B, as in
    :mod:`armimp_estimation.weighted_fit`. The changes of M, B and K by further terms, such as s³
    (s = jω) or a soft cuff, are added to their errors as far as the data allow for them.

    Parameters
    ----------
    estimate : ImpedanceEstimate
        Impedance with variances; all of its frequencies are used. A delay is fitted if it has a
        ``delay_uncertainty``.
    calibration : Calibration, optional
        Calibration errors of the sensors; by default they are exact.

    Returns
    -------
    estimate : ImpedanceEstimate
        The estimate with the delay corrected, if there is one, and the calibration in its noise.
    fit : MBKFit

    Raises
    ------
    DataError
        If there are fewer than three frequencies, or a value or variance is not finite.
    """
    known = calibration or Calibration(linearity=0.0)
    problem, delay = _with_delay(WeightedFit(estimate=estimate))
    if estimate.covariance is not None:
        # The noise is that at the fitted impedance, which the first fit gives.
        late = 0.0 if delay is None else delay.delay
        fitted = problem.impedance(problem.values) * np.exp(-1j * problem.omega * late)
        estimate = estimate.with_noise_at(fitted)
        problem, delay = _with_delay(WeightedFit(estimate=estimate))
    effects = known.effects(estimate.Z)
    if delay is not None and estimate.friction_skew is not None:
        # Torques that are or may be late also jump differently, as behind slow drives.
        late = abs(delay.delay) or delay.error
        share = min(late / estimate.delay_unknown, 1.0)
        systematics = (*problem.estimate.systematics, share * estimate.friction_skew)
        problem = problem.corrected(problem.estimate.Z, systematics)
    problem = _with_bounds_told(problem)
    tension = errors_by_tension(problem)
    problem = problem.corrected(problem.estimate.Z, (*problem.estimate.systematics, *tension))
    found = replace(problem.estimate, bounded=0, delay_uncertainty=None)
    fitted = problem.impedance(problem.values)
    further, of_channels = squared_changes(problem, may_creep=known.linearity is None)
    lack, limit = lack_of_fit(found, fitted), lack_limit(found.bin_correlation)
    # What seems to be the delay of an arm of another form is mostly the arm's own.
    sought = delay is not None and bool((lack <= limit).all())
    every, clear = _lateness(problem) if sought else np.zeros((2, *lack.shape))
    fit = MBKFit(
        values=problem.values,
        r2=r_squared(found.Z, fitted),
        lack=lack,
        lack_limit=limit,
        delay=delay,
        lateness=clear,
        covariance=problem.covariance(effects) + np.diag(further.ravel()),
        high_pass=high_pass(problem, fitted),
        functionals=problem.functionals,
    )
    noise = found.noise + sum(np.abs(one) ** 2 for one in effects)
    noise += np.abs(problem.omega * every[..., None] * found.Z) ** 2
    if delay is not None and estimate.hold is None:
        # No jumps with commands tell whether the readings are late or the arm, as of soft tissue.
        noise += np.abs(problem.omega * delay.delay * found.Z) ** 2
    return replace(found, noise=noise, systematics=(*found.systematics, *of_channels)), fit


def _lateness(fit: WeightedFit) -> tuple[FloatArray, FloatArray]:
    """Delays of single torques (rows) or angles (columns), s, and those that stand out, (n, m)."""
    turned = -1j * fit.omega * fit.impedance(fit.values)
    unknown = fit.estimate.delay_uncertainty or 0.0
    every, clear = np.zeros((2, *fit.shape))
    for axis, size in enumerate(fit.shape):
        for place in range(size):
            of_one = np.expand_dims(np.eye(size)[place], (1 - axis, 2))
            value, error, _ = fit.common_coefficient(turned * of_one)
            late = abs(value) * of_one[..., 0]
            every = np.maximum(every, late)
            if abs(value) > max(unknown, _BEYOND_CHANCE * math.hypot(_SUREST, error)):
                clear = np.maximum(clear, late)
    return every, clear


def _with_bounds_told(fit: WeightedFit) -> WeightedFit:
    """Estimate the systematic errors that are bounds from the data, and correct them.

    Each has a known shape over frequency and an unknown size, 0 ± 1 before the data.
    """
    Z, known, bounded = fit.estimate.Z, fit.estimate.systematics, fit.estimate.bounded
    if not bounded:
        return fit
    terms, others = np.stack(known[:bounded]), known[bounded:]
    found, covariance = fit.corrected(Z, others).common_coefficients(terms, np.zeros(bounded))
    errors = np.tensordot(root_of(covariance).T, terms, axes=1)
    return fit.corrected(Z - np.tensordot(found, terms, axes=1), (*errors, *others))


def _with_delay(problem: WeightedFit) -> tuple[WeightedFit, CommonDelay | None]:
    """Fit a common delay and correct it, if the estimate leaves it open."""
    estimate, turning = problem.estimate, 1j * problem.omega
    uncertainty, unknown = estimate.delay_uncertainty, estimate.delay_unknown
    if uncertainty is None:
        return problem, None
    total, measured_error, apart = 0.0, math.inf, 0.0
    trial = problem
    for _ in range(_ITERATIONS):
        # For each element, Z = fit - d jω fit is solved for d by weighted least squares.
        turned = -turning * trial.impedance(trial.values)
        step, measured_error, apart = trial.common_coefficient(turned)
        total = float(np.clip(total + step, -_LATEST, _LATEST))
        trial = problem.corrected(estimate.Z * np.exp(turning * total), estimate.systematics)
    # Torques that jump with their commands are read within the period: what then seems later than
    # that against the angles is the arm's own, as of soft tissue.
    late = total > unknown + _REFUTED * measured_error and estimate.hold is not None
    fits = trial.roughly_fits(trial.values) and not late
    sure = max(uncertainty, _SUREST)
    refuted = fits and abs(total) > _REFUTED * math.hypot(sure, measured_error)
    assumed = max(uncertainty, unknown) if refuted else uncertainty
    # Unless the arm is of the form M, B and K, what looks like a delay may be the arm's own.
    identified = fits and assumed > 0.0
    delay = total * assumed**2 / (assumed**2 + measured_error**2) if identified else 0.0
    values = trial.values if fits else problem.values
    steady, inertial = (
        problem.impedance(values * np.reshape(parts, (3, 1, 1)))
        for parts in ((0.0, 1.0, 1.0), (1.0, 0.0, 0.0))
    )
    turned = estimate.Z * np.exp(turning * delay)
    doubt = 0.5 * delay * turning * steady
    # The delay of B and K keeps its prior uncertainty, whatever the data show of the inertial part.
    prior = assumed * turning * steady
    # A first-order low-pass is exp(-sd + (sd)²/2 - (sd)³/3 ...); others have less of each term.
    filtered = [(delay * turning) ** order / order * inertial for order in _ORDERS if delay]
    # In mid-period, torques that jump and angles that do not differ by (ωL)²/24 of the inertia.
    jumping = (assumed * turning) ** 2 / 6.0 * inertial
    terms = np.stack([assumed * turning * turned, jumping, *filtered])
    # Each transducer may have a delay of its own, or seem to, as with hysteresis.
    single = (min(apart, assumed) * turning * turned,) if identified else ()
    trial = problem.corrected(turned - doubt, (*estimate.systematics, *single, doubt, prior))
    found, covariance = np.zeros(len(terms)), np.eye(len(terms))
    if identified:
        own = problem.own
        every = [
            term
            for first, *others in hidden_terms(problem, values)
            for term in (*first, *(one[0] for one in others))
        ]
        alike = np.zeros((len(every) * len(own), *turned.shape), dtype=np.complex128)
        for place, (term, row) in enumerate(product(every, own)):
            alike[place][row] = term[row]
        expected = np.zeros(len(terms) + len(alike))
        expected[0] = 0.0 if refuted else delay / assumed
        found, _ = trial.common_coefficients(terms, expected[: len(terms)])
        # A reflex or a relaxing spring may look like a delay. Most arms have little of it, so it
        # counts in the errors, not in the estimate.
        beside, covariance = trial.common_coefficients(np.concatenate((terms, alike)), expected)
        change = beside[: len(terms)] - found
        covariance = covariance[: len(terms), : len(terms)] + np.outer(change, change)
    known = CommonDelay(
        delay=delay - assumed * found[0],
        error=assumed * math.sqrt(covariance[0, 0]),
        measured=total,
        measured_error=measured_error,
        refuted=refuted,
    )
    errors = np.tensordot(root_of(covariance).T, terms, axes=1)
    Z = trial.estimate.Z - np.tensordot(found, terms, axes=1)
    return trial.corrected(Z, (*trial.estimate.systematics, *errors)), known
