"""How often intervals hold the truth, how certain that is, and actual against stated errors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from scipy import stats

from armimp_common.arrays import BoolArray, FloatArray
from research.cells import LETTERS, ErrorCell

NOMINAL: Final = 0.95
TARGET: Final = (0.92, 0.98)
"""Limits of the pooled share of a condition."""

QUANTILE: Final = float(stats.norm.ppf(0.5 + 0.5 * NOMINAL))
"""Half width of a nominal interval, standard errors."""


@dataclass(frozen=True, kw_only=True)
class Share:
    """Share of intervals that hold the truth."""

    value: float
    """Between 0 and 1."""
    lower: float
    upper: float
    """Ends of its own 95 % interval."""

    @classmethod
    def of(cls, held: BoolArray) -> Share:
        """Return the share of intervals that hold the truth, from booleans (runs, parameters).

        The interval is that of a binomial share by Wilson, "Probable inference, the law of
        succession, and statistical inference", J. Am. Stat. Assoc. 22, 1927. Errors of the
        parameters of one run are correlated, runs are independent. So the number of intervals is
        replaced by the number of independent ones whose share would scatter as it does from run to
        run; at most the number of all intervals, and that of runs if all or none hold the truth.
        """
        runs, value = len(held), float(held.mean())
        spread = float(np.var(held.mean(axis=1))) / runs
        certain = value * (1.0 - value)
        if not certain:
            independent = float(runs)
        else:
            independent = min(certain / spread, float(held.size)) if spread else float(held.size)
        weight = QUANTILE**2 / independent
        middle = (value + 0.5 * weight) / (1.0 + weight)
        half = float(np.sqrt(weight * (certain + 0.25 * weight))) / (1.0 + weight)
        # If none or all do, rounding may put the share itself outside.
        lower, upper = np.clip((middle - half, middle + half), 0.0, 1.0)
        return cls(value=value, lower=min(value, float(lower)), upper=max(value, float(upper)))

    @property
    def verdict(self) -> str:
        """Whether the share lies within the target, outside, or outside by no more than chance."""
        lowest, highest = TARGET
        if self.value < lowest:
            return "below" if self.upper < lowest else "below, within chance"
        if self.value > highest:
            return "above" if self.lower > highest else "above, within chance"
        return "within"

    def described(self) -> dict[str, Any]:
        """As it stands in the JSON file."""
        return {
            "value": self.value,
            "interval": [self.lower, self.upper],
            "verdict": self.verdict,
        }


@dataclass(frozen=True, kw_only=True, eq=False)
class Cell(ErrorCell):
    """One estimator in one condition, over all seeds."""

    stated: FloatArray
    """(runs, 3, n, n) standard errors, relative like the errors."""

    @property
    def held(self) -> BoolArray:
        """Whether the intervals hold the truth, (runs, 3, n, n)."""
        return np.abs(self.errors) <= QUANTILE * self.stated

    @property
    def pooled(self) -> Share:
        """Share for all elements of M, B and K."""
        return Share.of(self.held.reshape(self.runs, -1))

    @property
    def by_letter(self) -> tuple[Share, ...]:
        """Shares for the elements of M, of B, and of K."""
        return tuple(Share.of(self.held[:, i].reshape(self.runs, -1)) for i in range(3))

    @property
    def by_element(self) -> dict[str, Share]:
        """Share for each element, as M11."""
        shares = (Share.of(column[:, None]) for column in self.held.reshape(self.runs, -1).T)
        return dict(zip(self.elements, shares, strict=True))

    @property
    def claimed(self) -> FloatArray:
        """Mean standard errors, (3, n, n)."""
        claimed: FloatArray = self.stated.mean(axis=0)
        return claimed

    @property
    def honesty(self) -> FloatArray:
        """Stated over actual errors, both rms over the elements of M, of B and of K, (3,)."""
        true = np.sqrt(np.mean(self.errors**2, axis=(0, 2, 3)))
        ratio: FloatArray = np.sqrt(np.mean(self.claimed**2, axis=(1, 2))) / true
        return ratio

    def described(self) -> dict[str, Any]:
        """As it stands in the JSON file; bias, spread and standard errors in %."""
        shares = zip(LETTERS, self.by_letter, strict=True)
        return {
            **self.condition,
            "pooled": self.pooled.described(),
            "by_letter": {name: share.described() for name, share in shares},
            "by_element": {name: share.described() for name, share in self.by_element.items()},
            "bias": (100.0 * self.bias).tolist(),
            "spread": (100.0 * self.spread).tolist(),
            "stated_standard_error": (100.0 * self.claimed).tolist(),
        }

    def rows(self) -> list[dict[str, Any]]:
        """A row of the CSV file for each element."""
        shares = zip(np.ndindex(self.errors.shape[1:]), self.by_element.items(), strict=True)
        return [
            {
                **self.condition,
                "element": name,
                "share": share.value,
                "share_lower": share.lower,
                "share_upper": share.upper,
                "bias_percent": 100.0 * float(self.bias[place]),
                "spread_percent": 100.0 * float(self.spread[place]),
                "stated_error_percent": 100.0 * float(self.claimed[place]),
            }
            for place, (name, share) in shares
        ]
