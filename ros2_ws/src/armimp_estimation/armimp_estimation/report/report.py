"""The report of one result."""

from __future__ import annotations

from pathlib import Path

from armimp_estimation.report.curves_part import coherence_section, impedance_section
from armimp_estimation.report.estimates import parameters_section, scores_section
from armimp_estimation.report.html import Html, element, join
from armimp_estimation.report.ledger_part import ledger_section
from armimp_estimation.report.page import Chapter, page
from armimp_estimation.report.result import Result, setting
from armimp_estimation.report.settings_part import assumptions_section, settings_section
from armimp_estimation.report.timing_part import timing_section
from armimp_estimation.report.trials_part import locking_section, traces_section
from armimp_estimation.report.verdict_part import verdict_section
from armimp_estimation.whole_files import write_whole

REPORT_FILE = "report.html"


def report_page(result: Result) -> str:
    """HTML document of a result, valid or not."""
    summary = result.summary
    estimated = bool(summary.estimators)
    chapters: list[Chapter] = [
        ("verdict", "Verdict", verdict_section(result)),
        ("parameters", "M, B, K", parameters_section(summary) if estimated else None),
        ("scores", "Scores", scores_section(summary) if estimated else None),
        ("impedance", "Impedance", impedance_section(result)),
        ("coherence", "Coherence", coherence_section(result)),
        ("locking", "Locking", locking_section(result)),
        ("ledger", "Samples", ledger_section(result)),
        ("timing", "Timing", timing_section(summary)),
        ("traces", "Signals", traces_section(result)),
        ("settings", "Settings", settings_section(result)),
        ("assumptions", "Assumptions", assumptions_section(summary.config)),
    ]
    state = "valid" if summary.valid else "not valid"
    return page(f"{result.name}: arm impedance, {state}", _header(result), chapters)


def write_report(directory: Path, result: Result) -> Path:
    """Write ``report.html``, in place of one that is there.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    DataError
        If it cannot be written.
    """
    path = directory / REPORT_FILE
    text = report_page(result)
    write_whole(path, lambda part: part.write_text(text, encoding="utf-8"), anew=True)
    return path


def _header(result: Result) -> Html:
    joints = ", ".join(result.joint_names)
    return join(
        [
            element("p", "armimp · report of an identification", class_="kicker"),
            element("h1", f"Impedance of {joints}"),
            element("p", _introduction(result)),
        ]
    )


def _introduction(result: Result) -> str:
    summary = result.summary
    count = len(summary.trials)
    facts = [f"Result “{result.name}”", f"{count} trial{'' if count == 1 else 's'}"]
    ticks = {trial.ticks for trial in summary.trials}
    if len(ticks) == 1:
        facts[-1] += f" of {ticks.pop() / 1000:g} s"
    if summary.truth is not None:
        facts.append("simulated")
    for name in ("friction", "resolution", "perturbation"):
        level = setting(summary.config, "experiment", name)
        if isinstance(level, int):
            facts.append(f"{name} level {level}")
    law = setting(summary.config, "imbic_controller", "law.kind")
    if law not in (None, "imbic"):
        facts.append(f"control law {law}")
    if summary.seed is not None:
        facts.append(f"seed {summary.seed}")
    return " · ".join(facts)
