"""Voluntary torque of the person: low-pass filtered noise."""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from armimp_common.errors import ConfigurationError
from armimp_common.schema import Schema

_STREAM = 2  # keeps this random stream apart from those of the perturbations
_BLOCK = 4096


class VoluntaryParameters(Schema):
    """Voluntary torque of the person: second-order Butterworth noise."""

    rms: float = Field(
        default=0.0, ge=0.0, description="rms of the voluntary torque of every joint (N·m)"
    )
    cutoff: float = Field(
        default=2.0, gt=0.0, description="cut-off frequency of the voluntary torque (Hz)"
    )


@functools.lru_cache(maxsize=16)
def _low_pass(cutoff: float, period: float) -> tuple[NDArray[np.float64], float]:
    """Second-order sections, and the rms with which white noise of rms 1 leaves them (Parseval)."""
    # Where nobody asks for this torque, nobody waits for the import, which takes 0.6 s.
    from scipy import signal

    sos: NDArray[np.float64] = signal.butter(2, cutoff, fs=1.0 / period, output="sos")
    _, response = signal.freqz_sos(sos, worN=1 << 18)
    return sos, float(np.sqrt(np.mean(np.abs(response) ** 2)))


def power_spectrum(
    config: VoluntaryParameters, f: NDArray[np.float64], period: float
) -> NDArray[np.float64]:
    """Power of each sample of d by frequency; its mean over all frequencies is the variance.

    Parameters
    ----------
    config : VoluntaryParameters
    f : (n_freq,) Hz
    period : s, between ticks

    Returns
    -------
    (n_freq,) NDArray
        (N·m)², two-sided.
    """
    from scipy import signal

    sos, passed = _low_pass(config.cutoff, period)
    _, response = signal.freqz_sos(sos, worN=f, fs=1.0 / period)
    power: NDArray[np.float64] = np.abs(config.rms / passed * response) ** 2
    return power


class VoluntaryTorque:
    """An endless, reproducible stream of d, one value per joint and tick.

    Parameters
    ----------
    config : VoluntaryParameters
    joints : number of joints n
    period : s, between ticks
    seed : of the experiment, not negative

    Raises
    ------
    ConfigurationError
        If the cut-off is not below half the sampling rate.
    """

    def __init__(
        self, config: VoluntaryParameters, *, joints: int, period: float, seed: int
    ) -> None:
        if not config.cutoff < 0.5 / period:
            raise ConfigurationError(
                f"voluntary torque: cutoff {config.cutoff} Hz is not below half the sampling rate"
            )
        self._rms, self._joints = config.rms, joints
        self._random = np.random.default_rng(np.random.SeedSequence([seed, _STREAM]))
        if config.rms > 0.0:
            self._sos, passed = _low_pass(config.cutoff, period)
            self._state = np.zeros((self._sos.shape[0], joints, 2))
            self._gain = config.rms / passed
        self._block = np.zeros((0, joints))
        self._next = 0

    def take(self, ticks: int) -> NDArray[np.float64]:
        """Torque d (ticks, n), N·m, of the next ticks; independent of how the stream is cut."""
        if self._rms == 0.0:
            return np.zeros((ticks, self._joints))
        parts = [np.zeros((0, self._joints))]
        while ticks > 0:
            if self._next == len(self._block):
                self._refill()
            part = self._block[self._next : self._next + ticks]
            self._next += len(part)
            ticks -= len(part)
            parts.append(part)
        return np.concatenate(parts)

    def _refill(self) -> None:
        from scipy import signal

        white = self._random.standard_normal((_BLOCK, self._joints))
        filtered, self._state = signal.sosfilt(
            self._sos, white.T * self._gain, axis=-1, zi=self._state
        )
        self._block, self._next = np.ascontiguousarray(filtered.T), 0
