"""How readings of torque come about: instant, delay, anti-alias filter; what undoes it.

The torque on the arm is ``τ(ω)``. It passes a low-pass H, is read late by D, at the ticks of the
control: ``G(ω) = H(ω) exp(-jωD)``. That alone would be undone by division by G. But commands step
at the ticks, so that τ jumps there, and the spectrum of what jumps does not end at half the
sampling rate: sampling folds it back into the band. By how much is known in closed form. Be
``s(t)`` the response of a reading to a step of 1 N·m at t = 0, ``r(t)`` its integral over t/L. The
spectrum of the readings is then, with jumps ``J`` and jumps of the slope ``S/L`` at the ticks
(whose spectra repeat at the sampling rate), and with x = ωL,

    y(ω) = G τ(ω) - e(ω) J(ω) - b(ω) S(ω)
    e = G/jx - Σ_n s(nL) exp(-jxn),   b = G/(jx)² - Σ_n r(nL) exp(-jxn),   n > 0

For readings just before the update that pass no filter, ``e = 1/2 - jx/12 ...``, ``b = 1/12 ...``:
the Euler-Maclaurin formula. For a drive that lags, whose torque does not jump, s and r are the
responses to its command, and the first terms of e and b have the response of the drive as a factor.
"""

from __future__ import annotations

from enum import Enum
from functools import cached_property

import numpy as np
from pydantic import Field

from armimp_common.arrays import ComplexArray, FloatArray
from armimp_estimation.json_model import JsonModel

_APART = 1e-5
"""Relative distance that poles have at least; partial fractions know no double ones."""
HIGHEST_ORDER = 4
LATEST = 1.0
"""Delay of readings that is believed, s."""
_AT_ONCE = 1e-6
"""Part of a period by which a reading just after an update is later than it."""


class TorqueTiming(str, Enum):
    """When torques are read, relative to the update of the command at the same sample."""

    UNKNOWN = "unknown"
    """Nobody knows: the records have to tell, as far as they can."""
    BEFORE_UPDATE = "before_update"
    """Just before: what jumps with the command is late."""
    AFTER_UPDATE = "after_update"
    """Just after: what jumps with the command is early."""
    MID_INTERVAL = "mid_interval"
    """Half a sample before the angles."""
    INTERVAL_MEAN = "interval_mean"
    """As the mean since the last sample: everything is late by half a sample."""
    SIMULTANEOUS = "simultaneous"
    """With the angles, and nothing jumps."""


_INSTANTS = {
    TorqueTiming.UNKNOWN: "at an instant that nobody told",
    TorqueTiming.AFTER_UPDATE: "just after each command takes effect",
    TorqueTiming.MID_INTERVAL: "half a control period before the angles",
    TorqueTiming.BEFORE_UPDATE: "just before each command takes effect",
    TorqueTiming.INTERVAL_MEAN: "as means over the control period",
    TorqueTiming.SIMULTANEOUS: "at the instant of the angles",
}


class TorqueReading(JsonModel):
    """What is known of the readings of torque, all joints alike.

    Raises
    ------
    ValueError
        If a value is out of range.
    """

    timing: TorqueTiming = TorqueTiming.UNKNOWN
    """When they are read."""
    delay: float = Field(default=0.0, ge=-LATEST, le=LATEST)
    """How late they are beyond that, s; negative if they are early."""
    cutoff: float = Field(default=0.0, ge=0.0, allow_inf_nan=False)
    """Cut-off frequency of the Butterworth low-pass before the sampling, Hz; 0: there is none."""
    order: int = Field(default=1, ge=1, le=HIGHEST_ORDER)
    """Its order."""
    actuator_lag: float = Field(default=0.0, ge=0.0, allow_inf_nan=False)
    """Time constant with which the torque of the drives follows the commands, s; 0: at once. It
    delays torques and angles alike, and matters for what sampling folds back only."""

    @property
    def prompt(self) -> bool:
        """Whether nothing but the instant of reading is to be corrected."""
        return not (self.delay or self.cutoff or self.actuator_lag)

    @property
    def without_jumps(self) -> bool:
        """Whether it was told that what jumps with commands doesn't matter to these readings."""
        return self.timing in {TorqueTiming.INTERVAL_MEAN, TorqueTiming.SIMULTANEOUS}

    @property
    def sentence(self) -> str:
        """All of this in words."""
        facts = [_INSTANTS[self.timing]]
        if self.delay:
            facts.append(f"{1e3 * abs(self.delay):g} ms {'late' if self.delay > 0 else 'early'}")
        if self.cutoff:
            facts.append(
                f"through a Butterworth low-pass of order {self.order}, {self.cutoff:g} Hz"
            )
        if self.actuator_lag:
            facts.append(f"drives lag by {1e3 * self.actuator_lag:g} ms")
        return ", ".join(facts)

    def at_rate(self, rate: float) -> TorqueReading:
        """The same as readings just before the updates, or of what doesn't jump, that are late.

        Readings just after an update are early by nothing but the jump, those amid a period, and
        means over it, are late by half of it.

        Parameters
        ----------
        rate : float
            Readings per second, Hz.
        """
        shift = {
            TorqueTiming.AFTER_UPDATE: (TorqueTiming.BEFORE_UPDATE, -_AT_ONCE),
            TorqueTiming.MID_INTERVAL: (TorqueTiming.BEFORE_UPDATE, 0.5),
            TorqueTiming.INTERVAL_MEAN: (TorqueTiming.SIMULTANEOUS, 0.5),
        }
        if self.timing not in shift:
            return self
        timing, periods = shift[self.timing]
        return self.model_copy(update={"timing": timing, "delay": self.delay + periods / rate})

    def response(self, f: FloatArray) -> ComplexArray:
        """``G = H exp(-jωD)`` at frequencies in Hz."""
        late = np.exp(-2j * np.pi * f * self.delay)
        low_pass = np.ones(f.shape, dtype=np.complex128)
        if self.cutoff > 0.0:
            b, a = self._low_pass
            low_pass = np.polyval(b, 2j * np.pi * f) / np.polyval(a, 2j * np.pi * f)
        return np.asarray(low_pass * late, dtype=np.complex128)

    def folded(self, f: FloatArray, rate: float) -> tuple[ComplexArray, ComplexArray]:
        """What readings lack per jump and per jump of the slope, (e, b) of the module.

        Parameters
        ----------
        f : ndarray, shape (n_freq,)
            Frequencies, Hz.
        rate : float
            Updates and readings per second, Hz.
        """
        x = 2.0 * np.pi * f / rate
        first, since = self.first(rate)
        z = np.exp(-1j * x)
        steps = 1.0 / (1.0 - z)
        ramps = since * steps + z * steps**2
        for amplitude, pole in zip(*self._modes, strict=True):
            decay = np.exp(pole * since / rate) / (1.0 - np.exp(pole / rate) * z)
            steps = steps + amplitude * decay
            ramps = ramps + amplitude * rate / pole * (decay - 1.0 / (1.0 - z))
        driven = self.response(f) / (1.0 + 2j * np.pi * f * self._lag)
        edge = driven / (1j * x) - z**first * steps
        bend = driven / (1j * x) ** 2 - z**first * ramps
        return edge, bend

    def answers(self, rate: float, count: int) -> FloatArray:
        """Responses of readings to a step, a ramp and a parabola of the torque at an update.

        Parameters
        ----------
        rate : float
            Readings per second, Hz.
        count : int
            How many readings, from the first one that shows anything on.

        Returns
        -------
        ndarray, shape (3, count)
            For torques of 1, t/L and (t/L)²/2.
        """
        _, since = self.first(rate)
        t = since + np.arange(count)
        found = np.stack([np.ones(count), t, 0.5 * t**2]).astype(np.complex128)
        for amplitude, pole in zip(*self._modes, strict=True):
            turn = pole / rate
            rest = np.exp(turn * t)
            found[0] += amplitude * rest
            found[1] += amplitude / turn * (rest - 1.0)
            found[2] += amplitude / turn**2 * (rest - 1.0 - turn * t)
        return np.ascontiguousarray(found.real)

    def whitening(self, rate: float) -> FloatArray:
        """Coefficients that take the poles of the low-pass from readings, newest first; sum 1."""
        _, poles = self._modes
        coefficients = np.atleast_1d(np.poly(np.exp(poles / rate))).real
        return np.asarray(coefficients / np.sum(coefficients))

    def first(self, rate: float) -> tuple[int, float]:
        """Periods from an update to the first reading that shows it.

        And how many periods after the update that reading belongs to, 0 < since <= 1.
        """
        periods = self.delay * rate
        # A delay of whole periods may come with a rounding error.
        first = int(np.floor(periods + 1e-9)) + 1
        return first, float(min(first - periods, 1.0))

    @cached_property
    def _lag(self) -> float:
        """Lag of the drives, a little away from the time constant of a low-pass of first order."""
        if self.cutoff > 0.0 and self.order == 1:
            ratio = 2.0 * np.pi * self.cutoff * self.actuator_lag
            if abs(ratio - 1.0) < _APART:
                return self.actuator_lag * (1.0 + 2.0 * _APART)
        return self.actuator_lag

    @cached_property
    def _low_pass(self) -> tuple[FloatArray, FloatArray]:
        # Where there is no low-pass, nobody has to wait for this import.
        from scipy.signal import butter

        b, a = butter(self.order, 2.0 * np.pi * self.cutoff, analog=True)
        return np.asarray(b), np.asarray(a)

    @cached_property
    def _modes(self) -> tuple[ComplexArray, ComplexArray]:
        """Amplitudes and poles of what a step response has beside 1, of drive and low-pass."""
        b: FloatArray = np.ones(1)
        a: FloatArray = np.ones(1)
        if self.cutoff > 0.0:
            b, a = self._low_pass
        if self._lag > 0.0:
            a = np.asarray(np.polymul(a, [self._lag, 1.0]), dtype=np.float64)
        if len(a) == 1:
            nothing = np.zeros(0, dtype=np.complex128)
            return nothing, nothing
        from scipy.signal import residue

        residues, poles, _ = residue(b, a)
        return np.asarray(residues / poles, dtype=np.complex128), np.asarray(poles)
