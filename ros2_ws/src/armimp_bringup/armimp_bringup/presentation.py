"""What becomes of a result on the command line: figures, report, tables, exit status."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from armimp_bringup.say import say
from armimp_bringup.stopwatch import Stopwatch
from armimp_common.errors import DataError
from armimp_estimation.conclusion import SUMMARY_FILE
from armimp_estimation.figure_process import FigureProcess
from armimp_estimation.results import OriginSummary, Summary, write_summary


def present(
    summary: Summary,
    directory: Path | None,
    figures: FigureProcess,
    *,
    as_json: bool,
    bags: Sequence[Path] | None = None,
    namespace: str | None = None,
    stopwatch: Stopwatch | None = None,
) -> int:
    """Draw, report and print a result.

    Parameters
    ----------
    summary : Summary
        As it is stored.
    directory : Path or None
        Where it is stored, and figures and report go; None if nowhere.
    figures : FigureProcess
        What draws the figures, while the report is written.
    as_json : bool
        Whether to print the summary instead of tables.
    bags, namespace : optional
        As in `armimp_estimation.report.load_result`.
    stopwatch : Stopwatch, optional
        What has measured the run; its times become part of the summary.

    Returns
    -------
    int
        The exit status that the result deserves.
    """
    complete = True
    summary = summary.model_copy(update={"origin": OriginSummary.of(sys.argv)})
    if directory is not None:
        try:
            write_summary(directory / SUMMARY_FILE, summary, anew=True)
            _write(directory, figures, bags, namespace)
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
        from armimp_bringup.tables import print_summary

        print_summary(summary, directory)
    for problem in summary.problems:
        say(f"armimp: not valid: {problem}")
    return 0 if summary.valid and complete else 1


def _write(
    directory: Path, figures: FigureProcess, bags: Sequence[Path] | None, namespace: str | None
) -> None:
    """Write figures and report, each even if the other cannot be written.

    Raises
    ------
    DataError
        The first of what went wrong.
    """
    from armimp_estimation.report import load_result, write_report

    figures.draw(directory, bags, namespace=namespace)
    result = load_result(directory, bags, namespace=namespace)

    def draw() -> None:
        if not figures.finished():
            from armimp_estimation.figures import write_figures

            write_figures(directory, result)

    errors = [
        error
        for step in (lambda: write_report(directory, result), draw)
        if (error := _error_of(step)) is not None
    ]
    if errors:
        raise errors[0]


def _error_of(step: Callable[[], object]) -> DataError | None:
    try:
        step()
    except DataError as error:
        return error
    return None
