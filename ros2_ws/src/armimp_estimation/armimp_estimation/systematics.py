"""Systematic errors of an impedance from local polynomials, as far as the records show them.

Each is a standard error over frequency, one for each cause: encoders of locked joints miss motion,
torques jump with commands as friction makes them, and the arm differs between the trials.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from armimp_common.arrays import TINY, ComplexArray, FloatArray
from armimp_common.topics import JOINT_STATES, TORQUE_SENSORS
from armimp_estimation.estimators.estimate import ImpedanceEstimate
from armimp_estimation.estimators.welch import multiply
from armimp_estimation.hold_correction import HoldCorrection
from armimp_estimation.mbk import MBK
from armimp_estimation.record import APART, TrialRecord

_SKEW = 0.002
"""Relative standard error, which no residual shows, of the jump correction of inertial torque. In
simulation its matrix D is within 0.7 % of the truth, and half of the time within 0.2 %."""
_RUBBING = 0.3
"""The same for the torque that overcomes friction, while chattering commands reverse the motion
within a control period, so that friction responds within the period."""
_TENSED = 0.05
"""Assumption: share by which stiffness and viscosity of any person differ between trials."""
_FRICTION, _OVERCOME = 2.0, 3.0
"""Assumption: largest Coulomb friction F_c of a robot's joint, N·m, and relative to the rms of a
perturbation that moves it nonetheless."""
_LOST = 0.16  # rms motion that the encoder of a resting joint may miss, in steps
_YIELDING = 1e-4
"""Assumption: rms motion for each N·m of a locked joint whose angle never changes, as of a stiff
drive or a brake, rad: nobody may have recorded it."""
_LEADING, _MOST_LED, _UNGATHERED, _LEAD_ERROR = 0.12, 0.1, 0.2, 0.5
"""Assumptions for :func:`rounding_lead`: its factor; the largest lead times the speed in the band,
in steps; the standard error of ln ρ; and the relative standard error of the lead."""
_DISTINCT = 0.1
"""Least eigenvalue of A + Aᵀ at which an inertia A, scaled to a diagonal of 1, is inverted."""
_WINDOW = 0.5  # time over which the readings of a locked joint are judged, s
_VALUES = 3  # distinct values in such a window from which on a joint moves
_CHANGES = 5  # steps of an encoder from which on a joint moves
RESOLVED_SHARE = 0.25
"""Share of the motion of a locked joint that may be unseen where its motion counts as resolved."""


def with_systematic_errors(
    estimate: ImpedanceEstimate,
    records: Sequence[TrialRecord],
    correction: ComplexArray,
    reference: MBK,
) -> ImpedanceEstimate:
    """Correct an estimate for readings that lead the motion, and add its systematic errors.

    Parameters
    ----------
    estimate : ImpedanceEstimate
        Estimate with the inverse of R, and with the jumps of the torques if they were identified.
    records : sequence of TrialRecord
        One trial for each joint, in order, or those of the joints that were estimated.
    correction : ndarray, shape (n, m, n_freq)
        What the jumps of torques with commands add to the impedance.
    reference : MBK
        An arm near the one sought.
    """
    impedance, f, jump = estimate.Z, estimate.f, estimate.hold
    reversing, bending = _reversals(records, impedance, f)
    skew = _skew_errors(correction, f, jump, reversing, bending)
    if estimate.inverse is None or len(records) < len(impedance):
        return replace(estimate, systematics=tuple(skew))
    hidden = HiddenMotion(records, estimate.R, estimate.T, estimate.inverse, f)
    ahead, bounds, others = hidden.effects(impedance)
    others += _rounded(records, impedance, estimate.inverse, f)
    shapeless = sum((np.abs(one) ** 2 for one in others), 0.0)
    impedance = impedance + ahead
    if jump is None and not records[0].reading.without_jumps:
        bounds += _joints_held(impedance, f, 0.5 / records[0].rate)
        others += _untold_friction(records, impedance, f, bending)
    tensions, apart = _trials_apart(records, reference, estimate.R, estimate.inverse, f)
    return replace(
        estimate,
        Z=impedance,
        systematics=(*bounds, *others, *apart, *skew),
        bounded=len(bounds),
        shapeless=shapeless,
        tensions=tuple(tensions),
    )


def _skew_errors(
    correction: ComplexArray,
    f: FloatArray,
    jump: HoldCorrection | None,
    reversing: FloatArray,
    bending: FloatArray,
) -> list[ComplexArray]:
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
    return [inertial, rubbing, np.asarray(bent, dtype=np.complex128)]


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
            float(np.std(speed_of(record.position[k], record.rate, float(f[-1])))), TINY
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
) -> tuple[list[ComplexArray], list[ComplexArray]]:
    """Changes of the impedance where the arm differs between trials.

    The small motion R_jk of a joint j that is locked in trial k acts on the arm of trial k, not on
    that of trial j. Returned are, for each trial, the change if stiffness and viscosity are twice
    as large in it as in the others, and standard errors: those of any person differ by `_TENSED`
    (assumption), and between postures a distance apart, in rad, M_ij changes by at most that times
    ``√(M_ii M_jj)``, in proportion for all rows i.
    """
    postures = np.stack([record.position.mean(axis=1) for record in records])
    s = 2j * np.pi * f
    size = np.sqrt(np.abs(np.diag(arm.M)))
    tension = MBK(M=np.zeros_like(arm.M), B=arm.B, K=arm.K).impedance(f)
    tensions, effects = [np.zeros_like(R) for _ in records], list[ComplexArray]()
    for j, k in np.ndindex(R.shape[:2]):
        if j == k:
            continue
        moved = R[j, k] * inverse[k]
        tenser = tension[:, None, j] * moved
        effects.append(_TENSED * tenser)
        tensions[k] += tenser
        tensions[j] -= tenser
        apart = float(np.linalg.norm(postures[j] - postures[k]))
        if apart > APART:
            change = size * size[j] * apart / np.sqrt(3.0)
            effects.append(change[:, None, None] * s**2 * moved)
    return tensions, effects


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
        usual = max(float(np.mean(speed)), TINY)
        bending[number] = record.rate * reversing[number] * change / (6.0 * usual)
    return reversing, bending


def _rounded(
    records: Sequence[TrialRecord], impedance: ComplexArray, inverse: ComplexArray, f: FloatArray
) -> list[ComplexArray]:
    """Errors of the impedance from rounding that repeats with the periods of the perturbation.

    Rounding to steps q has the variance q²/12, which is spread over the harmonics of a period.
    Averages over periods, whose scatter doesn't show it, do not reduce it. Short periods have few.
    """
    effects = []
    for k, record in enumerate(records):
        periods = record.periods
        if periods is None:
            continue
        harmonics = np.rint(f * periods.samples / record.rate).astype(np.intp)
        if not np.isin(harmonics, periods.lines).all():
            continue
        pushes = record.perturbation[record.perturbed_joint, : periods.end][-periods.samples :]
        amplitudes = np.abs(np.fft.rfft(pushes)[harmonics]) / math.sqrt(periods.samples)
        per_step = inverse[k] / np.maximum(math.sqrt(12.0) * amplitudes, TINY)
        for joint, (angle, torque) in enumerate(
            zip(record.resolution[JOINT_STATES], record.resolution[TORQUE_SENSORS], strict=True)
        ):
            row = np.zeros_like(impedance)
            row[joint] = torque * per_step
            effects += [np.asarray(angle * impedance[:, joint, None] * per_step), row]
    return effects


def _inertia(impedance: ComplexArray, f: FloatArray) -> FloatArray:
    """Inertia, kg·m², from the real part of the impedance in the upper fifth of the band."""
    high = f >= 0.8 * f[-1]
    squared = (2.0 * np.pi * f[high]) ** 2
    return np.asarray(-np.mean(impedance.real[..., high] / squared, axis=-1))


def _possible(inertia: FloatArray) -> FloatArray:
    """Inertia, (n, n), with diagonal elements raised to what the coupling requires.

    ``M_kk ≥ M_ik²/M_ii`` for any i; a transducer that misses quick changes shows less.
    """
    own = np.maximum(np.abs(np.diag(inertia)), TINY)
    possible: FloatArray = inertia.copy()
    np.fill_diagonal(possible, np.max(inertia**2 / own[:, None], axis=0))
    return possible


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
                responses.append(beside[joint, k] / max(float(caused), TINY) * shape)
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


def lost_motion(records: Sequence[TrialRecord]) -> tuple[FloatArray, FloatArray]:
    """Motion that follows the perturbation and that the encoders of locked joints may not show.

    Rounding to steps q takes a share ``2 exp(-2π²σ²/q²)`` off the response of a motion with the
    standard deviation σ. σ² is the variance of the readings in each half second less that of
    rounding, ``q²/12``. A joint that shows fewer than three values in that time, or hardly changes
    between them, may be held by friction, and may move in any way within a step. The most that is
    lost then is 0.16 q, of a motion of 0.2 q. A reading that never changes may be none at all.

    Returns
    -------
    share : ndarray, shape (n, n)
        Error of the motion that the encoder of each joint shows in each trial, relative to it; 1
        while the joint seems to rest, as a reading that toggles may show more than there is.
    beside : ndarray, shape (n, n)
        Unseen motion of each joint in each trial while it seems to rest, rms, averaged over the
        trial, rad. Both are 0 where all motion is seen.
    """
    shares, beside = np.zeros((2, len(records), len(records)))
    for joint, k in np.ndindex(shares.shape):
        step = float(records[joint].resolution[JOINT_STATES][joint])
        size, signal = round(_WINDOW * records[k].rate), records[k].position[joint]
        if k != joint and not np.ptp(signal):
            beside[joint, k] = _YIELDING * float(np.std(records[k].torque[joint]))
        if k == joint or step == 0.0 or records[k].samples < size:
            continue
        counts = (signal - signal[0]) / step
        counts = counts[: counts.size // size * size].reshape(-1, size)
        changes = np.sum(np.abs(np.diff(counts, axis=1)), axis=1)
        rests = (np.ptp(counts, axis=1) < _VALUES - 1.5) | (changes < _CHANGES - 0.5)
        spread = np.maximum(np.var(counts, axis=1) - 1.0 / 12.0, 0.0)
        lacks = np.minimum(2.0 * np.exp(-2.0 * np.pi**2 * spread), 1.0)
        shares[joint, k] = np.mean(np.where(rests, 1.0, lacks))
        beside[joint, k] = max(beside[joint, k], _LOST * step * float(np.mean(rests)))
    return shares, beside


def rounding_lead(
    records: Sequence[TrialRecord], inertia: FloatArray, band_end: float
) -> tuple[FloatArray, FloatArray]:
    """Time by which the motion that encoders show is ahead of that of the joints.

    A control law throws a locked joint back when its reading steps, so that the joint stays near
    the thresholds, or between them. Rounding then isn't independent of the motion, but follows its
    speed. The rate of steps shows this: at a mean speed ``|v|`` it is ``ρ |v|/q``, where q is the
    step and ρ the density of the angle at thresholds relative to that elsewhere. Readings of joints
    that laws of 30 to 250 rad/s held at 250 to 4000 Hz led by about ``0.12 (1 - 2d) ln(ρ) q/|v|``,
    where d is the share of readings that step. That this holds, and that the lead is at most the
    time of a tenth of a step at the speed in the band, is an assumption.

    Parameters
    ----------
    inertia : ndarray, shape (n, n)
        Inertia of the arm, kg·m²: above the band the speed is taken from the torques.
    band_end : float
        Frequency up to which the speed is taken from the angles, Hz.

    Returns
    -------
    lead, error : ndarray, shape (n, n)
        Lead of each joint in each trial, and its standard error, s; 0 where nothing is rounded.
    """
    lead, error = np.zeros((2, len(records), len(records)))
    for k, record in enumerate(records):
        speeds = np.mean(np.abs(_speeds(record, inertia, band_end)), axis=1)
        for joint, (angle, speed) in enumerate(zip(record.position, speeds, strict=True)):
            step = float(records[joint].resolution[JOINT_STATES][joint])
            steps = np.abs(np.diff(angle)) / step if step > 0.0 else np.zeros(1)
            stepping = float(np.mean(np.minimum(steps, 1.0)))
            if np.sum(steps) < _CHANGES - 0.5 or not speed > 0.0:
                continue
            density = float(np.mean(steps)) * record.rate * step / speed
            least = _LEADING * max(1.0 - 2.0 * stepping, 0.0) * step / speed
            found = least * math.log(density)
            in_band = float(np.std(speed_of(angle, record.rate, band_end)))
            most = _MOST_LED * step / max(in_band, TINY)
            lead[joint, k] = math.copysign(min(abs(found), most), found)
            error[joint, k] = min(math.hypot(_LEAD_ERROR * found, _UNGATHERED * least), most)
    return lead, error


def _speeds(record: TrialRecord, inertia: FloatArray, band_end: float) -> FloatArray:
    """Speeds, (n, N), rad/s: from the angles in the band, above it from the torques if possible."""
    speeds = speed_of(record.position, record.rate, band_end)
    size = np.sqrt(np.abs(np.diag(inertia)))
    own = inertia / np.maximum(np.outer(size, size), TINY)
    if np.min(np.linalg.eigvalsh(own + own.T)) > _DISTINCT:
        turning = 2.0 * np.pi * np.fft.rfftfreq(record.samples, 1.0 / record.rate)
        beyond = turning > 2.0 * np.pi * band_end
        felt = np.fft.rfft(record.torque) * beyond
        felt[:, beyond] = np.linalg.solve(inertia, felt[:, beyond] / (1j * turning[beyond]))
        speeds = speeds + np.fft.irfft(felt, record.samples)
    return speeds


def speed_of(angle: FloatArray, rate: float, band_end: float) -> FloatArray:
    """Speed of joints up to the frequency `band_end` in Hz, (..., N), rad/s."""
    turning = 2.0 * np.pi * np.fft.rfftfreq(angle.shape[-1], 1.0 / rate)
    spectrum = 1j * turning * np.fft.rfft(angle - angle.mean(axis=-1, keepdims=True))
    spectrum[..., turning > 2.0 * np.pi * band_end] = 0.0
    return np.asarray(np.fft.irfft(spectrum, angle.shape[-1]))
