"""Bias and spread over independent runs, and whether a bias is more than chance."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from armimp_common.arrays import ComplexArray, FloatArray
from armimp_common.errors import ConfigurationError
from armimp_estimation.estimators.estimate import ImpedanceEstimate
from armimp_estimation.mbk import MBK

OCTAVES: Final = (0.12, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 15.01)
"""Limits of the bands that errors of Z are averaged over, Hz."""

LEVEL: Final = 0.05
"""Probability that a set of tests finds a bias where there is none."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Mean:
    """Mean of N independent errors, element by element."""

    runs: int
    """N."""
    bias: FloatArray
    spread: FloatArray
    """Mean and standard deviation over the runs."""

    @classmethod
    def of(cls, errors: FloatArray) -> Mean:
        """Return the mean of errors of shape (N, ...).

        Raises
        ------
        ConfigurationError
            If there are fewer than two runs.
        """
        if len(errors) < 2:
            raise ConfigurationError(f"--seeds: {len(errors)} seed is too few to tell a spread")
        return cls(
            runs=len(errors), bias=np.mean(errors, axis=0), spread=np.std(errors, axis=0, ddof=1)
        )

    @property
    def uncertainty(self) -> FloatArray:
        """Standard error of the bias, ``spread/sqrt(N)``."""
        error: FloatArray = self.spread / np.sqrt(self.runs)
        return error

    @property
    def z(self) -> FloatArray:
        """Bias in standard errors; 0 where every run has the same error of exactly 0."""
        return np.divide(
            self.bias, self.uncertainty, out=np.zeros_like(self.bias), where=self.bias != 0.0
        )

    @property
    def critical(self) -> float:
        """|z| that the largest of all elements exceeds by chance with probability ``LEVEL``.

        By Student's distribution with N - 1 degrees of freedom and Bonferroni's inequality.
        """
        return critical_z(self.runs, self.bias.size)

    @property
    def significant(self) -> bool:
        """Whether any element is biased by more than chance."""
        return bool(np.max(np.abs(self.z)) > self.critical)


def critical_z(runs: int, tests: int) -> float:
    """As :attr:`Mean.critical`, for a number of runs and of tests."""
    return float(stats.t.ppf(1.0 - LEVEL / (2.0 * tests), runs - 1))


def octave_errors(estimate: ImpedanceEstimate, truth: MBK) -> ComplexArray:
    """Return errors of each element of Z relative to its true size, averaged over each octave.

    Estimators differ in the number of their frequencies; octaves are the same for all. An octave
    that holds no frequency of the estimate gives NaN.

    Returns
    -------
    (n, n, octaves) NDArray
    """
    true = truth.impedance(estimate.f)
    relative = (estimate.Z - true) / np.abs(true)
    bands = np.digitize(estimate.f, OCTAVES) - 1
    errors = np.full((*relative.shape[:2], len(OCTAVES) - 1), np.nan, dtype=np.complex128)
    for band in np.unique(bands):
        errors[..., band] = np.mean(relative[..., bands == band], axis=-1)
    return errors


def root_mean_square(
    values: NDArray[np.generic], axes: tuple[int, ...] | None = None
) -> FloatArray:
    """Root of the mean squared magnitude."""
    found: FloatArray = np.sqrt(np.mean(np.abs(values) ** 2, axis=axes))
    return found
