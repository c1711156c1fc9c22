"""A trial as estimators use it: its record without drift, and the spectra of its signals.

A drifting transducer adds a ramp to its torque and, through the feedback of the measured torque, to
the angle of the perturbed joint. The spectrum of a ramp falls off with 1/f only, so it disturbs the
lowest bins of the band, and averaging does not remove it. A straight line fitted to the signal
would also remove part of the response to the perturbation. But the response can be separated from a
ramp: at the lowest bins each output obeys

    Y(k) = G(k) U(k) + T(k) + c·D(k) + V(k)

as in :mod:`armimp_estimation.estimators.local_polynomial`, with the transform D of a ramp. The
slope c follows by least squares, with its standard error.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from armimp_common.arrays import FloatArray
from armimp_common.errors import DataError
from armimp_estimation.estimators.local_polynomial import HALF_WIDTH, ORDER
from armimp_estimation.problems import Problem
from armimp_estimation.record import TrialRecord
from armimp_estimation.signal_quality import mended
from armimp_estimation.spectra import CrossSpectra, cross_spectra, segment_for_samples
from armimp_estimation.torque_timing import TorqueReading

HIGHEST = 2.0
"""Frequency up to which the bins may reach, Hz: beyond it lies the arm's resonance.

In a short record, the part of the resonance that the polynomials miss would be mistaken for drift.
Drift has little effect on such a record anyway.
"""
_ABSURD = 1e50
"""Values from this size on are refused, as they are neither angles nor torques."""
_WINDOW = 2 * HALF_WIDTH + 1
SIGNIFICANT = 6.0
"""Standard errors beyond which a slope counts as drift; no record gets there by chance."""


def slopes_of(record: TrialRecord) -> tuple[FloatArray, FloatArray]:
    """Estimate the slopes of the signals of a trial, apart from their response to the perturbation.

    Returns
    -------
    slopes, errors : ndarray, shape (2n,)
        Slopes of angles, rad/s, then of torques, N·m/s, and their standard errors. These are
        infinite if the record is too short (see :data:`HIGHEST`) or its perturbation too poor.
    """
    unknown = np.zeros(2 * record.joints), np.full(2 * record.joints, np.inf)
    places = np.arange(1, _WINDOW + 1)
    record = record.whole_periods
    samples = record.samples
    if (samples - 1) // 2 < _WINDOW or places[-1] * record.rate / samples > HIGHEST:
        return unknown
    inputs = np.fft.rfft(record.perturbation[record.perturbed_joint])[places]
    scale = np.sqrt(np.mean(np.abs(inputs) ** 2))
    if not scale > 0.0:
        return unknown
    if record.periods is not None:
        # A periodic perturbation has no power between its harmonics.
        places = places[places % record.periods.count != 0]
    ramp = np.fft.rfft(np.arange(samples) / record.rate)[places]
    size = np.sqrt(np.mean(np.abs(ramp) ** 2))
    powers = ((places - places.mean()) / HALF_WIDTH)[:, None] ** np.arange(ORDER + 1)
    columns = [powers, (ramp / size)[:, None]]
    if record.periods is None:
        columns.insert(0, (inputs / scale)[:, None] * powers)
    basis, triangle = np.linalg.qr(np.concatenate(columns, axis=1))
    freedom = places.size - triangle.shape[0]
    if freedom < 1 or np.min(np.abs(np.diag(triangle))) < 1e-9 * np.max(np.abs(triangle)):
        return unknown
    outputs = np.concatenate([record.position, record.torque])
    observed = np.fft.rfft(outputs - outputs.mean(axis=1, keepdims=True), axis=1)[:, places].T
    parts = np.conj(basis.T) @ observed
    noise = np.sum(np.abs(observed - basis @ parts) ** 2, axis=0) / freedom
    # The ramp is the last column, so its coefficient follows from the last row alone.
    slopes = (parts[-1] / triangle[-1, -1]).real / size
    return slopes, np.sqrt(0.5 * noise) / (abs(triangle[-1, -1]) * size)


def cleaned(
    stretches: Sequence[TrialRecord],
) -> tuple[tuple[TrialRecord, ...], tuple[Problem, ...]]:
    """Cut the rest after the perturbation off a trial, mend lost readings, and remove drift.

    The drift is that of the longest stretch.
    """
    whole, problems = zip(*(mended(one.until_rest) for one in stretches), strict=True)
    slopes, errors = slopes_of(max(whole, key=lambda stretch: stretch.samples))
    drift = np.where(np.abs(slopes) > SIGNIFICANT * errors, slopes, 0.0)
    if drift.any():
        whole = tuple(_without(drift, record) for record in whole)
    return whole, tuple(chain(*problems))


def _without(slopes: FloatArray, record: TrialRecord) -> TrialRecord:
    """Subtract ramps with these slopes, (2n,), from the angles and torques of a record."""
    t = (np.arange(record.samples) - 0.5 * (record.samples - 1)) / record.rate
    position, torque = np.split(slopes[:, None] * t, 2)
    return replace(record, position=record.position - position, torque=record.torque - torque)


def segment_for(trials: Sequence[Sequence[TrialRecord]]) -> int:
    """Choose the length of Welch segments, in samples, to suit the trial with the shortest parts.

    If all trials have the same periodic perturbation, segments follow its period.
    """
    periods = [max(parts, key=lambda part: part.samples).periods for parts in trials]
    if periods and periods[0] is not None and all(map(periods[0].alike, periods)):
        return periods[0].segment
    sizes = [
        segment_for_samples(*(part.samples for part in parts), rate=parts[0].rate)
        for parts in trials
    ]
    return min(sizes, default=segment_for_samples(0))


@dataclass(frozen=True, kw_only=True, eq=False)
class TrialData:
    """A finished trial."""

    record: TrialRecord
    """Samples without a gap: the longest stretch if the trial has gaps."""
    spectra: CrossSpectra
    """Those of ``[tau_delta_k, theta_1..theta_n, tau_1..tau_n]``, all stretches; N·m and rad."""
    problems: tuple[Problem, ...] = ()
    """Problems of readings that were lost and interpolated, in all stretches."""
    at_lines: bool = False
    """Whether the spectra are only at the lines of a periodic perturbation."""

    @classmethod
    def of(
        cls,
        *stretches: TrialRecord,
        segment: int | None = None,
    ) -> TrialData:
        """Compute the spectra of a whole record, or of the intact stretches of a trial.

        Segments have `segment` samples, by default those of :func:`segment_for`; none spans a gap.
        Delay and filter of the torque readings are removed from the spectra. Lost readings
        are interpolated. Drift, estimated from the longest stretch, is removed from record and
        spectra. If segments fit the periods of the perturbation, spectra are taken at its lines.

        Raises
        ------
        DataError
            If no stretch is as long as one segment, or values are absurdly large.
        """
        for stretch in stretches:
            given = (stretch.position, stretch.torque, stretch.perturbation, stretch.command)
            sizes = [np.max(np.abs(one), initial=0.0) for one in given if one is not None]
            if not (largest := float(np.max(sizes))) < _ABSURD:
                raise DataError(f"trial {stretch.trial}: {largest:.3g} is no angle and no torque")
        stretches, mendings = cleaned(stretches)
        record = max(stretches, key=lambda stretch: stretch.samples)
        k = record.perturbed_joint
        signals = [
            np.concatenate((one.perturbation[k : k + 1], one.position, one.torque))
            for one in stretches
        ]
        try:
            chosen = segment_for([stretches]) if segment is None else segment
            found = cross_spectra(*signals, rate=record.rate, segment=chosen)
            periods = record.periods
            if periods is not None and chosen != periods.segment:
                periods = None
            if periods is not None:
                found = found.at(periods.frequencies(record.rate))
            spectra = _read_at_once(found, record.reading)
            return cls(
                record=record,
                spectra=spectra,
                problems=mendings,
                at_lines=periods is not None,
            )
        except DataError as error:
            gaps = "" if len(stretches) == 1 else f" in {len(stretches)} intact parts"
            raise DataError(f"trial {record.trial}: {error}{gaps}", error.code) from error

    @property
    def joint(self) -> int:
        """The perturbed joint, 0-based."""
        return self.record.perturbed_joint

    @property
    def f(self) -> FloatArray:
        """Frequencies of the spectra, Hz, shape (n_freq,)."""
        return self.spectra.f

    @property
    def input_power(self) -> FloatArray:
        """Power density of the perturbation, (N·m)²/Hz, shape (n_freq,)."""
        return self.spectra.power(0)

    def position_channel(self, joint: int) -> int:
        """Channel of the angle of a joint (0-based)."""
        return 1 + joint

    def torque_channel(self, joint: int) -> int:
        """Channel of the torque of a joint (0-based)."""
        return 1 + self.record.joints + joint


def _read_at_once(spectra: CrossSpectra, reading: TorqueReading) -> CrossSpectra:
    """Remove delay and filter of the torque readings from spectra; coherences stay the same."""
    if reading.prompt:
        return spectra
    count = len(spectra.matrix)
    factor = np.ones((count, spectra.f.size), dtype=np.complex128)
    factor[1 + count // 2 :] = 1.0 / reading.response(spectra.f)
    # G_xy = E[conj(X) Y].
    matrix = np.conj(factor)[:, None] * spectra.matrix * factor[None]
    return replace(spectra, matrix=matrix)
