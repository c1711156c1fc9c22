"""The result of an experiment as tables on the terminal."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from armimp_estimation.results import EstimatorSummary, Summary, TimingSummary, WallSummary

_COUNTS = ("duplicated", "contradictory", "reordered", "late", "clipped", "excluded")
_UNITS = {"M": "kg·m²", "B": "N·m·s/rad", "K": "N·m/rad"}


def print_summary(summary: Summary, directory: Path | None, console: Console | None = None) -> None:
    """Print the tables of a result, the verdict, and where the files are."""
    out = console if console is not None else Console(soft_wrap=True)
    for name, result in summary.estimators.items():
        out.print(_parameter_table(name, result, summary))
        out.print(_quality_table(result, summary))
    if summary.trials:
        out.print(_trial_table(summary))
    if summary.timing is not None:
        out.print(_timing_table(summary.timing))
    out.print("[bold]valid[/]" if summary.valid else "[bold red]not valid[/]")
    if directory is not None:
        out.print(f"results in {directory}", highlight=False)
    if summary.wall is not None and not math.isnan(summary.wall.trials):
        out.print(_wall_line(summary.wall), highlight=False)
    for line in _without_precision(summary):
        out.print(line, highlight=False)


def _wall_line(wall: WallSummary) -> str:
    return (
        f"{wall.before:.1f} s until the first sample, {wall.trials:.1f} s to the last one, "
        f"{wall.after:.1f} s for the result"
    )


def _parameter_table(name: str, result: EstimatorSummary, summary: Summary) -> Table:
    table = Table(title=f"{name}: Z = M s² + B s + K", box=SIMPLE_HEAD, title_justify="left")
    table.add_column("")
    table.add_column("estimate", justify="right")
    table.add_column("± s.e.", justify="right")
    if summary.truth is not None:
        table.add_column("truth", justify="right")
        table.add_column("error", justify="right")
    table.add_column("unit")
    for letter, unit in _UNITS.items():
        estimates, errors = getattr(result, letter), getattr(result, f"{letter}_se")
        for i in range(summary.joints):
            for k in range(summary.joints):
                value = estimates[i][k]
                cells = [f"{letter}{i + 1}{k + 1}", f"{value:.5f}", f"{errors[i][k]:.5f}"]
                if summary.truth is not None:
                    true = getattr(summary.truth, letter)[i][k]
                    cells += [f"{true:.5f}", _relative(value, true)]
                table.add_row(*cells, unit, end_section=i == k == summary.joints - 1)
    return table


def _quality_table(result: EstimatorSummary, summary: Summary) -> Table:
    table = Table(box=SIMPLE_HEAD)
    table.add_column("element")
    rows: list[tuple[str, list[list[float]] | None, str]] = [
        ("VAF %", result.vaf, ".2f"),
        ("R²", result.r2, ".4f"),
        ("coherence, derived", result.coherence_derived, ".4f"),
        ("coherence τΔ→τ", result.coherence_torque, ".4f"),
    ]
    n = range(summary.joints)
    for title, matrix, _ in rows:
        if matrix is not None:
            table.add_column(title, justify="right")
    for i in n:
        for k in n:
            cells = [format(m[i][k], f) for _, m, f in rows if m is not None]
            table.add_row(f"Z{i + 1}{k + 1}", *cells)
    return table


def _trial_table(summary: Summary) -> Table:
    table = Table(title="trials", box=SIMPLE_HEAD, title_justify="left")
    table.add_column("joint", justify="right")
    table.add_column("samples", justify="right")
    table.add_column("lost", justify="right")
    # What is zero in all trials, as it mostly is, takes no room.
    counts = [kind for kind in _COUNTS if any(getattr(one, kind) for one in summary.trials)]
    for kind in counts:
        table.add_column(kind, justify="right")
    if saved := any(one.saved for one in summary.trials):
        table.add_column("saved s", justify="right")
    table.add_column("lock ratio", justify="right")
    table.add_column("x real time", justify="right")
    table.add_column("bag", overflow="fold")
    for trial in summary.trials:
        others = [ratio for i, ratio in enumerate(trial.lock_ratio) if i != trial.k - 1]
        table.add_row(
            str(trial.k),
            str(trial.ticks),
            str(trial.lost),
            *(_count(kind, getattr(trial, kind)) for kind in counts),
            *([f"{trial.saved:.1f}"] if saved else []),
            _largest(others),
            "–" if math.isnan(trial.rtf) else f"{trial.rtf:.1f}",
            "–" if trial.bag is None else trial.bag,
        )
    return table


def _timing_table(timing: TimingSummary) -> Table:
    title = f"timing: {timing.ticks} samples, {timing.late} late, {timing.missed} commands missed"
    table = Table(title=title, box=SIMPLE_HEAD, title_justify="left")
    table.add_column("")
    for column in ("median", "99 %", "longest"):
        table.add_column(f"{column}, ms", justify="right")
    for label, durations in (
        ("period", (timing.period_p50, timing.period_p99, timing.period_max)),
        ("sample to command", (timing.latency_p50, timing.latency_p99, timing.latency_max)),
    ):
        cells = ("–" if math.isnan(one) else f"{1e3 * one:.3f}" for one in durations)
        table.add_row(label, *cells)
    return table


def _count(kind: str, value: float) -> str:
    return f"{100.0 * value:.3g} %" if kind == "excluded" else str(value)


def _largest(values: Sequence[float]) -> str:
    worst = max(values, default=math.nan)
    return "–" if math.isnan(worst) else f"{worst:.4f}"


def _without_precision(summary: Summary) -> list[str]:
    """Which trials lasted as planned, as their errors did not become as small as was asked for."""
    experiment = summary.config.get("experiment")
    bound = experiment.get("until_error") if isinstance(experiment, dict) else None
    if not isinstance(bound, float) or not bound:
        return []
    return [
        f"joint {trial.k}: planned length, standard errors not below {100.0 * bound:g} % before"
        for trial in summary.trials
        if not trial.saved
    ]


def _relative(value: float, true: float) -> str:
    return f"{100.0 * (value / true - 1.0):+.2f} %" if true else "–"
