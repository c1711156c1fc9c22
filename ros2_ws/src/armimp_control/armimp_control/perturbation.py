"""The random torque τ_Δ, known exactly, that serves as the instrument of every estimate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armimp_common.errors import ConfigurationError
from armimp_control.lowpass import butterworth, filtered

_STREAM = 1  # keeps these random streams apart from that of the voluntary torque


@dataclass(frozen=True, kw_only=True)
class PerturbationConfig:
    """Uniform noise through a Butterworth low-pass, scaled to a peak.

    Parameters
    ----------
    peak : (n,) largest |τ_Δ| of each joint, N·m
    cutoff : Hz
    order : of the low-pass, 1 to 20
    period : s

    Raises
    ------
    ConfigurationError
        If a value is out of range.
    """

    peak: tuple[float, ...]
    cutoff: float = 15.0
    order: int = 8
    period: float = 1e-3

    def __post_init__(self) -> None:
        for i, value in enumerate(self.peak):
            if not 0.0 < value < np.inf:
                raise ConfigurationError(
                    f"perturbation: peak of joint {i + 1} must be positive, got {value}"
                )
        if not 0.0 < self.cutoff < 0.5 / self.period:
            raise ConfigurationError(
                f"perturbation: cutoff {self.cutoff} Hz is not below half the sampling rate"
            )
        if not 1 <= self.order <= 20:
            raise ConfigurationError(f"perturbation: order must be 1 to 20, got {self.order}")


def perturbation(
    config: PerturbationConfig, *, joint: int, trial: int, ticks: int, seed: int
) -> NDArray[np.float64]:
    """Signal τ_Δ of one trial; the same for the same arguments.

    Parameters
    ----------
    config : PerturbationConfig
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
    coloured = filtered(butterworth(config.order, config.cutoff, 1.0 / config.period), white)
    # In this order, the largest value is the peak exactly.
    scaled: NDArray[np.float64] = coloured / np.max(np.abs(coloured)) * config.peak[joint]
    return scaled
