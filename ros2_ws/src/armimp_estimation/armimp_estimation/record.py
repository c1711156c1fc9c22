"""The record of one trial as arrays, from which every estimator starts."""

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from armimp_common.arrays import FloatArray
from armimp_common.errors import DataError
from armimp_common.topics import JOINT_STATES, TORQUE_SENSORS
from armimp_estimation.periods import FEWEST_LINES, Periods
from armimp_estimation.spectra import BAND
from armimp_estimation.torque_timing import TorqueReading

EXACT = 1e-9
"""Differences of a signal, relative to its peak-to-peak range, that are floating-point rounding."""
APART = 0.02
"""Distance between the postures of trials that is neglected, rad."""
_BY_CHANCE = 10.0
"""Least gap that counts as a resolution, in units of ``r/n²``, the gap of n random values in a
range r; these have a larger one in 1 of e¹⁰ cases."""
_ONCE = 0.4
"""Least count of a genuine value, as a share of the median count of all values."""


@dataclass(frozen=True, kw_only=True, eq=False)
class TrialRecord:
    """The samples of one trial: the commanded perturbation and the readings of the sensors.

    The arrays are converted to C-contiguous float64, so that the estimates do not
    depend on how the caller happened to lay them out.

    Raises
    ------
    DataError
        If shapes disagree or a sample is not finite; the message names the joint and sample.
    """

    trial: int
    """Number of the trial, 1-based."""
    perturbed_joint: int
    """The joint that was perturbed, 0-based."""
    rate: float
    """Samples per second, Hz."""
    joint_names: tuple[str, ...]
    """One name for each of the n joints, in the order of the rows."""
    perturbation: FloatArray = field(repr=False)
    """Perturbation torque ``tau_delta`` of each joint, N·m; shape (n, N)."""
    position: FloatArray = field(repr=False)
    """Joint angles as the encoders read them, rad; shape (n, N)."""
    torque: FloatArray = field(repr=False)
    """Torques applied to the arm as the transducers read them, N·m; shape (n, N)."""
    start_ns: int
    """Stamp of the first sample, ns."""
    reading: TorqueReading = field(default_factory=TorqueReading)
    """What is known of how the torques were read."""
    command: FloatArray | None = field(default=None, repr=False)
    """Torque command sent in answer to each sample, in force until the next, N·m, if known; shape
    (n, N)."""
    bag: str | None = None
    """Bag in which the trial is stored, if any."""

    def __post_init__(self) -> None:
        n = len(self.joint_names)
        where = f"trial {self.trial}"
        if n == 0 or len(set(self.joint_names)) != n:
            raise DataError(f"{where}: joint names must be distinct, got {self.joint_names!r}")
        signals = ["perturbation", "position", "torque"]
        if self.command is not None:
            signals.append("command")
        for name in signals:
            values: FloatArray = np.ascontiguousarray(getattr(self, name), dtype=np.float64)
            if values.ndim != 2 or values.shape[0] != n:
                raise DataError(f"{where}: {name} has shape {values.shape}, expected ({n}, N)")
            if values.shape != np.shape(self.perturbation):
                raise DataError(
                    f"{where}: {name} has {values.shape[1]} samples, "
                    f"perturbation has {np.shape(self.perturbation)[1]}"
                )
            finite = np.isfinite(values)
            if not finite.all():
                row, sample = np.argwhere(~finite)[0]
                raise DataError(
                    f"{where}: {name} of {self.joint_names[row]} is "
                    f"{values[row, sample]} at sample {sample}"
                )
            object.__setattr__(self, name, values)

    @property
    def joints(self) -> int:
        """Number of joints n."""
        return len(self.joint_names)

    @property
    def samples(self) -> int:
        """Number of samples N."""
        return int(self.perturbation.shape[1])

    @property
    def duration(self) -> float:
        """Length of the record, s."""
        return self.samples / self.rate

    @property
    def whole_periods(self) -> "TrialRecord":
        """The whole periods of the record; all of it if it is not periodic."""
        if self.periods is None or self.periods.used == self.samples:
            return self
        return self.part(self.periods.stretch.start, self.periods.end)

    def part(self, first: int, end: int | None = None) -> "TrialRecord":
        """Return the samples from `first` up to, but not including, `end`."""
        names = ("perturbation", "position", "torque", "command")
        known = {name: getattr(self, name) for name in names if getattr(self, name) is not None}
        parts = {name: values[:, first:end] for name, values in known.items()}
        return replace(self, **parts, start_ns=self.start_ns + round(1e9 * first / self.rate))

    @property
    def until_rest(self) -> "TrialRecord":
        """The record without samples after the last period of the perturbation, if it has any."""
        if self.periods is None or self.periods.end == self.samples:
            return self
        return self.part(0, self.periods.end)

    @property
    def readings(self) -> dict[str, FloatArray]:
        """Angles and torques by the topic of their sensors."""
        return {JOINT_STATES: self.position, TORQUE_SENSORS: self.torque}

    @cached_property
    def resolution(self) -> dict[str, FloatArray]:
        """Resolutions of angles, rad, and torques, N·m, by topic as `readings`; shapes (n,)."""
        return {
            topic: np.array([resolution_of(one) for one in signals])
            for topic, signals in self.readings.items()
        }

    @cached_property
    def periods(self) -> Periods | None:
        """Periods of the perturbation, if it is periodic with enough lines in the band."""
        found = Periods.of(self.perturbation[self.perturbed_joint])
        few = found is None or found.lines_in(self.rate, BAND).size < FEWEST_LINES
        return None if few else found


def resolution_of(signal: FloatArray) -> float:
    """Least difference between two genuine values of a signal; 0 if it is constant.

    Linear interpolation onto other instants adds values between readings, but none where readings
    stay the same. So only values that last for at least two samples count, provided that their gaps
    are not random: of n random values in a range r, two are as a rule as near as ``r/n²``. A value
    that rarely lasts is left out: two interpolated values were equal by accident.
    """
    nothing = EXACT * float(np.ptp(signal))
    starts = np.flatnonzero(np.concatenate(([True], np.abs(np.diff(signal)) > nothing)))
    lasting = signal[starts[np.diff(starts, append=signal.size) > 1]]
    for shown, chance in ((lasting, _BY_CHANCE / max(lasting.size, 1) ** 2), (signal, 0.0)):
        values, times = np.unique(shown, return_counts=True)
        gaps = np.diff(values[times > _ONCE * np.median(np.append(times, 1))])
        gaps = gaps[gaps > nothing]
        if gaps.size and (least := float(np.min(gaps))) > chance * float(np.sum(gaps)):
            return least
    return 0.0
