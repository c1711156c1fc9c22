"""A trial as estimators take it: its record without drift, and the spectra of its signals.

A transducer that drifts adds a ramp to its torque, and through the feedback of the measured torque
to the angle of the perturbed joint. In the spectrum a ramp falls off with 1/f only, so that it
reaches the lowest bins of the band, as a disturbance that no average removes. A straight line
fitted to the signal would also take out what the perturbation does there. But the response to that
can be told from a ramp: at the lowest bins each output obeys

    Y(k) = G(k) U(k) + T(k) + c·D(k) + V(k)

as in :mod:`armimp_estimation.estimators.local_polynomial`, with the transform D of a ramp, and the
slope c follows by least squares, with its standard error.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from armimp_common.arrays import FloatArray
from armimp_common.errors import DataError
from armimp_estimation.estimators.local_polynomial import HALF_WIDTH, ORDER
from armimp_estimation.periods import common_periods
from armimp_estimation.problems import Problem
from armimp_estimation.record import TrialRecord
from armimp_estimation.signal_quality import mended
from armimp_estimation.spectra import CrossSpectra, cross_spectra, segment_for_samples
from armimp_estimation.torque_timing import TorqueReading

HIGHEST = 2.0
"""Frequency up to which the bins may reach, Hz: beyond it the arm's resonance is in the way.

What the polynomials do not follow of that would be taken for drift in a short record. Within one a
drift does little, too.
"""
_ABSURD = 1e50
_WINDOW = 2 * HALF_WIDTH + 1
SIGNIFICANT = 6.0
"""Standard errors beyond which a slope is taken for drift: in no record does chance get there."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Drift:
    """Slopes of the signals of a trial, beside what the perturbation does."""

    slopes: FloatArray
    errors: FloatArray
    """Of the angles, rad/s, then of the torques, N·m/s, and their standard errors; shape (2n,)."""

    @property
    def beyond_chance(self) -> FloatArray:
        """Slopes that no chance explains, others 0, shape (2n,)."""
        return np.where(np.abs(self.slopes) > SIGNIFICANT * self.errors, self.slopes, 0.0)

    @property
    def significant(self) -> bool:
        """Whether there is any beyond chance."""
        return bool(self.beyond_chance.any())

    def removed_from(self, record: TrialRecord) -> TrialRecord:
        """A record of the trial without those slopes that are beyond chance."""
        t = (np.arange(record.samples) - 0.5 * (record.samples - 1)) / record.rate
        position, torque = np.split(self.beyond_chance[:, None] * t, 2)
        return replace(record, position=record.position - position, torque=record.torque - torque)


def drift_of(record: TrialRecord) -> Drift | None:
    """Find the slopes of angles and torques.

    Parameters
    ----------
    record : TrialRecord
        A trial without gaps.

    Returns
    -------
    Drift or None
        None if the record is too short (see :data:`HIGHEST`), or its perturbation too poor, to
        tell.
    """
    places = np.arange(1, _WINDOW + 1)
    record = record.whole_periods
    samples = record.samples
    if (samples - 1) // 2 < _WINDOW or places[-1] * record.rate / samples > HIGHEST:
        return None
    inputs = np.fft.rfft(record.perturbation[record.perturbed_joint])[places]
    scale = np.sqrt(np.mean(np.abs(inputs) ** 2))
    if not scale > 0.0:
        return None
    if record.periods is not None:
        # Between its harmonics a periodic perturbation does nothing.
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
        return None
    outputs = np.concatenate([record.position, record.torque])
    observed = np.fft.rfft(outputs - outputs.mean(axis=1, keepdims=True), axis=1)[:, places].T
    parts = np.conj(basis.T) @ observed
    noise = np.sum(np.abs(observed - basis @ parts) ** 2, axis=0) / freedom
    # The ramp is the last column, so its coefficient follows from the last row alone.
    slopes = (parts[-1] / triangle[-1, -1]).real / size
    errors = np.sqrt(0.5 * noise) / (abs(triangle[-1, -1]) * size)
    return Drift(slopes=slopes, errors=errors)


def segment_for(trials: Sequence[Sequence[TrialRecord]]) -> int:
    """Samples of Welch segments that suit all trials, by that with the shortest intact parts.

    Where all have the same periodic perturbation, they are as long as its period.
    """
    longest = [max(parts, key=lambda part: part.samples) for parts in trials]
    periods = common_periods([record.periods for record in longest])
    if periods is not None:
        return periods.segment
    sizes = [
        segment_for_samples(*(part.samples for part in parts), rate=parts[0].rate)
        for parts in trials
    ]
    return min(sizes, default=segment_for_samples(0))


@dataclass(frozen=True, kw_only=True, eq=False)
class TrialData:
    """A finished trial."""

    record: TrialRecord
    """Samples without a gap; of a trial with gaps the longest stretch."""
    spectra: CrossSpectra
    """Of ``[tau_delta_k, theta_1..theta_n, tau_1..tau_n]`` in all stretches, N·m and rad."""
    problems: tuple[Problem, ...] = ()
    """What of the record was mended."""
    at_lines: bool = False
    """Whether the spectra are at the lines of a periodic perturbation alone."""

    @classmethod
    def of(
        cls,
        *stretches: TrialRecord,
        segment: int | None = None,
        reading: TorqueReading | None = None,
    ) -> TrialData:
        """Compute the spectra of a whole record, or of the intact stretches of a trial.

        Segments are of so many samples, by default as suits it. None spans a gap. Torques are taken
        without the delay and the filter of their ``reading``. Lost readings are interpolated.
        Drift, as the longest stretch tells it, is taken out of record and spectra. Where segments
        are those of its periods, spectra are taken at the lines of the perturbation.

        Raises
        ------
        DataError
            If none of them is as long as one segment, or values are absurd.
        """
        for stretch in stretches:
            given = (stretch.position, stretch.torque, stretch.perturbation, stretch.command)
            sizes = [np.max(np.abs(one), initial=0.0) for one in given if one is not None]
            if not (largest := float(np.max(sizes))) < _ABSURD:
                raise DataError(f"trial {stretch.trial}: {largest:.3g} is no angle and no torque")
        whole = [mended(stretch) for stretch in stretches]
        record, problems = max(whole, key=lambda one: one[0].samples)
        stretches = tuple(stretch for stretch, _ in whole)
        drift = drift_of(record)
        if drift is not None and drift.significant:
            stretches = tuple(drift.removed_from(stretch) for stretch in stretches)
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
            spectra = _read_at_once(found, reading or TorqueReading())
            return cls(
                record=record,
                spectra=spectra,
                problems=tuple(problems),
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
    """Spectra as if torques had been read without delay and filter; coherences stay."""
    if reading.prompt:
        return spectra
    count = len(spectra.matrix)
    factor = np.ones((count, spectra.f.size), dtype=np.complex128)
    factor[1 + count // 2 :] = 1.0 / reading.response(spectra.f)
    # G_xy = E[conj(X) Y].
    matrix = np.conj(factor)[:, None] * spectra.matrix * factor[None]
    return replace(spectra, matrix=matrix)
