"""Drift of the signals of a trial: found, and taken out where there is any.

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

from dataclasses import dataclass, replace

import numpy as np

from armimp_common.arrays import FloatArray
from armimp_estimation.estimators.local_polynomial import LocalPolynomialConfig
from armimp_estimation.record import TrialRecord

HIGHEST = 2.0
"""Frequency up to which the bins may reach, Hz: beyond it the arm's resonance is in the way.

What the polynomials do not follow of that would be taken for drift in a short record. Within one a
drift does little, too.
"""
# Polynomials of a higher degree would follow the ramp itself.
_LOCAL = LocalPolynomialConfig()
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
    places = np.arange(1, _LOCAL.window + 1)
    record = record.whole_periods
    samples = record.samples
    if (samples - 1) // 2 < _LOCAL.window or places[-1] * record.rate / samples > HIGHEST:
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
    powers = ((places - places.mean()) / _LOCAL.half_width)[:, None] ** np.arange(_LOCAL.order + 1)
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
