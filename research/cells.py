"""Errors of M, B and K of an estimator in a condition over all seeds, and the runs behind them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Final, TypeAlias

import numpy as np
from typing_extensions import Self

from armimp_bringup.config import ExperimentConfig
from armimp_bringup.study import parse_seeds
from armimp_common.arrays import FloatArray
from armimp_common.errors import ConfigurationError
from armimp_common.topics import RATE
from armimp_estimation.spectra import segment_for_samples
from research.decomposition_trials import in_blocks, in_threads
from research.options import InvestigationOptions

Levels: TypeAlias = tuple[int, int, int]
"""Levels of friction, resolution and perturbation."""
Run: TypeAlias = tuple[float, str, FloatArray, FloatArray]
"""Voluntary torque (N·m rms), name of the estimator, its errors, and what these are compared with;
both are relative, of shape (3, n, n)."""
Runs: TypeAlias = tuple[Levels, float, str, FloatArray, FloatArray]
"""Levels, and then the same as in `Run` for all seeds, of shape (runs, 3, n, n)."""

LETTERS: Final = ("M", "B", "K")


@dataclass(frozen=True, kw_only=True)
class Plan:
    """The simulations of a study."""

    VARIED: ClassVar[frozenset[str]] = frozenset({"seed", "estimators"})
    """Values of the base that do not stand in the JSON file."""

    base: ExperimentConfig = field(
        default_factory=lambda: ExperimentConfig(arm_sim={"substeps": 20})
    )
    """Everything but what the plan varies. The plant takes steps of 0.05 ms: with those of 0.01 ms,
    the default, simulations of two joints take two and a half times as long and find the same."""
    seeds: str
    """As for :func:`armimp_bringup.study.parse_seeds`."""

    def with_seeds(self, options: InvestigationOptions) -> Self:
        """Return the plan with the seeds of the command line, if some were given."""
        return self if options.seeds is None else replace(self, seeds=options.seeds)

    def described(self) -> dict[str, Any]:
        """As it stands in the JSON file."""
        experiment = self.base.model_dump(mode="json", exclude=set(self.VARIED))
        return {"schema": 1, "experiment": experiment, "seeds": self.seeds}


@dataclass(frozen=True, kw_only=True)
class ErrorPlan(Plan):
    """Estimators at some levels, with and without voluntary torque."""

    VARIED = Plan.VARIED | {"friction", "resolution", "perturbation"}

    levels: tuple[Levels, ...]
    voluntary: tuple[float, ...] = (0.3, 0.0)
    """Rms of the voluntary torque, N·m."""
    estimators: tuple[str, ...]

    @property
    def segment(self) -> int:
        """Length of the segments of averaged spectra in every run, samples."""
        return segment_for_samples(round(self.base.duration * RATE))

    def at(self, levels: Levels) -> ExperimentConfig:
        """Return the base at these levels."""
        names = ("friction", "resolution", "perturbation")
        return self.base.model_copy(update=dict(zip(names, levels, strict=True)))

    def runs(
        self,
        work: Callable[[ExperimentConfig, tuple[int, ...]], list[Run]],
        workers: int | None = None,
    ) -> Iterator[Runs]:
        """Do all runs.

        Parameters
        ----------
        work : simulates and estimates seeds of one base, with all voluntary torques and estimators
        workers : number of threads; None: one per core

        Returns
        -------
        iterator of Runs
            By estimator, voluntary torque and levels, in the order of the plan.

        Raises
        ------
        ConfigurationError, ArmimpError
            If there are fewer than two seeds, the plan does not make experiments, or they cannot be
            simulated or estimated.
        """
        seeds = parse_seeds(self.seeds)
        if len(seeds) < 2:
            raise ConfigurationError(f"--seeds {self.seeds}: one seed is too few for statistics")
        tasks = [(levels, block) for levels in self.levels for block in in_blocks(seeds)]
        found: dict[tuple[Levels, float, str], list[tuple[FloatArray, FloatArray]]] = {}
        done = in_threads(lambda task: work(self.at(task[0]), task[1]), tasks, workers)
        for (levels, _), results in zip(tasks, done, strict=True):
            for voluntary, estimator, errors, limits in results:
                found.setdefault((levels, voluntary, estimator), []).append((errors, limits))
        for estimator in self.estimators:
            for voluntary in self.voluntary:
                for levels in self.levels:
                    errors, limits = map(
                        np.stack, zip(*found[levels, voluntary, estimator], strict=True)
                    )
                    yield levels, voluntary, estimator, errors, limits


@dataclass(frozen=True, kw_only=True, eq=False)
class ErrorCell:
    """One estimator in one condition, over all seeds."""

    levels: Levels
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
        """Columns of the files that identify the cell."""
        friction, resolution, perturbation = self.levels
        return {
            "friction": friction,
            "resolution": resolution,
            "perturbation": perturbation,
            "voluntary_rms": self.voluntary,
            "estimator": self.estimator,
            "runs": self.runs,
        }
