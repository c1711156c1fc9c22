"""Impedance from the whole record by local polynomials, free of leakage and of torque skew."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import reduce

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from armimp_common.arrays import EPS, ComplexArray, FloatArray
from armimp_common.errors import DataError
from armimp_estimation.estimators.estimate import ImpedanceEstimate, combined, noise_of
from armimp_estimation.estimators.local_polynomial import (
    ORDER,
    LocalResponse,
    Mix,
    local_response,
    response_at_sines,
)
from armimp_estimation.estimators.welch import invert, multiply
from armimp_estimation.fit import fit_mbk
from armimp_estimation.frf import order_trials, stands_out
from armimp_estimation.hold_correction import (
    HoldCorrection,
    command_steps,
    update_jump,
    without_skew,
)
from armimp_estimation.mbk import MBK
from armimp_estimation.periods import among, common_lines
from armimp_estimation.record import TrialRecord
from armimp_estimation.signal_quality import without_slow
from armimp_estimation.spectra import BAND, bins_in_band
from armimp_estimation.systematics import with_systematic_errors
from armimp_estimation.torque_timing import TorqueTiming
from armimp_estimation.trial import TrialData, cleaned
from armimp_estimation.turning_links import at_posture
from armimp_estimation.weighted_fit import FEWEST_FREQUENCIES

_SPARE_BINS = 3
"""Bins on either side beyond the degree of the polynomials, for degrees of freedom of the noise."""
_REFERENCE_BINS = 64
"""Largest number of frequencies from which the reference arm is fitted."""
_REFERENCE_STEPS = 3
"""Fits of the reference arm, each relative to the one before."""
_SPAN = 0.25
"""Hz on either side of a bin that local polynomials may span, as arms have a resonance near 1 Hz.
In shorter records, whose bins are wider, fewer bins take part."""
_MOST_BINS = 36
"""Bins on either side at most: leakage then takes 1 of 24 parts of what a window tells. A periodic
perturbation has fewer windows, which may be wider."""
_APART, _ALONE, _SPARSE = 3, 0.75, 12
"""For :func:`_sines`: bins on either side that belong to a sine, share of power that is next to
sines, at least, and bins of the band for each, at least."""
_FLOOR = 0.0003
"""Relative error that the M-B-K fit adds in quadrature to that of each value for its weight."""
_BY_CHANCE, _SCATTER = 1.1, 2.5
"""Ratio of the variance from the scatter of F lines to that from noise, if there is only chance:
its mean, and √F times the excess over this mean that is hardly ever reached."""


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
        posed = at_posture(records, *reference)
        if posed:
            records, reference = [*posed], self._reference(posed)
        return replace(self._estimate(records, *reference), posed=posed)

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
        columns = [column.with_scatter(slice(n, 2 * n)) for column in plain]
        f = columns[0].f
        stacked = np.stack([column.response for column in columns], axis=1)
        R = stacked[joints]
        inverse = invert(R, f)
        offset, added = (multiply(part, inverse) for part in (stacked[n : 2 * n], stacked[2 * n :]))
        impedance = reference.impedance(f)[:, joints] + offset
        torque = multiply(impedance, R)
        every = _unit(2 * n, 3 * n, f)
        coefficients = every[n:].copy()
        every[n:, :n], coefficients[:, joints] = reference.impedance(f), -offset
        disturbance, whole = covariance_of(columns, coefficients), len(records) == n
        found = ImpedanceEstimate(
            name=self.name,
            f=f,
            Z=impedance,
            noise=noise_of(disturbance, inverse),
            bin_correlation=_mean([column.bin_correlation() for column in columns]),
            averages=min(column.freedom for column in columns) + 1.0,
            T=torque,
            R=R,
            perturbed=() if whole else tuple(joints),
            power=1.0 / np.stack([column.gain for column in columns]),
            weight_floor=_FLOOR,
            friction_skew=added.real.astype(np.complex128) if whole else None,
            delay_uncertainty=_delay_uncertainty(records[0], jump),
            delay_unknown=0.5 / rate,
            unbiased=True,
            uneven=_uneven(
                covariance_of(plain, coefficients), disturbance, torque, columns, joints
            ),
            without_slow=tuple(without_slow(records)) if whole else (),
            hold=jump,
            covariance=covariance_of(columns, every) if whole else None,
            disturbance=disturbance,
            inverse=inverse,
        )
        return with_systematic_errors(found, records, added, reference)

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
        fit, place = fit_mbk(found), joints.index(k)
        return FittedColumn(
            joint=k,
            values=fit.values[:, :, place],
            errors=fit.errors[:, :, place],
            preliminary=len(joints) < record.joints,
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
                size = np.maximum(size, EPS * np.max(size) or 1.0)
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

    These are the lines that periodic perturbations or sums of a few sines have in common, or the
    bins of the shortest trial, less those at which a perturbation has no power.

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
    sines = _sines(records, band) if lines is None else None
    if lines is not None:
        f = lines
    elif f is None:
        f = _bins(records, band)
    columns = []
    for record, signals in zip(records, outputs, strict=True):
        periods = None if lines is None else record.periods
        width = _half_width(record.duration, periodic=periods is not None)
        source = record.perturbation[record.perturbed_joint]
        columns.append(
            local_response(source, signals, rate, band, f, width, periods, mix)
            if sines is None
            else response_at_sines(source, signals, rate, sines, width, mix)
        )
    shared: FloatArray = reduce(lambda f, g: f[among(f, g)], [one.f for one in columns])
    if shared.size < FEWEST_FREQUENCIES:
        raise DataError(
            f"perturbations of the trials have {shared.size} frequencies in common, too few to fit "
            "M, B and K: they need the same lines"
        )
    return [one if one.f.size == shared.size else one.at(among(one.f, shared)) for one in columns]


def _half_width(duration: float, *, periodic: bool) -> int:
    """Half width of local polynomials, in bins, for a record of `duration` seconds."""
    # For a periodic perturbation, polynomials model leakage alone and use all bins of the span.
    within = max(int(_SPAN * duration * (1.0 + 1e-12)), ORDER + _SPARE_BINS)
    return within if periodic else min(_MOST_BINS, within)


def _bins(records: Sequence[TrialRecord], band: tuple[float, float]) -> FloatArray:
    """Frequencies of the bins of the shortest trial, Hz."""
    shortest, rate = min(record.samples for record in records), records[0].rate
    return bins_in_band(shortest, rate, *band).astype(np.float64) * float(rate / shortest)


def _strength(records: Sequence[TrialRecord], f: FloatArray) -> FloatArray:
    """Amplitude of the weakest perturbation at each frequency, (n_freq,)."""
    strength = np.full(f.size, np.inf)
    for record in records:
        amplitudes = np.abs(np.fft.rfft(record.perturbation[record.perturbed_joint]))
        strength = np.minimum(strength, amplitudes[np.rint(f * record.duration).astype(np.intp)])
    return strength


def _sines(records: Sequence[TrialRecord], band: tuple[float, float]) -> FloatArray | None:
    """Bins, Hz, that are next to the frequencies of a few sines, if perturbations are sums of them.

    Within three bins of such a bin, nearly all power is at it and its neighbours.
    """
    f = _bins(records, band)
    power = _strength(records, f) ** 2
    around = sliding_window_view(np.pad(power, _APART), 2 * _APART + 1)
    near = np.sum(around[:, _APART - 1 : _APART + 2], axis=1)
    sines = (power == np.max(around, axis=1)) & (near > _ALONE * np.sum(around, axis=1))
    count, total = np.count_nonzero(sines), float(np.sum(power))
    few = count >= FEWEST_FREQUENCIES and _SPARSE * count <= f.size
    return f[sines] if few and np.sum(near[sines]) > _ALONE * total else None


def _strongest(records: Sequence[TrialRecord]) -> FloatArray:
    """Bin with the strongest perturbations in each of `_REFERENCE_BINS` parts of the band, Hz."""
    f = _bins(records, BAND)
    strength = _strength(records, f)
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

    It follows from the responses T and from the covariance, (m, n, n, n_freq), of the torques that
    the estimated arm leaves, `plain` without that scatter and `scattered` with it. Lines count by
    their power. The motion itself may be uneven, where friction of the robot distorts it.
    """
    shares = []
    for column, joint in enumerate(joints if columns[0].at_lines else ()):
        power = 1.0 / columns[column].gain
        noise, both = (power * one[column, joint, joint].real for one in (plain, scattered))
        lines = np.sum(noise) ** 2 / np.sum(noise**2)
        share = np.sum(both - noise) / np.sum(power * np.abs(T[joint, column]) ** 2)
        limit = _BY_CHANCE + _SCATTER / math.sqrt(lines)
        shares.append(float(share) if np.sum(both) > limit * np.sum(noise) else 0.0)
    return tuple(shares)


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
