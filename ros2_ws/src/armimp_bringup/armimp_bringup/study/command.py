"""What `armimp reproduce` does with its options, and the table of the worst values."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.measure import Measurement
from rich.table import Table

from armimp_bringup.bench import available_cores
from armimp_bringup.config import load_config
from armimp_bringup.study.backends import Backend, Dask, Threads
from armimp_bringup.study.conditions import select_conditions
from armimp_bringup.study.study import VERDICT_FILE, run_study
from armimp_bringup.study.verdict import COLUMNS, StudyVerdict
from armimp_bringup.terminal import leave_terminal, say
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
        verdict = run_study(
            base,
            conditions,
            options.out,
            backend,
            figures=options.figures,
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
    leave_terminal()
    if options.json:
        print(verdict.model_dump_json(by_alias=True, ensure_ascii=True))
    else:
        console = Console(soft_wrap=True)
        print_verdict(verdict, console)
        told = "[bold]all targets met[/]" if verdict.met else "[bold red]targets missed[/]"
        console.print(told if any(one.limit is not None for one in verdict.worst) else "no targets")
        console.print(f"study in {options.out}", highlight=False)
    failures = verdict.failures()
    for failure in failures[:_MOST_FAILURES]:
        say(f"armimp: {failure}")
    if len(failures) > _MOST_FAILURES:
        more = len(failures) - _MOST_FAILURES
        say(f"armimp: and {more} more, see {options.out / VERDICT_FILE}")
    return 0 if verdict.met else 1


def print_verdict(verdict: StudyVerdict, console: Console) -> None:
    """Print the table of the worst values, wider than the terminal rather than with gaps."""
    table = verdict_table(verdict)
    wide = Measurement.get(console, console.options.update(max_width=1000), table).maximum
    console.width = max(console.width, wide)
    console.print(table)


def verdict_table(verdict: StudyVerdict) -> Table:
    """The worst value of each quantity for each estimator, with the target and the place."""
    many = "s" if verdict.conditions > 1 else ""
    table = Table(
        title=f"worst values of {verdict.conditions} condition{many}, all elements",
        caption="F, R, P: levels of friction, resolution and perturbation",
        box=SIMPLE_HEAD,
        padding=(0, 1, 0, 0),  # fits into 80 characters
        title_justify="left",
        caption_justify="left",
    )
    table.add_column("estimator", no_wrap=True)
    table.add_column("quantity", no_wrap=True)
    for name in ("worst", "target"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("", no_wrap=True)
    table.add_column("in", no_wrap=True)
    table.add_column("condition", no_wrap=True)
    columns = {column.quantity: column for column in COLUMNS}
    for number, one in enumerate(verdict.worst):
        column = columns[one.quantity]
        sign = "≥" if column.floor else "≤"
        table.add_row(
            one.estimator if number % len(COLUMNS) == 0 else "",
            one.quantity,
            column.format(one.worst),
            "–" if one.limit is None else f"{sign} {one.limit:g}{column.unit}",
            {True: "[green]✓[/]", False: "[bold red]✗[/]", None: ""}[one.met],
            one.element,
            f"F{one.friction} R{one.resolution} P{one.perturbation} seed {one.seed}",
            end_section=number % len(COLUMNS) == len(COLUMNS) - 1,
        )
    return table
