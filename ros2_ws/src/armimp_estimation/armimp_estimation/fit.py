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
from functools import cached_property, partial
from itertools import chain, product

import numpy as np
from scipy.special import log_ndtr, softmax

from armimp_common.arrays import BoolArray, ComplexArray, FloatArray
from armimp_common.errors import ConfigurationError, DataError
from armimp_estimation.estimators.estimate import ImpedanceEstimate
from armimp_estimation.json_model import JsonModel, Number
from armimp_estimation.mbk import MBK
from armimp_estimation.spectra import Values, sums_within


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
    told: Number
    """What the data alone tell, s."""
    told_error: Number
    """Standard error of that, s."""
    refuted: bool = False
    """Whether that contradicts what was declared."""

    @property
    def held(self) -> float:
        """Share of a true delay that is left uncorrected, as the prior shrinks the fitted one."""
        if not self.error < self.told_error:
            return 0.0
        return 1.0 - (self.error / self.told_error) ** 2


@dataclass(frozen=True, kw_only=True, eq=False)
class MBKFit:
    """Fitted parameters, their standard errors and the quality of the fit.

    Attributes
    ----------
    mbk : MBK
        Fitted matrices, in kg·m², N·m·s/rad and N·m/rad.
    r2 : ndarray, shape (n, n)
        Coefficient of determination, see :func:`r_squared`.
    lack : ndarray, shape (n, n)
        Lack of fit, see :func:`lack_of_fit`.
    lack_limit : float
        Lack of fit that chance alone does not exceed: 2, or more for few frequencies.
    delay : CommonDelay or None
        Delay that was fitted and corrected, if the estimate leaves it open.
    covariance : ndarray, shape (3n², 3n²)
        Covariance of all parameters: those of M row by row, then B, then K.
    high_pass : tuple of float
        Corner of a high-pass that torques passed and angles did not, and its standard error, Hz; to
        first order. The corner is negative if angles passed it.
    functionals : ndarray, shape (n, n, 3, n_freq)
        Rows b of ``(M, B, K) = Re Σ_f conj(b_f) Z_f`` for each element.
    """

    mbk: MBK
    r2: FloatArray
    covariance: FloatArray
    lack: FloatArray
    lack_limit: float
    functionals: ComplexArray
    delay: CommonDelay | None = None
    high_pass: tuple[float, float] = (0.0, math.inf)

    @property
    def values(self) -> FloatArray:
        """M, B and K, SI units, shape (3, n, n)."""
        return np.stack((self.mbk.M, self.mbk.B, self.mbk.K))

    @property
    def errors(self) -> FloatArray:
        """Their standard errors, SI units, shape (3, n, n)."""
        return _roots(self.covariance).reshape(self.values.shape)

    def of_row(self, joint: int, change: ComplexArray) -> FloatArray:
        """Change of M, B and K, (3, n), by a change of one row of the impedance, (n, n_freq)."""
        return np.asarray(_sums(self.functionals[joint], change[:, None]).T)

    def with_doubt(self, shift: FloatArray) -> MBKFit:
        """Return the fit with a change of M, B and K, (3, n, n), as one more standard error."""
        return replace(self, covariance=self.covariance + np.outer(shift, shift))


FEWEST_FREQUENCIES = 3
_SMOOTHING = 0.3
"""Half width of the band over which variances are averaged before they serve as weights, Hz."""
LACK_LIMIT = 2.0
"""Lack of fit beyond which an impedance is not of the fitted form; ideal runs stay below 1.5."""
_LACK_CHANCE = 5.0
_REFUTED = 4.0
"""Standard errors by which a fitted delay refutes the prior."""
_SUREST = 20e-6
"""Least standard error of the prior of the delay in that test, s."""
_SUREST_SHARE = 1e-6
"""Least standard error that data give a coefficient, relative to its prior one."""
_NOTICED = 2.0
_MOST_CUFFS = 8
"""Most joints for which cuffs and reflexes are looked for: the time goes with the third power."""
_LIKELY, _SOFT = 0.3, 0.2
"""Assumption: prior probabilities that an element has a reflex of either kind or a spring that
relaxes, and that a joint has a soft cuff."""
_RARE = 0.01
"""Probability at which a reflex or a relaxing spring is too rare to change a 95 % interval."""
_REFLEX = 0.5
"""Assumption: velocity gain that a reflex of an element may have, relative to its B."""
_ARCS = ((0.04, 30.0), (0.03, 50.0), (0.06, 50.0))
"""Assumption: delays of reflexes, s, and corners of their muscles, rad/s: as in Kearney, Stein &
Parameswaran (1997), and for velocity reflexes a quicker and a later one, too."""
_STRETCH, _LEAD = 0.3, 20.0
"""Assumption: stretch gain of a reflex, relative to K, and relative to its velocity gain, 1/s."""
_RELAXED, _RELAXATIONS = 0.4, (0.05, 0.3)
"""Assumption: stiffness of a relaxing spring beside K, relative to K, and its time constants, s."""
_MODE = 0.1
_MODES, _DAMPED, _PARTS = (1.8, 2.5, 3.5, 5.0, 7.0, 10.0), (0.2, 0.5, 1.0), (0.02, 0.06, 0.2)
"""Assumption: prior probability that an arm has a second mode, as of a hand that nobody strapped or
of soft tissue; its natural frequency, Hz, damping ratio and share of the inertia."""
_CUFF = 1e-5
"""Assumption: compliance that a cuff between robot and arm may have, rad/(N·m)."""
_COUPLED, _CORNERS = 0.5, (0.3, 1.0)
"""Assumption: prior probability that a torque or angle without slow motion passed a high-pass, and
corners of that, Hz."""
_CREEPING, _CREEPS = 0.2, (0.05, 0.3)
_CREEP = (0.02, 0.06, 0.2, -0.02, -0.06)
"""Assumption: prior probability that a transducer of undeclared linearity creeps, time constants of
that, s, and shares of the torque."""
_LOW, _FEWEST = 1.0 / 3.0, 8
"""Lowest part of the band that is fitted alone for comparison, as a share, and its fewest bins."""
_ITERATIONS = 3
_ORDERS = (2, 3, 4, 5)
_SINGULAR = 1e-10
_ROUNDING = 1e-9
_EXACT = 2e-3
"""Relative error that any estimate has even without noise."""


def r_squared(values: ComplexArray, fitted: ComplexArray) -> float:
    """Coefficient of determination of a complex fit.

    Real and imaginary parts are stacked into one real vector y of twice the length:
    ``R² = 1 - Σ (y - ŷ)² / Σ (y - mean(y))²``, unweighted, with one mean for the stacked vector.

    Parameters
    ----------
    values, fitted : ndarray, shape (n_freq,)
        Estimated and fitted values.
    """
    y = _stacked(values)
    residual = y - _stacked(fitted)
    total = float(np.sum((y - y.mean()) ** 2))
    return 1.0 - float(np.sum(residual**2)) / total if total > 0.0 else math.nan


def lack_limit(correlation: FloatArray) -> float:
    """Lack of fit that chance does not reach: 2, or 5 standard deviations above 1 for few bins.

    The mean of F values of ``|e|²/variance`` scatters by ``sqrt(Σ ρ²)/F``, summed over all pairs,
    with the correlation ρ, (lags, F), of the errors of each bin and those above it.
    """
    return max(LACK_LIMIT, 1.0 + _LACK_CHANCE * spread_of_mean(correlation))


def spread_of_mean(correlation: FloatArray) -> float:
    """Standard deviation of the mean of F correlated powers, relative to that of one power."""
    frequencies = int(correlation.shape[1])
    return math.sqrt(frequencies + 2.0 * float(np.sum(correlation[1:] ** 2))) / frequencies


def fit_mbk(estimate: ImpedanceEstimate) -> MBKFit:
    """Fit ``Z_ij(jω) = K - M ω² + jω B`` to each element; see :func:`fit_impedance`."""
    return fit_impedance(estimate)[1]


def fit_impedance(
    estimate: ImpedanceEstimate,
    calibration: Calibration | None = None,
) -> tuple[ImpedanceEstimate, MBKFit]:
    """Fit ``Z_ij(jω) = K - M ω² + jω B`` to each element, and a delay that is common to all.

    The real part gives M and K, the imaginary part B. Weights are inverse variances, smoothed and
    limited as in :func:`fit_weights`. Each parameter is then a sum ``Re Σ_f conj(b_f) Z_f``. So for
    any weights its variance is the sandwich ``½ Re Σ_fg conj(b_f) b_g σ_f σ_g ρ_fg``, with half of
    the complex variance for either part, and the correlation ρ of the errors of neighbouring
    frequencies. The error of a correction, which is the same at all frequencies, adds the square of
    ``Re Σ_f conj(b_f) δ_f`` with its standard error δ. The changes of M, B and K by further terms,
    such as s³ (s = jω) or a soft cuff, are added, too, as far as the data allow for them.

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
        The estimate with the delay corrected, if there is one, and the calibration in its variance.
    fit : MBKFit

    Raises
    ------
    DataError
        If there are fewer than three frequencies, or a value or variance is not finite.
    """
    n = estimate.joints
    problem = _Elements.of(estimate.with_noise_at(_first_fit(estimate)))
    if calibration is not None:
        effects = calibration.effects(problem.estimate.Z)
        problem = replace(
            problem,
            calibration=tuple(map(_flat, effects)),
            may_creep=calibration.linearity is None,
        )
    problem, delay = _with_delay(problem)
    if delay is not None and estimate.friction_skew is not None:
        # Torques that are or may be late also jump differently, as behind slow drives.
        late = abs(delay.delay) or delay.error
        share = min(late / estimate.delay_unknown, 1.0)
        doubt = _flat(share * estimate.friction_skew)
        problem = replace(problem, systematics=(*problem.systematics, doubt))
    problem = problem.with_bounds_told()
    estimate = problem.corrected
    M, B, K = problem.values().reshape(3, n, n)
    mbk = MBK(M=M, B=B, K=K)
    fitted = mbk.impedance(estimate.f)
    lack = lack_of_fit(estimate, fitted)
    if problem.calibration:
        known = sum(np.abs(one) ** 2 for one in problem.calibration)
        estimate = replace(estimate, variance=estimate.variance + np.reshape(known, fitted.shape))
    quality = [[r_squared(estimate.Z[i, j], fitted[i, j]) for j in range(n)] for i in range(n)]
    fit = MBKFit(
        mbk=mbk,
        r2=np.array(quality),
        lack=lack,
        lack_limit=lack_limit(estimate.bin_correlation),
        delay=delay,
        covariance=problem.covariance(),
        high_pass=problem.high_pass(fitted),
        functionals=problem.functionals.reshape(n, n, 3, -1),
    )
    return estimate, fit


def _first_fit(estimate: ImpedanceEstimate) -> ComplexArray:
    """Fitted impedance of M, B, K and a delay, with the noise taken at the estimated impedance."""
    problem, delay = _with_delay(_Elements.of(estimate))
    late = 0.0 if delay is None else delay.delay
    fitted = _of_mbk(problem.values(), problem.omega) * np.exp(-1j * problem.omega * late)
    return np.asarray(fitted.reshape(estimate.Z.shape))


def fit_columns(estimate: ImpedanceEstimate) -> tuple[FloatArray, FloatArray]:
    """Fit the elements of some columns as :func:`fit_impedance` fits those of a matrix.

    Parameters
    ----------
    estimate : ImpedanceEstimate
        Estimate with an impedance of the shape (n, m, n_freq).

    Returns
    -------
    values, errors : ndarray, shape (3, n, m)
        M, B and K of each element, and their standard errors, SI units.

    Raises
    ------
    DataError
        As :func:`fit_impedance`.
    """
    problem, _ = _with_delay(_Elements.of(estimate))
    shape = (3, *estimate.Z.shape[:2])
    return problem.values().reshape(shape), _roots(problem.covariance()).reshape(shape)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Elements:
    """Elements of an impedance, row by row and all fitted alike; arrays (elements, n_freq)."""

    estimate: ImpedanceEstimate
    """Source of the elements, for everything that corrections do not change."""
    Z: ComplexArray
    noise: FloatArray
    """Variance without that of the corrections."""
    systematics: tuple[ComplexArray, ...]
    calibration: tuple[ComplexArray, ...] = ()
    may_creep: bool = False
    """Whether transducers may show more of a torque the longer it lasts."""

    @classmethod
    def of(cls, estimate: ImpedanceEstimate) -> _Elements:
        """Take the elements of an estimate."""
        if estimate.f.size < FEWEST_FREQUENCIES:
            raise DataError(f"{estimate.f.size} frequencies are too few to fit M, B and K")
        if not (np.isfinite(estimate.Z).all() and np.isfinite(estimate.variance).all()):
            raise DataError(f"{estimate.name}: impedance or its variance is not finite")
        return cls(
            estimate=estimate,
            Z=_flat(estimate.Z),
            noise=_flat(estimate.noise),
            systematics=tuple(map(_flat, estimate.systematics)),
        )

    @property
    def corrected(self) -> ImpedanceEstimate:
        """The estimate with all corrections and their variance."""
        shape = self.estimate.Z.shape
        return replace(
            self.estimate,
            Z=self.Z.reshape(shape),
            variance=self.total.reshape(shape),
            systematics=tuple(one.reshape(shape) for one in self.systematics),
            bounded=0,
            delay_uncertainty=None,
        )

    @property
    def omega(self) -> FloatArray:
        return 2.0 * np.pi * self.estimate.f

    @property
    def own(self) -> list[int]:
        """Indices of the elements from a perturbed joint's angle to the torque of that joint."""
        _, columns, _ = self.estimate.Z.shape
        perturbed = self.estimate.perturbed or range(columns)
        return [joint * columns + column for column, joint in enumerate(perturbed)]

    @property
    def pairs(self) -> list[tuple[int, int]]:
        """Indices of each element, and of the own element of the joint of its column."""
        columns = self.estimate.Z.shape[1]
        return [
            (row, own) for own in self.own for row in range(own % columns, len(self.Z), columns)
        ]

    @property
    def total(self) -> FloatArray:
        """Variance including that of the corrections."""
        return np.asarray(self.noise + sum(np.abs(one) ** 2 for one in self.systematics))

    @cached_property
    def weights(self) -> FloatArray:
        """Weights of the frequencies in the fit of each element."""
        estimate = self.estimate
        power = _flat(np.broadcast_to(estimate.power, estimate.Z.shape))
        return fit_weights(estimate.f, self.Z, self.total, estimate.weight_floor, power)

    @cached_property
    def functionals(self) -> ComplexArray:
        """Rows b of ``(M, B, K) = Re Σ_f conj(b_f) Z_f``, (elements, 3, n_freq)."""
        return np.stack([_mbk_functionals(self.omega, weights) for weights in self.weights])

    def values(self) -> FloatArray:
        """M, B and K, (3, elements)."""
        return self.shifts(self.Z)

    def shifts(self, terms: ComplexArray) -> FloatArray:
        """Contribution of terms (elements, n_freq) to M, B and K, (3, elements)."""
        return np.asarray(_sums(self.functionals, terms[:, None]).T)

    def covariance_of(self, functionals: ComplexArray, row: int) -> FloatArray:
        """Covariance, (p, p), of ``Re Σ_f conj(b_f) Z_f`` for functionals b, (p, n_freq)."""
        spread = functionals * np.sqrt(self.noise[row])
        covariance = covariance_of_sums(spread, self.estimate.bin_correlation)
        for systematic in self.systematics:
            shift = _sums(functionals, systematic[row])
            covariance = covariance + np.outer(shift, shift)
        return covariance

    def covariance(self) -> FloatArray:
        """Covariance of all M, then B, then K, (3 elements, 3 elements): the sum of all errors.

        The error of a correction is that of one transducer, so it is common to a row; a calibration
        error is common to all elements that it concerns. Further terms may be in any element.
        """
        (n, columns, _), count = self.estimate.Z.shape, len(self.Z)
        rows = np.arange(count) // columns
        common = [self.shifts(one) for one in self.calibration]
        for shift in map(self.shifts, self.systematics):
            common += [shift * (rows == row) for row in range(n)]
        known = np.reshape(common, (-1, 3 * count))
        further = np.diag(self._squared_change_by_more_terms().ravel())
        return np.asarray(self._covariance_by_noise() + known.T @ known + further)

    def _covariance_by_noise(self) -> FloatArray:
        """Part of noise: ``½ Re Σ_fg conj(b_f) c_g σ_f ς_g ρ_fg (κ_f + κ_g)/2`` of two elements.

        κ is their coherency. Without covariances in the estimate, elements count as independent.
        """
        count = len(self.Z)
        terms = self.functionals * np.sqrt(0.5 * self.noise)[:, None]
        spread = with_neighbours(terms, self.estimate.bin_correlation)
        covariance = np.zeros((3, count, 3, count))
        for one in range(count):
            for other in range(one, count):
                kappa = self._coherency(one, other)
                a, b = np.conj(terms[one]) * kappa, np.conj(spread[one]) * kappa
                block = 0.5 * (a @ spread[other].T + b @ terms[other].T).real
                covariance[:, one, :, other] = block
                covariance[:, other, :, one] = block.T
        return covariance.reshape(3 * count, 3 * count)

    def _coherency(self, one: int, other: int) -> ComplexArray:
        """Complex correlation of the errors of two elements at each frequency."""
        disturbance, inverse = self.estimate.disturbance, self.estimate.inverse
        if one == other:
            return np.ones(self.omega.size, dtype=np.complex128)
        if disturbance is None or inverse is None:
            return np.zeros(self.omega.size, dtype=np.complex128)
        (i, j), (m, l) = (divmod(place, self.estimate.Z.shape[1]) for place in (one, other))
        shared = np.sum(disturbance[:, i, m] * inverse[:, j] * np.conj(inverse[:, l]), axis=0)
        size = np.sqrt(self.noise[one]) * np.sqrt(self.noise[other])
        return np.asarray(np.divide(shared, size, out=np.zeros_like(shared), where=size > 0.0))

    def _squared_change_by_more_terms(self) -> FloatArray:
        """Squared change of M, B, K, (3, elements), by ``c s³``, ``c s⁴``, cuffs and hidden terms.

        Viscosity and stiffness show at low frequencies. Anything else at the upper end of the band
        shows in their difference from those of the lowest third alone (Hausman, *Econometrica* 46,
        1978). A cuff of the compliance c between robot and arm at joint l takes ``c Z_il Z_lj``
        off, and a first-order high-pass with the corner c, which torques passed and angles did not,
        about ``c Z_ij/s``. Resonances of transducers and encoders far above the band change Z by a
        share in proportion to s². These three have one coefficient in all elements, so they count
        also in elements where noise hides them.
        """
        plain = self.values()
        squares = np.zeros_like(plain)
        relative = self.omega / self.omega[-1]
        for term in (-1j * relative**3, relative**4 + 0j):
            terms: ComplexArray = np.broadcast_to(term, self.Z.shape)
            noticed = [_noticed(*one) for one in self.coefficients_of(terms)]
            squares += noticed * self.shifts(terms) ** 2
        low = relative <= _LOW
        if np.count_nonzero(low) >= _FEWEST:
            for row in range(len(self.Z)):
                of_low = _mbk_functionals(self.omega, self.weights[row] * low)
                apart = self.functionals[row] - of_low
                values, variances = _sums(apart, self.Z[row]), self.covariance_of(apart, row)
                for place in (1, 2):
                    error = math.sqrt(max(variances[place, place], 0.0))
                    squares[place, row] += _noticed(values[place], error)
        (n, columns, _), hidden = self.estimate.Z.shape, self._change_by_hidden(plain)
        hidden = np.maximum(hidden, self._change_by_second_mode(plain))
        if n == columns and n <= _MOST_CUFFS:
            Z = _of_mbk(plain, self.omega).reshape(n, n, -1)
            common = [-Z[:, joint, None] * Z[None, joint] for joint in range(n)]
            for place, one in enumerate([*common, -1j * Z / self.omega, relative**2 * Z]):
                terms = _flat(one)
                value, error, _ = self.common_coefficient(terms)
                # A compliance is not negative; a corner is if angles passed the high-pass.
                square = _noticed(max(value, 0.0) if place < n else value, error)
                if place < n:
                    soft, _ = hidden_square(value, error, _SOFT, sizes=(_CUFF,), positive=True)
                    square = max(square, soft)
                squares += square * self.shifts(terms) ** 2
            hidden = hidden + self._change_by_coupling(Z)
        squares += hidden
        # A change within rounding errors is none.
        least = _ROUNDING * np.abs(plain)
        return np.where(squares > least**2, squares, 0.0)

    def high_pass(self, Z: ComplexArray) -> tuple[float, float]:
        """Corner of a high-pass common to the torques of an arm Z, and its standard error, Hz."""
        value, error, _ = self.common_coefficient(_flat(1j * Z / self.omega))
        return value / (2.0 * np.pi), error / (2.0 * np.pi)

    def hidden_terms(self, values: FloatArray) -> list[tuple[float, ComplexArray]]:
        """Prior probabilities of reflexes and relaxing springs, and what they add, (n², n_freq)."""
        if len(self.Z) > _MOST_CUFFS**2:
            return []
        s, (_, B, K) = 1j * self.omega, values[:, :, None]
        arcs = [np.exp(-s * delay) / (1.0 + s / muscle) ** 2 for delay, muscle in _ARCS]
        found = [(_LIKELY / len(arcs), _REFLEX * B * s * arc) for arc in arcs]
        found.append((_LIKELY, _STRETCH * K * (1.0 + s / _LEAD) * arcs[0]))
        # The leakage of biased estimators also hides a relaxing spring.
        times = _RELAXATIONS if self.estimate.unbiased else ()
        return found + [(_LIKELY, _RELAXED * K * s * T / (1.0 + s * T)) for T in times]

    def _change_by_hidden(self, values: FloatArray) -> FloatArray:
        """Squared change of M, B and K, (3, n²), by the hidden term that may change them most.

        A term across joints also acts on its own joint, which shows whether the term is present.
        """
        change = np.zeros_like(values)
        for likely, terms in self.hidden_terms(values):
            shifts, told = self.shifts(terms), self.coefficients_of(terms)
            judged = partial(hidden_square, likely=likely, positive=True, rare=_RARE)
            for row, own in self.pairs:
                elsewhere = 0.0 if row == own else judged(*told[own])[1]
                square, _ = judged(*told[row], elsewhere=elsewhere)
                change[:, row] = np.maximum(change[:, row], square * shifts[:, row] ** 2)
        return change

    def _change_by_second_mode(self, values: FloatArray) -> FloatArray:
        """Squared change of M, B and K, (3, n²), by a mass that a spring couples to the arm.

        With the share c of the inertia, it adds ``-c M s⁴/(s² + 2ζws + w²)`` to the arm that is
        rigid up to it: beyond w the mass stays behind. All elements together tell which w and ζ it
        may have; what the data leave open counts by the prior.
        """
        change = np.zeros_like(values)
        if not self.estimate.unbiased or len(self.Z) > _MOST_CUFFS**2:
            return change
        s, M = 1j * self.omega, values[0][:, None]
        shapes = [
            -M * s**4 / (s**2 + 2.0 * damped * w * s + w**2)
            for w, damped in product(2.0 * np.pi * np.array(_MODES), _DAMPED)
        ]
        judged = partial(hidden_square, likely=0.5, sizes=_PARTS, positive=True)
        told = [[judged(*one) for one in self.coefficients_of(shape)] for shape in shapes]
        squares, evidence = np.moveaxis(np.array(told), 2, 0)
        squares *= 1.0 + np.exp(np.minimum(-evidence, 700.0))  # if there is such a mode
        moved = squares * np.stack([self.shifts(shape) for shape in shapes], axis=1) ** 2
        for row, own in self.pairs:
            others = np.maximum(np.sum(evidence[:, self.own], axis=1) - evidence[:, own], 0.0)
            seen = others + evidence[:, row] + (evidence[:, own] if row != own else 0.0)
            odds = math.log(_MODE / (1.0 - _MODE) / len(shapes)) + seen
            change[:, row] = moved[:, :, row] @ softmax(np.append(odds, 0.0))[:-1]
        return change

    def _change_by_coupling(self, Z: ComplexArray) -> FloatArray:
        """Squared change of M, B and K, (3, n²), by high-passes and creep of single channels.

        A first-order high-pass with the corner w takes ``w/(s + w) Z_ij`` off the row of a torque,
        and adds ``w/s Z_ij`` to the column of an angle. A channel that shows slow signals passed
        none. A transducer that creeps adds ``c/(1 + sT) Z_ij`` to its row. Channels of one rig are
        alike, so each is evidence of whether the others have such an error.
        """
        n, s = len(Z), np.asarray(1j * self.omega, dtype=np.complex128)
        own = np.eye(n, dtype=np.bool_)[:, :, None, None]
        kinds: list[tuple[float, Sequence[float], int, BoolArray, ComplexArray]] = [
            (_COUPLED, (1.0,), axis, possible, -w / (s + w) if axis == 0 else w / s)
            for w in 2.0 * np.pi * np.array(_CORNERS)
            for axis, possible in enumerate(self.estimate.without_slow)
        ]
        if self.may_creep:
            every = np.ones(n, dtype=np.bool_)
            kinds += [(_CREEPING, _CREEP, 0, every, 1.0 / (1.0 + s * time)) for time in _CREEPS]
        change = np.zeros((3, n * n))
        for likely, sizes, axis, possible, effect in kinds:
            channels = np.where(np.moveaxis(own, 1, 1 + axis), effect * Z, 0.0)
            channels = channels.reshape(n, n * n, -1)[possible]
            judged = partial(hidden_square, likely=likely, sizes=sizes, positive=True)
            told = [self.common_coefficient(terms)[:2] for terms in channels]
            evidence = [judged(*one)[1] for one in told]
            for terms, one, of_one in zip(channels, told, evidence, strict=True):
                square, _ = judged(*one, elsewhere=max(sum(evidence) - of_one, 0.0))
                change = np.maximum(change, square * self.shifts(terms) ** 2)
        return change

    def beside(self, terms: ComplexArray) -> ComplexArray:
        """Residual of terms (..., elements, n_freq) regressed on M, B and K of their elements.

        It is orthogonal to them with the elements' weights.
        """
        alike = _sums(self.functionals, terms[..., None, :])
        return np.asarray(terms - _of_mbk(np.moveaxis(alike, -1, 0), self.omega))

    def coefficients_of(self, terms: ComplexArray) -> FloatArray:
        """Coefficient of each element's term beside M, B and K, and its error, (elements, 2)."""
        left = self.beside(terms)
        total = np.sum(self.weights * np.abs(left) ** 2, axis=1)
        told = (np.finfo(np.float64).tiny < total) & (total < math.inf)
        left = np.where(told[:, None], left, 0.0)
        functionals = self.weights * left / np.where(told, total, 1.0)[:, None]
        spread = functionals * np.sqrt(self.noise)
        variance = 0.5 * _sums(spread, with_neighbours(spread, self.estimate.bin_correlation))
        for systematic in self.systematics:
            variance += _sums(functionals, systematic) ** 2
        found = np.stack((_sums(functionals, self.Z), np.sqrt(np.maximum(variance, 0.0))), axis=1)
        # Where nothing was measured, the values are not numbers either.
        return np.where(told[:, None], found, (0.0, math.inf))

    def common_coefficient(self, terms: ComplexArray) -> tuple[float, float, float]:
        """Weighted mean of :meth:`coefficients_of`, its error with their scatter, and their spread.

        The spread is the standard deviation between elements beyond chance (DerSimonian & Laird,
        *Controlled Clinical Trials* 7, 1986), where one standard deviation more counts as chance.
        """
        found = self.coefficients_of(terms)
        values, errors = found[np.isfinite(found[:, 1]) & (found[:, 1] > 0.0)].T
        if not values.size:
            return 0.0, math.inf, 0.0
        precision = 1.0 / errors**2
        total = float(np.sum(precision))
        mean = float(np.sum(precision * values)) / total
        freedom = max(values.size - 1, 1)
        scatter = float(np.sum(precision * (values - mean) ** 2))
        spare = total - float(np.sum(precision**2)) / total
        excess = max(scatter - freedom - math.sqrt(2.0 * freedom), 0.0)
        apart = math.sqrt(excess / spare) if spare > 0.0 else 0.0
        return mean, math.sqrt(max(1.0, scatter / freedom) / total), apart

    def common_coefficients(
        self, terms: ComplexArray, expected: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Posterior means and covariance of the coefficients of terms common to all elements.

        The terms, (p, elements, n_freq), are beside M, B and K, each scaled to its prior standard
        error about `expected`, (p,). The covariance covers the scatter over the elements.
        """
        rows, beside = [], self.beside(terms)
        for row in range(len(self.Z)):
            term, left = terms[:, row], beside[:, row]
            size = np.sum(self.weights[row] * np.abs(left) ** 2, axis=1, keepdims=True)
            functionals = self.weights[row] * left / np.sqrt(size + np.finfo(np.float64).tiny)
            # If data determined a term still better, its prior mean would be lost to rounding.
            errors = self.covariance_of(functionals, row) + np.diag(_SUREST_SHARE**2 * size[:, 0])
            design = (np.conj(functionals) @ term.T).real
            information = np.linalg.pinv(errors, rcond=_SINGULAR, hermitian=True)
            rows.append((design, information, (np.conj(functionals) @ self.Z[row]).real))
        normal = sum(design.T @ information @ design for design, information, _ in rows)
        mixed = sum(design.T @ information @ found for design, information, found in rows)
        found = np.linalg.solve(np.eye(len(terms)) + normal, expected + mixed)
        left_over = [(one @ found - told, information) for one, information, told in rows]
        ratio = sum(float(one @ information @ one) for one, information in left_over)
        scatter = max(1.0, ratio / (len(terms) * max(len(rows) - 1, 1)))
        covariance = np.linalg.inv(np.eye(len(terms)) + normal / scatter)
        return covariance @ (expected + mixed / scatter), covariance

    def with_bounds_told(self) -> _Elements:
        """Estimate the systematics that are bounds from the data; return corrected elements.

        Each has a known shape over frequency and an unknown size, 0 ± 1 before the data.
        """
        bounded = self.estimate.bounded
        if not bounded:
            return self
        terms, others = np.stack(self.systematics[:bounded]), self.systematics[bounded:]
        found, covariance = replace(self, systematics=others).common_coefficients(
            terms, np.zeros(bounded)
        )
        errors = np.tensordot(root_of(covariance).T, terms, axes=1)
        Z = self.Z - np.tensordot(found, terms, axes=1)
        return replace(self, Z=Z, systematics=(*errors, *others))

    def roughly_fits(self, values: FloatArray) -> bool:
        """Whether M, B and K, with systematic errors of any shape, explain each element."""
        estimate = self.corrected
        fitted = _of_mbk(values, self.omega).reshape(estimate.Z.shape)
        lack = np.sum(lack_ratio(estimate, fitted), axis=-1) / max(estimate.f.size - 1.5, 1.0)
        return bool((lack <= lack_limit(estimate.bin_correlation)).all())


def _flat(values: Values) -> Values:
    """Elements of a matrix row by row, (elements, n_freq)."""
    return values.reshape(-1, values.shape[-1])


def lack_of_fit(estimate: ImpedanceEstimate, fitted: ComplexArray) -> FloatArray:
    """Weighted squared residual of each element per degree of freedom, (n, n).

    It is 1 if noise explains all of it. M, B and K, and systematic errors within their standard
    errors, first explain what they can of ``Z - fit``: each has one shape over frequency, and
    explains nothing else (generalised least squares).
    """
    f, n = estimate.f, estimate.joints
    weights = 1.0 / np.sqrt(_spared(estimate.Z, estimate.noise, estimate.averages - 1.0))
    relative = 1j * f / f[-1]
    shapes = np.stack((relative**2, relative, np.ones_like(relative)))
    found = np.zeros((n, n))
    for at in np.ndindex(n, n):
        systematic = np.reshape([one[at] for one in estimate.systematics], (-1, f.size))
        design = _stacked(weights[at] * np.concatenate((shapes, systematic)))
        # M, B and K, the first three, have no prior.
        known = np.arange(len(design)) >= len(shapes)
        design /= np.where(known, 1.0, np.linalg.norm(design, axis=1))[:, None]
        rest = _stacked(weights[at] * (estimate.Z - fitted)[at])
        normal = design @ design.T + np.diag(np.where(known, 1.0, _ROUNDING))
        taken = np.linalg.solve(normal, design @ rest)
        found[at] = rest @ rest - taken @ design @ rest
    return found / max(f.size - 1.5, 1.0)


def _stacked(values: ComplexArray) -> FloatArray:
    """Real and imaginary parts one after the other, (..., 2 n_freq)."""
    return np.concatenate((values.real, values.imag), axis=-1)


def lack_ratio(estimate: ImpedanceEstimate, fitted: ComplexArray) -> FloatArray:
    """``|Z - fit|²/variance`` of each element and bin, (n, n, n_freq); its mean is 1 if it fits."""
    spared = _spared(estimate.Z, estimate.variance, estimate.averages - 1.0)
    return np.asarray(np.abs(estimate.Z - fitted) ** 2 / spared)


def _spared(Z: ComplexArray, variance: FloatArray, freedom: float) -> FloatArray:
    """Variance by which to judge the residual of a fit.

    It makes up for the mean of inverse variances with m complex degrees of freedom, which is too
    large, and includes the estimator's own errors, lest they count as lack of fit without noise.
    """
    spare = (freedom - 1.0) / freedom if 1.0 < freedom < math.inf else 1.0
    least = (_EXACT * np.abs(Z)) ** 2 + np.finfo(np.float64).tiny
    return np.asarray((variance + least) / spare)


def _with_delay(problem: _Elements) -> tuple[_Elements, CommonDelay | None]:
    """Fit a common delay and correct it, if the estimate leaves it open."""
    uncertainty, unknown = problem.estimate.delay_uncertainty, problem.estimate.delay_unknown
    if uncertainty is None:
        return problem, None
    total, told_error, apart = 0.0, math.inf, 0.0
    trial = problem
    for _ in range(_ITERATIONS):
        # For each element, Z = fit - d jω fit is solved for d by weighted least squares.
        turned = -1j * problem.omega * _of_mbk(trial.values(), problem.omega)
        step, told_error, apart = trial.common_coefficient(turned)
        # No drive, filter or clock is later than 20 ms; what seems to be is not a delay.
        total = float(np.clip(total + step, -0.02, 0.02))
        turn = np.exp(1j * problem.omega * total)
        trial = replace(problem, Z=problem.Z * turn)
    fitted, plain = trial.values(), problem.values()
    # Torques that jump with their commands are read within the period: what then seems later than
    # that against the angles is the arm's own, as of soft tissue.
    late = total > unknown + _REFUTED * told_error and problem.estimate.hold is not None
    fits = trial.roughly_fits(fitted) and not late
    sure = max(uncertainty, _SUREST)
    refuted = fits and abs(total) > _REFUTED * math.hypot(sure, told_error)
    assumed = max(uncertainty, unknown) if refuted else uncertainty
    # Unless the arm is of the form M, B and K, what looks like a delay may be the arm's own.
    identified = fits and assumed > 0.0
    delay = total * assumed**2 / (assumed**2 + told_error**2) if identified else 0.0
    values = fitted if fits else plain
    turning = 1j * problem.omega
    steady = _of_mbk(values * [[0.0], [1.0], [1.0]], problem.omega)
    inertial = _of_mbk(values * [[1.0], [0.0], [0.0]], problem.omega)
    turned = problem.Z * np.exp(turning * delay)
    doubt = 0.5 * delay * turning * steady
    # The delay of B and K keeps its prior uncertainty, whatever the data tell of the inertial part.
    untold = assumed * turning * steady
    # A first-order low-pass is exp(-sd + (sd)²/2 - (sd)³/3 ...); others have less of each term.
    filtered = [(delay * turning) ** order / order * inertial for order in _ORDERS if delay]
    # In mid-period, torques that jump and angles that do not differ by (ωL)²/24 of the inertia.
    jumping = (assumed * turning) ** 2 / 6.0 * inertial
    terms = np.stack([assumed * turning * turned, jumping, *filtered])
    # Each transducer may have a delay of its own, or seem to, as with hysteresis.
    single = (min(apart, assumed) * turning * turned,) if identified else ()
    trial = replace(
        problem, Z=turned - doubt, systematics=(*problem.systematics, *single, doubt, untold)
    )
    found, covariance = np.zeros(len(terms)), np.eye(len(terms))
    if identified:
        own = problem.own
        every = [term for _, term in problem.hidden_terms(values)]
        alike = np.zeros((len(every) * len(own), *turned.shape), dtype=np.complex128)
        for place, (term, row) in enumerate(product(every, own)):
            alike[place, row] = term[row]
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
        told=total,
        told_error=told_error,
        refuted=refuted,
    )
    errors = np.tensordot(root_of(covariance).T, terms, axes=1)
    return replace(
        trial,
        Z=trial.Z - np.tensordot(found, terms, axes=1),
        systematics=(*trial.systematics, *errors),
    ), known


def root_of(covariance: Values) -> Values:
    """Matrices F, (..., p, p), with ``F Fᴴ`` a covariance, which rounding may make indefinite."""
    sizes, directions = np.linalg.eigh(covariance)
    root: Values = directions * np.sqrt(np.maximum(sizes, 0.0))[..., None, :]
    return root


def hidden_square(
    told: float,
    error: float,
    likely: float,
    *,
    sizes: Sequence[float] = (1.0,),
    positive: bool = False,
    elsewhere: float = 0.0,
    rare: float = 0.0,
) -> tuple[float, float]:
    """Posterior mean square of an effect that may be absent (spike-and-slab prior).

    Before the data, the effect is present with the probability p, and is then 0 ± s. If the data
    estimate it as g with the standard error e, in units of s, the odds are multiplied by the
    likelihood ratio ``√v exp(m²/2v)``, with ``v = e²/(1 + e²)`` and ``m = g v/e²``, and the mean
    square of an effect that is present is ``m² + v``. If it cannot be negative, the ratio is
    ``2 Φ(m/√v)`` times that.

    Parameters
    ----------
    told, error : float
        Estimate g s and its standard error e s.
    likely : float
        Prior probability p.
    sizes : sequence of float
        Sizes s, all equally likely.
    positive : bool
        Whether the effect cannot be negative.
    elsewhere : float
        Logarithm of that ratio for other data, which show only whether the effect is present.
    rare : float
        Posterior probability that is subtracted, so that a rarer effect does not count.

    Returns
    -------
    square : float
        Posterior mean square of the effect, which is 0 if it is absent.
    evidence : float
        Logarithm of the likelihood ratio of these data, over all sizes.
    """
    if not 0.0 < error < math.inf:
        return 0.0, 0.0
    size = np.asarray(sizes, dtype=np.float64)
    left = (error / size) ** 2 / (1.0 + (error / size) ** 2)
    mean = told / size * left / (error / size) ** 2
    ratios = 0.5 * np.log(left) + 0.5 * mean**2 / left - math.log(len(size))
    if positive:
        ratios += math.log(2.0) + log_ndtr(mean / np.sqrt(left))
        mean = np.maximum(mean, 0.0)
    odds = math.log(likely / (1.0 - likely)) + elsewhere + ratios
    there = softmax(np.append(odds, 0.0))[:-1]
    present = float(np.sum(there))
    counts = max(present - rare, 0.0) / max(present, np.finfo(np.float64).tiny)
    square = float(np.sum(there * (mean**2 + left) * size**2))
    return counts * square, float(np.logaddexp.reduce(ratios))


def _mbk_functionals(omega: FloatArray, weights: FloatArray) -> ComplexArray:
    """Rows b, (3, n_freq), of ``(M, B, K) = Re Σ_f conj(b_f) Z_f``."""
    scale = omega[-1]
    relative = omega / scale
    design = np.stack((-(relative**2), np.ones(omega.size)))
    normal = (design * weights) @ design.T
    of_real = np.linalg.solve(normal, design * weights)
    of_imaginary = weights * relative / np.sum(weights * relative**2)
    return np.stack((of_real[0] / scale**2, 1j * (of_imaginary / scale), of_real[1]))


def _of_mbk(values: FloatArray, omega: FloatArray) -> ComplexArray:
    """Impedance, (..., n_freq), of M, B and K, (3, ...)."""
    M, B, K = values[..., None]
    return np.asarray(K - M * omega**2 + 1j * omega * B, dtype=np.complex128)


def _roots(covariance: FloatArray) -> FloatArray:
    """Standard errors from a covariance."""
    return np.asarray(np.sqrt(np.maximum(np.diag(covariance), 0.0)))


def _sums(functionals: ComplexArray, values: ComplexArray) -> FloatArray:
    """``Re Σ_f conj(b_f) y_f`` along the last axis."""
    parts = functionals.real * values.real + functionals.imag * values.imag
    return np.asarray(np.sum(parts, axis=-1))


def _noticed(value: float, error: float) -> float:
    """Squared coefficient of a term, less the square that chance alone may give it.

    With a mere threshold, all of it would count whenever chance exceeds the threshold.
    """
    return max(value**2 - (_NOTICED * error) ** 2, 0.0) if math.isfinite(error) else 0.0


def fit_weights(
    f: FloatArray,
    impedance: ComplexArray,
    variance: FloatArray,
    weight_floor: float,
    power: FloatArray | float = 1.0,
    *,
    reach: float = _SMOOTHING,
) -> FloatArray:
    """Inverse of the variance, smoothed over frequency (geometric mean) and floored, at most 1.

    The variance at one frequency comes from few averages. Weights that followed its fluctuations
    would favour frequencies whose variance is too small by chance, and make standard errors too
    small. Its variation with the inverse of the power is known, and so is not smoothed.

    Parameters
    ----------
    f, impedance, variance, power : ndarray, shape (..., n_freq)
        Frequencies, Hz, values, their variances, and the power of the perturbation behind each.
    weight_floor : float
        Standard deviation, relative to the impedance, that is added; less where power is above its
        mean, as errors for which it stands, such as harmonics of friction, don't grow with power.
    reach : float
        Half width of the smoothing, Hz.
    """
    power, tiny = np.broadcast_to(power, variance.shape), np.finfo(np.float64).tiny
    usual = np.mean(power, axis=-1, keepdims=True)
    size = np.abs(impedance)
    floor = weight_floor * np.exp(_smooth(f, np.log(size + tiny), reach))
    # Even without a floor, a variance below rounding errors means nothing.
    rounding = np.finfo(np.float64).eps * np.max(size, axis=-1, keepdims=True)
    noise = np.exp(_smooth(f, np.log(variance * power + tiny), reach)) / power
    total = noise + floor**2 * np.minimum(1.0, usual / power) + rounding**2
    return np.asarray(np.min(total, axis=-1, keepdims=True) / total)


def _smooth(f: FloatArray, logarithm: FloatArray, reach: float) -> FloatArray:
    """Mean over all frequencies within `reach`, Hz, on either side of each; (..., n_freq)."""
    sums, count = sums_within(f, logarithm, reach * (1.0 + 1e-9))
    return np.asarray(sums / count)


def covariance_of_sums(spread: Values, correlation: FloatArray) -> FloatArray:
    """Covariance of ``Re Σ conj(b) δZ`` where errors δZ of neighbouring bins are correlated.

    Parameters
    ----------
    spread : ndarray, shape (p, ..., n_freq)
        For each sum, b times the standard deviations of the complex δZ. Errors along axes other
        than the last are independent.
    correlation : ndarray, shape (lags, n_freq)
        Correlation of the errors of each bin and the one 0, 1, 2... places above it.

    Returns
    -------
    ndarray, shape (p, p)
    """
    left = np.conj(spread).reshape(len(spread), -1)
    right = with_neighbours(spread, correlation).reshape(len(spread), -1)
    return np.asarray(0.5 * (left @ right.T).real)


def with_neighbours(values: Values, correlation: FloatArray) -> Values:
    """Sums ``Σ_g ρ_fg values_g`` over neighbouring bins, (..., n_freq).

    Parameters
    ----------
    values : ndarray, shape (..., n_freq)
    correlation : ndarray, shape (lags, n_freq)
        Correlation of each bin and the one 0, 1, 2... places above it.
    """
    total: Values = values.copy()
    bins = values.shape[-1]
    for lag, of_lag in enumerate(correlation[1:bins], start=1):
        rho = of_lag[: bins - lag]
        total[..., : bins - lag] += rho * values[..., lag:]
        total[..., lag:] += rho * values[..., : bins - lag]
    return total
