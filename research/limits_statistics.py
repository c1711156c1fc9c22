"""Errors of M, B and K against the Cramér-Rao bound."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from armimp_common.arrays import FloatArray
from research.cells import ErrorCell


@dataclass(frozen=True, kw_only=True, eq=False)
class Cell(ErrorCell):
    """One estimator in one condition, over all seeds."""

    bounds: FloatArray
    """(runs, 3, n, n) smallest standard deviations that noise allows in that run, relative like the
    errors."""

    @property
    def bound(self) -> FloatArray:
        """Root mean square of the bounds of all runs, (3, n, n)."""
        return _root_mean_square(self.bounds)

    @property
    def rms(self) -> FloatArray:
        """Root mean square error, (3, n, n)."""
        return _root_mean_square(self.errors)

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
