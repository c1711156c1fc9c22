"""The command line of the studies: ``make research ARGS=limits``."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from datetime import datetime
from importlib import import_module
from pathlib import Path
from typing import Annotated

import typer

from armimp_bringup import cli
from armimp_bringup.config import prepare_directory
from armimp_bringup.terminal import Display
from armimp_common.compiled import on_compiling
from armimp_common.errors import ConfigurationError
from research.options import InvestigationOptions

STUDIES = {
    "coverage": "whether the standard errors of M, B and K are honest",
    "limits": "how far the estimators are from the accuracy that noise allows",
    "controller": "what the choice of the controller's parameters does to accuracy",
    "decomposition": "what decomposition gains: direct, decomposed and all joints at once",
    "truth": "whether valid results are true, on recordings of an independent rig",
    "rigs": "the same on rigs and arms that are drawn at random",
    "ideal": "whether checks refuse ideal runs",
    "distortion": "whether a multisine reveals arms that are nonlinear or change over time",
    "efficiency": "how close errors come to the Cramér-Rao bound for each kind of perturbation",
    "growth": "accuracy, time and record length from two to seven joints",
}
"""Question of each study; a new study is a module of this name with `investigate`."""

SELECTIVE = {"truth", "rigs", "ideal", "distortion", "efficiency"}
"""Studies with cases that can be chosen with ``--only``."""
TEXTUAL = {"ideal", "distortion"}
"""Studies that print text alone."""

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)
_NAMES = "; ".join(f"{name}: {what}" for name, what in STUDIES.items()) + "."


@app.command()
def study(
    name: Annotated[str, typer.Argument(metavar="NAME", help=_NAMES)],
    out: Annotated[Path | None, typer.Option(help="New directory for the results.")] = None,
    seeds: Annotated[
        str | None, typer.Option(help="Seeds, as in 77 or 0:10; default: those of NAME.")
    ] = None,
    workers: Annotated[int | None, typer.Option(help="Threads; default: one per core.")] = None,
    only: Annotated[
        str, typer.Option(help="Cases of truth, rigs, efficiency, distortion or ideal to run.")
    ] = "",
    json: Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")] = False,
) -> int:
    """Answer one question by Monte Carlo simulation; the pages of this folder have the answers."""
    if name not in STUDIES:
        raise ConfigurationError(f"unknown study {name!r}, known are {', '.join(STUDIES)}")
    if only and name not in SELECTIVE:
        raise ConfigurationError(f"--only: {name} has no cases to choose from")
    if json and name in TEXTUAL:
        raise ConfigurationError(f"--json: {name} prints text alone")
    with Display() as display:
        display.phase("starting")
        on_compiling(cli.tell_of_compiling)
        directory = out or Path("results") / f"{name}-{datetime.now():%Y%m%d-%H%M%S}"
        options = InvestigationOptions(
            out=directory, seeds=seeds, workers=workers, json=json, only=only
        )
        prepare_directory(directory)
        investigate: Callable[[InvestigationOptions], int] = import_module(
            f"research.{name}"
        ).investigate
        return investigate(options)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns its exit status."""
    return cli.main(arguments, app, "research")


if __name__ == "__main__":
    sys.exit(main())
