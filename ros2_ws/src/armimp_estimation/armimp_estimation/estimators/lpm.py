"""Impedance from the whole record by local polynomials, free of leakage and of torque skew."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import reduce

import numpy as np

from armimp_common.arrays import ComplexArray, FloatArray
from armimp_common.errors import DataError
from armimp_estimation.estimators.estimate import ImpedanceEstimate, combined, noise_of
from armimp_estimation.estimators.local_polynomial import (
    ORDER,
    LocalResponse,
    Mix,
    local_response,
)
from armimp_estimation.estimators.welch import invert, multiply
from armimp_estimation.fit import fit_columns, fit_mbk
from armimp_estimation.frf import order_trials, stands_out
from armimp_estimation.hold_correction import (
    HoldCorrection,
    command_steps,
    update_jump,
    without_skew,
)
from armimp_estimation.mbk import MBK
from armimp_estimation.periods import among, common_lines
from armimp_estimation.record import APART, TrialRecord
from armimp_estimation.signal_quality import (
    lost_motion,
    rounding_lead,
    speed_of,
    without_slow,
)
from armimp_estimation.spectra import BAND, bins_in_band
from armimp_estimation.torque_timing import TorqueTiming
from armimp_estimation.trial import TrialData, cleaned
from armimp_estimation.turning_links import at_posture, turning_inertia
from armimp_estimation.weighted_fit import FEWEST_FREQUENCIES

_SPARE_BINS = 3
"""Bins on either side beyond the degree of the polynomials, for degrees of freedom of the noise."""
_REFERENCE_BINS = 64
"""Largest number of frequencies from which the reference arm is fitted."""
_REFERENCE_STEPS = 3
"""Fits of the reference arm, each relative to the one before."""
_TINY = float(np.finfo(np.float64).tiny)
_SPAN = 0.25
"""Hz on either side of a bin that local polynomials may span, as arms have a resonance near 1 Hz.
In shorter records, whose bins are wider, fewer bins take part."""
_MOST_BINS = 36
"""Bins on either side at most: leakage then takes 1 of 24 parts of what a window tells. A periodic
perturbation has fewer windows, which may be wider."""
_FLOOR = 0.0003
"""Relative error that the M-B-K fit adds in quadrature to that of each value for its weight."""
_BY_CHANCE, _SCATTER = 1.1, 2.5
"""Ratio of the variance from the scatter of F lines to that from noise, if there is only chance:
its mean, and √F times the excess over this mean that is hardly ever reached."""
_SKEW = 0.002
"""Relative standard error, which no residual shows, of the jump correction of inertial torque. In
simulation its matrix D is within 0.7 % of the truth, and half of the time within 0.2 %."""
_RUBBING = 0.3
"""The same for the torque that overcomes friction, while chattering commands reverse the motion
within a control period, so that friction responds within the period."""


@dataclass(frozen=True, kw_only=True, eq=False)
class FittedColumn:
    """Column k of the fitted matrices, from the trial of joint k alone."""

    joint: int
    """Joint k, 0-based."""
    values: FloatArray
    """M (kg·m²), B (N·m·s/rad) and K (N·m/rad) from the angle of joint k to each torque; shape
    (3, n)."""
    errors: FloatArray
    """Their standard errors, without those of the calibration, in the same units; shape (3, n)."""
    preliminary: bool
    """Whether the motion of a locked joint is not accounted for, as that joint had no trial yet.
    The values may then be off by many standard errors."""


@dataclass(frozen=True, kw_only=True)
class LpmFull:
    """``Z = T R⁻¹`` from local polynomials, at every bin of the record.

    How torques were read tells what is corrected: see :mod:`armimp_estimation.torque_timing`.
    :mod:`armimp_estimation.hold_correction` identifies the part of the torques that jumps with the
    commands. Without commands in the records, the M-B-K fit estimates a common delay instead.
    """

    name: str = "lpm_full"
    """Name of the estimator."""

    def estimate(self, trials: Sequence[TrialData]) -> ImpedanceEstimate:
        """Estimate the whole matrix from n trials, one for each joint, in any order.

        The estimated response is not T, but the response E of ``e = τ - Z_0 θ``, where Z_0 is a
        reference arm with M, B and K close to those sought: ``Z = Z_0 + E R⁻¹``. The torques τ
        include the jumps with the commands that their readings lack. Motion that the
        perturbation does not cause, as by friction, adds to T, bin by bin, about what Z_0 predicts,
        so E is almost free of it, and of the resonance, which polynomials follow worst. The
        estimate is right for any Z_0. Its variance is that of ``(δE - (Z - Z_0) δR) R⁻¹``, from the
        joint covariance of all channels of each trial.

        Trials may differ in length: all are estimated at the frequencies of the shortest.

        Raises
        ------
        DataError
            If a joint has no trial, a record is too short, or R cannot be inverted.
        """
        records = [trial.record for trial in order_trials(trials)]
        reference = self._reference(records)
        turning = turning_inertia(records, *reference)
        if turning:
            records = at_posture(records, turning)
            reference = self._reference(records)
        return replace(self._estimate(records, *reference), turning=turning)

    def _estimate(
        self, records: Sequence[TrialRecord], reference: MBK, jump: HoldCorrection | None
    ) -> ImpedanceEstimate:
        """Do what :meth:`estimate` does, with one record for each joint, in their order.

        If only m joints have a record, estimate their columns alone, (n, m, n_freq), as if all
        other joints were still.
        """
        rate, n = records[0].rate, records[0].joints
        joints = [record.perturbed_joint for record in records]
        channels = _channels(records, jump)
        plain = self._residuals(records, channels, reference, jump)
        columns = [column.with_scatter_of_lines(slice(n, 2 * n)) for column in plain]
        f = columns[0].f
        stacked = np.stack([column.response for column in columns], axis=1)
        R = stacked[joints]
        inverse = invert(R, f)
        offset, added = (multiply(part, inverse) for part in (stacked[n : 2 * n], stacked[2 * n :]))
        impedance = reference.impedance(f)[:, joints] + offset
        torque = multiply(impedance, R)
        reversing, bending = _reversals(records, impedance, f)
        skewed = _doubts(added, f, jump, reversing, bending)

        every = _unit(2 * n, 3 * n, f)
        coefficients = every[n:].copy()
        every[n:, :n], coefficients[:, joints] = reference.impedance(f), -offset
        half_period = 0.5 / rate
        delay_uncertainty = _delay_uncertainty(records[0], jump)
        bounds: list[ComplexArray] = []
        lost: list[ComplexArray] = []
        whole = len(records) == n
        if whole:
            hidden = HiddenMotion(records, R, torque, inverse, f)
            ahead, bounds, lost = hidden.effects(impedance)
            impedance = impedance + ahead
            if jump is None and delay_uncertainty == half_period:
                bounds += _joints_held(impedance, f, half_period)
                lost += _untold_friction(records, impedance, f, bending)
            lost += _trials_apart(records, reference, R, inverse, f)
        disturbance = covariance_of(columns, coefficients)
        return ImpedanceEstimate(
            name=self.name,
            f=f,
            Z=impedance,
            noise=noise_of(disturbance, inverse),
            bin_correlation=_mean([column.bin_correlation() for column in columns]),
            averages=min(column.freedom for column in columns) + 1.0,
            T=torque,
            R=R,
            perturbed=() if whole else tuple(joints),
            systematics=(*bounds, *lost, *skewed),
            bounded=len(bounds),
            power=1.0 / np.stack([column.gain for column in columns]),
            weight_floor=_FLOOR,
            friction_skew=added.real.astype(np.complex128),
            delay_uncertainty=delay_uncertainty,
            delay_unknown=half_period,
            unbiased=True,
            uneven=_uneven(
                covariance_of(plain, coefficients), disturbance, torque, columns, joints
            ),
            without_slow=tuple(without_slow(records)) if whole else (),
            hold=jump,
            covariance=covariance_of(columns, every),
            disturbance=disturbance,
            inverse=inverse,
        )

    def column(self, record: TrialRecord, others: Sequence[TrialRecord] = ()) -> FittedColumn:
        """Fit column k of M, B and K to the trial of joint k so far, and to finished trials.

        With a trial of every other joint, the column is that of :meth:`estimate`, unless the
        inertia changes with the angles. Otherwise it is preliminary: motion of joints without a
        trial biases the values, and the standard errors do not include this bias.

        Parameters
        ----------
        record : TrialRecord
            The trial so far.
        others : sequence of TrialRecord
            Trials of other joints; the last one counts if a joint has several.

        Raises
        ------
        DataError
            If a record is too short, joint k does not move, or R cannot be inverted.
        """
        by_joint = {one.perturbed_joint: cleaned([one])[0][0] for one in (*others, record)}
        joints, k = sorted(by_joint), record.perturbed_joint
        records = [by_joint[joint] for joint in joints]
        found = self._estimate(records, *self._reference(records))
        preliminary = len(joints) < record.joints
        if preliminary:
            values, errors = fit_columns(found)
        else:
            fit = fit_mbk(found)
            values, errors = fit.values, fit.errors
        place = joints.index(k)
        return FittedColumn(
            joint=k,
            values=values[:, :, place],
            errors=errors[:, :, place],
            preliminary=preliminary,
        )

    def _residuals(
        self,
        records: Sequence[TrialRecord],
        channels: Sequence[FloatArray],
        reference: MBK,
        jump: HoldCorrection | None,
        f: FloatArray | None = None,
    ) -> list[LocalResponse]:
        """Responses of angles, torques less those of a reference arm, and skew corrections."""
        n = reference.joints

        def mixed(at: FloatArray) -> ComplexArray:
            skew = without_skew(at, records[0], jump)
            chosen = _unit(3 * n, n + skew.shape[1], at)
            chosen[n : 2 * n, :n] = -reference.impedance(at)
            chosen[n:, n:] = np.concatenate((skew, skew))
            chosen[2 * n :, n : 2 * n] = 0.0
            return chosen

        return _moved(responses(records, channels, BAND, mixed, f), records)

    def _reference(self, records: Sequence[TrialRecord]) -> tuple[MBK, HoldCorrection | None]:
        """Fit an arm near the one sought, and find how torques jump with the commands.

        M, B and K are fitted by least squares of relative errors, at some frequencies. The error of
        the polynomials is proportional to the distance of the arm from the reference arm of the
        previous step, so little is left after the second step, however few the bins.
        """
        jump = update_jump(records)
        channels = _channels(records, jump)
        n, joints = records[0].joints, [record.perturbed_joint for record in records]
        found, f = np.zeros((3, n, n)), _strongest(records)
        for _ in range(_REFERENCE_STEPS):
            reference = MBK(M=found[0], B=found[1], K=found[2])
            columns = self._residuals(records, channels, reference, jump, f)
            stacked = np.stack([column.response for column in columns], axis=1)
            R, residual = stacked[joints], stacked[n : 2 * n]
            s = 2j * np.pi * columns[0].f
            motion = np.stack((s**2, s, np.ones_like(s)))[:, None, None] * R
            torques = residual + multiply(reference.impedance(columns[0].f)[:, joints], R)
            for row, (torque, left) in enumerate(zip(torques, residual, strict=True)):
                size = np.abs(torque)
                # Keep relative errors finite for a transducer that reads zero.
                size = np.maximum(size, np.finfo(np.float64).eps * np.max(size) or 1.0)
                design, aim = (motion / size).reshape(3 * len(R), -1), (left / size).ravel()
                parts = np.concatenate((design.real, design.imag), axis=1)
                scale = np.linalg.norm(parts, axis=1)[:, None]
                aims = np.concatenate((aim.real, aim.imag))
                solved = np.linalg.lstsq((parts / scale).T, aims, rcond=None)[0] / scale[:, 0]
                found[:, row, joints] += solved.reshape(3, -1)
        return MBK(M=found[0], B=found[1], K=found[2]), jump


def _delay_uncertainty(record: TrialRecord, jump: HoldCorrection | None) -> float:
    """Standard error of the delay between torques and angles, s.

    It is half a period unless it is known how torques are read, and the jumps that this implies
    were identified.
    """
    reading = record.reading
    jumps_told = jump is not None and reading.timing is not TorqueTiming.UNKNOWN
    return reading.uncertainty if reading.without_jumps or jumps_told else 0.5 / record.rate


def _channels(records: Sequence[TrialRecord], jump: HoldCorrection | None) -> list[FloatArray]:
    """Angles and torques of each trial, and steps of the commands with which torques jump."""
    channels = [np.concatenate([one.position, one.torque]) for one in records]
    if jump is None:
        return channels
    return [
        np.concatenate(pair) for pair in zip(channels, map(command_steps, records), strict=True)
    ]


def responses(
    records: Sequence[TrialRecord],
    outputs: Sequence[FloatArray],
    band: tuple[float, float],
    mix: Mix | None = None,
    f: FloatArray | None = None,
) -> list[LocalResponse]:
    """Estimate the responses of trials to their perturbations, all at the same frequencies.

    These are the lines that periodic perturbations have in common, or the bins of the shortest
    trial, less those at which a perturbation has no power.

    Parameters
    ----------
    records : sequence of TrialRecord
        Trials.
    outputs : sequence of ndarray, shape (C, N)
        Output signals of each trial.
    band : tuple of float
        Lowest and highest frequency, Hz.
    mix : callable, optional
        As :func:`local_response` takes it.
    f : ndarray, shape (n_freq,), optional
        Frequencies in place of those bins, Hz.

    Raises
    ------
    DataError
        If a record is too short, or the perturbations have too few frequencies in common.
    """
    rate = records[0].rate
    lines = common_lines((record.periods for record in records), rate, band)
    if lines is not None:
        f = lines
    elif f is None:
        f = _bins(records, band)
    columns = []
    for record, signals in zip(records, outputs, strict=True):
        periods = None if lines is None else record.periods
        width = _half_width(record.duration, periodic=periods is not None)
        source = record.perturbation[record.perturbed_joint]
        columns.append(local_response(source, signals, rate, band, f, width, periods, mix))
    shared: FloatArray = reduce(lambda f, g: f[among(f, g)], [one.f for one in columns])
    if shared.size < FEWEST_FREQUENCIES:
        raise DataError(
            f"perturbations of the trials have {shared.size} frequencies in common, too few to fit "
            "M, B and K: they need the same lines"
        )
    return [one if one.f.size == shared.size else one.at(among(one.f, shared)) for one in columns]


def _doubts(
    correction: ComplexArray,
    f: FloatArray,
    jump: HoldCorrection | None,
    reversing: FloatArray,
    bending: FloatArray,
) -> tuple[ComplexArray, ...]:
    """Standard errors of the skew correction of an impedance.

    The correction is ``jωL/2`` times the torque that jumps: imaginary for inertial torque,
    proportional to s², and real for friction torque, proportional to s. The real part is uncertain
    where motion reverses. The correction does not cover the curvature of friction within a period,
    which looks like viscosity: its effect is the third returned error.
    """
    error = np.zeros(len(correction)) if jump is None else jump.error
    known = np.hypot(_SKEW, error)[:, None, None]
    inertial = np.asarray(1j * known * correction.imag)
    share = np.hypot(known, _RUBBING * reversing[:, None])
    rubbing = np.asarray(share * correction.real, dtype=np.complex128)
    bent = (_inertia(correction, f) * bending)[..., None] * 2j * np.pi * f
    return inertial, rubbing, np.asarray(bent, dtype=np.complex128)


def _half_width(duration: float, *, periodic: bool) -> int:
    """Half width of local polynomials, in bins, for a record of `duration` seconds."""
    # For a periodic perturbation, polynomials model leakage alone and use all bins of the span.
    within = max(int(_SPAN * duration * (1.0 + 1e-12)), ORDER + _SPARE_BINS)
    return within if periodic else min(_MOST_BINS, within)


def _bins(records: Sequence[TrialRecord], band: tuple[float, float]) -> FloatArray:
    """Frequencies of the bins of the shortest trial, Hz."""
    shortest, rate = min(record.samples for record in records), records[0].rate
    return bins_in_band(shortest, rate, *band).astype(np.float64) * float(rate / shortest)


def _strongest(records: Sequence[TrialRecord]) -> FloatArray:
    """Bin with the strongest perturbations in each of `_REFERENCE_BINS` parts of the band, Hz."""
    f = _bins(records, BAND)
    strength = np.full(f.size, np.inf)
    for record in records:
        amplitudes = np.abs(np.fft.rfft(record.perturbation[record.perturbed_joint]))
        strength = np.minimum(strength, amplitudes[np.rint(f * record.duration).astype(np.intp)])
    parts = np.array_split(np.arange(f.size), max(min(_REFERENCE_BINS, f.size), 1))
    return f[[part[np.argmax(strength[part])] for part in parts if part.size]]


def _moved(columns: Sequence[LocalResponse], records: Sequence[TrialRecord]) -> list[LocalResponse]:
    """Keep responses where the motion of every perturbed joint stands out from its noise."""
    kept = np.ones(columns[0].f.size, dtype=np.bool_)
    for column, record in zip(columns, records, strict=True):
        k = record.perturbed_joint
        variance = column.gain * column.noise[k, k].real
        moved = stands_out(column.f, column.response[k], variance)
        kept &= moved
        if np.count_nonzero(kept) < FEWEST_FREQUENCIES:
            raise DataError(
                f"trial {record.trial}: joint {k + 1} moves with its perturbation, beyond noise, "
                f"at only {np.count_nonzero(moved)} of {kept.size} frequencies",
                "joint_does_not_move",
            )
    return list(columns) if kept.all() else [column.at(kept) for column in columns]


def _uneven(
    plain: ComplexArray,
    scattered: ComplexArray,
    T: ComplexArray,
    columns: Sequence[LocalResponse],
    joints: Sequence[int],
) -> tuple[float, ...]:
    """Scatter of lines beyond noise, as a share of the power of each perturbed joint's torque.

    From the responses T and the covariance (m, n, n, n_freq) of the torques that the estimated arm
    leaves, without it and with it; by the power of the lines, as noise at a weak line is no torque.
    The motion itself may be uneven, where friction of the robot distorts it.
    """
    shares = []
    for column, joint in enumerate(joints):
        power = 1.0 / columns[column].gain
        noise, both = (power * one[column, joint, joint].real for one in (plain, scattered))
        lines = np.sum(noise) ** 2 / np.sum(noise**2)
        share = np.sum(both - noise) / np.sum(power * np.abs(T[joint, column]) ** 2)
        limit = _BY_CHANCE + _SCATTER / math.sqrt(lines)
        shares.append(float(share) if np.sum(both) > limit * np.sum(noise) else 0.0)
    return tuple(shares)


class HiddenMotion:
    """Effect on the impedance of motion of locked joints that their encoders don't show.

    Readings lead the motion, which adds ``jω`` times the lead to the responses R, relative to R.
    Rounding takes a share off R, or adds it. Motion that isn't seen at all follows the torque on
    the joint, which yields like a spring or a damper: with ``S = T`` or ``T/s``, an rms motion a is
    a response ``δR = a S / rms(S x)``.

    Parameters
    ----------
    records : sequence of TrialRecord
        One trial for each joint, in order.
    R, T, inverse : ndarray, shape (n, n, n_freq)
        Responses of angles and torques, and ``R⁻¹``.
    f : ndarray, shape (n_freq,)
        Frequencies, Hz.
    """

    def __init__(
        self,
        records: Sequence[TrialRecord],
        R: ComplexArray,
        T: ComplexArray,
        inverse: ComplexArray,
        f: FloatArray,
    ) -> None:
        self.share, beside = lost_motion(records)
        inertia = _possible(_inertia(multiply(T, inverse), f))
        lead, error = rounding_lead(records, inertia, float(f[-1]))
        self._inverse = inverse
        self._lost: list[tuple[int, int, ComplexArray]] = []
        self._leads: list[tuple[int, int, ComplexArray, float, float]] = []
        for joint, k in np.argwhere(self.share + beside + error > 0.0).tolist():
            responses = [self.share[joint, k] * R[joint, k]]
            for shape in (T[joint, k], T[joint, k] / (2j * np.pi * f)):
                caused = np.sqrt(np.mean(np.abs(shape) ** 2)) * np.std(records[k].perturbation[k])
                responses.append(beside[joint, k] / max(float(caused), _TINY) * shape)
            self._lost += [(joint, k, one) for one in responses if one.any()]
            if error[joint, k] > 0.0:
                moved = 2j * np.pi * f * R[joint, k]
                self._leads.append((joint, k, moved, lead[joint, k], error[joint, k]))

    def effects(
        self, impedance: ComplexArray
    ) -> tuple[ComplexArray, list[ComplexArray], list[ComplexArray]]:
        """Effects on an impedance: an error δR of a response causes ``δZ = -Z δR R⁻¹``.

        Returns
        -------
        ahead : (n, n, n_freq) NDArray
            Correction to add to the impedance, as readings lead.
        leads, lost : list of (n, n, n_freq) NDArray
            Standard errors of that correction, and of the other effects. Only the leads have a
            shape over frequency so well known that the data can tell their size.
        """

        def effect(joint: int, k: int, response: ComplexArray) -> ComplexArray:
            return np.asarray(response * (impedance[:, joint, None] * self._inverse[None, k]))

        ahead, leads = np.zeros_like(impedance), []
        for joint, k, moved, lead, error in self._leads:
            one = effect(joint, k, moved)
            ahead += lead * one
            leads.append(error * one)
        return ahead, leads, [effect(*one) for one in self._lost]


_TENSED = 0.05
"""Assumption: share by which the stiffness and viscosity of a person differ between trials."""
_FRICTION, _OVERCOME = 2.0, 3.0
"""Assumption: largest Coulomb friction F_c of a robot's joint, N·m, and relative to the rms of a
perturbation that moves it nonetheless."""


def _untold_friction(
    records: Sequence[TrialRecord], impedance: ComplexArray, f: FloatArray, bending: FloatArray
) -> list[ComplexArray]:
    """Errors of the impedance from friction of the perturbed joint where jumps are not identified.

    With each update Δu, the torque on the arm jumps by ``D Δu``, ``D = M_h (M_r + M_h)⁻¹``. For the
    part of u that moves the arm, reading before the jump is a delay, which is fitted. The rest
    overcomes friction, like ``jω c θ`` with ``c = 4 F_c/(π V)`` at a velocity of amplitude V
    (describing function). Readings miss half of its jumps: ``δZ = -ω² L D c/2``, which looks like
    inertia. They also miss its curvature (`_reversals`), which looks like viscosity.
    F_c up to `_FRICTION` or `_OVERCOME` and ``D_ik = M_ik/(2 M_kk)`` are assumptions.
    """
    turning = 2j * np.pi * f
    effects = []
    inertia = _possible(_inertia(impedance, f))
    for k, record in enumerate(records):
        amplitude = np.sqrt(2.0) * max(
            float(np.std(speed_of(record.position[k], record.rate, float(f[-1])))), _TINY
        )
        of_one = turning * (turning - bending[k])
        friction = min(_FRICTION, _OVERCOME * float(np.std(record.perturbation[k])))
        largest = 0.25 / record.rate * 4.0 * friction / (np.pi * amplitude)
        effect = np.zeros_like(impedance)
        effect[:, k] = largest / np.sqrt(3.0) * (inertia[:, k] / inertia[k, k])[:, None] * of_one
        effects.append(effect)
    return effects


def _joints_held(impedance: ComplexArray, f: FloatArray, half_period: float) -> list[ComplexArray]:
    """Errors of the impedance from friction of locked joints where jumps are not identified.

    Reading before the jump delays the torque ``-ω² M_ik θ_k`` by half a period if commands cause
    it. If friction holds joint i, it supplies the torque instead of the command, which then does
    not jump: some or all of the delay is missing, differently for each element. The shapes over
    frequency of these standard errors are known so well that the data can tell their size.
    """
    cubed = half_period / np.sqrt(3.0) * (2j * np.pi * f) ** 3
    effects = []
    for i, k in np.argwhere(~np.eye(len(impedance), dtype=np.bool_)):
        effect = np.zeros_like(impedance)
        effect[i, k] = _inertia(impedance[i, k], f) * cubed
        effects.append(effect)
    return effects


def _trials_apart(
    records: Sequence[TrialRecord],
    arm: MBK,
    R: ComplexArray,
    inverse: ComplexArray,
    f: FloatArray,
) -> list[ComplexArray]:
    """Errors of the impedance where the arm differs between trials.

    The small motion R_jk of a joint j that is locked in trial k acts on the arm of trial k, not on
    that of trial j. A person's stiffness and viscosity differ by `_TENSED` (assumption). Between
    postures a distance apart, in rad, M_ij changes by at most that times ``√(M_ii M_jj)``, in
    proportion for all rows i. The data don't tell the size of this: where joints are held softly,
    the person causes most of R_jk.
    """
    postures = np.stack([record.position.mean(axis=1) for record in records])
    s = 2j * np.pi * f
    size = np.sqrt(np.abs(np.diag(arm.M)))
    tension = _TENSED * MBK(M=np.zeros_like(arm.M), B=arm.B, K=arm.K).impedance(f)
    effects = list[ComplexArray]()
    for j, k in np.ndindex(R.shape[:2]):
        if j == k:
            continue
        moved = R[j, k] * inverse[k]
        effects.append(tension[:, None, j] * moved)
        apart = float(np.linalg.norm(postures[j] - postures[k]))
        if apart > APART:
            change = size * size[j] * apart / np.sqrt(3.0)
            effects.append(change[:, None, None] * s**2 * moved)
    return effects


def _reversals(
    records: Sequence[TrialRecord], impedance: ComplexArray, f: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """How friction of the perturbed joint responds to chattering commands within control periods.

    Torques on the arm that step by Δτ from reading to reading change its speed by ``Δv = M⁻¹ Δτ L``
    in between, which reverses any lower speed. The mean over the period of a force F that is not
    linear in speed is then less than the mean of its values at the ends, by ``F'' Δv²/12``. For F
    with the sign of v, this acts like a viscosity ``E[v F'']/E[v²] = -2 p(0) E[v F]/(E|v| E[v²])``,
    with the density p of v; the skew correction adds half of ``L E[v F]/E[v²]`` as inertia.

    Returned by trial: the share of the time in which the motion of the joint is reversed, and that
    viscosity relative to the inertia that the skew correction adds, 1/s.
    """
    reversing, bending = np.zeros((2, len(records)))
    inertia = _inertia(impedance, f)
    # With some trials only, no more is known than the inertia of each perturbed joint. The whole
    # matrix may be singular, as from identical channels, which the verdict reports.
    whole = np.linalg.pinv(_possible(inertia)) if len(records) == len(inertia) else None
    for number, record in enumerate(records):
        k = record.perturbed_joint
        steps = np.diff(record.torque, axis=1)
        gained = steps[k] / inertia[k, number] if whole is None else whole[k] @ steps
        change = float(np.std(gained)) / record.rate
        speed = np.abs(speed_of(record.position[k], record.rate, float(f[-1])))
        reversing[number] = np.mean(speed < change)
        usual = max(float(np.mean(speed)), _TINY)
        bending[number] = record.rate * reversing[number] * change / (6.0 * usual)
    return reversing, bending


def _inertia(impedance: ComplexArray, f: FloatArray) -> FloatArray:
    """Inertia, kg·m², from the real part of the impedance in the upper fifth of the band."""
    high = f >= 0.8 * f[-1]
    squared = (2.0 * np.pi * f[high]) ** 2
    return np.asarray(-np.mean(impedance.real[..., high] / squared, axis=-1))


def _possible(inertia: FloatArray) -> FloatArray:
    """Inertia, (n, n), with diagonal elements raised to what the coupling requires.

    ``M_kk ≥ M_ik²/M_ii`` for any i; a transducer that misses quick changes shows less.
    """
    own = np.maximum(np.abs(np.diag(inertia)), _TINY)
    possible: FloatArray = inertia.copy()
    np.fill_diagonal(possible, np.max(inertia**2 / own[:, None], axis=0))
    return possible


def _unit(rows: int, channels: int, f: FloatArray) -> ComplexArray:
    """Coefficients, (rows, channels, n_freq), that pick the first channels unchanged."""
    return np.repeat(np.eye(rows, channels, dtype=np.complex128)[:, :, None], f.size, axis=2)


def covariance_of(columns: Sequence[LocalResponse], coefficients: ComplexArray) -> ComplexArray:
    """Covariance of combinations (m, C, n_freq) of each trial's responses, (n, m, m, n_freq)."""
    return np.stack([one.gain * combined(coefficients, one.noise) for one in columns])


def _mean(correlations: Sequence[FloatArray]) -> FloatArray:
    """Mean of correlations (lags, n_freq), each taken as 0 beyond its last lag."""
    longest = max(len(one) for one in correlations)
    padded = [np.pad(one, ((0, longest - len(one)), (0, 0))) for one in correlations]
    mean: FloatArray = np.mean(padded, axis=0)
    return mean
