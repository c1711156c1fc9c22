"""A trial as estimators take it: its record and the spectra of its signals."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from armimp_common.arrays import FloatArray
from armimp_common.errors import DataError
from armimp_estimation.drift import drift_of
from armimp_estimation.periods import common_periods
from armimp_estimation.record import TrialRecord
from armimp_estimation.spectra import CrossSpectra, SpectralAccumulator, WelchConfig
from armimp_estimation.torque_timing import TorqueReading


def channels(
    joint: int, perturbation: FloatArray, position: FloatArray, torque: FloatArray
) -> FloatArray:
    """Stack samples of the trial of a joint (0-based), each (n, m), as spectra have them."""
    return np.concatenate((perturbation[joint : joint + 1], position, torque))


def segments_for(trials: Sequence[Sequence[TrialRecord]]) -> WelchConfig:
    """Choose Welch segments that suit all trials, by that with the shortest intact parts.

    Where all have the same periodic perturbation, they are as long as its period.
    """
    longest = [max(parts, key=lambda part: part.samples) for parts in trials]
    periods = common_periods(record.periods for record in longest)
    if periods is not None:
        return WelchConfig(segment=periods[0].segment, overlap=periods[0].segment * 3 // 4)
    configs = [
        WelchConfig.for_samples(*(part.samples for part in parts), rate=parts[0].rate)
        for parts in trials
    ]
    return min(configs, key=lambda config: config.segment, default=WelchConfig.for_samples(0))


@dataclass(frozen=True, kw_only=True, eq=False)
class TrialData:
    """A finished trial."""

    record: TrialRecord
    """Samples without a gap; of a trial with gaps the longest stretch."""
    spectra: CrossSpectra
    """Of ``[tau_delta_k, theta_1..theta_n, tau_1..tau_n]`` in all stretches, N·m and rad."""

    @classmethod
    def of(
        cls,
        *stretches: TrialRecord,
        welch: WelchConfig | None = None,
        reading: TorqueReading | None = None,
    ) -> "TrialData":
        """Compute the spectra of a whole record, or of the intact stretches of a trial.

        They are bit-identical to those that are gathered live, and no segment spans a gap. Torques
        are taken without the delay and the filter of their ``reading``. Drift, as the longest
        stretch tells it, is taken out of record and spectra.

        Raises
        ------
        DataError
            If none of them is as long as one segment.
        """
        record = max(stretches, key=lambda stretch: stretch.samples)
        drift = drift_of(record)
        if drift is not None and drift.significant:
            stretches = tuple(drift.removed_from(stretch) for stretch in stretches)
            record = max(stretches, key=lambda stretch: stretch.samples)
        accumulator = SpectralAccumulator(2 * record.joints + 1, record.rate, welch)
        k = record.perturbed_joint
        for stretch in stretches:
            accumulator.interrupt()
            accumulator.push(channels(k, stretch.perturbation, stretch.position, stretch.torque))
        try:
            found = accumulator.result()
            if record.periods is not None:
                found = found.at(record.periods.frequencies(record.rate))
            return cls(record=record, spectra=_read_at_once(found, reading or TorqueReading()))
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
