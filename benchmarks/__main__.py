"""The command line of all benchmarks: ``make bench ARGS=start``."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Annotated

import typer

from armimp_bringup import cli
from armimp_bringup.bench import bench, jitter
from benchmarks.estimate import time_estimate
from benchmarks.graph import time_graph
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
    "graph": time_graph,
    "jitter": jitter,
}
"""Every benchmark by name; a new one is a function and a line here."""

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)


@app.command()
def measure(
    names: Annotated[
        list[str] | None, typer.Argument(metavar="[NAME]...", help="Benchmarks; default: all.")
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Print JSON instead of tables.")] = False,
) -> int:
    """Measure what a run costs; a target that is missed makes the exit status 1."""
    return bench(names or (), as_json=json, known=ALL)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns its exit status."""
    return cli.main(arguments, app, "bench")


if __name__ == "__main__":
    sys.exit(main())
