"""Baseline that perturbs all joints at once: ``Z = T R⁻¹`` from multi-input spectra.

The decomposition takes one trial for each joint; this takes trials in which every joint is
compliant and has a perturbation of its own. With the n perturbations x, ``G_xy = G_xx H^T`` gives
both responses, ``R^T = G_xx⁻¹ G_xθ`` and ``T^T = G_xx⁻¹ G_xτ``. Inputs must not be coherent: their
common part in a finite record can be attributed to neither, and adds to the variance.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from armimp_common.arrays import EPS, TINY, ComplexArray, FloatArray
from armimp_common.errors import DataError
from armimp_estimation.estimators.estimate import ImpedanceEstimate
from armimp_estimation.estimators.welch import invert, multiply
from armimp_estimation.record import TrialRecord
from armimp_estimation.spectra import SEGMENT, CrossSpectra, cross_spectra


@dataclass(frozen=True, kw_only=True, eq=False)
class InputCoupling:
    """How much the perturbations of the joints have in common."""

    f: FloatArray
    """Frequencies, Hz; shape (n_freq,)."""
    coherence: FloatArray
    """Ordinary coherence of each pair; 1 on the diagonal. For independent perturbations its mean is
    one over the number of averages; shape (n, n, n_freq)."""
    condition: FloatArray
    """Condition number of the matrix of their spectra, each scaled to power 1; shape (n_freq,)."""
    inflation: FloatArray
    """Factor by which coupling raises the variance of the responses to each perturbation, ``1/(1 -
    γ²)`` with the multiple coherence γ² of it with the others; shape (n, n_freq)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class MimoEstimate:
    """Impedance from trials that perturb all joints, and how far their inputs were independent."""

    impedance: ImpedanceEstimate
    coupling: InputCoupling


def input_coupling(f: FloatArray, spectra: ComplexArray) -> InputCoupling:
    """Return the coupling of inputs from the matrix of their spectra, shape (n, n, n_freq).

    Raises
    ------
    DataError
        If an input has no power at a frequency.
    """
    power = np.einsum("iif->if", spectra).real
    if not (power > 0.0).all():
        joint, bin_ = np.argwhere(~(power > 0.0))[0]
        raise DataError(f"no perturbation of joint {joint + 1} at {f[bin_]:.4g} Hz")
    scaled = spectra / np.sqrt(power[:, None] * power[None, :])
    eigenvalues = np.linalg.eigvalsh(np.moveaxis(scaled, 2, 0))
    smallest = np.maximum(eigenvalues[:, 0], TINY)
    regular = eigenvalues[:, 0] > EPS * eigenvalues[:, -1]
    inflation = np.full(power.shape, np.inf)
    inverse = np.linalg.inv(np.moveaxis(scaled, 2, 0)[regular])
    inflation[:, regular] = np.einsum("fii->if", inverse).real
    return InputCoupling(
        f=f,
        coherence=np.minimum(np.abs(scaled) ** 2, 1.0),
        condition=eigenvalues[:, -1] / smallest,
        inflation=inflation,
    )


def estimate_mimo(
    records: Sequence[TrialRecord],
    segment: int = SEGMENT,
    *,
    largest_condition: float = 100.0,
) -> MimoEstimate:
    """Estimate the impedance matrix from trials that perturb all joints at once.

    Parameters
    ----------
    records : sequence of TrialRecord
        One or several trials of one arm. It does not matter which joint a record names as the
        perturbed one.
    segment : int
        Length of the segments, samples.
    largest_condition : float
        Largest condition number of the input spectra, see :class:`InputCoupling`.

    Returns
    -------
    MimoEstimate
        The variance of ``Z_ij`` is ``G_ee/(n_d - n) Σ_lm R⁻¹_lj (G_xx⁻¹)_lm conj(R⁻¹_mj)`` with
        ``e = τ_i - Σ_j Z_ij θ_j``.

    Raises
    ------
    DataError
        If there is no record, records do not belong together, are too few or too short, or their
        perturbations are not independent.
    """
    n, pooled = _pool(records, segment)
    f, matrix = pooled.f, pooled.matrix
    x, theta, tau = slice(0, n), slice(n, 2 * n), slice(2 * n, 3 * n)
    coupling = input_coupling(f, matrix[x, x])
    worst = int(np.argmax(coupling.condition))
    if not coupling.condition[worst] <= largest_condition:
        raise DataError(
            f"perturbations of the joints are not independent: condition number "
            f"{coupling.condition[worst]:.3g} at {f[worst]:.4g} Hz (limit {largest_condition:.3g})"
        )
    freedom = pooled.effective_averages - n
    if not freedom > 0.0:
        raise DataError(
            f"{pooled.effective_averages:.3g} independent averages are too few for {n} inputs"
        )
    inputs = invert(matrix[x, x], f)
    R = np.swapaxes(multiply(inputs, matrix[x, theta]), 0, 1)
    T = np.swapaxes(multiply(inputs, matrix[x, tau]), 0, 1)
    inverse = invert(R, f)
    impedance = multiply(T, inverse)

    gain = np.einsum("ljf,lmf,mjf->jf", inverse, inputs, np.conj(inverse)).real / freedom
    channels = matrix[n:, n:]
    unexplained = np.concatenate(
        (-impedance, np.broadcast_to(np.eye(n)[:, :, None], impedance.shape)), axis=1
    )
    residual = np.einsum("icf,cdf,idf->if", np.conj(unexplained), channels, unexplained).real
    terms = np.einsum("icf,ccf->if", np.abs(unexplained) ** 2, channels).real
    residual = np.maximum(residual, EPS * terms)
    return MimoEstimate(
        impedance=ImpedanceEstimate(
            name="mimo",
            f=f,
            Z=impedance,
            noise=residual[:, None, :] * gain[None, :, :],
            bin_correlation=pooled.bin_correlation,
            averages=freedom + 1.0,
            T=T,
            R=R,
        ),
        coupling=coupling,
    )


def _pool(records: Sequence[TrialRecord], segment: int) -> tuple[int, CrossSpectra]:
    """Number of joints, and spectra of perturbations, angles and torques over all records."""
    if not records:
        raise DataError("no trial to estimate from")
    first = records[0]
    spectra = []
    for record in records:
        if (record.joint_names, record.rate) != (first.joint_names, first.rate):
            raise DataError(
                f"trials {first.trial} and {record.trial} are of different joints or rates"
            )
        for joint, name in enumerate(record.joint_names):
            if not record.perturbation[joint].any():
                raise DataError(
                    f"trial {record.trial} does not perturb {name}: "
                    "all joints have to be perturbed at once"
                )
        signals = np.concatenate((record.perturbation, record.position, record.torque))
        try:
            spectra.append(cross_spectra(signals, rate=record.rate, segment=segment))
        except DataError as error:
            raise DataError(f"trial {record.trial}: {error}") from error
    segments = sum(one.segments for one in spectra)
    return first.joints, CrossSpectra(
        f=spectra[0].f,
        matrix=np.sum([one.matrix * (one.segments / segments) for one in spectra], axis=0),
        segments=segments,
        effective_averages=sum(one.effective_averages for one in spectra),
        bin_correlation=spectra[0].bin_correlation,
    )
