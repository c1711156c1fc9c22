"""Accuracy and cost of an estimator with one number of joints, over all seeds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from armimp_bringup.offline import SimulatedExperiment
from armimp_common.arrays import FloatArray
from armimp_common.topics import RATE
from research.cells import LETTERS
from research.decomposition_statistics import Mean, root_mean_square
from research.decomposition_trials import (
    MIMO,
    Run,
    matrices,
    relative_errors,
)


@dataclass(frozen=True, kw_only=True, eq=False)
class Outcome:
    """What is kept of a run: its identity, errors of (M, B, K), VAF (%), wall time (s).

    ``voluntary`` is the voluntary torque, N·m rms.
    ``errors`` are relative to ``sqrt(|X_ii X_jj|)``, ``relative`` ones to each element itself.
    """

    joints: int
    voluntary: float
    estimator: str
    samples: int
    errors: FloatArray
    relative: FloatArray
    vaf: FloatArray
    seconds: float

    @classmethod
    def of(cls, experiment: SimulatedExperiment, run: Run) -> Outcome:
        """Return the outcome of one run."""
        true = matrices(experiment.truth)
        return cls(
            joints=experiment.truth.joints,
            voluntary=float(str(experiment.config.arm_sim["voluntary.rms"])),
            estimator=run.estimator,
            samples=experiment.records[0].samples,
            errors=relative_errors(run.fit, experiment.truth)[0],
            relative=(matrices(run.fit.mbk) - true) / np.abs(true),
            vaf=run.vaf,
            seconds=run.seconds,
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class Cell:
    """One estimator with one number of joints, over all seeds."""

    joints: int
    voluntary: float
    estimator: str
    duration: float
    """Length of each of the n trials, s."""
    vaf: float
    worst_vaf: float
    """Mean and smallest VAF of all elements and seeds, %."""
    bias: FloatArray
    spread: FloatArray
    """(3,) of M, B and K, rms over the elements, relative to ``sqrt(|X_ii X_jj|)``."""
    worst: FloatArray
    """(3,) largest error of all elements and seeds, likewise."""
    worst_relative: FloatArray
    """(3,) the same relative to each element itself."""
    exponent: FloatArray
    """(3,) exponent with which the spread falls with the length of the record, from the first half
    of each trial to the whole; 0.5 if errors are noise that averages out."""
    needed: float
    """Length of all n trials together at which the spread of M, B and K reaches the target, s, if
    it falls with the square root of the length. A bias does not fall."""
    responses: int
    """Number of transfer functions that are estimated together."""
    seconds: float
    """Median wall time of an estimate, s."""

    @classmethod
    def of(cls, whole: Sequence[Outcome], half: Sequence[Outcome], target: float) -> Cell:
        """Combine the outcomes of all seeds for whole trials and for their first halves."""
        first = whole[0]
        n, duration = first.joints, first.samples / RATE
        errors = np.array([one.errors for one in whole])
        relative = np.array([one.relative for one in whole])
        bias, spread = _over_elements(errors)
        _, of_half = _over_elements(np.array([one.errors for one in half]))
        vaf = np.array([one.vaf for one in whole])
        return cls(
            joints=n,
            voluntary=first.voluntary,
            estimator=first.estimator,
            duration=duration,
            vaf=float(np.mean(vaf)),
            worst_vaf=float(np.min(vaf)),
            bias=bias,
            spread=spread,
            worst=np.max(np.abs(errors), axis=(0, 2, 3)),
            worst_relative=np.max(np.abs(relative), axis=(0, 2, 3)),
            exponent=np.log2(of_half / spread),
            needed=n * duration * float(np.max((spread / target) ** 2)),
            responses=2 * n * n if first.estimator == MIMO else 2 * n,
            seconds=float(np.median([one.seconds for one in whole])),
        )

    def described(self) -> dict[str, Any]:
        """As it stands in the JSON file; errors in %."""
        return {
            "joints": self.joints,
            "voluntary_rms": self.voluntary,
            "estimator": self.estimator,
            "trials": self.joints,
            "trial_s": self.duration,
            "recording_s": self.joints * self.duration,
            "responses_at_once": self.responses,
            "estimation_s": self.seconds,
            "vaf": self.vaf,
            "worst_vaf": self.worst_vaf,
            **{
                f"{what}_{letter}": (factor * values[number])
                for what, factor, values in (
                    ("bias", 100.0, self.bias),
                    ("spread", 100.0, self.spread),
                    ("worst", 100.0, self.worst),
                    ("worst_relative", 100.0, self.worst_relative),
                    ("exponent", 1.0, self.exponent),
                )
                for number, letter in enumerate(LETTERS)
            },
            "recording_needed_s": self.needed,
        }


def _over_elements(errors: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Bias and spread of M, B and K, rms over their elements."""
    mean = Mean.of(errors)
    return root_mean_square(mean.bias, (1, 2)), root_mean_square(mean.spread, (1, 2))
