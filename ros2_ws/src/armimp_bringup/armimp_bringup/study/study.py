"""The study from beginning to end: conditions, results, tables, figures and verdict."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

from armimp_bringup.config import ExperimentConfig
from armimp_bringup.study.backends import Backend
from armimp_bringup.study.conditions import Condition
from armimp_bringup.study.csv_tables import results_csv, verdict_csv
from armimp_bringup.study.engine import Batch, Provenance, condition_parameters, split_evenly
from armimp_bringup.study.entry import StudyEntry, study_text
from armimp_bringup.study.figures import figure_title, write_figures
from armimp_bringup.study.report import StudyReport
from armimp_bringup.study.store import (
    CONFIG_FILE,
    RESULTS_DIRECTORY,
    StudyStore,
    write_file,
)
from armimp_bringup.study.verdict import StudyVerdict, judge
from armimp_bringup.terminal import phase, progress
from armimp_estimation.results import OriginSummary

STUDY_FILE = "study.json"
VERDICT_FILE = "verdict.json"
TABLES: Final = {
    STUDY_FILE: "all results",
    "results.csv": "one row for each condition, element and estimator",
    VERDICT_FILE: "worst values and targets",
    "verdict.csv": "the same as a table",
    CONFIG_FILE: "what the results were made with",
    RESULTS_DIRECTORY + "/": "result and curves of each condition",
}


def run_study(
    base: ExperimentConfig,
    conditions: Sequence[Condition],
    directory: Path,
    backend: Backend,
    *,
    figures: bool = True,
    origin: OriginSummary | None = None,
) -> StudyVerdict:
    """Run what is missing of a study, and write its files.

    Parameters
    ----------
    base : ExperimentConfig
        Everything but the levels and the seed.
    conditions : sequence of Condition
        What the study consists of, each once.
    directory : Path
        New, empty, or that of a study with the same configuration, which is completed.
    backend : Backend
        Runs what is missing.
    figures : bool
        Whether to draw those for print; the report is written in any case.
    origin : OriginSummary, optional
        Command line and date, for the report.

    Returns
    -------
    StudyVerdict
        StoppingDecision of the given conditions.

    Raises
    ------
    ConfigurationError
        If something is set wrongly, or the directory holds something else.
    StudyError, DataError
        If the study cannot be run or stored.
    """
    provenance = Provenance.here()
    condition_parameters(
        base, conditions[0]
    )  # what is set wrongly should show before anything is made
    with StudyStore(directory, base, provenance) as store:
        missing = store.missing(conditions)
        stored = len(conditions) - len(missing)
        done = stored
        progress(done, len(conditions), stored, things="conditions")
        if missing:
            batches = [
                Batch(base=base, conditions=part, provenance=provenance)
                for part in split_evenly(missing, backend.workers)
            ]
            for results in backend.run(batches):
                for result in results:
                    store.save(result)
                done += len(results)
                progress(done, len(conditions), stored, things="conditions")
        entries = store.entries(conditions)
        verdict = judge(entries)
        _write_tables(directory, entries, verdict)
        drawn: list[Path] = []
        if figures:
            phase("drawing the figures")
            drawn = write_figures(directory, entries, store.curves)
        phase("writing the report")
        StudyReport(
            entries=entries,
            origin=origin,
            verdict=verdict,
            curves=store.curves,
            files={**TABLES, **{path.name: figure_title(path.name) for path in drawn}},
        ).write(directory)
    return verdict


def _write_tables(directory: Path, entries: Sequence[StudyEntry], verdict: StudyVerdict) -> None:
    write_file(directory / STUDY_FILE, study_text(entries))
    write_file(directory / "results.csv", results_csv(entries))
    write_file(directory / "verdict.csv", verdict_csv(verdict))
    text = verdict.model_dump_json(indent=1, by_alias=True)
    write_file(directory / VERDICT_FILE, f"{text}\n")
