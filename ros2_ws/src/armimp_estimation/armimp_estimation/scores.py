"""Scores that tell how far an estimate can be trusted, each over the band of the spectra.

Band means are unweighted means over the frequencies of the band.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from armimp_common.arrays import ComplexArray, FloatArray
from armimp_common.errors import DataError
from armimp_estimation.estimators.estimate import ImpedanceEstimate
from armimp_estimation.frf import FrfMatrix
from armimp_estimation.mbk import MBK
from armimp_estimation.record import TrialRecord
from armimp_estimation.spectra import CrossSpectra
from armimp_estimation.trial import TrialData
from armimp_estimation.weights import spread_of_mean, with_neighbours

NORMAL_95 = 1.959963984540054
"""Standard errors on either side of an estimate that make a 95 % confidence interval."""
CHANCE = 4.0
"""Standard deviations above the mean that a band mean of chance coherence hardly ever exceeds."""


def vaf(estimate: ImpedanceEstimate, truth: MBK) -> FloatArray:
    """Variance accounted for (VAF) of each element, relative to the true impedance, %.

    ``VAF_ij = 100 (1 - Σ_f |Z_ij - Ẑ_ij|² / Σ_f |Z_ij|²)``; NaN where the true element is zero.

    Returns
    -------
    ndarray, shape (n, n)
    """
    true = truth.impedance(estimate.f)
    error = np.sum(np.abs(true - estimate.Z) ** 2, axis=2)
    power = np.sum(np.abs(true) ** 2, axis=2)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(power > 0.0, error / power, np.nan)
    accounted: FloatArray = 100.0 * (1.0 - share)
    return accounted


def coherence(spectra: CrossSpectra, x: int, y: int) -> FloatArray:
    """Ordinary coherence ``γ² = |G_xy|² / (G_xx G_yy)`` of two channels, shape (n_freq,).

    It is 0 where a channel has no power.
    """
    power = spectra.power(x) * spectra.power(y)
    common = np.abs(spectra.matrix[x, y]) ** 2
    ratio = np.divide(common, power, out=np.zeros_like(power), where=power > 0.0)
    bounded: FloatArray = np.minimum(ratio, 1.0)  # rounding may lift full coherence above 1
    return bounded


def derived_coherence(
    trial: TrialData, joint: int, f: FloatArray, impedance: ComplexArray
) -> FloatArray:
    """Coherence of the angle of joint k with the torque of joint i, as if without feedback.

    ``|Ẑ|² G_θθ / (|Ẑ|² G_θθ + G_nn)`` with ``G_nn = (1 - γ²(θ_k, τ_i)) G_ττ``. It is the share of
    the torque that the impedance explains, and stays near 1 even if other joints were not still.

    Parameters
    ----------
    trial : TrialData
        Trial that perturbed joint k.
    joint : int
        Joint i of the torque, 0-based.
    f : ndarray, shape (m,)
        Frequencies of the impedance, Hz. If the spectra have others, it is interpolated to those.
    impedance : ndarray, shape (m,)
        Estimate of ``Z_ik``, N·m/rad.

    Returns
    -------
    ndarray, shape (n_freq,)
        At the frequencies of the spectra.
    """
    angle = trial.position_channel(trial.joint)
    torque = trial.torque_channel(joint)
    values = impedance if np.array_equal(f, trial.f) else np.interp(trial.f, f, impedance)
    explained = np.abs(values) ** 2 * trial.spectra.power(angle)
    noise = (1.0 - coherence(trial.spectra, angle, torque)) * trial.spectra.power(torque)
    total = explained + noise
    return np.divide(explained, total, out=np.zeros_like(total), where=total > 0.0)


def coherence_significance(averages: float) -> float:
    """Coherence that independent signals exceed in 5 % of all cases: ``1 - 0.05^{1/(n_d - 1)}``.

    Parameters
    ----------
    averages : float
        Number n_d of independent averages (not of overlapped segments).

    Returns
    -------
    float
        Level of γ²; 1 for a single average, with which any coherence is meaningless.
    """
    return float(1.0 - 0.05 ** (1.0 / (averages - 1.0))) if averages > 1.0 else 1.0


def coherence_of_chance(spectra: CrossSpectra) -> float:
    """Level that the band mean of the coherence of unrelated signals hardly ever exceeds.

    At each frequency, that coherence has a beta distribution with the parameters 1 and ``n_d - 1``,
    whose mean is ``1/n_d``. Where averages at two frequencies are correlated by ρ, coherences are
    by ρ². The level is `CHANCE` standard deviations of the band mean above ``1/n_d``.
    """
    averages = spectra.effective_averages
    if not averages > 1.0:
        return 1.0
    single = np.sqrt((averages - 1.0) / (averages + 1.0)) / averages
    spread = single * spread_of_mean(spectra.bin_correlation)
    return float(1.0 / averages + CHANCE * spread)


def require_motion(record: TrialRecord) -> None:
    """Refuse a trial whose perturbed joint rests, or in which its torque transducer is dead.

    Raises
    ------
    DataError
        If angle or torque of the perturbed joint did not change at all.
    """
    k = record.perturbed_joint
    if np.ptp(record.position[k]) == 0.0:
        raise DataError(
            f"trial {record.trial}: {record.joint_names[k]} is perturbed but does not move",
            "joint_does_not_move",
        )
    if np.ptp(record.torque[k]) == 0.0:
        raise DataError(
            f"trial {record.trial}: torque of {record.joint_names[k]} reads "
            f"{record.torque[k, 0]:.4g} N·m throughout"
        )


def lock_ratio(trials: Sequence[TrialData], frf: FrfMatrix) -> FloatArray:
    """Motion of each joint that the perturbation causes, relative to that of the perturbed one.

    ``sqrt(Σ_f |R_ik|² G_xx / Σ_f |R_kk|² G_xx)`` over the band, with the expected contribution of
    noise subtracted. So motion outside the band does not count, nor does motion with another cause,
    such as the dither of locked joints. Trials are in order of k, and `frf` has their responses.

    Returns
    -------
    ndarray, shape (n, n)
        Row i is the joint that moves, column k the perturbed one; 1 on the diagonal.
    """
    power = np.stack([trial.input_power for trial in trials])
    noise = frf.variance[: len(frf.R)]
    caused = np.sum((np.abs(frf.R) ** 2 - noise) * power[None], axis=2)
    # NaN where the perturbed joint itself moves no more than by chance.
    own = np.where(np.diag(caused) > 0.0, np.diag(caused), np.nan)
    ratio: FloatArray = np.sqrt(np.maximum(caused, 0.0) / own[None])
    return ratio


def bias_bound(frf: FrfMatrix) -> FloatArray:
    """Relative bias of ``T_ik / R_kk`` that motion of locked joints may cause.

    For a locked joint i, it is the band mean of ``|Ẑ_ii R_ik / T_ik|``, the share of the joint's
    torque that is due to its own motion. For the perturbed joint, where that means nothing, it is
    the band mean of ``Σ_j |Ẑ_kj R_jk / T_kk|`` over the locked joints j. ``Ẑ_ij = T_ij / R_jj``.

    Returns
    -------
    ndarray, shape (n, n)
        Row i is the joint of the torque, column k the perturbed joint.
    """
    n = frf.R.shape[0]
    bound = np.zeros((n, n))
    # Less the power of noise, which would look like bias where torques are small.
    R = np.sqrt(np.maximum(np.abs(frf.R) ** 2 - frf.variance[:n], 0.0))
    with np.errstate(divide="ignore", invalid="ignore"):
        for i, k in np.ndindex(n, n):
            for j in [i] if i != k else np.delete(np.arange(n), k):
                share = np.abs(frf.T[i, j] / frf.R[j, j] * R[j, k] / frf.T[i, k])
                bound[i, k] += np.mean(share)
    return bound


def realisation(estimate: ImpedanceEstimate, target: MBK | None) -> FloatArray:
    """Deviation of the robot from the target impedance of each joint while that joint is perturbed.

    The law aims at ``Z_rd θ_k = τΔ - τ_k``, so the robot realises ``Ẑ_r = (1 - T_kk)/R_kk``, which
    is ``1/R_kk - Ẑ_kk`` where locked joints are still. Its deviation, relative to the target, is
    ``sqrt(Σ_f (|Ẑ_r - Z_rd|² - var Ẑ_r) / Σ_f |Z_rd|²)``.

    Parameters
    ----------
    estimate : ImpedanceEstimate
        Estimate with the responses T and R and their covariance.
    target : MBK or None
        Target impedance Z_rd, of which only the diagonal counts, if it is known.

    Returns
    -------
    ndarray, shape (n, 3)
        Deviation by k, and the ends of its 95 % interval. The ends are NaN without a covariance;
        all values are NaN without a target for these joints.
    """
    if target is None or target.joints != estimate.joints:
        return np.full((estimate.joints, 3), np.nan)
    every = np.arange(estimate.joints)
    moved, asked = estimate.R[every, every], target.impedance(estimate.f)[every, every]
    shown = (1.0 - estimate.T[every, every]) / moved
    error, sizes = shown - asked, np.sum(np.abs(asked) ** 2, axis=1)
    if estimate.covariance is None:
        plain = np.sqrt(np.sum(np.abs(error) ** 2, axis=1) / sizes)
        return np.stack([plain, *np.full((2, plain.size), np.nan)], axis=1)
    found = []
    for k, motion in enumerate(moved):
        pair = [k, estimate.joints + k]
        shares = np.stack([shown[k], np.ones_like(motion)]) / motion
        noise = np.einsum(
            "af,abf,bf->f", shares, estimate.covariance[k][np.ix_(pair, pair)], np.conj(shares)
        ).real
        square = float(np.sum(np.abs(error[k]) ** 2 - noise))
        spread = NORMAL_95 * np.sqrt(_variance_of_power(error[k], noise, estimate.bin_correlation))
        ends = np.array([square, square - spread, square + spread])
        found.append(np.sqrt(np.maximum(ends, 0.0) / sizes[k]))
    return np.stack(found)


def _variance_of_power(values: ComplexArray, noise: FloatArray, correlation: FloatArray) -> float:
    """Variance of ``Σ_f |v|²`` for values v with circular noise of the variance `noise`."""
    scaled = values * np.sqrt(noise)
    least = float(noise @ with_neighbours(noise, correlation**2))
    crossed = float(np.vdot(scaled, with_neighbours(scaled, correlation)).real)
    # The values' own noise is part of `crossed`, too; the rest can't be negative.
    return least + 2.0 * max(crossed - least, 0.0)


@dataclass(frozen=True, kw_only=True, eq=False)
class Coherences:
    """Coherences behind an estimate, at the frequencies of the spectra."""

    f: FloatArray
    """Frequencies, Hz; shape (n_freq,)."""
    motion: FloatArray
    """``γ²(τΔ_k, θ_k)`` by k; shape (n, n_freq)."""
    torque: FloatArray
    """``γ²(τΔ_k, τ_i)`` by i, k; shape (n, n, n_freq)."""
    derived: FloatArray
    """Derived coherence, see :func:`derived_coherence`, by i, k; shape (n, n, n_freq)."""

    @classmethod
    def of(cls, trials: Sequence[TrialData], estimate: ImpedanceEstimate) -> "Coherences":
        """Compute the coherences behind an estimate from trials in order of the perturbed joint."""
        joints = range(len(trials))
        motion = [coherence(one.spectra, 0, one.position_channel(one.joint)) for one in trials]
        torque = [
            [coherence(one.spectra, 0, one.torque_channel(i)) for one in trials] for i in joints
        ]
        derived = [
            [derived_coherence(one, i, estimate.f, estimate.Z[i, one.joint]) for one in trials]
            for i in joints
        ]
        return cls(
            f=trials[0].f,
            motion=np.stack(motion),
            torque=np.stack(torque),
            derived=np.stack(derived),
        )
