"""Efficiency of each kind of perturbation: errors over the Cramér-Rao bound, and their intervals.

The shoulder's column is estimated from 150 s and the elbow's from 90 s, the times after which an
arm with voluntary torque of 0.3 N·m is to be known to 2 %.
"""

from __future__ import annotations

import fnmatch
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from armimp_bringup.config import ExperimentConfig
from armimp_bringup.offline import simulate
from armimp_bringup.study import parse_seeds
from armimp_common.arrays import FloatArray
from armimp_common.errors import ConfigurationError
from armimp_control.perturbation import PerturbationKind
from research.cells import LETTERS, Levels
from research.coverage_statistics import QUANTILE
from research.decomposition_trials import (
    ESTIMATOR,
    in_blocks,
    in_threads,
    relative_errors,
    with_voluntary,
)
from research.limits import bound_of
from research.options import InvestigationOptions
from research.writing import print_table, to_json, write_tables

TIMES: Final = (150.0, 90.0)
"""Lengths of the trials that give the columns of shoulder and elbow, s."""


@dataclass(frozen=True, kw_only=True)
class Case:
    """One kind of perturbation in one condition."""

    kind: PerturbationKind
    voluntary: float
    """Rms of the voluntary torque, N·m."""
    levels: Levels = (3, 3, 3)
    law: str = "default"
    """Name of the overrides of the controller, see `LAWS`."""

    @property
    def name(self) -> str:
        """Name of the case, for `--only`."""
        return f"{self.kind} {self.voluntary:g} {'/'.join(map(str, self.levels))} {self.law}"

    def config(self, duration: float) -> ExperimentConfig:
        """Configuration without seed and voluntary torque; the plant takes steps of 0.05 ms."""
        levels = dict(zip(("friction", "resolution", "perturbation"), self.levels, strict=True))
        law: dict[str, Any] = {} if self.law == "default" else LAWS[self.law]
        values = {"perturbation_kind": self.kind, "duration": duration, **levels}
        return ExperimentConfig.model_validate(
            {**values, "arm_sim": {"substeps": 20}, "imbic_controller": law}
        )


LAWS: Final[dict[str, Any]] = {
    "slow": {"law": {"gamma": 30.0}, "target": {"lock_frequency": 30.0}},
}
"""Overrides of the controller by name."""
KINDS: Final[tuple[PerturbationKind, ...]] = ("noise", "multisine", "optimal")
CASES: Final = (
    *(Case(kind=kind, voluntary=torque) for torque in (0.3, 0.0) for kind in KINDS),
    *(
        Case(kind=kind, voluntary=torque, levels=levels)
        for kind in KINDS[1:]
        for torque in (0.3, 0.0)
        for levels in ((3, 0, 3), (1, 1, 1))
    ),
    Case(kind="optimal", voluntary=0.3, law="slow"),
)


@dataclass(frozen=True, kw_only=True, eq=False)
class Column:
    """One column of M, B and K from trials of one length; first axis: runs."""

    errors: FloatArray
    """(runs, 3, n), relative to ``sqrt(|X_ii X_jj|)`` like standard errors and bound."""
    stated: FloatArray
    """Stated standard errors, (runs, 3, n)."""
    bound: FloatArray
    """Cramér-Rao bound, (3, n)."""
    angles: FloatArray
    """Rms angle of the perturbed joint, rad; (runs,)."""
    valid: NDArray[np.bool_]
    """Verdict on each run, (runs,)."""


def column_of(
    case: Case, k: int, seconds: float, seeds: Sequence[int], workers: int | None
) -> Column:
    """Estimate column k, 0-based, from trials of `seconds`; the first seeds give the bound."""
    blocks = in_blocks(seeds)
    config = case.config(seconds)

    def work(
        block: tuple[int, ...],
    ) -> list[tuple[FloatArray, FloatArray, FloatArray | None, float, bool]]:
        experiments = simulate(with_voluntary(config, case.voluntary, block))
        bounds: list[FloatArray | None] = [None] * len(block)
        if block == blocks[0]:
            quiet = simulate(with_voluntary(config, 0.0, block))
            both = zip(experiments, quiet, strict=True)
            bounds = [bound_of(one, same) for one, same in both]
        found = []
        for experiment, bound in zip(experiments, bounds, strict=True):
            result = experiment.identify([ESTIMATOR])
            errors, stated = relative_errors(result.estimators[ESTIMATOR].fit, experiment.truth)
            least = None if bound is None else bound[:, :, k]
            angle = float(np.std(experiment.records[k].position[k]))
            found.append((errors[:, :, k], stated[:, :, k], least, angle, result.valid))
        return found

    runs = [one for block in in_threads(work, blocks, workers) for one in block]
    bounds = [run[2] for run in runs if run[2] is not None]
    return Column(
        errors=np.stack([run[0] for run in runs]),
        stated=np.stack([run[1] for run in runs]),
        bound=np.sqrt(np.mean(np.square(bounds), axis=0)),
        angles=np.array([run[3] for run in runs]),
        valid=np.array([run[4] for run in runs]),
    )


def measure(case: Case, seeds: Sequence[int], workers: int | None) -> dict[str, Any]:
    """Return errors of a case over all seeds, in % of ``sqrt(|X_ii X_jj|)``."""
    columns = [column_of(case, k, s, seeds, workers) for k, s in enumerate(TIMES)]
    valid = np.all([one.valid for one in columns], axis=0)
    row: dict[str, Any] = {"case": case.name, "runs": len(seeds), "valid": int(np.sum(valid))}
    for k, (seconds, column) in enumerate(zip(TIMES, columns, strict=True), 1):
        rms = np.sqrt(np.mean(column.errors**2, axis=0))
        ratio = np.sqrt(np.mean((rms / column.bound) ** 2, axis=1))
        row[f"angle_{k}"] = 1e3 * float(np.mean(column.angles))
        for letter, error, over in zip(LETTERS, np.max(rms, axis=1), ratio, strict=True):
            row[f"{letter}{k}_{seconds:g}s"] = 100.0 * float(error)
            row[f"{letter}{k}_over_bound"] = float(over)
    held = np.stack([np.abs(one.errors) < QUANTILE * one.stated for one in columns], axis=3)
    for of_letter, letter in enumerate(LETTERS):
        row[f"{letter}_held"] = 100.0 * float(np.mean(held[:, of_letter]))
        row[f"{letter}_held_least"] = 100.0 * float(np.min(np.mean(held[:, of_letter], axis=0)))
    return row


def investigate(options: InvestigationOptions) -> int:
    """Write ``efficiency.*`` and print what was found; returns exit status 0.

    Raises
    ------
    ArmimpError
        If no case has such a name, nothing can be simulated, or a file can't be written.
    """
    seeds = parse_seeds(options.seeds or "0:32")
    chosen = [one for one in CASES if fnmatch.fnmatch(one.name, f"*{options.only}*")]
    if not chosen:
        raise ConfigurationError(f"--only {options.only}: there is none of {len(CASES)} cases")
    rows = [measure(case, seeds, options.workers) for case in chosen]
    write_tables(options.out, "efficiency", {"schema": 1, "rows": rows}, rows)
    if options.json:
        print(to_json({"schema": 1, "rows": rows}))
        return 0
    names = list(rows[0])
    for title, part in (
        ("rms errors, worst of a column, %, and over the bound; angle mrad", names[3:17]),
        ("intervals that hold the truth, %", [*names[1:3], *names[17:]]),
    ):
        print_table(
            title,
            ["case", *part],
            [[row["case"], *(f"{row[name]:.3g}" for name in part)] for row in rows],
        )
    return 0
