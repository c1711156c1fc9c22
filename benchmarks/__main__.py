"""The command line of all benchmarks: ``make bench ARGS=start``."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import Annotated

import typer

from armimp_bringup import cli
from armimp_bringup.benchmarks import BENCHMARKS, bench
from benchmarks.estimate import time_estimate
from benchmarks.growth import measure_growth
from benchmarks.memory import measure_memory
from benchmarks.start import time_start
from benchmarks.study import time_study

ALL = {
    "study": time_study,
    "start": time_start,
    "estimate": time_estimate,
    "memory": measure_memory,
    "growth": measure_growth,
    **BENCHMARKS,
}
"""Every benchmark by name; a new one is a function and a line here."""

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)


@app.command()
def measure(
    names: Annotated[
        list[str] | None, typer.Argument(metavar="[NAME]...", help="Benchmarks; default: all.")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Directory for bench.json.")] = None,
    json: Annotated[
        bool, typer.Option("--json", help="Print bench.json instead of a table.")
    ] = False,
) -> int:
    """Measure what a run costs; a target that is missed makes the exit status 1."""
    directory = out or Path("results") / f"bench-{datetime.now():%Y%m%d-%H%M%S}"
    return bench(names or (), directory, as_json=json, known=ALL)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns its exit status."""
    return cli.main(arguments, app, "bench")


if __name__ == "__main__":
    sys.exit(main())
