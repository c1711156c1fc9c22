"""What is kept of every run of the investigation of the controller, and what all seeds make."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from armimp_bringup.offline import OfflineTrial
from armimp_bringup.study.store import StudyEntry
from research.decomposition_statistics import root_mean_square

FloatArray = NDArray[np.float64]

LETTERS: Final = ("M", "B", "K")


@dataclass(frozen=True, kw_only=True)
class Setting:
    """One parameter off its default; without a name all are at their defaults."""

    parameter: str | None = None
    value: float = np.inf

    def __str__(self) -> str:
        return "defaults" if self.parameter is None else f"{self.parameter} {self.value:g}"


@dataclass(frozen=True, kw_only=True)
class Place:
    """Perturbation level, and voluntary torque in N·m rms."""

    perturbation: int
    voluntary: float

    def __str__(self) -> str:
        return f"perturbation {self.perturbation}, voluntary torque {self.voluntary:g} N·m rms"


@dataclass(frozen=True, kw_only=True, eq=False)
class Outcome:
    """One estimator in one run.

    Attributes
    ----------
    estimator : which
    errors : (3, n, n) of M, B and K, relative to each element
    vaf, coherence : smallest of all elements: %, and mean derived coherence
    lock_ratio : largest of all locked joints
    lock_bias : bias that their motion may cause, relative, that of the worst element of Z
    command_step : rms of the change of the commands from tick to tick, N·m
    largest_command : N·m
    clipped : number of clipped joint commands
    """

    estimator: str
    errors: FloatArray
    vaf: float
    coherence: float
    lock_ratio: float
    lock_bias: float
    command_step: float
    largest_command: float
    clipped: int

    @classmethod
    def of(cls, entry: StudyEntry, estimator: str, trials: Sequence[OfflineTrial]) -> Outcome:
        """From the result of a run and its records.

        Raises
        ------
        ValueError
            If the result does not hold the truth.
        """
        found, truth = entry.estimators[estimator], entry.truth
        if truth is None or found.vaf is None:
            raise ValueError("simulated runs have a truth")
        true = np.array([truth.M, truth.B, truth.K])
        steps = np.array([np.diff(one.command) for one in trials])
        return cls(
            estimator=estimator,
            errors=np.array([found.M, found.B, found.K]) / true - 1.0,
            vaf=float(np.min(found.vaf)),
            coherence=float(np.min(found.coherence_derived)),
            lock_ratio=max(
                ratio
                for trial in entry.trials
                for joint, ratio in enumerate(trial.lock_ratio, start=1)
                if joint != trial.k
            ),
            lock_bias=max(max(trial.bias_bound) for trial in entry.trials),
            command_step=float(root_mean_square(steps)),
            largest_command=max(float(np.max(np.abs(one.command))) for one in trials),
            clipped=sum(one.clipped for one in trials),
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class Cell:
    """One estimator with one setting in one place, over all seeds; NaN if no run ended.

    Attributes
    ----------
    setting, place, estimator : which
    runs, lost : numbers of runs that ended, and that did not
    bias : (3,) mean error of M, B and K over the seeds, that of the worst element
    uncertainty : (3,) standard error of that mean
    rms, worst : (3,) errors of all elements and seeds
    vaf, coherence : smallest of all elements and seeds
    lock_ratio, lock_bias, largest_command : largest of all seeds
    command_step : rms, N·m
    clipped : number of clipped joint commands
    """

    setting: Setting
    place: Place
    estimator: str
    runs: int
    lost: int
    bias: FloatArray
    uncertainty: FloatArray
    rms: FloatArray
    worst: FloatArray
    vaf: float
    coherence: float
    lock_ratio: float
    lock_bias: float
    command_step: float
    largest_command: float
    clipped: int

    @classmethod
    def of(
        cls,
        setting: Setting,
        place: Place,
        estimator: str,
        outcomes: Sequence[Outcome],
        lost: int,
    ) -> Cell:
        """From the outcomes of the runs that ended, and the number of the others."""
        nothing = np.full(3, np.nan)
        bias, uncertainty, rms, worst = nothing, nothing, nothing, nothing
        if outcomes:
            errors = np.array([one.errors for one in outcomes]).reshape(len(outcomes), 3, -1)
            mean = np.mean(errors, axis=0)
            element = np.argmax(np.abs(mean), axis=1)
            bias = mean[np.arange(3), element]
            if len(outcomes) > 1:
                spread = np.std(errors, axis=0, ddof=1)[np.arange(3), element]
                uncertainty = spread / np.sqrt(len(outcomes))
            rms = root_mean_square(errors, (0, 2))
            worst = np.max(np.abs(errors), axis=(0, 2))
        return cls(
            setting=setting,
            place=place,
            estimator=estimator,
            runs=len(outcomes),
            lost=lost,
            bias=bias,
            uncertainty=uncertainty,
            rms=rms,
            worst=worst,
            vaf=min((one.vaf for one in outcomes), default=np.nan),
            coherence=min((one.coherence for one in outcomes), default=np.nan),
            lock_ratio=max((one.lock_ratio for one in outcomes), default=np.nan),
            lock_bias=max((one.lock_bias for one in outcomes), default=np.nan),
            command_step=float(root_mean_square(np.array([one.command_step for one in outcomes])))
            if outcomes
            else np.nan,
            largest_command=max((one.largest_command for one in outcomes), default=np.nan),
            clipped=sum(one.clipped for one in outcomes),
        )

    def described(self) -> dict[str, Any]:
        """As it stands in the JSON file; errors in %."""
        return {
            "parameter": self.setting.parameter or "defaults",
            "value": self.setting.value,
            "perturbation": self.place.perturbation,
            "voluntary_rms": self.place.voluntary,
            "estimator": self.estimator,
            "runs": self.runs,
            "lost_runs": self.lost,
            **{
                f"{what}_{letter}": 100.0 * values[number]
                for what, values in (
                    ("rms", self.rms),
                    ("worst", self.worst),
                    ("bias", self.bias),
                    ("bias_se", self.uncertainty),
                )
                for number, letter in enumerate(LETTERS)
            },
            "worst_vaf": self.vaf,
            "worst_coherence": self.coherence,
            "worst_lock_ratio": self.lock_ratio,
            "worst_lock_bias": 100.0 * self.lock_bias,
            "command_step_rms": self.command_step,
            "largest_command": self.largest_command,
            "clipped": self.clipped,
        }
