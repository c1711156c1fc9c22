"""The random torque τ_Δ, known exactly, that serves as the instrument of every estimate."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator

from armimp_common.compiled import compiled_entry
from armimp_common.schema import Schema
from armimp_common.topics import NS_PER_S, PERIOD_NS

Array = NDArray[np.float64]
_RATE = NS_PER_S / PERIOD_NS
_STREAM = 1  # keeps these random streams apart from that of the voluntary torque


class PerturbationParameters(Schema):
    """The perturbation τ_Δ: uniform noise through a Butterworth low-pass, scaled to a peak."""

    peak: tuple[float, ...] = Field(
        description="largest perturbation torque of each joint while it is perturbed (N·m)"
    )
    cutoff: float = Field(
        default=15.0,
        gt=0.0,
        lt=0.5 * _RATE,
        description="cut-off frequency of the low-pass of the perturbation (Hz)",
    )
    order: int = Field(
        default=8, ge=1, le=20, description="order of the Butterworth low-pass of the perturbation"
    )

    @field_validator("peak")
    @classmethod
    def _positive(cls, peak: tuple[float, ...]) -> tuple[float, ...]:
        if not all(value > 0.0 for value in peak):
            raise ValueError("must be positive")
        return peak


def perturbation(
    parameters: PerturbationParameters, *, joint: int, trial: int, ticks: int, seed: int
) -> Array:
    """Signal τ_Δ of one trial; the same for the same arguments.

    Parameters
    ----------
    parameters : PerturbationParameters
    joint : perturbed joint, 0-based; chooses the peak
    trial : trial number, chooses an independent random stream
    ticks : number of samples
    seed : of the experiment, not negative

    Returns
    -------
    (ticks,) NDArray
        N·m, with the largest absolute value equal to the peak.
    """
    random = np.random.default_rng(np.random.SeedSequence([seed, _STREAM, trial]))
    white = random.uniform(-1.0, 1.0, ticks)
    coloured = filtered(butterworth(parameters.order, parameters.cutoff, _RATE), white)
    # In this order, the largest value is the peak exactly.
    scaled: Array = coloured / np.max(np.abs(coloured)) * parameters.peak[joint]
    return scaled


def butterworth(order: int, cutoff: float, rate: float) -> Array:
    """Second-order sections, as of ``scipy.signal.butter(order, cutoff, fs=rate, output="sos")``.

    To the bit. Importing `scipy.signal` takes longer than everything else that a run imports, and
    this filter is all that the graph needs of it.

    Parameters
    ----------
    order : of the low-pass, positive
    cutoff : where half the power passes, below half the rate, Hz
    rate : of the samples, Hz

    Returns
    -------
    (n_sections, 6) NDArray
        b0, b1, b2, 1, a1, a2 of each; the poles nearest to the unit circle come last.
    """
    twice = 4.0  # twice the rate, in units in which the bilinear transform has a rate of 2
    warped = float(twice * np.tan(np.pi * (cutoff / (rate / 2.0)) / 2.0))
    places = np.arange(1 - order, order, 2, dtype=np.float64)
    analogue = warped * -np.exp(1j * np.pi * places / (2 * order))
    poles = (twice + analogue) / (twice - analogue)
    gain = warped**order * np.real(1.0 / np.prod(twice - analogue))
    zeros = np.full(order + order % 2, -1.0)
    pairs = [(pole, pole.conjugate()) for pole in poles[: order // 2]]
    if order % 2:  # a pole and a zero at zero complete those that are single
        pairs.append((poles[order // 2].real, 0.0))
        zeros[-1] = 0.0
    pairs.sort(key=lambda pair: abs(1.0 - abs(pair[0])))
    sections = np.zeros((len(pairs), 6))
    for section, pair in zip(sections[::-1], pairs, strict=True):
        # Each pole takes the zeros nearest to it, beginning with the one nearest to the circle.
        nearest = np.argsort(np.abs(zeros - pair[0]))
        section[:3] = np.poly(zeros[nearest[:2]])
        section[3:] = np.real(np.poly(pair))
        zeros = zeros[nearest[2:]]
    sections[0, :3] *= gain
    return sections


@compiled_entry
def filtered(sections: Array, signal: Array) -> Array:
    """Signal behind a filter that was at rest, as of ``scipy.signal.sosfilt``.

    Parameters
    ----------
    sections : (n_sections, 6) NDArray
        See `butterworth`.
    signal : (n_samples,) NDArray

    Returns
    -------
    (n_samples,) NDArray
    """
    state = np.zeros((sections.shape[0], 2))
    out = np.empty_like(signal)
    for n in range(signal.size):
        value = signal[n]
        for s in range(sections.shape[0]):
            entered = value
            value = sections[s, 0] * entered + state[s, 0]
            state[s, 0] = sections[s, 1] * entered - sections[s, 4] * value + state[s, 1]
            state[s, 1] = sections[s, 2] * entered - sections[s, 5] * value
        out[n] = value
    return out
