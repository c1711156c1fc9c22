"""Input and output of the estimators of the impedance matrix."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from armimp_common.arrays import EPS, BoolArray, ComplexArray, FloatArray
from armimp_estimation.hold_correction import HoldCorrection
from armimp_estimation.record import TrialRecord
from armimp_estimation.trial import TrialData


def confidence_radius(variance: FloatArray, averages: float, level: float = 0.95) -> FloatArray:
    """Radius of the confidence circle about each complex estimate.

    The error is circular complex normal and its variance was itself estimated with
    ``m = averages - 1`` degrees of freedom, so ``|error|² / variance`` follows F(2, 2m), whose
    quantile is ``m ((1 - level)^(-1/m) - 1)``.

    Parameters
    ----------
    variance : ndarray
        Variance of the complex values.
    averages : float
        Number of independent averages behind them.
    level : float
        Probability that the circle holds the truth, above 0 and below 1.

    Returns
    -------
    ndarray
        Radius, in the units of the estimate, same shape as `variance`; NaN with a single average.
    """
    freedom = averages - 1.0
    if not freedom > 0.0:
        return np.full(variance.shape, np.nan)
    quantile = freedom * ((1.0 - level) ** (-1.0 / freedom) - 1.0)
    radius: FloatArray = np.sqrt(quantile * variance)
    return radius


def combined(coefficients: ComplexArray, covariance: ComplexArray) -> ComplexArray:
    """Covariance ``E[δ_a conj(δ_b)]`` of linear combinations of channels.

    Parameters
    ----------
    coefficients : ndarray, shape (m, C, n_freq)
        Coefficient of each channel in each combination.
    covariance : ndarray, shape (C, C, n_freq)
        Covariance of the channels.

    Returns
    -------
    ndarray, shape (m, m, n_freq)
        The variances on the diagonal never fall below the level of rounding errors.
    """
    found: ComplexArray = np.einsum(
        "acf,cdf,bdf->abf", coefficients, covariance, np.conj(coefficients), optimize=True
    )
    terms = np.einsum("acf,ccf->af", np.abs(coefficients) ** 2, covariance.real)
    own = np.arange(len(found))
    found[own, own] = np.maximum(found[own, own].real, EPS * terms)
    return found


def disturbances(arms: Iterable[ComplexArray], covariance: ComplexArray) -> ComplexArray:
    """Covariance of ``T - Z R`` in each trial, shape (n, n, n, n_freq).

    `arms` gives Z, (n, n, n_freq), and `covariance` that of R and T, (2n, 2n, n_freq), by trial.
    """
    n, size = covariance.shape[0], covariance.shape[-1]
    torques = np.broadcast_to(np.eye(n)[:, :, None], (n, n, size))
    return np.stack(
        [
            combined(np.concatenate((-Z, torques), axis=1), one)
            for Z, one in zip(arms, covariance, strict=True)
        ]
    )


def noise_of(disturbance: ComplexArray, inverse: ComplexArray) -> FloatArray:
    """Noise, (n, n, n_freq), that follows from fields of an :class:`ImpedanceEstimate`."""
    return np.asarray(np.einsum("kiif,kjf->ijf", disturbance.real, np.abs(inverse) ** 2))


@dataclass(frozen=True, kw_only=True, eq=False)
class ImpedanceEstimate:
    """The impedance matrix over frequency."""

    name: str
    """Name of the estimator."""
    f: FloatArray
    """Frequencies, Hz; shape (n_freq,)."""
    Z: ComplexArray
    """Impedance, N·m/rad; shape (n, n, n_freq)."""
    noise: FloatArray
    """Variance of each complex value without that of `systematics`, (N·m/rad)²; real and imaginary
    part have half each; shape (n, n, n_freq)."""
    bin_correlation: FloatArray
    """Correlation between the errors at each frequency and at the one 0, 1, 2... places above it;
    1 at lag 0; shape (lags, n_freq)."""
    averages: float
    """Number of independent averages behind each value and its variance."""
    T: ComplexArray
    R: ComplexArray
    """Responses of torques and of angles (rad/(N·m)) to the perturbation; shape (n, n, n_freq)."""
    perturbed: tuple[int, ...] = ()
    """Joints of the columns, 0-based, if only m of the n columns were estimated: the arrays then
    have the shape (n, m, n_freq). Empty if all were."""
    systematics: tuple[ComplexArray, ...] = ()
    """Standard errors of corrections that were applied or of known biases, N·m/rad. Each is one
    error common to all frequencies, so it is complex and shows its shape over frequency; shape of
    each (n, n, n_freq)."""
    bounded: int = 0
    """Number of leading `systematics` that are prior bounds, whose actual size the M-B-K fit
    estimates from the data."""
    shapeless: FloatArray | float = 0.0
    """Variance, (N·m/rad)², by those `systematics` whose shape over frequency is hardly known, so
    that they may look like a lack of fit; shape (n, n, n_freq)."""
    tensions: tuple[ComplexArray, ...] = ()
    """Changes, N·m/rad, if stiffness and viscosity are twice as large in one trial as in others,
    in which the joints move that it locks; one of shape (n, n, n_freq) for each trial."""
    covariance: ComplexArray | None = None
    """``E[δ_a conj(δ_b)]`` of the errors of ``R_1k … R_nk, T_1k … T_nk``, for each trial k;
    responses from different trials are independent. None if that is not so; shape
    (n, 2n, 2n, n_freq)."""
    disturbance: ComplexArray | None = None
    """Covariance ``E[V_ik conj(V_mk)]``, by k, i, m, of the disturbance ``V = T - Z R``; shape
    (n, n, n, n_freq)."""
    inverse: ComplexArray | None = None
    """Maps V to the errors of the impedance: ``δZ = V · inverse``; shape (n, n, n_freq)."""
    power: FloatArray | float = 1.0
    """Power of the perturbation in each trial, up to a factor; variances are inversely proportional
    to it. Shape (n, n_freq), or 1 if it is the same everywhere."""
    weight_floor: float = 0.2
    """Relative standard deviation that the M-B-K fit adds, in quadrature, to that of each value
    before it serves as a weight. The variance does not cover errors proportional to the impedance
    itself, such as leakage bias and time skew of the sensors; without a floor, the frequencies with
    tiny random errors would dominate and bring in those errors. With a floor of 0, a skew
    of 0.5 ms biases B by up to 55 % on a quiet simulated rig; with 0.2, by 7 %."""
    friction_skew: ComplexArray | None = None
    """Part of the skew correction in Z that concerns friction torques, which jump with the
    commands, N·m/rad; shape (n, n, n_freq)."""
    delay_uncertainty: float | None = None
    """Standard error of the delay between torques and angles, s. The M-B-K fit then has a common
    delay as a parameter; with None it takes them as simultaneous."""
    delay_unknown: float = 0.0
    """Standard error of that delay if the data contradict `delay_uncertainty`, s."""
    unbiased: bool = False
    """Whether the variance covers every error. Only then does lack of fit show that the arm isn't
    M, B and K, and only such an estimate decides whether a result is valid."""
    uneven: tuple[float, ...] = ()
    """For each perturbed joint, the share of its torque's power at the lines of a multisine that is
    neither noise nor smooth over frequency, as the response of a linear arm would be."""
    without_slow: tuple[BoolArray, ...] = ()
    """Whether each torque, then each angle, has so little power at low frequencies that it may have
    been high-pass filtered; two arrays of shape (n,). Empty if this was not checked."""
    hold: HoldCorrection | None = None
    """How torques jump with each update of the commands, if that was identified and corrected."""
    posed: tuple[TrialRecord, ...] = ()
    """The trials, if the inertia changes with the angles: corrected by
    :func:`armimp_estimation.turning_links.at_posture`."""

    @property
    def joints(self) -> int:
        """Number of joints n."""
        return int(self.Z.shape[0])

    @property
    def variance(self) -> FloatArray:
        """Variance of each complex value with that of `systematics`; shape (n, n, n_freq)."""
        return np.asarray(self.noise + sum(np.abs(common) ** 2 for common in self.systematics))

    def with_noise_at(self, impedance: ComplexArray) -> "ImpedanceEstimate":
        """Return the estimate with the noise of ``T - Z R`` evaluated at another impedance.

        Noise that moves the joints pulls ``Ẑ = T R⁻¹`` to where ``T - Ẑ R`` is least noisy. The
        variance evaluated there is too small, the more so the larger the share of noise in the
        motion. Without a covariance of T and R, the estimate is returned unchanged.

        Parameters
        ----------
        impedance : ndarray, shape (n, n, n_freq)
            Impedance at which to evaluate the noise, such as the fitted one, N·m/rad.
        """
        if self.covariance is None or self.inverse is None:
            return self
        disturbance = disturbances([impedance] * self.joints, self.covariance)
        noise = noise_of(disturbance, self.inverse)
        return replace(self, noise=noise, disturbance=disturbance)


class Estimator(Protocol):
    """Estimator of the impedance matrix from one trial for each joint."""

    @property
    def name(self) -> str:
        """Name in tables, files and on the command line."""
        ...

    def estimate(self, trials: Sequence[TrialData]) -> ImpedanceEstimate:
        """Estimate the impedance from n trials, one for each joint, in any order.

        Raises
        ------
        DataError
            If a joint has no trial (the message names it) or the data cannot be estimated.
        """
        ...
