"""Noise of the person and of the sensors: voluntary torque, tremor, noise of readings."""

from __future__ import annotations

import functools
from collections.abc import Iterator, Sequence

import numpy as np
from pydantic import Field, model_validator

from armimp_common.arrays import FloatArray
from armimp_common.schema import Schema
from armimp_common.topics import RATE
from armimp_sim.model.sensors import SensorParameters

# Keys of random streams, which keep these apart from each other and from those of perturbations.
_VOLUNTARY, _TREMOR, _READINGS = 2, 3, 4
_BLOCK = 4096  # ticks that are drawn at once
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
        """Return rms, edges of low-pass or band-pass, and random stream of each torque present."""
        both = (
            (self.rms, (self.cutoff,), _VOLUNTARY),
            (self.tremor, (self.tremor_low, self.tremor_high), _TREMOR),
        )
        return [one for one in both if one[0] > 0.0]


@functools.lru_cache(maxsize=16)
def band_filter(edges: tuple[float, ...]) -> tuple[FloatArray, float]:
    """Return second-order sections, and their output's rms for white noise of rms 1 (Parseval)."""
    # Imported here, as it takes 0.6 s and is needed for this torque only.
    from scipy import signal

    kind, at = ("low", edges[0]) if len(edges) == 1 else ("band", edges)
    sos: FloatArray = signal.butter(2, at, kind, fs=RATE, output="sos")
    _, response = signal.freqz_sos(sos, worN=1 << 18)
    return sos, float(np.sqrt(np.mean(np.abs(response) ** 2)))


def _blocks(
    rms: Sequence[float], *, seed: int, stream: int, edges: tuple[float, ...] = ()
) -> Iterator[FloatArray]:
    """Yield blocks of Gaussian noise with these rms by column; white without edges (Hz)."""
    strength = np.array(rms)
    random = np.random.default_rng(np.random.SeedSequence([seed, stream]))
    if edges:
        from scipy import signal

        sos, passed = band_filter(edges)
        state, strength = np.zeros((len(sos), strength.size, 2)), strength / passed
    while True:
        noise = random.standard_normal((_BLOCK, strength.size)) * strength
        if edges:
            filtered, state = signal.sosfilt(sos, noise.T, axis=-1, zi=state)
            noise = np.ascontiguousarray(filtered.T)
        yield noise


class Noise:
    """An endless, reproducible sum of Gaussian noises, with one array for each tick.

    Parameters
    ----------
    sources : blocks of each noise, a column for each value of the array; if empty, values are 0
    shape : shape of the array
    """

    def __init__(self, sources: Sequence[Iterator[FloatArray]], shape: tuple[int, ...]) -> None:
        self._sources, self._shape = sources, shape
        self._left = np.zeros((0, *shape))

    def take(self, ticks: int) -> FloatArray:
        """Return the values (ticks, *shape) of the next ticks, the same for calls of any size."""
        if not self._sources:
            return np.zeros((ticks, *self._shape))
        while len(self._left) < ticks:
            block = np.sum([next(one) for one in self._sources], axis=0)
            self._left = np.concatenate([self._left, block.reshape(-1, *self._shape)])
        taken, self._left = self._left[:ticks], self._left[ticks:]
        return taken


def voluntary_torque(config: VoluntaryParameters, *, joints: int, seed: int) -> Noise:
    """Return voluntary torque and tremor d (n,), N·m, of a number of joints.

    Parameters
    ----------
    config : VoluntaryParameters
    joints : number of joints n
    seed : seed of the experiment, not negative
    """
    sources = [
        _blocks([rms] * joints, seed=seed, stream=stream, edges=edges)
        for rms, edges, stream in config.bands()
    ]
    return Noise(sources, (joints,))


def reading_noise(sensors: SensorParameters, *, joints: int, seed: int) -> Noise:
    """Return noise (2, n) on readings of angles, rad, and torques, N·m; see `voluntary_torque`."""
    rms = [sensors.position.noise] * joints + [sensors.torque.noise] * joints
    sources = [_blocks(rms, seed=seed, stream=_READINGS)] if any(rms) else []
    return Noise(sources, (2, joints))
