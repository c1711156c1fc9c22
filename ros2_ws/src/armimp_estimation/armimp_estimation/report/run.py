"""The report of one result: its sections, and the data that their templates are filled with."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
from markupsafe import Markup

from armimp_common import topics
from armimp_common.realtime import LATE_NS
from armimp_estimation.alignment.assemble import Trial
from armimp_estimation.atomic_write import write_text
from armimp_estimation.distortion import Distortion
from armimp_estimation.mbk import MBK
from armimp_estimation.nonlinearity import deviations
from armimp_estimation.problems import Kind, ProblemCode, kind_of
from armimp_estimation.report.formats import (
    STREAMS,
    alarming,
    mark,
    number,
    symbol,
)
from armimp_estimation.report.look import joint_colour, strokes
from armimp_estimation.report.page import Content, Section, Table, box, render_page
from armimp_estimation.report.plots import BANDS, Plot
from armimp_estimation.report.result_plots import (
    BAND,
    PERIOD,
    SIDE_BY_SIDE,
    TRUTH,
    bode_plot,
    coherence_plot,
    distortion_plot,
    plot_matrix,
    reference_of,
    trace_plot,
    trace_views,
)
from armimp_estimation.report.settings import assumptions_content, configuration, identity
from armimp_estimation.result import Result
from armimp_estimation.verdict import Limits

REPORT_FILE = "report.html"
_LIMITS = Limits()
_FEW_BUCKETS = 250
"""Parts of thinned signals where many trials share a plot, so that the file stays small."""


def report_page(result: Result) -> str:
    """Return the HTML document of a result, valid or not."""
    summary, names = result.summary, result.joint_names
    estimated: Content | None = {} if summary.estimators else None
    known = summary.torque_reading
    settings = {
        "identity": identity(summary.config, summary.seed) if summary.config else None,
        "reading": None if known is None else known.sentence,
        "conditions": False,
        "tables": configuration(summary.config),
    }
    timing = None if summary.timing is None else {"late": LATE_NS / 1e9}
    excluded = [one for one in result.trials if one.statistics.excluded or one.statistics.clipped]
    found: list[tuple[str, str, Content | None]] = [
        ("verdict", "Verdict", _verdict(result)),
        ("parameters", "M, B, K", estimated),
        ("scores", "Scores", _scores(result)),
        ("impedance", "Impedance", _impedance(result)),
        ("coherence", "Coherence", _coherence(result)),
        ("locking", "Locking", _locking(result)),
        ("distortion", "Distortion", _distortion(result)),
        ("samples", "Samples", {"excluded": excluded}),
        ("timing", "Timing", timing),
        ("signals", "Signals", _signals(result)),
        ("settings", "Settings", settings),
        ("assumptions", "Assumptions", assumptions_content(summary.config)),
    ]
    state = "valid" if summary.valid else "not valid"
    return render_page(
        f"{result.name}: arm impedance, {state}",
        "report/run_header.html",
        [
            Section(identifier=name, title=title, template=f"report/{name}.html", content=content)
            for name, title, content in found
        ],
        result=result,
        summary=summary,
        names=names,
        elements=list(np.ndindex(summary.joints, summary.joints)),
        limits=_LIMITS,
        title_of=lambda one: _title(result, one),
        noted=lambda count: alarming(count) if count else 0,
        STREAMS=STREAMS,
        COMMANDS=topics.COMMANDS,
        PERIOD=PERIOD,
        DEGREE=180.0 / math.pi,
    )


def write_report(directory: Path, result: Result) -> Path:
    """Write ``report.html``, in place of one that is there, and return its path.

    Raises
    ------
    DataError
        If it cannot be written.
    """
    path = directory / REPORT_FILE
    write_text(path, report_page(result))
    return path


def _title(result: Result, one: Trial) -> str:
    """Return the title of a trial, whose bag and summary may not agree on the joints."""
    joint, names = one.window.joint, result.joint_names
    name = names[joint] if joint < len(names) else f"joint {joint + 1}"
    return f"Trial {one.trial}: {name} perturbed"


def _verdict(result: Result) -> Content:
    summary = result.summary
    count = len(summary.faults)
    problems = f"Not valid: {count} problem{'' if count == 1 else 's'}"
    return {
        "valid": summary.valid,
        "joints": summary.joints,
        "title": "Valid" if summary.valid else problems,
        "problems": advised((one.code, one.sentence) for one in summary.faults),
        "notes": result.notes,
        "limits": _limits_table(result) if summary.estimators else None,
    }


def advised(problems: Iterable[tuple[ProblemCode, str]]) -> list[tuple[Kind, list[str]]]:
    """Sort problems, given by code and sentence, by what there is to do about them.

    Kinds are in the order of the first problem of each; numbers and their units stay on one line.
    """
    kinds: dict[str, tuple[Kind, list[str]]] = {}
    for code, sentence in problems:
        kind = kind_of(code)
        whole = sentence.replace(" %", "\N{NO-BREAK SPACE}%")
        kinds.setdefault(kind.title, (kind, []))[1].append(whole)
    return list(kinds.values())


def _limits_table(result: Result) -> Table:
    summary, names = result.summary, result.joint_names
    first = next(iter(summary.estimators.values()))
    rows: list[list[object]] = []

    def add(
        title: str,
        found: Iterable[tuple[float, object]],
        limit: float | None = None,
        spec: str = ".4f",
        unit: str = "",
        *,
        ceiling: bool = False,
    ) -> None:
        """Add a row with the worst of some values and where it was found; NaN is the worst."""
        sign = 1.0 if ceiling else -1.0
        known = list(found)
        if not known:
            return
        value, where = max(known, key=lambda one: math.inf if math.isnan(one[0]) else sign * one[0])
        bound: str = ""
        verdict: object = "not judged"
        if limit is not None:
            bound = f"{'≤' if ceiling else '≥'} {number(limit, spec, unit).rstrip()}"
            verdict = mark(sign * value <= sign * limit)
        rows.append([title, number(value, spec, unit), bound, verdict, where])

    def elements(field: str, *only: str) -> Iterator[tuple[float, object]]:
        for name in only or summary.estimators:
            one = summary.estimators[name]
            for i, row in enumerate(getattr(one, field) or []):
                for k, value in enumerate(row):
                    yield value, Markup("{}, {}").format(symbol("Z", i + 1, k + 1), name)

    if summary.joints > 1:
        locks = [
            (100.0 * ratio, f"{names[i]}, while {names[trial.k - 1]} is perturbed")
            for trial in summary.trials
            for i, ratio in enumerate(trial.lock_ratio)
            if i != trial.k - 1
        ]
        bounds = [
            (100.0 * bound, symbol("Z", i + 1, trial.k))
            for trial in summary.trials
            for i, bound in enumerate(trial.bias_bound)
        ]
        limits = 100.0 * _LIMITS.lock_ratio, 100.0 * _LIMITS.bias_bound
        add("motion of held joints", locks, limits[0], ".2f", "%", ceiling=True)
        add("bias that this may cause", bounds, limits[1], ".2f", "%", ceiling=True)
    coherent = [(v, f"angle, {names[k]} perturbed") for k, v in enumerate(first.coherence_motion)]
    coherent += [
        (value, f"torque of {names[i]}, {names[k]} perturbed")
        for i, row in enumerate(first.coherence_torque)
        for k, value in enumerate(row)
    ]
    add("coherence with perturbation", coherent, result.significance)
    # Of estimators with known biases, these are part of the misfit.
    if (judged := summary.estimators.get("lpm_full")) is not None:
        lacks = elements("lack_of_fit", "lpm_full")
        add("lack of fit", lacks, judged.lack_limit, ".2f", ceiling=True)
    add("derived coherence", elements("coherence_derived"))
    add("R² of the fit", elements("r2"))
    add("VAF (simulation)", elements("vaf"), spec=".2f", unit="%")
    lost = sum(trial.lost for trial in summary.trials)
    rows.append(["lost samples", lost, "0", mark(not lost), ""])
    return Table(
        caption="Worst values and limits",
        columns=["quantity", "worst", "limit", "verdict", "where"],
        groups=[(None, rows)],
        words=(3, 4),
    )


def _scores(result: Result) -> Content | None:
    if not result.summary.estimators:
        return None
    return {"realised": [one for one in result.summary.trials if math.isfinite(one.realisation)]}


def _switches(names: Iterable[str]) -> list[Content]:
    return [
        box(stroke.tags[0], stroke.name, stroke.colour, stroke.dash)
        for stroke in strokes(names).values()
    ]


def _impedance(result: Result) -> Content | None:
    curves, n = result.curves, result.summary.joints
    if not curves:
        return None
    truth = result.summary.truth
    switches = [*_switches(curves), box(BANDS, "95 % confidence bands", "--rule", width=9)]
    if truth is not None:
        switches.append(box(TRUTH, "truth (simulation)", "--ink", "dot"))
    reference = reference_of(curves, truth)
    return {
        "switches": switches,
        "reference": reference or "the truth",
        "joints": n,
        "plots": plot_matrix(n, lambda i, k: bode_plot(curves, truth, i, k)),
    }


def _coherence(result: Result) -> Content | None:
    curves, n, level = result.curves, result.summary.joints, result.significance
    if level is None:
        return None
    return {
        "key": [
            box("", "perturbation → angle of the perturbed joint", "--signal-0"),
            box("", "perturbation → torque", "--signal-1"),
            box("", f"unrelated signals stay below {level:.2f} (95 %)", "--soft", "dot", 2),
        ],
        "switches": _switches(curves),
        "joints": n,
        "averages": result.averages,
        "plots": plot_matrix(
            n, lambda i, k: coherence_plot(curves, i, k, result.joint_names, level)
        ),
    }


def _locking(result: Result) -> Content | None:
    """List trials with scores of locking, and the rms motion of all joints in each, degrees."""
    scored = [trial for trial in result.summary.trials if not np.isnan(trial.lock_ratio).all()]
    if not scored or result.summary.joints == 1:
        return None
    records = {one.window.joint: one.record for one in reversed(result.trials)}
    motions = []
    for trial in scored:
        record = records.get(trial.k - 1)
        unknown = np.full(result.summary.joints, np.nan)
        motion = unknown if record is None else np.degrees(np.std(record.position, axis=1))
        motions.append(motion.tolist())
    return {"trials": list(zip(scored, motions, strict=True))}


def _distortion(result: Result) -> Content | None:
    """What periodic perturbations show of each trial beside the fitted arm."""
    summary = result.summary
    if not summary.estimators:
        return None
    fitted = summary.estimators.get("lpm_full") or next(iter(summary.estimators.values()))
    arm = MBK(M=np.array(fitted.M), B=np.array(fitted.B), K=np.array(fitted.K))
    trials = []
    for one in result.trials:
        record = one.record
        found = None if record is None else Distortion.of(record, arm)
        if record is None or found is None:
            continue
        changes = deviations(record, arm)
        trials.append((one, found, changes.get("amplitude"), changes.get("time")))
    if not trials:
        return None
    plots = [distortion_plot(found, one.trial) for one, found, *_ in trials]
    return {"trials": trials, "plots": plots, "joints": len(plots)}


def _signals(result: Result) -> Content:
    """Plot the signals of all trials: each for itself, or with many joints all in one plot."""
    shown = [one for one in result.trials if one.segments]
    signals = "Perturbation, angles, torques and commands of"
    plots: list[Plot | None] = [None] * len(shown)
    together = None
    if result.summary.joints <= SIDE_BY_SIDE:
        plots = [
            trace_plot(f"trace-{place}", f"{signals} trial {one.trial}.", trace_views(one))
            for place, one in enumerate(shown, 1)
        ]
    elif shown:
        views = [
            view
            for one in shown
            for view in trace_views(one, f"{_title(result, one)}, ", _FEW_BUCKETS)
        ]
        together = trace_plot("traces-all", f"{signals} all trials.", views)
    return {
        "key": [
            box("", name, joint_colour(joint)) for joint, name in enumerate(result.joint_names)
        ],
        "band": f"{BAND:g}",
        "trials": list(zip(shown, plots, strict=True)),
        "plot": together,
    }
