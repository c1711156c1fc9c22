"""The report of one result: its sections and the data for their templates."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from armimp_common import topics
from armimp_common.realtime import LATE_NS
from armimp_estimation.atomic_write import write_text
from armimp_estimation.distortion import Distortion
from armimp_estimation.mbk import MBK
from armimp_estimation.problems import Kind, ProblemCode, Severity, kinds
from armimp_estimation.report.formats import (
    STREAMS,
    alarming,
    mark,
    number,
    setting,
    symbol,
)
from armimp_estimation.report.page import Content, Rows, Section, render_page
from armimp_estimation.report.plots import (
    BAND,
    CONFIDENCE,
    MOTION,
    SIDE_BY_SIDE,
    TORQUE,
    TRUE,
    UNRELATED,
    bode_chart,
    coherence_chart,
    distortion_plot,
    element_plots,
    joint_strokes,
    reference_of,
    strokes,
    trace_plot,
)
from armimp_estimation.result import Result
from armimp_estimation.summary import Summary
from armimp_estimation.verdict import BIAS_BOUND, LOCK_RATIO, SINGLE

REPORT_FILE = "report.html"
_BUCKETS, _FEW_BUCKETS = 1000, 250
"""Buckets of thinned-out signals; fewer if there are many trials, to keep the file small."""


def report_page(result: Result, name: str = "") -> str:
    """Return the HTML document of a result, valid or not, with its name in the title."""
    summary, names = result.summary, result.summary.joint_names
    estimated: Content | None = {} if summary.estimators else None
    known = summary.torque_reading
    settings = {
        "config": summary.config,
        "seed": summary.seed,
        "reading": None if known is None else known.sentence,
        "conditions": False,
    }
    rates = [one.segments[0].rate for one in result.trials if one.segments]
    timing = None if summary.timing is None else {"late": LATE_NS / 1e9}
    excluded = [one for one in result.trials if one.statistics.excluded or one.statistics.clipped]
    sections = [
        Section("verdict", "Verdict", _verdict(result)),
        Section("parameters", "M, B, K", estimated),
        Section("scores", "Scores", _scores(result)),
        Section("impedance", "Impedance", _impedance(result)),
        Section("coherence", "Coherence", _coherence(result)),
        Section("locking", "Locking", _locking(result)),
        Section("distortion", "Distortion", _distortion(result)),
        Section("samples", "Samples", {"excluded": excluded}),
        Section("timing", "Timing", timing),
        Section("signals", "Signals", _signals(result)),
        Section("settings", "Settings", settings),
        Section("assumptions", "Assumptions", assumptions(summary.config)),
    ]
    state = "valid" if summary.valid else "not valid"
    return render_page(
        f"{name}: arm impedance, {state}",
        "report/run_header.html",
        sections,
        name=name,
        summary=summary,
        names=names,
        elements=list(np.ndindex(summary.joints, summary.joints)),
        LOCK_RATIO=LOCK_RATIO,
        BIAS_BOUND=BIAS_BOUND,
        held=lambda met: _held(summary, met),
        title_of=lambda one: f"Trial {one.trial}: {names[one.joint]} perturbed",
        noted=lambda count: alarming(count) if count else 0,
        STREAMS=STREAMS,
        COMMANDS=topics.COMMANDS,
        rate=rates[0] if rates else 1e9 / topics.PERIOD_NS,
        DEGREE=180.0 / math.pi,
    )


def write_report(directory: Path, result: Result) -> Path:
    """Write ``report.html``, replacing an existing one, and return its path.

    Raises
    ------
    DataError
        If it cannot be written.
    """
    path = directory / REPORT_FILE
    write_text(path, report_page(result, directory.absolute().name))
    return path


def _verdict(result: Result) -> Content:
    summary = result.summary
    count = len(summary.faults)
    problems = f"Not valid: {count} problem{'' if count == 1 else 's'}"
    return {
        "valid": summary.valid,
        "joints": summary.joints,
        "complete": not any(trial.lost for trial in summary.trials),
        "still": all(ratio <= LOCK_RATIO for ratio in _locks(summary).values()),
        "title": "Valid" if summary.valid else problems,
        "problems": advised((one.code, one.sentence) for one in summary.faults),
        "notes": [
            *result.notes,
            *(one.sentence for one in summary.problems if one.severity is Severity.NOTE),
            *(f"refused: {one}" for one in summary.refusals),
        ],
        "limits": _limits(result) if summary.estimators else None,
    }


def _locks(summary: Summary) -> dict[object, float]:
    """Motion of each locked joint relative to the perturbed one, by a description of the pair."""
    names = summary.joint_names
    return {
        f"{name}, while {names[trial.k - 1]} is perturbed": trial.lock_ratio[i]
        for trial in summary.trials
        for i, name in enumerate(names)
        if i != trial.k - 1
    }


def _held(summary: Summary, met: bool) -> object:
    """Write whether a limit for locked joints is met, or that full matrices don't need that."""
    if met or SINGLE in summary.deciding:
        return mark(met)
    return f"not needed by {', '.join(summary.deciding)}"


def advised(problems: Iterable[tuple[ProblemCode, str]]) -> list[tuple[Kind, list[str]]]:
    """Group problems, given by code and sentence, by their kind, which has the advice.

    Kinds are in the order of their first problem; numbers and per cent signs stay on one line.
    """
    groups: dict[str, tuple[Kind, list[str]]] = {}
    for code, sentence in problems:
        kind = kinds()[code]
        whole = sentence.replace(" %", "\N{NO-BREAK SPACE}%")
        groups.setdefault(kind.title, (kind, []))[1].append(whole)
    return list(groups.values())


def _limits(result: Result) -> Rows:
    """Rows with the worst value of each score, its limit, whether that is met, and the place."""
    summary, names = result.summary, result.summary.joint_names
    judged = max(summary.estimators.values(), key=lambda one: one.decides)
    coherences: dict[object, float] = {}
    bounds: dict[object, float] = {}
    lacks: dict[object, float] = {}
    for k, name in enumerate(names):
        coherences[f"angle, {name} perturbed"] = judged.coherence_motion[k]
        coherences[f"torque of {name}, {name} perturbed"] = judged.coherence_torque[k][k]
    locks = {place: 100.0 * ratio for place, ratio in _locks(summary).items()}
    for trial in summary.trials if summary.joints > 1 else ():
        for i, bound in enumerate(trial.bias_bound):
            bounds[symbol("Z", i + 1, trial.k)] = 100.0 * bound
    for i, k in np.ndindex(summary.joints, summary.joints):
        lacks[symbol("Z", i + 1, k + 1)] = judged.lack_of_fit[i][k]
    rows: Rows = []
    scores: tuple[tuple[str, dict[object, float], float, str, float], ...] = (
        ("motion of held joints (%)", locks, 100.0 * LOCK_RATIO, ".2f", 1.0),
        ("bias that this may cause (%)", bounds, 100.0 * BIAS_BOUND, ".2f", 1.0),
        ("coherence with perturbation", coherences, judged.coherence_limit, ".4f", -1.0),
        ("lack of fit", lacks, judged.lack_limit, ".2f", 1.0),
    )
    for title, found, limit, spec, sign in scores:
        if not found:
            continue
        # Written so that NaN is the worst value and beyond every limit.
        off = {place: math.inf if math.isnan(v) else sign * v for place, v in found.items()}
        where = max(off, key=lambda place: off[place])
        text = f"{'≤' if sign > 0.0 else '≥'} {number(limit, spec)}"
        met = off[where] <= sign * limit
        verdict = mark(met) if found is coherences or found is lacks else _held(summary, met)
        rows.append([title, number(found[where], spec), text, verdict, where])
    lost = sum(trial.lost for trial in summary.trials)
    verdict = "left out" if lost and summary.valid else mark(not lost)
    silent = any(trial.without_commands for trial in summary.trials)
    rows.append(["lost samples", lost, "0", verdict, "commands not recorded" if silent else ""])
    return rows


def _scores(result: Result) -> Content | None:
    if not result.summary.estimators:
        return None
    return {"realised": [one for one in result.summary.trials if math.isfinite(one.realisation)]}


def _impedance(result: Result) -> Content | None:
    curves, n = result.curves, result.summary.joints
    if not curves:
        return None
    truth = result.summary.truth
    switches = [*strokes(curves).values(), CONFIDENCE, *([] if truth is None else [TRUE])]
    reference = reference_of(curves, truth)
    return {
        "switches": switches,
        "reference": reference or "the truth",
        "joints": n,
        "plots": element_plots("bode", n, lambda i, k: bode_chart(curves, truth, i, k), 500),
    }


def _coherence(result: Result) -> Content | None:
    n, level = result.summary.joints, result.significance
    if level is None:
        return None
    return {
        "key": [
            replace(MOTION, name=f"{MOTION.name} of the perturbed joint"),
            TORQUE,
            replace(UNRELATED, name=f"{UNRELATED.name} {level:.2f} (95 %)"),
        ],
        "switches": list(strokes(result.curves).values()),
        "joints": n,
        "averages": result.averages,
        "plots": element_plots("coherence", n, lambda i, k: coherence_chart(result, i, k), 250),
    }


def _locking(result: Result) -> Content | None:
    """List the trials that have lock ratios."""
    scored = [trial for trial in result.summary.trials if not np.isnan(trial.lock_ratio).all()]
    return {"trials": scored} if scored and result.summary.joints > 1 else None


def _distortion(result: Result) -> Content | None:
    """Distortion in trials with a periodic perturbation, apart from the fitted arm's response."""
    summary = result.summary
    if not summary.estimators:
        return None
    fitted = max(summary.estimators.values(), key=lambda one: one.decides)
    arm = MBK(M=np.array(fitted.M), B=np.array(fitted.B), K=np.array(fitted.K))
    changes = {one.k - 1: one.stiffness_changes for one in summary.trials}
    trials = [
        (one, found, changes[one.joint])
        for one in result.trials
        if one.record is not None and (found := Distortion.of(one.record, arm)) is not None
    ]
    if not trials:
        return None
    plots = [distortion_plot(found, one.trial) for one, found, _ in trials]
    return {"trials": trials, "plots": plots, "joints": min(len(plots), SIDE_BY_SIDE)}


def _signals(result: Result) -> Content:
    """Plot the signals of every trial."""
    shown = [one for one in result.trials if one.segments]
    buckets = _BUCKETS if result.summary.joints <= SIDE_BY_SIDE else _FEW_BUCKETS
    plots = [trace_plot(f"trace-{n}", one, buckets) for n, one in enumerate(shown, 1)]
    return {
        "key": joint_strokes(result.summary.joint_names),
        "band": f"{BAND:g}",
        "trials": list(zip(shown, plots, strict=True)),
    }


def assumptions(config: Mapping[str, Any], *, friction: str | None = None) -> Content | None:
    """Assumptions of the simulation; None if nothing is known to be simulated.

    The configuration may have any structure. `friction` describes the levels if there are several.
    """
    if setting(config, "experiment") is None or setting(config, "arm_sim") is None:
        return None
    return {
        "joints": setting(config, "experiment", "joints"),
        "friction": friction or f"level {setting(config, 'experiment', 'friction')}",
    }
