"""How torque readings come about (instant, delay, anti-alias filter), and how that is undone.

The torque on the arm, ``τ(ω)``, passes a low-pass H and is read at the control ticks with a delay
D: ``G(ω) = H(ω) exp(-jωD)``. If τ were smooth, division by G would suffice. But commands step at
the ticks, so τ jumps there, and the spectrum of jumps does not end at half the sampling rate:
sampling folds it back into the band, by an amount that is known in closed form. Let L be the
control period, x = ωL, ``s(t)`` the response of a reading to a step of 1 N·m at t = 0, and ``r(t)``
its integral over t/L. With jumps ``J`` of the torque and ``S/L`` of its slope at the ticks, whose
spectra repeat at the sampling rate, the spectrum of the readings is

    y(ω) = G τ(ω) - e(ω) J(ω) - b(ω) S(ω)
    e = G/jx - Σ_n s(nL) exp(-jxn),   b = G/(jx)² - Σ_n r(nL) exp(-jxn),   n > 0

For unfiltered readings just before the update ``e = 1/2 - jx/12 ...`` and ``b = 1/12 ...``, which
is the Euler-Maclaurin formula. The torque of a drive that lags does not jump: s and r are then the
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
"""Least relative distance of two poles, as the partial fractions allow no double ones."""
HIGHEST_ORDER = 4  # of the low-pass
LATEST = 1.0
"""Largest delay of readings that is accepted, s."""
_AT_ONCE = 1e-6
"""Time from an update to a reading just after it, in periods."""


class TorqueTiming(str, Enum):
    """Instant of a torque reading relative to the command update at the same sample."""

    UNKNOWN = "unknown"
    """Unknown: it is estimated from the records as far as possible."""
    BEFORE_UPDATE = "before_update"
    """Just before the update: torque that jumps with the command is late."""
    AFTER_UPDATE = "after_update"
    """Just after the update: torque that jumps with the command is early."""
    MID_INTERVAL = "mid_interval"
    """Half a sample before the angles."""
    INTERVAL_MEAN = "interval_mean"
    """Mean since the last sample: all torque is late by half a sample."""
    SIMULTANEOUS = "simultaneous"
    """At the instant of the angles; no torque jumps."""


_INSTANTS = {
    TorqueTiming.UNKNOWN: "at an unknown instant",
    TorqueTiming.AFTER_UPDATE: "just after each command takes effect",
    TorqueTiming.MID_INTERVAL: "half a control period before the angles",
    TorqueTiming.BEFORE_UPDATE: "just before each command takes effect",
    TorqueTiming.INTERVAL_MEAN: "as means over the control period",
    TorqueTiming.SIMULTANEOUS: "at the instant of the angles",
}


class TorqueReading(JsonModel):
    """What is known of the torque readings, which are alike for all joints.

    Raises
    ------
    ValueError
        If a value is out of range.
    """

    timing: TorqueTiming = TorqueTiming.UNKNOWN
    """Instant at which they are read."""
    delay: float = Field(default=0.0, ge=-LATEST, le=LATEST)
    """Delay beyond that instant, s; negative if they are early."""
    cutoff: float = Field(default=0.0, ge=0.0, allow_inf_nan=False)
    """Cut-off frequency of the Butterworth low-pass before the sampling, Hz; 0: there is none."""
    order: int = Field(default=1, ge=1, le=HIGHEST_ORDER)
    """Order of that low-pass."""
    actuator_lag: float = Field(default=0.0, ge=0.0, allow_inf_nan=False)
    """Time constant with which the torque of the drives follows the commands, s; 0: at once. It
    delays torques and angles alike, so it matters only for what sampling folds back."""
    uncertainty: float = Field(default=20e-6, ge=0.0, le=LATEST)
    """Standard error of the instant where that is known, s."""

    @property
    def prompt(self) -> bool:
        """Whether only the instant of reading has to be corrected."""
        return not (self.delay or self.cutoff or self.actuator_lag)

    @property
    def without_jumps(self) -> bool:
        """Whether by declaration jumps with the commands don't affect these readings."""
        return self.timing in {TorqueTiming.INTERVAL_MEAN, TorqueTiming.SIMULTANEOUS}

    @property
    def sentence(self) -> str:
        """Instant, delay, filter and lag in words."""
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
        """Return equivalent readings just before the updates, or without jumps, with a delay.

        Readings just after an update differ from those just before only by the jump; readings amid
        a period, and means over it, are late by half a period.

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
        """What readings lack per jump of the torque, and of its slope: e and b as defined above.

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
        """Responses of readings to a step, a ramp and a parabola of the torque from an update on.

        Parameters
        ----------
        rate : float
            Readings per second, Hz.
        count : int
            Number of readings, from the first one that shows the update on.

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
        """Weights, newest first, that remove poles of drive and low-pass from readings; sum 1."""
        _, poles = self._modes
        coefficients = np.atleast_1d(np.poly(np.exp(poles / rate))).real
        return np.asarray(coefficients / np.sum(coefficients))

    def first(self, rate: float) -> tuple[int, float]:
        """Periods from an update to the first reading that shows it, and `since`.

        That reading shows the torque of `since` periods after the update, 0 < since <= 1.
        """
        periods = self.delay * rate
        # A delay of whole periods may come with a rounding error.
        first = int(np.floor(periods + 1e-9)) + 1
        return first, float(min(first - periods, 1.0))

    @cached_property
    def _lag(self) -> float:
        """Lag of the drives, a little away from the time constant of a low-pass of odd order."""
        if self.cutoff > 0.0 and self.order % 2:
            ratio = 2.0 * np.pi * self.cutoff * self.actuator_lag
            if abs(ratio - 1.0) < _APART:
                return self.actuator_lag * (1.0 + 2.0 * _APART)
        return self.actuator_lag

    @cached_property
    def _low_pass(self) -> tuple[FloatArray, FloatArray]:
        # This import is slow, and needless without a low-pass.
        from scipy.signal import butter

        b, a = butter(self.order, 2.0 * np.pi * self.cutoff, analog=True)
        return np.asarray(b), np.asarray(a)

    @cached_property
    def _modes(self) -> tuple[ComplexArray, ComplexArray]:
        """Amplitudes and poles of the transient of a step response, of drive and low-pass."""
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
