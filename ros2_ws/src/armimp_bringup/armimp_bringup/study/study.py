"""The study from beginning to end: conditions, results, tables, figures, report and verdict."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Final

from pydantic import TypeAdapter
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.measure import Measurement
from rich.table import Table

from armimp_bringup.config import ExperimentConfig, prepare_directory
from armimp_bringup.offline import simulate
from armimp_bringup.parameters import node_parameters
from armimp_bringup.study import Condition, StudyEntry
from armimp_bringup.study.engine import Backend, condition_config, run_batch, split_evenly
from armimp_bringup.study.scores import SCORES, StudyVerdict, judge, results_csv, results_table
from armimp_bringup.terminal import display, say
from armimp_common.errors import DataError
from armimp_common.versions import software
from armimp_estimation.atomic_write import write_text
from armimp_estimation.report.run import REPORT_FILE
from armimp_estimation.summary import (
    ImpedanceCurve,
    OriginSummary,
    read_frf,
    write_frf,
    write_summary,
)

RESULTS_DIRECTORY: Final = "conditions"
STUDY_FILE: Final = "study.json"
VERDICT_FILE: Final = "verdict.json"
_FILES: Final = {
    STUDY_FILE: "all results",
    "results.csv": "one row for each condition, element and estimator",
    VERDICT_FILE: "worst values and targets",
    RESULTS_DIRECTORY + "/": "result and curves of each condition",
}
_MOMENT: Final = 2.0  # s, length of the trials of a run that compiles the machine code
_MOST_FAILURES: Final = 20


def run_study(
    base: ExperimentConfig,
    conditions: Sequence[Condition],
    directory: Path,
    backend: Backend,
    *,
    figures: bool = True,
    origin: OriginSummary | None = None,
) -> StudyVerdict:
    """Run a study and write its files.

    Parameters
    ----------
    base : everything but the levels and the seed
    conditions : what the study consists of, each once
    directory : new or empty
    backend : runs it
    figures : whether to draw the figures for print; the report is written in any case
    origin : command line and date, for the report

    Returns
    -------
    StudyVerdict
        Of the given conditions.

    Raises
    ------
    ConfigurationError
        If a setting is wrong, or the directory is not empty.
    DataError
        If the study cannot be run or stored.
    """
    # Wrong settings should be found before any file is written.
    first = condition_config(base, conditions[0])
    node_parameters(first, None)
    prepare_directory(directory)
    results = directory / RESULTS_DIRECTORY
    try:
        results.mkdir()
    except OSError as error:
        raise DataError(f"{directory}: cannot be used: {error.strerror}") from None
    # A short run compiles the machine code here, so that no worker has to.
    simulate([first.model_copy(update={"duration": _MOMENT})])
    batches = split_evenly(conditions, backend.workers)
    found: dict[Condition, StudyEntry] = {}
    display().progress(0, len(conditions), things="conditions")
    display().phase("simulating and estimating the first")
    with closing(backend.run(partial(run_batch, base, software()), batches)) as done:
        for batch in done:
            for entry, of_estimators in batch:
                name = entry.condition.name
                write_frf(results / f"{name}.npz", of_estimators)
                write_summary(results / f"{name}.json", entry)
                found[entry.condition] = entry
            display().progress(len(found), len(conditions), things="conditions")

    def curves(of: Condition) -> dict[str, ImpedanceCurve]:
        return read_frf(results / f"{of.name}.npz")

    entries = [found[condition] for condition in conditions]
    table = results_table(entries)
    verdict = judge(entries, table)
    content = TypeAdapter(list[StudyEntry]).dump_json(entries, indent=1, by_alias=True)
    write_text(directory / STUDY_FILE, content.decode() + "\n")
    write_text(directory / "results.csv", results_csv(table))
    text = verdict.model_dump_json(indent=1, by_alias=True)
    write_text(directory / VERDICT_FILE, f"{text}\n")
    drawn: dict[str, str] = {}
    if figures:
        display().phase("drawing the figures")
        from armimp_bringup.study.figures import write_figures

        drawn = write_figures(directory, conditions, table, entries[0].arm, curves)
    display().phase("writing the report")
    from armimp_bringup.study.report import StudyReport

    report = StudyReport(
        entries=entries,
        table=table,
        verdict=verdict,
        curves=curves,
        files={**_FILES, **drawn},
        origin=origin,
    )
    write_text(directory / REPORT_FILE, report.page())
    return verdict


def present_verdict(verdict: StudyVerdict, directory: Path, *, as_json: bool) -> int:
    """Print the verdict on a study; return exit status 0 if it is met, else 1."""
    if as_json:
        print(verdict.model_dump_json(by_alias=True, ensure_ascii=True))
    else:
        console = Console(soft_wrap=True)
        print_verdict(verdict, console)
        words = "[bold]all targets met[/]" if verdict.met else "[bold red]targets missed[/]"
        judged = any(one.limit is not None for one in verdict.worst)
        console.print(words if judged else "no targets")
        console.print(f"study in {directory}", highlight=False)
    failures = verdict.failures()
    for failure in failures[:_MOST_FAILURES]:
        say(f"armimp: {failure}")
    if len(failures) > _MOST_FAILURES:
        say(f"armimp: and {len(failures) - _MOST_FAILURES} more, see {directory / VERDICT_FILE}")
    return 0 if verdict.met else 1


def print_verdict(verdict: StudyVerdict, console: Console) -> None:
    """Print the worst value of each quantity; nothing is truncated, even if lines get too wide."""
    many = "s" if verdict.conditions > 1 else ""
    caption = "F, R, P: levels of friction, resolution and perturbation"
    if verdict.unresolved:
        caption += f"\n{100.0 * verdict.unresolved:.1f} % of all elements not resolved, not judged"
    table = Table(
        title=f"worst values of {verdict.conditions} condition{many}, all elements",
        caption=caption,
        box=SIMPLE_HEAD,
        padding=(0, 1, 0, 0),  # fits into 80 characters
        title_justify="left",
        caption_justify="left",
    )
    for name in ("estimator", "quantity", "worst", "target", "", "in", "condition"):
        right = name in ("worst", "target")
        table.add_column(name, justify="right" if right else "left", no_wrap=True)
    for place, one in enumerate(verdict.worst):
        table.add_row(
            one.estimator if place % len(SCORES) == 0 else "",
            one.quantity,
            one.score.format(one.worst, one.limit),
            one.target,
            {True: "[green]✓[/]", False: "[bold red]✗[/]", None: ""}[one.met],
            one.element,
            f"{one.condition.short} seed {one.seed}",
            end_section=place % len(SCORES) == len(SCORES) - 1,
        )
    wide = Measurement.get(console, console.options.update(max_width=1000), table).maximum
    console.width = max(console.width, wide)
    console.print(table)
