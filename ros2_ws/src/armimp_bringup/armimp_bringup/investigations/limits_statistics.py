"""Errors of M, B and K against the Cramér-Rao bound."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

LETTERS: Final = ("M", "B", "K")


@dataclass(frozen=True, kw_only=True, eq=False)
class Cell:
    """One estimator in one condition, over all seeds.

    Attributes
    ----------
    levels : of friction, resolution and perturbation
    voluntary : rms of the voluntary torque, N·m
    estimator : name
    errors : (runs, 3, n, n) of M, B and K, relative to ``sqrt(|X_ii X_jj|)``
    bounds : (runs, 3, n, n) smallest standard deviations that noise allows in that run, likewise
    """

    levels: tuple[int, int, int]
    voluntary: float
    estimator: str
    errors: FloatArray
    bounds: FloatArray

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
    def bound(self) -> FloatArray:
        """Root mean square of the bounds of all runs, (3, n, n)."""
        return _root_mean_square(self.bounds)

    @property
    def rms(self) -> FloatArray:
        """Root mean square error, (3, n, n)."""
        return _root_mean_square(self.errors)

    @property
    def bias(self) -> FloatArray:
        """Mean error, (3, n, n)."""
        mean: FloatArray = self.errors.mean(axis=0)
        return mean

    @property
    def spread(self) -> FloatArray:
        """Standard deviation of the estimates, (3, n, n)."""
        deviation: FloatArray = self.errors.std(axis=0, ddof=1)
        return deviation

    @property
    def ratio(self) -> FloatArray:
        """Root mean square error over the bound, (3, n, n); NaN where nothing limits accuracy."""
        return self._over_bound(self.rms)

    @property
    def uncertainty(self) -> FloatArray:
        """Monte Carlo standard error of the ratio, (3, n, n)."""
        squares = self.errors**2
        of_squares = squares.std(axis=0, ddof=1) / np.sqrt(self.runs)
        return self._over_bound(0.5 * of_squares / self.rms)

    @property
    def spread_ratio(self) -> FloatArray:
        """Standard deviation over the bound, (3, n, n): the ratio without any bias."""
        return self._over_bound(self.spread)

    @property
    def worst(self) -> tuple[str, float]:
        """Element with the largest ratio, and that ratio."""
        place = int(np.argmax(np.nan_to_num(self.ratio)))
        return self.elements[place], float(self.ratio.flat[place])

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

    def described(self) -> dict[str, Any]:
        """As it stands in the JSON file; bound, errors, bias and spread in %."""
        element, ratio = self.worst
        return {
            **self.condition,
            "bound": (100.0 * self.bound).tolist(),
            "rms_error": (100.0 * self.rms).tolist(),
            "bias": (100.0 * self.bias).tolist(),
            "spread": (100.0 * self.spread).tolist(),
            "rms_over_bound": self.ratio.tolist(),
            "rms_over_bound_uncertainty": self.uncertainty.tolist(),
            "spread_over_bound": self.spread_ratio.tolist(),
            "worst_element": element,
            "worst_rms_over_bound": ratio,
        }

    def rows(self) -> list[dict[str, Any]]:
        """A row of the CSV file for each element."""
        return [
            {
                **self.condition,
                "element": name,
                "bound_percent": 100.0 * float(self.bound[place]),
                "rms_error_percent": 100.0 * float(self.rms[place]),
                "bias_percent": 100.0 * float(self.bias[place]),
                "spread_percent": 100.0 * float(self.spread[place]),
                "rms_over_bound": float(self.ratio[place]),
                "rms_over_bound_uncertainty": float(self.uncertainty[place]),
                "spread_over_bound": float(self.spread_ratio[place]),
            }
            for name, place in zip(self.elements, np.ndindex(self.bound.shape), strict=True)
        ]

    def _over_bound(self, values: FloatArray) -> FloatArray:
        bound = self.bound
        return np.divide(values, bound, out=np.full_like(bound, np.nan), where=bound > 0.0)


def _root_mean_square(values: FloatArray) -> FloatArray:
    root: FloatArray = np.sqrt(np.mean(values**2, axis=0))
    return root
