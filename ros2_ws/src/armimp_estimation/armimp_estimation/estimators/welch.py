"""Impedance by averaged spectra: one column at a time, or all columns together.

Both estimators use the frequency responses of :mod:`armimp_estimation.frf`. In the trial that
perturbs joint k, the torque obeys ``τ_i = Σ_j Z_ij θ_j + v_i``, where the perturbation x does not
cause the disturbance v. So ``T = Z R + V``, and ``V_ik = G_{x v_i}/G_xx`` has the variance
``G_vv/(n_d G_xx)``. Motion that v causes through the loop only has an effect of second order.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from armimp_common.arrays import ComplexArray, FloatArray
from armimp_common.errors import DataError
from armimp_estimation.estimators.estimate import ImpedanceEstimate, disturbances, noise_of
from armimp_estimation.frf import FrfMatrix, frf_matrix, order_trials
from armimp_estimation.trial import TrialData


@dataclass(frozen=True, kw_only=True)
class WelchSiso:
    """The estimator of Kang & Zhang, eq. 17-18: ``Z_ik = T_ik / R_kk``.

    It assumes that locked joints are still. If they move, it matters in two ways: motion that
    follows the perturbation biases the estimate by ``Σ_{j≠k} Z_ij R_jk / R_kk``; other motion
    acts as noise and is part of the variance.
    """

    name: str = "welch_siso"

    def estimate(self, trials: Sequence[TrialData]) -> ImpedanceEstimate:
        """Estimate the whole matrix from n trials, one for each joint, in any order.

        The variance of a column is ``G_ee / ((n_d - 1) G_xx |R_kk|²)`` with ``e = τ_i - Z_ik θ_k``;
        see :func:`armimp_estimation.frf.noise_gain` for the ``n_d - 1``.

        Raises
        ------
        DataError
            If a joint has no trial, or there are too few segments, no perturbation or no motion.
        """
        ordered = order_trials(trials)
        frf = frf_matrix(ordered)
        n = len(ordered)
        own = frf.R[np.arange(n), np.arange(n)]
        for k, f in np.argwhere(~(np.abs(own) > 0.0)):
            raise DataError(
                f"joint {k + 1} does not follow its perturbation at {frf.f[f]:.4g} Hz",
                "joint_does_not_move",
            )
        # Each column uses the angle of the perturbed joint only.
        still = frf.R * np.eye(n)[:, :, None]
        inverse, impedance = invert(still, frf.f), frf.T / own
        taken = np.einsum("ikf,kl->kilf", impedance, np.eye(n))
        disturbance = disturbances(taken, frf.covariance)
        moving = multiply(multiply(impedance, frf.R - still), inverse)
        biases = (*known_biases(frf, impedance, still, inverse, trials[0]), moving)
        return matrix_estimate(self.name, ordered, frf, impedance, disturbance, inverse, biases)


@dataclass(frozen=True, kw_only=True)
class WelchFull:
    """All columns together: ``Z = T R⁻¹``, exact also when locked joints move with joint k."""

    name: str = "welch_full"

    def estimate(self, trials: Sequence[TrialData]) -> ImpedanceEstimate:
        """Estimate the whole matrix from n trials, one for each joint, in any order.

        The error is ``V R⁻¹``. Columns of V come from different trials, so they are independent:
        ``var(Z_ij) = Σ_k var(V_ik) |R⁻¹_kj|²``, with ``var(V_ik)`` from the residual
        ``e = τ_i - Σ_j Z_ij θ_j`` in trial k.

        Raises
        ------
        DataError
            If a joint has no trial, there are too few segments, or R cannot be inverted.
        """
        ordered = order_trials(trials)
        frf = frf_matrix(ordered)
        inverse = invert(frf.R, frf.f)
        impedance = multiply(frf.T, inverse)
        disturbance = disturbances([impedance] * len(ordered), frf.covariance)
        biases = known_biases(frf, impedance, frf.R, inverse, trials[0])
        return matrix_estimate(self.name, ordered, frf, impedance, disturbance, inverse, biases)


def known_biases(
    frf: FrfMatrix, Z: ComplexArray, R: ComplexArray, inverse: ComplexArray, trial: TrialData
) -> tuple[ComplexArray, ...]:
    """Known biases of averaged spectra, as systematic standard errors of the impedance.

    Leakage: a Hann window averages a response over neighbouring bins with the weights 1/6, 2/3,
    1/6, which adds a sixth of the second difference: ``(ΔΔT - Z ΔΔR) R⁻¹ / 6``. Skew: torques that
    are read before the update of the command are late by half a sample, ``jωL/2 Z``.

    Parameters
    ----------
    frf : FrfMatrix
        Frequency responses.
    Z, R, inverse : ndarray, shape (n, n, n_freq)
        Estimated impedance, responses of those angles that the estimator uses, and their inverse.
    trial : TrialData
        One of the trials. If its spectra are only at lines of the perturbation, nothing leaks.
    """
    if frf.f.size < 3:
        return ()
    skew = 1j * np.pi * frf.f / trial.record.rate * Z
    if trial.at_lines:
        return (skew,)
    change = _second_difference(frf.T) - multiply(Z, _second_difference(R))
    return multiply(change, inverse) / 6.0, skew


def _second_difference(values: ComplexArray) -> ComplexArray:
    inner = values[..., 2:] - 2.0 * values[..., 1:-1] + values[..., :-2]
    return np.concatenate([inner[..., :1], inner, inner[..., -1:]], axis=-1)


def invert(matrix: ComplexArray, f: FloatArray) -> ComplexArray:
    """Invert a matrix of shape (n, n, n_freq) at each frequency.

    Raises
    ------
    DataError
        If the matrix is singular at a frequency, which the message names.
    """
    # A fresh array, so that the result cannot depend on the memory layout of the matrix.
    stack = np.ascontiguousarray(np.moveaxis(matrix, 2, 0))
    try:
        inverse = np.linalg.inv(stack)
    except np.linalg.LinAlgError as error:
        singular = int(np.argmin(np.linalg.matrix_rank(stack)))
        raise DataError(
            f"motion of the joints is linearly dependent at {f[singular]:.4g} Hz: "
            "the impedance matrix is not determined"
        ) from error
    return np.ascontiguousarray(np.moveaxis(inverse, 0, 2))


def multiply(left: ComplexArray, right: ComplexArray) -> ComplexArray:
    """Matrix product at each frequency; shapes (n, m, n_freq) and (m, p, n_freq)."""
    product = np.zeros((left.shape[0], right.shape[1], left.shape[2]), dtype=np.complex128)
    for middle in range(left.shape[1]):
        product += left[:, middle, None, :] * right[None, middle, :, :]
    return product


def matrix_estimate(
    name: str,
    trials: Sequence[TrialData],
    frf: FrfMatrix,
    impedance: ComplexArray,
    disturbance: ComplexArray,
    inverse: ComplexArray,
    biases: tuple[ComplexArray, ...],
) -> ImpedanceEstimate:
    """Assemble the result of an averaged-spectra estimator, from trials in order of joint k."""
    # Trials may differ in length: the shortest has the least certain variance.
    shortest = min(trials, key=lambda trial: trial.spectra.effective_averages).spectra
    return ImpedanceEstimate(
        name=name,
        f=frf.f,
        Z=impedance,
        noise=noise_of(disturbance, inverse),
        bin_correlation=shortest.bin_correlation,
        averages=shortest.effective_averages,
        T=frf.T,
        R=frf.R,
        systematics=biases,
        covariance=frf.covariance,
        disturbance=disturbance,
        inverse=inverse,
    )
