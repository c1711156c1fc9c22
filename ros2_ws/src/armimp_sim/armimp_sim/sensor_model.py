"""What a real rig does to torques: offset, drift, gain, anti-alias filter, delay, actuator lag.

Numbers of a rig by themselves; :mod:`armimp_sim.sensor_dynamics` is the compiled part.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armimp_common.errors import ConfigurationError
from armimp_sim import sensor_dynamics as t

Vector = tuple[float, ...]

LONGEST_DELAY = 0.1
"""s; a rig that is later cannot be controlled."""


@dataclass(frozen=True, kw_only=True)
class SensorModel:
    """Between the torque on the arm and its reading, and between command and torque of the drives.

    The torque on the arm passes a Butterworth low-pass, is read late, and the reading is
    ``gain · τ + offset + drift · t``, which is then rounded. Filter, delay and lag act within the
    control period, on the grid of the integration.

    Parameters
    ----------
    offset : one value for all joints or one for each, N·m
    drift : likewise, N·m/s; from the start of the simulation on
    gain : likewise, 1 for a transducer in good order
    delay : of the readings of torque, s, rounded to steps of the integration
    cutoff : of the low-pass before the sampling, Hz; 0: there is none
    order : of the low-pass
    actuator_lag : time constant with which the torque of the drives follows commands, s; 0: at once

    Raises
    ------
    ConfigurationError
        If a value is out of range.
    """

    offset: Vector = (0.0,)
    drift: Vector = (0.0,)
    gain: Vector = (1.0,)
    delay: float = 0.0
    cutoff: float = 0.0
    order: int = 1
    actuator_lag: float = 0.0

    def __post_init__(self) -> None:
        for name in ("offset", "drift", "gain"):
            values = getattr(self, name)
            if not values or not np.all(np.isfinite(values)):
                raise ConfigurationError(
                    f"sensors: torque {name} needs finite values: {list(values)}"
                )
        if 0.0 in self.gain:
            raise ConfigurationError(f"sensors: torque gain must not be 0: {list(self.gain)}")
        if not 0.0 <= self.delay <= LONGEST_DELAY:
            raise ConfigurationError(
                f"sensors: torque delay must be between 0 and {LONGEST_DELAY} s, got {self.delay}"
            )
        if not 0.0 <= self.cutoff < np.inf:
            raise ConfigurationError(
                f"sensors: torque cut-off must not be negative, got {self.cutoff} Hz"
            )
        if not 1 <= self.order <= t.ORDERS:
            raise ConfigurationError(
                f"sensors: order of the torque low-pass must be 1 to {t.ORDERS}, got {self.order}"
            )
        if not 0.0 <= self.actuator_lag < np.inf:
            raise ConfigurationError(
                f"actuators: lag must not be negative, got {self.actuator_lag} s"
            )

    @property
    def none(self) -> bool:
        """Whether readings and torques are what they are without any of this."""
        return (
            not any(self.offset)
            and not any(self.drift)
            and set(self.gain) == {1.0}
            and not (self.delay or self.cutoff or self.actuator_lag)
        )

    def check(self, joints: int) -> None:
        """Check that the vectors fit so many joints.

        Raises
        ------
        ConfigurationError
            If one does not; the message carries the numbers.
        """
        for name in ("offset", "drift", "gain"):
            count = len(getattr(self, name))
            if count not in (1, joints):
                raise ConfigurationError(
                    f"sensors: torque {name} has {count} values, needs 1 or {joints}"
                )

    def numbers(
        self, *, joints: int, step: float, substeps: int, periods: int
    ) -> NDArray[np.float64]:
        """All of this for one lane as compiled code takes it, settled without torque.

        Parameters
        ----------
        joints : n
        step : of the integration, s
        substeps : steps in a control period
        periods : room for so many whole periods of delay, at least :meth:`whole_periods`
        """
        numbers = np.zeros(t.size(joints, periods))
        if self.actuator_lag > 0.0:
            keep = np.exp(-step / self.actuator_lag)
            numbers[t.KEEP] = keep
            numbers[t.MEAN] = -np.expm1(-step / self.actuator_lag) * self.actuator_lag / step
        late = round(self.delay / step)
        numbers[t.CAPTURE] = substeps - late % substeps
        numbers[t.PERIODS] = late // substeps
        if self.cutoff > 0.0:
            self._filter(numbers, step)
        per_joint = numbers[t.JOINTS : t.JOINTS + t.PER_JOINT * joints].reshape(joints, -1)
        per_joint[:, t.GAIN] = self.gain
        per_joint[:, t.OFFSET] = self.offset
        per_joint[:, t.DRIFT] = np.array(self.drift) * (step * substeps)
        return numbers

    def whole_periods(self, step: float, substeps: int) -> int:
        """Whole control periods in the delay."""
        return round(self.delay / step) // substeps

    def _filter(self, numbers: NDArray[np.float64], step: float) -> None:
        """Exact transition of the low-pass for a torque that is linear over a step."""
        # Where there is no low-pass, nobody has to wait for these imports.
        from scipy.linalg import expm
        from scipy.signal import butter, zpk2ss

        p = self.order
        zpk = butter(p, 2.0 * np.pi * self.cutoff, analog=True, output="zpk")
        a, b, c, _ = zpk2ss(*zpk)
        # State, torque at the start of the step, and its change over the step as one system.
        system = np.zeros((p + 2, p + 2))
        system[:p, :p], system[:p, p : p + 1] = a * step, b * step
        system[p, p + 1] = 1.0
        over = expm(system)
        numbers[t.ORDER] = p
        matrix = np.zeros((t.ORDERS, t.ORDERS))
        matrix[:p, :p] = over[:p, :p]
        numbers[t.TRANSITION : t.TRANSITION + t.ORDERS**2] = matrix.ravel()
        end = over[:p, p + 1]
        numbers[t.FROM_START : t.FROM_START + p] = over[:p, p] - end
        numbers[t.FROM_END : t.FROM_END + p] = end
        numbers[t.OUTPUT : t.OUTPUT + p] = c[0]
        numbers[t.SETTLED : t.SETTLED + p] = np.linalg.solve(-a, b)[:, 0]
