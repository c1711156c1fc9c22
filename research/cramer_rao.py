"""The accuracy of M, B and K that the noise of the sensors allows: the Cramér-Rao bound.

At each bin of the Fourier transform of a trial the sensors read ``θ + w_θ`` and
``Z θ + d + w_τ``, with the unknown motion θ, the impedance ``Z = M s² + B s + K``, the voluntary
torque d, and noise w. With θ as a nuisance parameter at every bin, all information about M, B and K
is in the error ``e = τ - Z θ`` of the equation of motion, whose covariance is

    Σ = N (σ_τ² I + σ_θ² Z Z*) + S_dd I ,

for records of N samples. With the derivatives ``φ = (s² θ, s θ, θ)`` of Z θ by the elements of a
row of M, B and K, the Fisher information of all 3n² parameters, where i and l are rows, is

    F_(i,a),(l,b) = 2 Re Σ_trials Σ_bins conj(φ_a) (Σ⁻¹)_il φ_b ,

and no unbiased estimator has standard deviations below ``sqrt(diag(F⁻¹))`` (Söderström,
*Errors-in-Variables Methods in System Identification*, 2018; Pintelon & Schoukens, *System
Identification: A Frequency Domain Approach*, 2nd ed., section 9).

What is assumed:

- The bound is conditional on the actual motion. Robot, controller and friction shape that motion
  and enter in no other way: the torque transducers sit between the robot and the arm.
- Only the part of that motion that responds to the perturbation counts. Leakage from the ends of a
  record is no motion: where perturbations are weak it is most of the transform, and with it M and B
  would seem to be known better, in some trials by 40 %.
- Noise is white, circular normal, independent between bins, channels and trials, and its variance
  is known. Rounding to counts of q has the variance q²/12. It is neither normal nor, where a signal
  stays within a few counts, white.
- Voluntary torque is normal noise of a known spectrum, independent between joints. Through the loop
  it moves the arm, too. Estimators with the perturbation as instrument learn nothing from that part
  of the motion, so it has to be left out; a motion simulated without voluntary torque has none.
  (With it, the bound would be that of an estimator that knows the robot, and infers Z from the
  covariance of the readings. The part of sensor noise that goes through the loop is taken for
  motion; it is tiny.)
- The ends of the record are known, nothing outside the band is used, and torques are read on time.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from armimp_common.arrays import ComplexArray, FloatArray
from armimp_common.errors import ConfigurationError, DataError
from armimp_estimation.estimators.lpm import responses
from armimp_estimation.mbk import MBK
from armimp_estimation.record import TrialRecord
from armimp_estimation.spectra import BAND

# Condition number of the normalised information beyond which its inverse is rounding error.
_WORST_CONDITION = 1e12


@dataclass(frozen=True, kw_only=True)
class SensorNoise:
    """White noise of the sensors.

    Raises
    ------
    ConfigurationError
        If one is negative or not finite.
    """

    angle: float
    torque: float
    """Standard deviations of each sample, rad and N·m."""

    def __post_init__(self) -> None:
        for name in ("angle", "torque"):
            value = getattr(self, name)
            if not 0.0 <= value < np.inf:
                raise ConfigurationError(f"noise of the {name} must not be negative, got {value!r}")

    @classmethod
    def of_rounding(cls, *, angle: float, torque: float) -> "SensorNoise":
        """Noise of readings rounded to counts q (rad, N·m): uniform within one, ``q/sqrt(12)``."""
        return cls(angle=angle / float(np.sqrt(12.0)), torque=torque / float(np.sqrt(12.0)))


def motion_in_band(
    records: Sequence[TrialRecord],
    band: tuple[float, float] = BAND,
) -> tuple[FloatArray, ComplexArray]:
    """Return Fourier transforms of the angles of trials, as far as they respond to perturbation.

    Parameters
    ----------
    records : sequence of TrialRecord
        Records of equal rate, one for each joint.
    band : tuple of float
        Lowest and highest frequency, Hz.

    Returns
    -------
    f : (n_freq,) NDArray
        Frequencies that all perturbations have, Hz.
    motion : (trials, n, n_freq) NDArray
        ``Σ_t θ(t) exp(-jωt)``, rad.

    Raises
    ------
    DataError
        If a record is too short, or the perturbation has no power in the band.
    """
    columns = responses(records, [record.position for record in records], band)
    motion = []
    for column, record in zip(columns, records, strict=True):
        bins = np.rint(column.f * record.duration).astype(np.intp)
        force = np.fft.rfft(record.perturbation[record.perturbed_joint])[bins]
        motion.append(column.response * force)
    return columns[0].f, np.stack(motion)


def error_covariance(
    truth: MBK,
    f: FloatArray,
    samples: int,
    noise: SensorNoise,
    disturbance: FloatArray | None = None,
) -> ComplexArray:
    """Return the covariance Σ of the Fourier transform of ``τ - Z θ``.

    Parameters
    ----------
    truth : MBK
    f : (n_freq,) NDArray
        Hz.
    samples : int
        Length N of each trial.
    noise : SensorNoise
    disturbance : (n_freq,) NDArray, optional
        Two-sided power spectrum of the voluntary torque of each joint for each sample, (N·m)²; its
        mean over all frequencies, negative ones as well, is the variance.

    Returns
    -------
    (n_freq, n, n) NDArray
        (N·m)².
    """
    impedance = np.moveaxis(truth.impedance(f), -1, 0)
    alike = np.full(f.size, noise.torque**2)
    if disturbance is not None:
        alike = alike + disturbance
    through_angles = noise.angle**2 * (impedance @ np.conj(np.swapaxes(impedance, 1, 2)))
    covariance: ComplexArray = samples * (
        alike[:, None, None] * np.eye(truth.joints) + through_angles
    )
    return covariance


def cramer_rao_bound(f: FloatArray, motion: ComplexArray, covariance: ComplexArray) -> FloatArray:
    """Return the smallest standard deviations that unbiased estimates of M, B and K can have.

    Parameters
    ----------
    f : (n_freq,) NDArray
        Hz.
    motion : (trials, n, n_freq) NDArray
        Fourier transforms of the angles, rad.
    covariance : (n_freq, n, n) NDArray
        As from :func:`error_covariance`; if it is 0 everywhere, so is the bound.

    Returns
    -------
    (3, n, n) NDArray
        For M, B and K, in kg·m², N·m·s/rad and N·m/rad.

    Raises
    ------
    DataError
        If it is singular at some frequencies, or the motion cannot separate the parameters.
    """
    n = motion.shape[1]
    if not covariance.any():
        return np.zeros((3, n, n))
    try:
        precision = np.linalg.inv(covariance)
    except np.linalg.LinAlgError:
        raise DataError("noise is 0 in some channels only; there is no bound") from None
    s = 2j * np.pi * f
    # (trials, 3n, n_freq): derivatives by M, B and K, each by joint.
    slopes = np.concatenate((s**2 * motion, s * motion, motion), axis=1)
    products = np.einsum("taf,tbf->fab", np.conj(slopes), slopes)
    information = 2.0 * np.real(np.einsum("fil,fab->ialb", precision, products))
    information = information.reshape(3 * n * n, 3 * n * n)
    # Scaled to a unit diagonal before the inversion: information on M and K differs by ω⁴.
    size = np.sqrt(np.diagonal(information))
    if not (size > 0.0).all():
        raise DataError("a joint does not move; there is no information about it")
    normal = information / size[:, None] / size
    if np.linalg.cond(normal) > _WORST_CONDITION:
        raise DataError("the motion does not tell M, B and K of all joints apart")
    variance = np.diagonal(np.linalg.inv(normal)) / size**2
    bound: FloatArray = np.moveaxis(np.sqrt(variance).reshape(n, 3, n), 1, 0)
    return bound
