"""What `armimp reproduce` does with its options."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from armimp_bringup.benchmarks import available_cores
from armimp_bringup.config import load_config
from armimp_bringup.study.backends import Backend, Dask, Threads
from armimp_bringup.study.conditions import select_conditions
from armimp_bringup.study.display import StudyDisplay, print_verdict
from armimp_bringup.study.study import VERDICT_FILE, Watcher, run_study
from armimp_bringup.study.verdict import StudyVerdict
from armimp_common.errors import ConfigurationError, InterruptionError
from armimp_estimation.results import OriginSummary

DEFAULT_ESTIMATORS = ("welch_siso", "lpm_full")
_MOST_FAILURES = 20


@dataclass(frozen=True, kw_only=True)
class ReproduceOptions:
    """Options of the command line; None for what was not given.

    Parameters
    ----------
    config : YAML file with an experiment
    out : directory of the study
    only, seeds : as for :func:`armimp_bringup.study.conditions.select_conditions`
    workers : number of threads
    scheduler : address of a dask scheduler
    joints, duration, estimators : as in :class:`armimp_bringup.config.ExperimentConfig`
    figures : whether to draw them
    json : whether to print the verdict as JSON
    """

    config: Path | None
    out: Path
    only: Sequence[str]
    seeds: str
    workers: int | None
    scheduler: str | None
    joints: int | None
    duration: float | None
    estimators: Sequence[str] | None
    figures: bool
    json: bool


def reproduce(options: ReproduceOptions) -> int:
    """Run the study, print its verdict, and return the exit status that it deserves.

    Raises
    ------
    ArmimpError
        If the study can't be run.
    """
    given: dict[str, Any] = {"joints": options.joints, "duration": options.duration}
    if options.estimators:
        given["estimators"] = tuple(options.estimators)
    elif options.config is None:
        given["estimators"] = DEFAULT_ESTIMATORS
    base = load_config(options.config, given)
    conditions = select_conditions(options.only, options.seeds)
    backend = _backend(options)
    try:
        with StudyDisplay() as display:
            verdict = run_study(
                base,
                conditions,
                options.out,
                backend,
                figures=options.figures,
                watcher=Watcher(on_progress=display.show, on_stage=display.tell),
                origin=OriginSummary.of(sys.argv),
            )
    except KeyboardInterrupt:
        raise InterruptionError("interrupted; the same command goes on from here") from None
    return _present(verdict, options)


def _backend(options: ReproduceOptions) -> Backend:
    scheduler = options.scheduler
    if scheduler is not None:
        if options.workers is not None:
            raise ConfigurationError(
                "--workers is for threads of this machine, a --scheduler has its own"
            )
        return Dask(scheduler)
    return Threads(options.workers if options.workers is not None else available_cores())


def _present(verdict: StudyVerdict, options: ReproduceOptions) -> int:
    if options.json:
        print(verdict.model_dump_json(by_alias=True, ensure_ascii=True))
    else:
        from rich.console import Console

        console = Console(soft_wrap=True)
        print_verdict(verdict, console)
        told = "[bold]all targets met[/]" if verdict.met else "[bold red]targets missed[/]"
        console.print(told if any(one.limit is not None for one in verdict.worst) else "no targets")
        console.print(f"study in {options.out}", highlight=False)
    failures = verdict.failures()
    for failure in failures[:_MOST_FAILURES]:
        print(f"armimp: {failure}", file=sys.stderr)
    if len(failures) > _MOST_FAILURES:
        more = len(failures) - _MOST_FAILURES
        print(f"armimp: and {more} more, see {options.out / VERDICT_FILE}", file=sys.stderr)
    return 0 if verdict.met else 1
