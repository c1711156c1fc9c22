"""What an estimator of the impedance matrix takes and gives."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from armimp_common.arrays import BoolArray, ComplexArray, FloatArray
from armimp_estimation.hold_correction import HoldCorrection
from armimp_estimation.trial import TrialData


def confidence_radius(variance: FloatArray, averages: float, level: float = 0.95) -> FloatArray:
    """Radius of the circle about each complex estimate that holds the truth with a probability.

    The error is circular complex normal and its variance was itself estimated with
    ``m = averages - 1`` degrees of freedom, so ``|error|² / variance`` follows F(2, 2m), whose
    quantile is ``m ((1 - level)^(-1/m) - 1)``.

    Parameters
    ----------
    variance : ndarray
        Variance of the complex values.
    averages : float
        Number of independent averages behind them, above 1.
    level : float
        Probability, above 0 and below 1.

    Returns
    -------
    ndarray
        Radius, in the units of the estimate, same shape as `variance`.
    """
    freedom = averages - 1.0
    quantile = freedom * ((1.0 - level) ** (-1.0 / freedom) - 1.0)
    radius: FloatArray = np.sqrt(quantile * variance)
    return radius


def combined(coefficients: ComplexArray, covariance: ComplexArray) -> ComplexArray:
    """Covariance of combinations, ``E[δ_a conj(δ_b)]``, from that of the channels.

    Parameters
    ----------
    coefficients : ndarray, shape (m, C, n_freq)
        Of each channel in each combination.
    covariance : ndarray, shape (C, C, n_freq)
        Of the channels.

    Returns
    -------
    ndarray, shape (m, m, n_freq)
        Variances on the diagonal are never below what rounding alone would leave.
    """
    found: ComplexArray = np.einsum(
        "acf,cdf,bdf->abf", coefficients, covariance, np.conj(coefficients), optimize=True
    )
    terms = np.einsum("acf,ccf->af", np.abs(coefficients) ** 2, covariance.real)
    own = np.arange(len(found))
    found[own, own] = np.maximum(found[own, own].real, np.finfo(np.float64).eps * terms)
    return found


def disturbances(arms: Iterable[ComplexArray], covariance: ComplexArray) -> ComplexArray:
    """Covariance of ``T - Z R`` of each trial from that of R and T, (n, 2n, 2n, n_freq).

    With an impedance Z, (n, n, n_freq), for each trial; shape (n, n, n, n_freq).
    """
    n, size = covariance.shape[0], covariance.shape[-1]
    torques = np.broadcast_to(np.eye(n)[:, :, None], (n, n, size))
    return np.stack(
        [
            combined(np.concatenate((-Z, torques), axis=1), one)
            for Z, one in zip(arms, covariance, strict=True)
        ]
    )


def variance_of(
    disturbance: ComplexArray, inverse: ComplexArray, systematics: Iterable[ComplexArray] = ()
) -> FloatArray:
    """Variance of an impedance, (n, n, n_freq), from what an :class:`ImpedanceEstimate` has."""
    noise = np.einsum("kiif,kjf->ijf", disturbance.real, np.abs(inverse) ** 2)
    return np.asarray(noise + sum(np.abs(common) ** 2 for common in systematics))


@dataclass(frozen=True, kw_only=True, eq=False)
class ImpedanceEstimate:
    """The impedance matrix over frequency."""

    name: str
    """Name of the estimator."""
    f: FloatArray
    """Frequencies, Hz; shape (n_freq,)."""
    Z: ComplexArray
    """Impedance, N·m/rad; shape (n, n, n_freq)."""
    variance: FloatArray
    """Variance of each complex value, (N·m/rad)²; real and imaginary part have half each; shape
    (n, n, n_freq)."""
    bin_correlation: FloatArray
    """Correlation of the errors at each frequency and the one 0, 1, 2... places above it; 1 at lag
    0; shape (lags, n_freq)."""
    averages: float
    """Number of independent averages behind each value and its variance."""
    T: ComplexArray
    R: ComplexArray
    """Responses of torques and of angles (rad/(N·m)) to the perturbation; shape (n, n, n_freq)."""
    perturbed: tuple[int, ...] = ()
    """Joints of the columns, 0-based, where there are not those of all: (n, m, n_freq) is the shape
    of the arrays then."""
    systematics: tuple[ComplexArray, ...] = ()
    """Standard errors of corrections that the values contain, or of biases that they are known to
    have, N·m/rad: complex, since each is the same error at all frequencies, in this proportion. The
    variance includes them; shape (n, n, n_freq)."""
    bounded: int = 0
    """How many of them, the first ones, are bounds: what the data tell of their size is left to the
    M-B-K fit."""
    covariance: ComplexArray | None = None
    """``E[δ_a conj(δ_b)]`` of the errors of ``R_1k … R_nk, T_1k … T_nk``, for each trial k;
    responses from different trials are independent. None if that is not so; shape
    (n, 2n, 2n, n_freq)."""
    disturbance: ComplexArray | None = None
    """``E[V_ik conj(V_mk)]`` by k, i, m for the ``V = T - Z R`` that the disturbances leave; shape
    (n, n, n, n_freq)."""
    inverse: ComplexArray | None = None
    """What takes it to the errors of the impedance: ``δZ = V · inverse``; shape (n, n, n_freq)."""
    power: FloatArray | float = 1.0
    """Power of the perturbation of each trial behind each value, up to a factor: variances go with
    its inverse; shape (n, n_freq), or 1 if it is alike."""
    weight_floor: float = 0.2
    """Relative standard deviation that the M-B-K fit adds, in quadrature, to that of each value
    before it serves as a weight. The variance does not know of errors in proportion to the
    impedance itself, such as leakage bias and time skew of the sensors; without a floor the
    frequencies whose random errors are tiny decide alone and bring in those errors. With 0 the skew
    of half a millisecond biases B by up to 55 % on a quiet simulated rig, with 0.2 by 7 %."""
    friction_skew: ComplexArray | None = None
    """What was added for torques of friction that jump with the commands, N·m/rad; shape
    (n, n, n_freq)."""
    delay_uncertainty: float | None = None
    """Standard error with which torques and angles are known to be of the same instant, s: the fit
    then has a common delay as a parameter. None: they are taken as they are."""
    delay_unknown: float = 0.0
    """Standard error to fall back upon where the data refute that, s."""
    unbiased: bool = False
    """Whether nothing but its variance separates the estimate from the truth: only then does lack
    of fit mean another arm, and only such an estimate decides whether a result is valid."""
    uneven: tuple[float, ...] = ()
    """Share of the power of the torque of each perturbed joint at the lines of a multisine that is
    neither noise nor smooth over frequency, as any linear arm's response is."""
    without_slow: tuple[BoolArray, ...] = ()
    """Torques, and angles, that show so little of what is slow that they may have passed a
    high-pass, two of shape (n,). Empty: nobody looked."""
    hold: HoldCorrection | None = None
    """What torques do at each update of the commands, if that was found and corrected."""

    @property
    def joints(self) -> int:
        """Number of joints n."""
        return int(self.Z.shape[0])

    def without_systematics(self) -> "ImpedanceEstimate":
        """Return the same with the variance of noise alone."""
        variance = self.variance.copy()
        for common in self.systematics:
            variance -= np.abs(common) ** 2
        return replace(self, variance=np.maximum(variance, 0.0), systematics=(), bounded=0)

    def with_noise_at(self, impedance: ComplexArray) -> "ImpedanceEstimate":
        """Return the same with the noise of ``T - Z R`` at another impedance than the estimated.

        Noise that moves the joints pulls ``Ẑ = T R⁻¹`` to where ``T - Ẑ R`` has least of it, so its
        variance there is too small, the more so the more of the motion is noise. It is returned as
        it is without the covariance of T and R.

        Parameters
        ----------
        impedance : ndarray, shape (n, n, n_freq)
            Such as the fitted one, N·m/rad.
        """
        if self.covariance is None or self.inverse is None:
            return self
        disturbance = disturbances([impedance] * self.joints, self.covariance)
        variance = variance_of(disturbance, self.inverse, self.systematics)
        return replace(self, variance=variance, disturbance=disturbance)


class Estimator(Protocol):
    """A way to get the impedance matrix from the trials of one decomposition."""

    @property
    def name(self) -> str:
        """Name in tables, files and on the command line."""
        ...

    def estimate(self, trials: Sequence[TrialData]) -> ImpedanceEstimate:
        """Estimate from n trials in any order, one for each joint.

        Raises
        ------
        DataError
            If a joint has no trial (the message names it) or the data cannot be estimated.
        """
        ...
