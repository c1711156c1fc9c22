"""Frequency responses from the perturbation to angles and torques, by averaged spectra.

Kang & Zhang, eq. 15-16: ``R_ik = G_{τΔk θi} / G_{τΔk τΔk}``, ``T_ik = G_{τΔk τi} / G_{τΔk τΔk}``.
The perturbation is known exactly, so no disturbance in the loop biases either of them.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import reduce

import numpy as np

from armimp_common.arrays import EPS, BoolArray, ComplexArray, FloatArray
from armimp_common.errors import DataError
from armimp_estimation.periods import has_power
from armimp_estimation.spectra import CrossSpectra, sums_within
from armimp_estimation.trial import TrialData

# Largest perturbation of another joint, relative to that of the perturbed one, that is accepted as
# crosstalk. A proportional one is harmless, as T R⁻¹ stays the same; any other is a disturbance.
_BESIDE = 0.05
# Power of a perturbation, relative to its largest, below which it is leakage of the window.
_LEAKED = 1e-5
# Least ratio of power to noise with which a response may be a divisor: the ratio of two responses
# is then drawn towards that of their noise by a share of exp(-2). Where a person pushes and the
# perturbation is weak, 4 would leave out bins with half of the information on the stiffness.
_STANDS_OUT = 2.0
# Hz on either side over which the power of a response is averaged.
_ALIKE = 0.6


@dataclass(frozen=True, kw_only=True, eq=False)
class FrfMatrix:
    """All columns of the frequency responses."""

    f: FloatArray
    """Frequencies, Hz; shape (n_freq,)."""
    R: ComplexArray
    T: ComplexArray
    """Responses of angles (rad/(N·m)) and torques; first index the responding, second the perturbed
    joint; shape (n, n, n_freq)."""
    covariance: ComplexArray
    """As in :class:`armimp_estimation.estimators.estimate.ImpedanceEstimate`; shape
    (n, 2n, 2n, n_freq)."""

    @property
    def variance(self) -> FloatArray:
        """Variance of each value of R and, below, of T, shape (2n, n, n_freq)."""
        variance: FloatArray = np.einsum("kaaf->akf", self.covariance).real
        return variance


def noise_gain(trial: TrialData) -> FloatArray:
    """Variance of a response per unit of residual power density, shape (n_freq,).

    A response is estimated as ``G_xy / G_xx``. With n_d independent averages, and with e the part
    of y that the perturbation x does not explain, its variance is ``G_ee_true / (n_d G_xx)``. The
    residual after estimation lacks the part that x explains by chance, one of the n_d degrees of
    freedom: ``E[G_ee] = G_ee_true (n_d - 1) / n_d``. Together: ``1 / ((n_d - 1) G_xx)``.

    Where leakage is the only error, this is too high by a factor of about two: unlike noise, the
    leakage at the ends of overlapping segments cancels in part.

    Raises
    ------
    DataError
        If the trial has too few segments, or the perturbation has no power in the band.
    """
    averages = trial.spectra.effective_averages
    where = f"trial of joint {trial.joint + 1}"
    if not averages > 1.0:
        raise DataError(
            f"{where}: {trial.spectra.segments} segment gives no measure of noise, "
            "at least 2 are needed",
            "record_too_short",
        )
    power = trial.input_power
    # Written so that NaN fails, too.
    if not (power > 0.0).all():
        raise DataError(f"{where}: no perturbation at {trial.f[~(power > 0.0)][0]:.4g} Hz")
    return 1.0 / ((averages - 1.0) * power)


def stands_out(f: FloatArray, response: ComplexArray, variance: FloatArray) -> BoolArray:
    """Where a response exceeds its noise so far that it may be a divisor, mask of shape (n_freq,).

    In a loop, noise alone gives torque and angle some ratio. Where the perturbation has hardly any
    power, as between the lines of a few sines, the ratio of two responses is biased towards it,
    at all such frequencies alike (weak instruments: Staiger & Stock, *Econometrica* 65, 1997).

    Parameters
    ----------
    f : ndarray, shape (n_freq,)
        Frequencies, Hz.
    response : ndarray, shape (n_freq,)
        Response. Its power is averaged over frequencies around, weighted by inverse variances:
        selecting bins by their own power would favour those that are large by chance.
    variance : ndarray, shape (n_freq,)
        Variance of the response.
    """
    squares = np.abs(response) ** 2
    if not squares.all():
        return np.zeros(f.size, dtype=np.bool_)
    precision = 1.0 / np.maximum(variance, EPS * squares)
    terms = np.stack((precision * squares - 1.0, precision))
    (power, total), _ = sums_within(f, terms, _ALIKE)
    return np.asarray(precision * power >= _STANDS_OUT * total)


def frf_matrix(trials: Sequence[TrialData]) -> FrfMatrix:
    """Frequency responses from trials which :func:`order_trials` has put in order.

    Raises
    ------
    DataError
        If a trial has fewer than two segments or no perturbation in the band.
    """
    # From the residuals of the signals.
    covariance = np.stack([noise_gain(one) * unexplained(one.spectra, 0, 1) for one in trials])
    responses = [trial.spectra.matrix[0, 1:] / trial.input_power for trial in trials]
    stacked, n = np.stack(responses, axis=1), trials[0].record.joints
    return FrfMatrix(
        f=trials[0].f, R=stacked[:n].copy(), T=stacked[n:].copy(), covariance=covariance
    )


def unexplained(spectra: CrossSpectra, source: int, first: int) -> ComplexArray:
    """Spectra ``E[X conj(Y)]`` of the residuals of channels regressed on the channel `source`.

    The channels are those from `first` on; shape (C - first, C - first, n_freq).
    """
    matrix, crossed = spectra.matrix, spectra.matrix[source, first:]
    explained = crossed[:, None] * np.conj(crossed[None]) / spectra.power(source)
    left: ComplexArray = np.swapaxes(matrix[first:, first:], 0, 1) - explained
    return left


def order_trials(trials: Sequence[TrialData]) -> tuple[TrialData, ...]:
    """Sort trials by perturbed joint, and check that they match: one for each joint.

    Frequencies at which one perturbation has no power, or no line, are dropped from all spectra.

    Raises
    ------
    DataError
        If a joint has no trial or several, if the trials differ in joint names, rates or
        frequencies, or if a trial perturbs other joints too.
    """
    grids = [trial.f for trial in trials]
    common = reduce(np.intersect1d, grids, grids[0]) if grids else np.zeros(0)
    if common.size and any(f.size > common.size for f in grids):
        trials = [replace(one, spectra=one.spectra.at(common)) for one in trials]
    for contradiction in _contradictions(trials):
        raise DataError(contradiction, "trials_incomplete")
    first = trials[0]
    perturbed = np.all([_perturbed(trial) for trial in trials], axis=0)
    if perturbed.any() and not perturbed.all():
        trials = [
            replace(one, spectra=one.spectra.at(first.spectra.f[perturbed])) for one in trials
        ]
    return tuple(sorted(trials, key=lambda trial: trial.joint))


def _contradictions(trials: Sequence[TrialData]) -> Iterator[str]:
    """Yield the reasons why trials cannot be combined into one matrix."""
    if not trials:
        yield "no trial to estimate from"
    for trial in trials:
        one, other = trial.record, trials[0].record
        this, that, names = f"trial {one.trial}", f"trial {other.trial}", other.joint_names
        if one.joint_names != names:
            yield f"{this} has joints {', '.join(one.joint_names)}, {that} has {', '.join(names)}"
        if one.rate != other.rate:
            yield f"{this} has {one.rate} samples per second, {that} has {other.rate}"
        if not np.array_equal(trial.f, trials[0].f):
            yield f"trials {other.trial} and {one.trial} have spectra at different frequencies"
        sizes = np.std(one.perturbation, axis=1)
        for joint, name in enumerate(names):
            if joint != trial.joint and sizes[joint] > _BESIDE * sizes[trial.joint]:
                both = f"{name} as well as {names[trial.joint]}"
                yield f"{this} perturbs {both}: decomposition needs one joint at a time"
    for joint, name in enumerate(trials[0].record.joint_names):
        records = [trial.record for trial in trials if trial.joint == joint]
        numbers = [f"{one.trial} of {one.bag}" if one.bag else str(one.trial) for one in records]
        which = f"joint {joint + 1} ({name})"
        if not numbers:
            yield f"no trial perturbs {which}"
        if len(numbers) > 1:
            listed = ", ".join(numbers)
            yield f"{len(numbers)} trials perturb {which}, expected one: trials {listed}"


def _perturbed(trial: TrialData) -> BoolArray:
    """Where the perturbation of a trial has power, (n_freq,)."""
    record, f, power = trial.record, trial.f, trial.input_power
    if trial.at_lines:
        return np.ones(f.size, dtype=np.bool_)
    signal = record.perturbation[trial.joint]
    bins = np.rint(f * record.samples / record.rate).astype(np.intp)
    amplitudes = np.abs(np.fft.rfft(signal - signal.mean())[bins])
    return has_power(amplitudes) & (power >= _LEAKED * np.max(power))
