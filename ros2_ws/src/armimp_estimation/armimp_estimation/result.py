"""From assembled trials to the result that is shown and stored, live, replayed or offline."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from armimp_common.errors import BagError, DataError
from armimp_common.topics import NS_PER_S, PERIOD_NS, PERTURBATION
from armimp_estimation.alignment.assemble import Trial
from armimp_estimation.alignment.trial_windows import TOLERANCE
from armimp_estimation.bags.reader import read_bag
from armimp_estimation.estimators.estimate import Estimator
from armimp_estimation.identify import Identification, TrialScores, identify_records
from armimp_estimation.metadata import Metadata
from armimp_estimation.problems import Problem, ProblemCode, problem
from armimp_estimation.scores import coherence_significance
from armimp_estimation.summary import (
    FRF_FILE,
    SUMMARY_FILE,
    ImpedanceCurve,
    Summary,
    TrialSummary,
    read_frf,
    read_summary,
    write_frf,
    write_summary,
)


@dataclass(frozen=True, kw_only=True, eq=False)
class Result:
    """A result and its evidence."""

    summary: Summary
    """Numbers, problems and verdict."""
    curves: Mapping[str, ImpedanceCurve] = field(default_factory=dict)
    """Impedance over frequency by name of the estimator; empty if nothing could be estimated."""
    trials: tuple[Trial, ...] = ()
    """Samples and their statistics, in the order of the perturbed joints."""
    notes: tuple[str, ...] = ()
    """Remarks on what could not be found or is unusual."""

    @property
    def averages(self) -> float | None:
        """Least number of independent averages behind the coherences; None without curves."""
        known = [one.averages for name, one in self.curves.items() if name.startswith("welch")]
        return min(known or [one.averages for one in self.curves.values()], default=None)

    @property
    def significance(self) -> float | None:
        """Coherence below which signals count as unrelated; None without curves."""
        averages = self.averages
        return None if averages is None else coherence_significance(averages)

    def write(self, directory: Path) -> None:
        """Write ``summary.json`` and, if there are curves, ``frf.npz``.

        Raises
        ------
        DataError
            If a file exists already or cannot be written.
        """
        if self.curves:
            write_frf(directory / FRF_FILE, self.curves)
        write_summary(directory / SUMMARY_FILE, self.summary)


def conclude(
    trials: Sequence[Trial],
    *,
    known: Metadata,
    joint_names: Sequence[str],
    estimators: Sequence[str | Estimator],
    problems: Sequence[Problem] = (),
) -> Result:
    """Identify the impedance from the trials, and collect the problems of the result.

    Welch segments have the length that suits the shortest trial.

    Parameters
    ----------
    trials : sequence of Trial
        One for each joint. If one may not be used, nothing is estimated. Intervals in which the
        controller clipped its command are left out.
    known : Metadata
        What was recorded or declared beside the samples.
    joint_names : sequence of str
        Names of the n joints.
    estimators : sequence of str or Estimator
        As for :func:`armimp_estimation.identify.identify`.
    problems : sequence of Problem
        Problems that are known beforehand.

    Raises
    ------
    ConfigurationError
        If an estimator does not exist.
    """
    found = list(problems)
    for one in problems_of(trials, known):
        if one not in found:
            found.append(one)
    names = tuple(joint_names)
    identification = Identification(joint_names=names, trials=(), estimators={}, problems=())
    if not any(trial.refusals for trial in trials):
        try:
            parts = [trial.segments for trial in trials]
            identification = identify_records(parts, estimators, known)
        except DataError as error:
            found.append(Problem.of(error))
    found += identification.problems
    seed = known.seed if known.seed is not None or not trials else trials[0].window.seed
    # A trial of an unknown joint is reported as a problem, but left out of tables and figures.
    trials = [trial for trial in trials if trial.joint < len(names)]
    trials.sort(key=lambda trial: (trial.joint, trial.trial))
    results = identification.estimators
    summary = Summary.of(
        identification,
        truth=known.truth,
        config=known.config,
        seed=seed,
        problems=found,
        trials=[_trial_summary(trial, identification) for trial in trials],
        timing=known.timing,
        torque_reading=known.reading if results else None,
    )
    return Result(
        summary=summary,
        curves={name: ImpedanceCurve.of(one) for name, one in results.items()},
        trials=tuple(trials),
    )


def problems_of(trials: Sequence[Trial], known: Metadata) -> list[Problem]:
    """Find the problems of a recording before anything is estimated from it.

    Parameters
    ----------
    trials, known
        As :func:`conclude` takes them.
    """
    found = [] if known.timing is None else known.timing.problems
    declared = known.planned_rate
    for trial in trials:
        judged = trial.judged
        if declared is not None:
            judged = [one for one in judged if one.code is not ProblemCode.RATE_UNCUSTOMARY]
            rate = trial.segments[0].rate if trial.segments else declared
            if abs(rate / declared - 1.0) > TOLERANCE:
                code = ProblemCode.RATE_UNPLANNED
                judged.append(problem(code, trial=trial.trial, rate=rate, planned=declared))
        found += judged
    return found


def load_result(directory: Path) -> Result:
    """Read the files of a result, and the bags of its trials.

    A bag that cannot be read leaves a note, not an error.

    Parameters
    ----------
    directory : Path
        Directory of ``summary.json``, of ``frf.npz`` if there are estimates, and of the bags that
        the summary names.

    Raises
    ------
    DataError
        If summary or curves cannot be read.
    """
    summary = read_summary(directory / SUMMARY_FILE)
    notes: list[str] = []
    trials: list[Trial] = []
    for name in dict.fromkeys(trial.bag for trial in summary.trials if trial.bag):
        try:
            content = read_bag(directory / name)
        except BagError as error:
            notes.append(f"no time traces: {error}")
            continue
        notes += content.notes
        # Where there are estimates, every trial was used as far as it may be.
        used = bool(summary.estimators)
        trials += [replace(trial, allow_gaps=used) for trial in content.trials]
    return Result(
        summary=summary,
        curves=read_frf(directory / FRF_FILE) if summary.estimators else {},
        trials=tuple(sorted(trials, key=lambda trial: (trial.joint, trial.trial))),
        notes=tuple(notes),
    )


def _trial_summary(trial: Trial, identification: Identification) -> TrialSummary:
    """Summary of a trial; without scores if nothing could be estimated."""
    k, unknown = trial.joint + 1, [math.nan] * len(identification.joint_names)
    scores = TrialScores(k=k, lock_ratio=unknown, bias_bound=unknown)
    return TrialSummary(
        **dict(next((one for one in identification.trials if one.k == k), scores)),
        **dict(trial.statistics),
        bag=trial.bag,
        ticks=trial.statistics.streams[PERTURBATION].received,
        rtf=trial.rtf,
        saved=trial.window.saved * PERIOD_NS / NS_PER_S,
    )
