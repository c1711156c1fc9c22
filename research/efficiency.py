"""How much each kind of perturbation tells: errors over the Cramér-Rao bound, and their intervals.

The shoulder's column after 150 s and the elbow's after 90 s, the times after which a person who
does 0.3 N·m beside shall be known to 2 %.
"""

from __future__ import annotations

import fnmatch
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from armimp_bringup.config import ExperimentConfig
from armimp_bringup.offline import SimulatedExperiment, simulate
from armimp_bringup.study.conditions import parse_seeds
from armimp_common.errors import ConfigurationError
from armimp_control.perturbation import PerturbationKind
from armimp_estimation.record import TrialRecord
from research.cells import LETTERS, FloatArray, Levels
from research.coverage_statistics import QUANTILE
from research.decomposition_trials import in_blocks, in_threads, matrices, scales, with_voluntary
from research.limits import bound_of
from research.options import InvestigationOptions
from research.writing import print_table, to_json, write_tables

TIMES: Final = (150.0, 90.0)
"""Of the trials that give the columns of shoulder and elbow, s."""
_ESTIMATOR: Final = "lpm_full"
_BAND: Final = (0.122, 15.0)


@dataclass(frozen=True, kw_only=True)
class Case:
    """One kind of perturbation in one condition."""

    kind: PerturbationKind
    voluntary: float
    """Rms of the voluntary torque, N·m."""
    levels: Levels = (3, 3, 3)
    law: str = "default"
    """Of what differs from the default law or sensors, see `LAWS`."""

    @property
    def name(self) -> str:
        """As `--only` takes it."""
        return f"{self.kind} {self.voluntary:g} {'/'.join(map(str, self.levels))} {self.law}"

    @property
    def config(self) -> ExperimentConfig:
        """Everything but seed and voluntary torque, with the plant in steps of 0.05 ms."""
        levels = dict(zip(("friction", "resolution", "perturbation"), self.levels, strict=True))
        law: dict[str, Any] = {} if self.law == "default" else LAWS[self.law]
        values = {"perturbation_kind": self.kind, "duration": max(TIMES), **levels}
        return ExperimentConfig.model_validate(
            {**values, "arm_sim": {"substeps": 20}, "imbic_controller": law}
        )


LAWS: Final[dict[str, Any]] = {
    "slow": {"law": {"gamma": 30.0}, "target": {"lock_frequency": 30.0}},
}
"""Overrides of the controller."""
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


def first(record: TrialRecord, samples: int) -> TrialRecord:
    """The begin of a record."""
    command = record.command
    return replace(
        record,
        perturbation=record.perturbation[:, :samples],
        position=record.position[:, :samples],
        torque=record.torque[:, :samples],
        command=None if command is None else command[:, :samples],
    )


def until(experiment: SimulatedExperiment, seconds: float) -> SimulatedExperiment:
    """An experiment that ended earlier."""
    records = tuple(first(one, round(seconds * one.rate)) for one in experiment.records)
    return replace(experiment, records=records)


def columns(of_times: Sequence[FloatArray]) -> FloatArray:
    """Matrices (3, n, n) with each column from those of its time."""
    return np.stack([one[:, :, k] for k, one in enumerate(of_times)], axis=2)


def measure(case: Case, seeds: Sequence[int], workers: int | None) -> dict[str, Any]:
    """Errors of a case over all seeds, in % of ``sqrt(|X_ii X_jj|)``."""
    blocks = in_blocks(seeds)
    quiet = simulate(with_voluntary(case.config, 0.0, blocks[0]))

    def work(block: tuple[int, ...]) -> list[tuple[FloatArray, FloatArray, FloatArray, bool]]:
        experiments = simulate(with_voluntary(case.config, case.voluntary, block))
        found = []
        for experiment in experiments:
            true = matrices(experiment.truth)
            angles = [np.std(one.position[one.perturbed_joint]) for one in experiment.records]
            errors, stated, valid = [], [], True
            for seconds in TIMES:
                result = until(experiment, seconds).identify([_ESTIMATOR])
                fit = result.estimators[_ESTIMATOR].fit
                errors.append((matrices(fit.mbk) - true) / scales(true))
                stated.append(np.stack([fit.M_se, fit.B_se, fit.K_se]) / scales(true))
                valid &= result.valid
            found.append((columns(errors), columns(stated), np.array(angles), valid))
        return found

    runs = [one for block in in_threads(work, blocks, workers) for one in block]
    errors, stated, angles = (np.stack(one) for one in list(zip(*runs, strict=True))[:3])
    bounds = [
        columns([bound_of(until(one, s), until(same, s), _BAND) for s in TIMES])
        for one, same in zip(
            simulate(with_voluntary(case.config, case.voluntary, blocks[0])), quiet, strict=True
        )
    ]
    truth = matrices(quiet[0].truth)
    bound = np.sqrt(np.mean(np.square(bounds), axis=0)) / scales(truth)
    rms = np.sqrt(np.mean(errors**2, axis=0))
    ratio = np.sqrt(np.mean((rms / bound) ** 2, axis=1))
    held = np.abs(errors) < QUANTILE * stated
    row: dict[str, Any] = {"case": case.name, "runs": len(runs), "valid": sum(r[3] for r in runs)}
    for k, (seconds, angle) in enumerate(zip(TIMES, np.mean(angles, axis=0), strict=True)):
        row[f"angle_{k + 1}"] = 1e3 * float(angle)
        for letter, of_letter in zip(LETTERS, range(3), strict=True):
            row[f"{letter}{k + 1}_{seconds:g}s"] = 100.0 * float(np.max(rms[of_letter, :, k]))
            row[f"{letter}{k + 1}_over_bound"] = float(ratio[of_letter, k])
    for of_letter, letter in enumerate(LETTERS):
        row[f"{letter}_held"] = 100.0 * float(np.mean(held[:, of_letter]))
        row[f"{letter}_held_least"] = 100.0 * float(np.min(np.mean(held[:, of_letter], axis=0)))
    return row


def investigate(options: InvestigationOptions) -> int:
    """Write ``efficiency.*`` and print what was found; returns exit status 0.

    Raises
    ------
    ArmimpError
        If no case has the name, nothing can be simulated, or a file can't be written.
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
