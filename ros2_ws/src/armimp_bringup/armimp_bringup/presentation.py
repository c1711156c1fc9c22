"""Presentation of a result by the command line: tables, figures, report, exit status."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from armimp_bringup.terminal import Display, say
from armimp_common.errors import DataError
from armimp_common.process import age
from armimp_common.status import Phase
from armimp_estimation.arm_models import ModelFit
from armimp_estimation.mbk import UNITS
from armimp_estimation.metadata import Timing
from armimp_estimation.problems import ProblemCode, Severity
from armimp_estimation.result import Result, load_result
from armimp_estimation.summary import (
    SUMMARY_FILE,
    EstimatorSummary,
    OriginSummary,
    Summary,
    WallSummary,
    write_summary,
)

_TOO_BUSY = (ProblemCode.SAMPLES_LATE, ProblemCode.COMMANDS_LATE, ProblemCode.LATENCY)
_COUNTS = ("duplicated", "contradictory", "reordered", "late")
_WORDS = ("", "element", "unit", "bag")  # names of columns that hold text


class Stopwatch:
    """Wall times of a run, counted from the start of the process.

    The time of the trials reaches from the first to the last perturbed sample of all trials. The
    time before covers imports and the start of the graph, the time after estimates and all output.
    """

    def __init__(self) -> None:
        self._began = time.monotonic() - age()
        self._first = self._last = self._shown = math.nan
        self._perturbing = False

    def note(self, phase: Phase) -> None:
        """Note that a phase of a trial begins."""
        if self._perturbing:
            self._last = time.monotonic()
        self._perturbing = phase is Phase.PERTURB
        if self._perturbing and math.isnan(self._first):
            self._first = time.monotonic()

    def shown(self) -> None:
        """Note that M, B and K are now on the screen."""
        self._shown = time.monotonic()

    def stop(self) -> WallSummary:
        """Return the wall times until now; NaN without any sample."""
        return WallSummary(
            before=self._first - self._began,
            trials=self._last - self._first,
            result=self._shown - self._last,
            after=time.monotonic() - self._last,
        )


def present(
    result: Result,
    directory: Path | None,
    *,
    as_json: bool,
    stopwatch: Stopwatch | None = None,
) -> int:
    """Print a result, then write its figures and report.

    Parameters
    ----------
    result : as it is stored; without curves and trials, all of it is read from the directory
    directory : where it is stored, and where figures and report go; None if nowhere
    as_json : whether to print the summary instead of tables
    stopwatch : the one that measured the run; its times become part of the summary

    Returns
    -------
    int
        Exit status: 0 if the result is valid and all of it could be written, else 1.
    """
    complete = True
    summary = result.summary.model_copy(update={"origin": OriginSummary.of(sys.argv)})
    if not as_json:
        print_result(summary)
        if stopwatch is not None:
            stopwatch.shown()
    for line in complaints(summary):
        say(f"armimp: {line}")
    if directory is not None:
        try:
            try:
                with Display() as display:
                    display.phase("drawing figures and report")
                    if not result.trials:
                        result = load_result(directory)
                    _draw(directory, replace(result, summary=summary))
            finally:
                if stopwatch is not None:
                    summary = summary.model_copy(update={"wall": stopwatch.stop()})
                write_summary(directory / SUMMARY_FILE, summary, anew=True)
        except DataError as error:
            # As on a full disk; the numbers are there all the same.
            say(f"armimp: {error}")
            complete = False
    if as_json:
        print(summary.model_dump_json(by_alias=True, ensure_ascii=True))
    else:
        _print_files(summary, directory)
    return 0 if summary.valid and complete else 1


def complaints(summary: Summary) -> list[str]:
    """Return the problems of a result with their consequence, in one line for each cause.

    Notes have no consequence; an error of an estimator that does not decide the verdict only leads
    to the refusal of its estimate.
    """
    faults = summary.faults
    late = [one for one in faults if one.code in _TOO_BUSY]
    lines = []
    if len(late) > 1:
        causes = "; ".join(one.sentence.removeprefix("real time: ") for one in late)
        lines.append(f"not valid: the machine was too busy for real time: {causes}")
    for one in summary.problems:
        if one.severity is Severity.NOTE:
            lines.append(f"note: {one}")
        elif one in summary.refusals:
            lines.append(f"refused: {one}")
        elif one not in late or len(late) == 1:
            lines.append(f"not valid: {one}")
    return lines


def _draw(directory: Path, result: Result) -> None:
    """Write report and figures, each even if the other cannot be written."""
    from armimp_estimation.report.run import write_report

    try:
        write_report(directory, result)
    finally:
        from armimp_estimation.figures import write_figures

        write_figures(directory, result)


def print_result(summary: Summary) -> None:
    """Print the tables of a result, and the verdict."""
    out = Console(soft_wrap=True)
    for name, result in summary.estimators.items():
        out.print(_parameter_table(name, result, summary))
        if result.offered is not None:
            out.print(_model_table(f"{name}, model {result.model}", result.offered))
        out.print(_quality_table(result, summary))
    if summary.trials:
        out.print(_trial_table(summary))
    if summary.timing is not None:
        out.print(_timing_table(summary.timing))
    for line in _without_precision(summary):
        out.print(line, highlight=False)
    by = f", by {', '.join(summary.deciding)}" if summary.refusals else ""
    out.print(f"[bold]valid[/]{by}" if summary.valid else "[bold red]not valid[/]", highlight=False)
    if summary.verdict.impedance and not summary.verdict.parameters:
        out.print("Z(f) is valid; M, B and K are not", highlight=False)


def _print_files(summary: Summary, directory: Path | None) -> None:
    """Print where the files of a result are, and how long everything took."""
    out = Console(soft_wrap=True)
    if directory is not None:
        out.print(f"results in {directory}", highlight=False)
    wall = summary.wall
    if wall is not None and not math.isnan(wall.trials):
        out.print(
            f"{wall.before:.1f} s until the first sample, {wall.trials:.1f} s to the last one, "
            f"{wall.result:.1f} s for the result, {wall.after - wall.result:.1f} s for the rest",
            highlight=False,
        )


def _table(columns: Sequence[str], title: str | None = None) -> Table:
    """Return an empty table, in which words stand on the left and numbers on the right."""
    table = Table(title=title, box=SIMPLE_HEAD, title_justify="left")
    for name in columns:
        table.add_column(name, justify="left" if name in _WORDS else "right")
    return table


def _parameter_table(name: str, result: EstimatorSummary, summary: Summary) -> Table:
    known = [] if summary.truth is None else ["truth", "error"]
    columns = ["", "estimate", "± s.e.", *known, "unit"]
    table = _table(columns, f"{name}: Z = M s² + B s + K")
    last = summary.joints - 1
    for letter, unit in UNITS.items():
        estimates, errors = getattr(result, letter), getattr(result, f"{letter}_se")
        for i, k in np.ndindex(summary.joints, summary.joints):
            value = estimates[i][k]
            cells = [f"{letter}{i + 1}{k + 1}", f"{value:.5f}", f"{errors[i][k]:.5f}"]
            if summary.truth is not None:
                true = getattr(summary.truth, letter)[i][k]
                cells += [f"{true:.5f}", f"{100.0 * (value / true - 1.0):+.2f} %" if true else "–"]
            table.add_row(*cells, unit, end_section=i == k == last)
    return table


def _model_table(title: str, model: ModelFit) -> Table:
    table = _table(["", "estimate", "± s.e.", "unit"], f"{title}: Z = {model.equation}")
    for name, place, value, error, unit in model.elements:
        label = name + "".join(map(str, place))
        table.add_row(label, f"{value:.5g}", _shown(error, ".2g"), unit)
    return table


def _quality_table(result: EstimatorSummary, summary: Summary) -> Table:
    scores = {
        "VAF %": (result.vaf, ".2f"),
        "R²": (result.r2, ".4f"),
        "lack of fit": (result.lack_of_fit, ".2f"),
        "coherence, derived": (result.coherence_derived, ".4f"),
        "coherence τΔ→τ": (result.coherence_torque, ".4f"),
    }
    known = {title: (matrix, spec) for title, (matrix, spec) in scores.items() if matrix}
    table = _table(["element", *known])
    for i, k in np.ndindex(summary.joints, summary.joints):
        cells = (format(matrix[i][k], spec) for matrix, spec in known.values())
        table.add_row(f"Z{i + 1}{k + 1}", *cells)
    return table


def _trial_table(summary: Summary) -> Table:
    trials = summary.trials
    # A column is left out if it is as it should be in all trials, which is the rule.
    counts = {
        **{kind: [str(one.total(kind)) for one in trials] for kind in _COUNTS},
        "clipped": [str(one.clipped) for one in trials],
        "excluded": [f"{100.0 * one.excluded_share:.3g} %" for one in trials],
        "saved s": [f"{one.saved:.1f}" for one in trials],
        "not recorded": ["commands" if one.without_commands else "" for one in trials],
    }
    cells = {
        "joint": [str(one.k) for one in trials],
        "samples": [str(one.ticks) for one in trials],
        "lost": [str(one.lost) for one in trials],
        **{name: found for name, found in counts.items() if {*found} - {"0", "0 %", "0.0", ""}},
        "lock ratio": [
            _shown(max(np.delete(one.lock_ratio, one.k - 1), default=math.nan), ".4f")
            for one in trials
        ],
        "x real time": [_shown(one.rtf, ".1f") for one in trials],
        "bag": ["–" if one.bag is None else one.bag for one in trials],
    }
    table = _table(list(cells), "trials")
    table.columns[-1].overflow = "fold"
    for row in zip(*cells.values(), strict=True):
        table.add_row(*row)
    return table


def _timing_table(timing: Timing) -> Table:
    title = f"timing: {timing.ticks} samples, {timing.late} late, {timing.missed} commands missed"
    table = _table(["", "median, ms", "99 %, ms", "longest, ms"], title)
    for label, durations in (
        ("period", (timing.period_p50, timing.period_p99, timing.period_max)),
        ("sample to command", (timing.latency_p50, timing.latency_p99, timing.latency_max)),
    ):
        table.add_row(label, *(_shown(1e3 * one, ".3f") for one in durations))
    return table


def _shown(value: float, spec: str) -> str:
    return "–" if math.isnan(value) else format(value, spec)


def _without_precision(summary: Summary) -> list[str]:
    """Name the trials that lasted as planned because their errors did not reach the target."""
    from armimp_estimation.report.formats import setting

    bound = setting(summary.config, "experiment", "target_error")
    if not isinstance(bound, float) or not bound:
        return []
    return [
        f"joint {trial.k}: planned length, standard errors not below {100.0 * bound:g} % before"
        for trial in summary.trials
        if not trial.saved
    ]
