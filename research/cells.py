"""Errors of M, B and K over all seeds of one estimator in one condition."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

LETTERS: Final = ("M", "B", "K")


@dataclass(frozen=True, kw_only=True, eq=False)
class ErrorCell:
    """One estimator in one condition, over all seeds."""

    levels: tuple[int, int, int]
    """Of friction, resolution and perturbation."""
    voluntary: float
    """Rms of the voluntary torque, N·m."""
    estimator: str
    errors: FloatArray
    """(runs, 3, n, n) of M, B and K, relative to ``sqrt(|X_ii X_jj|)``."""

    @property
    def runs(self) -> int:
        """Number of seeds."""
        return len(self.errors)

    @property
    def elements(self) -> list[str]:
        """Names of the elements in the order of the flat arrays, as M11."""
        return [
            f"{LETTERS[which]}{i + 1}{k + 1}" for which, i, k in np.ndindex(self.errors.shape[1:])
        ]

    @property
    def bias(self) -> FloatArray:
        """Mean errors, (3, n, n)."""
        mean: FloatArray = self.errors.mean(axis=0)
        return mean

    @property
    def spread(self) -> FloatArray:
        """Standard deviations of the estimates, (3, n, n)."""
        deviation: FloatArray = self.errors.std(axis=0, ddof=1)
        return deviation

    @property
    def condition(self) -> dict[str, Any]:
        """Which it is, in words of the files."""
        friction, resolution, perturbation = self.levels
        return {
            "friction": friction,
            "resolution": resolution,
            "perturbation": perturbation,
            "voluntary_rms": self.voluntary,
            "estimator": self.estimator,
            "runs": self.runs,
        }
