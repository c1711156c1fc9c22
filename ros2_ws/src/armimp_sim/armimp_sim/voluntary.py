"""Noise of the person and of the sensors: voluntary torque, tremor, readings."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, model_validator

from armimp_common.schema import Schema
from armimp_common.topics import RATE
from armimp_sim.model.sensors import SensorParameters

# Of the random streams, which keep these apart from each other and from those of perturbations.
_VOLUNTARY, _TREMOR, _READINGS = 2, 3, 4
_BLOCK = 4096
_NYQUIST = 0.5 * RATE


class VoluntaryParameters(Schema):
    """Torque of the person: second-order Butterworth noise for intention, band-passed for tremor.

    The band of physiological tremor is that of Novak & Newell (Neurosci. Lett. 641, 2017).
    """

    rms: float = Field(default=0.0, ge=0.0)
    """Rms of the voluntary torque of every joint (N·m)."""
    cutoff: float = Field(default=2.0, gt=0.0, lt=_NYQUIST)
    """Cut-off frequency of the voluntary torque (Hz)."""
    tremor: float = Field(default=0.0, ge=0.0)
    """Rms of the torque of tremor of every joint (N·m)."""
    tremor_low: float = Field(default=8.0, gt=0.0, lt=_NYQUIST)
    """Lower end of the band of tremor (Hz)."""
    tremor_high: float = Field(default=12.0, gt=0.0, lt=_NYQUIST)
    """Upper end of the band of tremor (Hz)."""

    @model_validator(mode="after")
    def _has_a_band(self) -> VoluntaryParameters:
        if not self.tremor_low < self.tremor_high:
            raise ValueError(f"tremor_low must be below tremor_high, {self.tremor_high} Hz")
        return self

    def bands(self) -> list[tuple[float, tuple[float, ...], int]]:
        """Of all that the person does: rms, edges of a low-pass or band-pass, random stream."""
        both = (
            (self.rms, (self.cutoff,), _VOLUNTARY),
            (self.tremor, (self.tremor_low, self.tremor_high), _TREMOR),
        )
        return [one for one in both if one[0] > 0.0]


@functools.lru_cache(maxsize=16)
def band_filter(edges: tuple[float, ...]) -> tuple[NDArray[np.float64], float]:
    """Second-order sections, and the rms with which white noise of rms 1 leaves them (Parseval)."""
    # Where nobody asks for this torque, nobody waits for the import, which takes 0.6 s.
    from scipy import signal

    kind, at = ("low", edges[0]) if len(edges) == 1 else ("band", edges)
    sos: NDArray[np.float64] = signal.butter(2, at, kind, fs=RATE, output="sos")
    _, response = signal.freqz_sos(sos, worN=1 << 18)
    return sos, float(np.sqrt(np.mean(np.abs(response) ** 2)))


class NoiseStream:
    """Endless, reproducible Gaussian noise in columns, independent of how the stream is cut.

    Parameters
    ----------
    rms : (columns,)
    seed, stream : of the experiment, and which of its random streams
    edges : of a low-pass (one) or band-pass (two), Hz; none for white noise
    """

    def __init__(
        self,
        rms: ArrayLike,
        *,
        seed: int,
        stream: int,
        edges: tuple[float, ...] = (),
    ) -> None:
        self._rms = np.asarray(rms, dtype=np.float64)
        self._random = np.random.default_rng(np.random.SeedSequence([seed, stream]))
        self._sos: Any = None
        if edges:
            self._sos, passed = band_filter(edges)
            self._state = np.zeros((self._sos.shape[0], self._rms.size, 2))
            self._rms = self._rms / passed
        self._block = np.zeros((0, self._rms.size))
        self._next = 0

    def take(self, ticks: int) -> NDArray[np.float64]:
        """Noise (ticks, columns) of the next ticks."""
        parts = [np.zeros((0, self._rms.size))]
        while ticks > 0:
            if self._next == len(self._block):
                self._refill()
            part = self._block[self._next : self._next + ticks]
            self._next += len(part)
            ticks -= len(part)
            parts.append(part)
        return np.concatenate(parts)

    def _refill(self) -> None:
        noise = self._random.standard_normal((_BLOCK, self._rms.size)) * self._rms
        if self._sos is not None:
            from scipy import signal

            filtered, self._state = signal.sosfilt(self._sos, noise.T, axis=-1, zi=self._state)
            noise = np.ascontiguousarray(filtered.T)
        self._block, self._next = noise, 0


class Noise:
    """An endless, reproducible sum of noise streams, an array in each tick.

    Parameters
    ----------
    streams : with as many columns as the array has values; without any it is zero
    shape : of the array
    """

    def __init__(self, streams: Sequence[NoiseStream], shape: tuple[int, ...]) -> None:
        self._streams, self._shape = streams, shape

    def take(self, ticks: int) -> NDArray[np.float64]:
        """Values (ticks, *shape) of the next ticks; independent of how the stream is cut."""
        shape = (ticks, *self._shape)
        parts = [one.take(ticks).reshape(shape) for one in self._streams]
        return np.sum(parts, axis=0) if parts else np.zeros(shape)


def voluntary_torque(config: VoluntaryParameters, *, joints: int, seed: int) -> Noise:
    """Voluntary torque and tremor d (n,), N·m, of a number of joints.

    Parameters
    ----------
    config : VoluntaryParameters
    joints : number of joints n
    seed : of the experiment, not negative
    """
    streams = [
        NoiseStream([rms] * joints, seed=seed, stream=stream, edges=edges)
        for rms, edges, stream in config.bands()
    ]
    return Noise(streams, (joints,))


def reading_noise(sensors: SensorParameters, *, joints: int, seed: int) -> Noise:
    """Noise (2, n) on readings of angles and torques, rad and N·m; arguments as above."""
    rms = [sensors.position.noise] * joints + [sensors.torque.noise] * joints
    streams = [NoiseStream(rms, seed=seed, stream=_READINGS)] if any(rms) else []
    return Noise(streams, (2, joints))
