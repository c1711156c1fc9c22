"""The frame of all benchmarks, and those behind `armimp bench`: a function each, and a name."""

from __future__ import annotations

import json
import os
import platform
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from armimp_common.errors import ArmimpError, ConfigurationError, DataError
from armimp_common.versions import git_revision, versions

BENCH_FILE = "bench.json"


@dataclass(frozen=True, kw_only=True)
class Measured:
    """One figure of a benchmark.

    Parameters
    ----------
    key : str
        Name in ``bench.json``.
    label : str
        What people read.
    value : float
    unit : str
        May be empty.
    limit : float or None
        What the value must not exceed, if there is a target.
    """

    key: str
    label: str
    value: float
    unit: str
    limit: float | None = None

    @property
    def met(self) -> bool | None:
        """Whether the target is met; None without one. NaN never meets it."""
        return None if self.limit is None else self.value <= self.limit


Benchmark = Callable[[Callable[[str], None]], list[Measured]]
"""Takes a function that is told what is being measured; gives the figures."""


def _graph(tell: Callable[[str], None]) -> list[Measured]:
    from armimp_bringup.graph_bench import time_graph

    return time_graph(tell)


def _realtime(tell: Callable[[str], None]) -> list[Measured]:
    from armimp_bringup.realtime_bench import time_realtime

    return time_realtime(tell)


BENCHMARKS: Mapping[str, Benchmark] = {"graph": _graph, "realtime": _realtime}
"""What a user wants to know of a machine; those of the project itself are in ``benchmarks/``."""


def available_cores() -> int:
    """Processor cores that this process may use."""
    return len(os.sched_getaffinity(0))


def check_names(names: Sequence[str], known: Mapping[str, Benchmark]) -> None:
    """Check that there are benchmarks of these names.

    Raises
    ------
    ConfigurationError
        Naming the first that there is not.
    """
    for name in names:
        if name not in known:
            raise ConfigurationError(f"there is no benchmark {name!r}, only {', '.join(known)}")


@dataclass(frozen=True, kw_only=True)
class BenchResults:
    """What came of benchmarks.

    Attributes
    ----------
    measured : figures by benchmark
    failed : why there are none of others, likewise
    """

    measured: dict[str, list[Measured]]
    failed: dict[str, str]

    @property
    def missed(self) -> list[Measured]:
        """Figures whose target is not met."""
        return [one for group in self.measured.values() for one in group if one.met is False]


def run_benchmarks(
    names: Sequence[str], tell: Callable[[str], None], known: Mapping[str, Benchmark]
) -> BenchResults:
    """Run benchmarks by name; none means all. One that fails does not keep others from running.

    Raises
    ------
    ConfigurationError
        If there is no such benchmark.
    """
    check_names(names, known)
    results = BenchResults(measured={}, failed={})
    for name in dict.fromkeys(names or known):
        try:
            results.measured[name] = known[name](tell)
        except ArmimpError as error:
            results.failed[name] = str(error)
    return results


def bench_record(results: BenchResults) -> dict[str, Any]:
    """Content of ``bench.json``: the machine, and each figure by benchmark and key."""
    return {
        "schema": 1,
        "machine": {
            "cores": available_cores(),
            "processor": _processor(),
            "system": platform.platform(),
        },
        "versions": versions(),
        "git_revision": git_revision(),
        "benchmarks": {
            name: {
                one.key: {"value": one.value, "unit": one.unit, "limit": one.limit, "met": one.met}
                for one in measured
            }
            for name, measured in results.measured.items()
        },
        "failed": results.failed,
    }


def write_bench(directory: Path, record: dict[str, Any]) -> Path:
    """Write ``bench.json`` into a directory that has none.

    Raises
    ------
    DataError
        If there is one, or it can't be written.
    """
    path = directory / BENCH_FILE
    try:
        directory.mkdir(parents=True, exist_ok=True)
        with path.open("x", encoding="utf-8") as file:
            file.write(json.dumps(record, indent=1) + "\n")
    except FileExistsError:
        raise DataError(f"{path}: exists already") from None
    except OSError as error:
        raise DataError(f"{path}: cannot be written: {error.strerror}") from None
    return path


def bench(
    names: Sequence[str],
    directory: Path,
    *,
    as_json: bool,
    known: Mapping[str, Benchmark] | None = None,
) -> int:
    """Run benchmarks, show and store the figures; 0 if all ran and met their targets, else 1.

    Raises
    ------
    ConfigurationError
        If there is no such benchmark.
    DataError
        If the result can't be stored.
    """
    from rich.console import Console

    errors = Console(stderr=True, soft_wrap=True)
    known = BENCHMARKS if known is None else known
    check_names(names, known)
    _require_place(directory)
    began = time.monotonic()
    results = run_benchmarks(names, lambda text: errors.print(text, highlight=False), known)
    took = time.monotonic() - began
    record = bench_record(results)
    path = write_bench(directory, record)
    if as_json:
        print(json.dumps(record))
    else:
        _print(results.measured, path, took)
    for one in results.missed:
        errors.print(
            f"armimp: {one.label} is {one.value:.3g} {one.unit}, target {one.limit:g}",
            highlight=False,
        )
    for name, reason in results.failed.items():
        errors.print(f"armimp: {name}: {reason}", highlight=False)
    return 1 if results.missed or results.failed else 0


def _require_place(directory: Path) -> None:
    """Find out before anything is measured whether the figures can be stored."""
    path = directory / BENCH_FILE
    try:
        directory.mkdir(parents=True, exist_ok=True)
        if path.exists():
            raise DataError(f"{path}: exists already")
        if not os.access(directory, os.W_OK):
            raise DataError(f"{path}: cannot be written: no permission")
    except OSError as error:
        raise DataError(f"{path}: cannot be written: {error.strerror}") from None


def _print(results: dict[str, list[Measured]], path: Path, took: float) -> None:
    from rich.box import SIMPLE_HEAD
    from rich.console import Console
    from rich.table import Table

    console = Console(soft_wrap=True)
    for name, measured in results.items():
        table = Table(title=name, box=SIMPLE_HEAD, title_justify="left", show_header=False)
        table.add_column("")
        table.add_column("", justify="right")
        table.add_column("")
        table.add_column("")
        for one in measured:
            mark = {True: "[green]✓[/]", False: "[bold red]✗[/]", None: ""}[one.met]
            limit = "" if one.limit is None else f"≤ {one.limit:g} {one.unit} {mark}"
            table.add_row(one.label, f"{one.value:.3g}", one.unit, limit)
        console.print(table)
    console.print(
        f"{available_cores()} cores, {_processor()}; measured in {took:.0f} s", highlight=False
    )
    console.print(f"figures in {path}", highlight=False)


def _processor() -> str:
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8")
    except OSError:
        return platform.processor()
    names = [line.split(":", 1)[1].strip() for line in text.splitlines() if "model name" in line]
    return names[0] if names else platform.processor()
