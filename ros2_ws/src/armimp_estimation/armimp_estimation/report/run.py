"""The report of one result: what its templates are filled with."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from armimp_common import topics
from armimp_common.realtime import LATE_NS
from armimp_common.topics import NS_PER_S, PERIOD_NS
from armimp_estimation.alignment.assemble import AssembledTrial
from armimp_estimation.atomic_write import write_whole
from armimp_estimation.json_model import Matrix
from armimp_estimation.report.advice import advise
from armimp_estimation.report.curves import coherence_curves
from armimp_estimation.report.formats import (
    NAMES,
    NONE,
    STREAMS,
    UNITS,
    alarming,
    code,
    difference,
    mark,
    number,
    percent,
    symbol,
    uncertain,
    written,
)
from armimp_estimation.report.frequency_plots import (
    BANDS,
    SIDE_BY_SIDE,
    TRUTH,
    bode_plot,
    coherence_plot,
    estimator_tag,
    plot_matrix,
    reference_of,
)
from armimp_estimation.report.look import joint_variable, looks
from armimp_estimation.report.plots import View
from armimp_estimation.report.provenance import ASSUMPTION, assumptions, origin
from armimp_estimation.report.render import Group, Section, Table, render_page
from armimp_estimation.report.result import Result, setting
from armimp_estimation.report.traces import BAND, trace_plot, trace_views
from armimp_estimation.results import EstimatorSummary, Summary, TrialSummary
from armimp_estimation.verdict import Limits

REPORT_FILE = "report.html"
_PERIOD = PERIOD_NS / NS_PER_S
_LIMITS = Limits()
_FEW_BUCKETS = 250
"""Parts of thinned signals where many trials share a plot, so that the file stays small."""

Content = dict[str, Any]


def report_page(result: Result) -> str:
    """HTML document of a result, valid or not."""
    summary = result.summary
    found: list[tuple[str, str, str, Content | None]] = [
        ("verdict", "Verdict", "verdict", _verdict(result)),
        ("parameters", "M, B, K", "parameters", _parameters(summary)),
        ("scores", "Scores", "scores", _scores(summary)),
        ("impedance", "Impedance", "impedance", _impedance(result)),
        ("coherence", "Coherence", "coherence", _coherence(result)),
        ("locking", "Locking", "locking", _locking(result)),
        ("ledger", "Samples", "samples", _samples(result)),
        ("timing", "Timing", "timing", _timing(summary)),
        ("traces", "Signals", "signals", _signals(result)),
        ("settings", "Settings", "settings", _settings(summary)),
        ("assumptions", "Assumptions", "assumptions", assumptions_content(summary.config)),
    ]
    sections = [
        Section(identifier=name, title=title, template=f"report/{template}.html", content=content)
        for name, title, template, content in found
        if content is not None
    ]
    state = "valid" if summary.valid else "not valid"
    return render_page(
        f"{result.name}: arm impedance, {state}",
        "report/run_header.html",
        sections,
        result=result,
        introduction=_introduction(result),
        origin=summary.origin,
    )


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


# --- verdict -----------------------------------------------------------------------------------


def _verdict(result: Result) -> Content:
    summary = result.summary
    count = len(summary.problems)
    return {
        "valid": summary.valid,
        "joints": summary.joints,
        "title": "Valid"
        if summary.valid
        else f"Not valid: {count} problem{'' if count == 1 else 's'}",
        "problems": advised(summary.problems),
        "notes": result.notes,
        "limits": _limits_table(result) if summary.estimators else None,
    }


def advised(problems: Iterable[str]) -> list[tuple[object, list[str]]]:
    """Problems by what there is to do about them; a number and its unit stay on one line."""
    return [
        (advice, [sentence.replace(" %", "\N{NO-BREAK SPACE}%") for sentence in sentences])
        for advice, sentences in advise(problems)
    ]


@dataclass(frozen=True, kw_only=True)
class _Value:
    """A value, and where it was found."""

    value: float
    where: object

    def badness(self, sign: float) -> float:
        """What is not a number is worse than any number."""
        return math.inf if math.isnan(self.value) else sign * self.value


def _limits_table(result: Result) -> Table:
    summary, names, level = result.summary, result.joint_names, result.significance
    estimators = summary.estimators
    first = next(iter(estimators.values()))
    label = {name: look.label for name, look in looks(estimators).items()}
    locks = [
        _Value(value=ratio, where=f"{names[i]}, while {names[trial.k - 1]} is perturbed")
        for trial in summary.trials
        for i, ratio in enumerate(trial.lock_ratio)
        if i != trial.k - 1
    ]
    bounds = [
        _Value(value=bound, where=symbol("Z", i + 1, trial.k))
        for trial in summary.trials
        for i, bound in enumerate(trial.bias_bound)
    ]
    coherent = [
        _Value(value=value, where=f"angle, {names[k]} perturbed")
        for k, value in enumerate(first.coherence_motion)
    ]
    coherent += [
        _Value(value=value, where=f"torque of {names[i]}, {names[k]} perturbed")
        for i, row in enumerate(first.coherence_torque)
        for k, value in enumerate(row)
    ]

    def elements(field: str, only: str | None = None) -> list[_Value]:
        return [
            _Value(value=v, where=Markup("{}, {}").format(symbol("Z", i + 1, k + 1), label[name]))
            for name, one in estimators.items()
            if only in (None, name)
            for i, row in enumerate(getattr(one, field) or [])
            for k, v in enumerate(row)
        ]

    rows: list[list[object]] = []

    def add(
        name: str, found: Sequence[_Value], form: Any, limit: float | None, sign: float
    ) -> None:
        if found:
            worst = max(found, key=lambda one: one.badness(sign))
            met = None if limit is None else sign * worst.value <= sign * limit
            relation = "≤" if sign > 0.0 else "≥"
            bound = "" if limit is None else f"{relation} {form(limit).rstrip()}"
            verdict = "not judged" if met is None else mark(met)
            rows.append([name, form(worst.value), bound, verdict, worst.where])

    def plain_number(value: float) -> str:
        return number(value, ".4f")

    held = locks if summary.joints > 1 else []
    add("motion of held joints", held, percent, _LIMITS.lock_ratio, 1.0)
    add("bias that this may cause", bounds if held else [], percent, _LIMITS.bias_bound, 1.0)
    add("coherence with perturbation", coherent, plain_number, level, -1.0)
    # Of estimators with known biases, these are part of the misfit.
    judged = next((one for name, one in estimators.items() if name == "lpm_full"), None)
    lacks = [] if judged is None else elements("lack_of_fit", "lpm_full")
    limit = None if judged is None else judged.lack_limit
    add("lack of fit", lacks, lambda v: number(v, ".2f"), limit, 1.0)
    add("derived coherence", elements("coherence_derived"), plain_number, None, -1.0)
    add("R² of the fit", elements("r2"), plain_number, None, -1.0)
    add("VAF (simulation)", elements("vaf"), lambda v: number(v, ".2f", "%"), None, -1.0)
    lost = sum(trial.lost for trial in summary.trials)
    rows.append(["lost samples", lost, "0", mark(not lost), ""])
    return Table(
        caption="Worst values and limits",
        columns=["quantity", "worst", "limit", "verdict", "where"],
        groups=[Group(rows=rows)],
        words=(3, 4),
    )


# --- estimates ---------------------------------------------------------------------------------


def _parameters(summary: Summary) -> Content | None:
    if not summary.estimators:
        return None
    found = looks(summary.estimators)
    return {
        "table": _parameter_table(summary),
        "remarks": [look for look in found.values() if look.remark],
    }


def _parameter_table(summary: Summary) -> Table:
    known = summary.truth is not None
    columns: list[object] = ["element"]
    spans: list[tuple[object, int]] = [("", 1)]
    if known:
        columns.append("true value")
        spans.append(("Simulation", 1))
    for look in looks(summary.estimators).values():
        columns += ["estimate ± s.e.", "95 % interval", "error" if known else "relative s.e."]
        spans.append((look.label, 3))
    groups = [
        Group(
            title=Markup("{} {} ({})").format(NAMES[letter], symbol(letter), UNITS[letter]),
            rows=list(_parameter_rows(summary, letter)),
        )
        for letter in ("M", "B", "K")
    ]
    return Table(caption="Estimates", columns=columns, groups=groups, spans=spans)


def _parameter_rows(summary: Summary, letter: str) -> Iterator[list[object]]:
    for i, k in np.ndindex(summary.joints, summary.joints):
        cells: list[object] = [symbol(letter, i + 1, k + 1)]
        true = None
        if summary.truth is not None:
            true = float(getattr(summary.truth, letter)[i][k])
            cells.append(number(true, ".5g"))
        for one in summary.estimators.values():
            value = float(getattr(one, letter)[i][k])
            error = float(getattr(one, f"{letter}_se")[i][k])
            ends = getattr(one, f"{letter}_ci")[i][k]
            cells += [uncertain(value, error), " to ".join(number(end, "#.4g") for end in ends)]
            if true is not None:
                cells.append(difference(value, true))
            else:
                cells.append(percent(abs(error / value)) if value else NONE)
        yield cells


def _scores(summary: Summary) -> Content | None:
    if not summary.estimators:
        return None

    def gamma(kind: str) -> Markup:
        return Markup("<var>γ</var>² {}").format(kind)

    def of_estimator(one: EstimatorSummary) -> list[tuple[object, Matrix, str]]:
        found: list[tuple[object, Matrix, str]] = []
        if one.vaf is not None:
            found.append(("VAF %", one.vaf, ".2f"))
        return [
            *found,
            ("R²", one.r2, ".4f"),
            ("lack of fit", one.lack_of_fit, ".2f"),
            (gamma("derived"), one.coherence_derived, ".4f"),
        ]

    groups = [
        (look.label, of_estimator(summary.estimators[name]))
        for name, look in looks(summary.estimators).items()
    ]
    # No matter of the estimator, so once is enough.
    first = next(iter(summary.estimators.values()))
    groups.append(("Signals", [(gamma("torque"), first.coherence_torque, ".4f")]))
    scores = [score for _, members in groups for score in members]
    rows = [
        [symbol("Z", i + 1, k + 1), *(number(values[i][k], spec) for _, values, spec in scores)]
        for i, k in np.ndindex(summary.joints, summary.joints)
    ]
    table = Table(
        caption="Scores of the elements",
        columns=["element", *(title for title, _, _ in scores)],
        groups=[Group(rows=rows)],
        spans=[("", 1), *((label, len(members)) for label, members in groups)],
    )
    return {"table": table, "known": summary.truth is not None}


# --- curves ------------------------------------------------------------------------------------


def box(tag: str, label: str, colour: str, style: str = "solid", width: int = 3) -> Content:
    """Control that switches what carries a tag, or entry of a key, drawn like its lines."""
    css = {"solid": "solid", "dot": "dotted"}.get(style, "dashed")
    return {"tag": tag, "label": label, "colour": f"var({colour})", "style": css, "width": width}


def _switches(names: Iterable[str]) -> list[Content]:
    return [
        box(estimator_tag(look.name), look.label, look.variable, look.dash)
        for look in looks(names).values()
    ]


def _impedance(result: Result) -> Content | None:
    if not result.curves:
        return None
    truth = result.summary.truth
    known = None if truth is None else truth.mbk()
    switches = [*_switches(result.curves), box(BANDS, "95 % confidence bands", "--rule", width=9)]
    if known is not None:
        switches.append(box(TRUTH, "truth (simulation)", "--ink", "dot"))
    reference = reference_of(result.curves, known)
    n = result.summary.joints
    return {
        "switches": switches,
        "reference": looks([reference])[reference].label if reference else "the truth",
        "joints": n,
        "plots": plot_matrix(n, lambda i, k: bode_plot(result.curves, known, i, k)),
    }


def _coherence(result: Result) -> Content | None:
    level = result.significance
    if level is None:
        return None
    n = result.summary.joints
    curves = coherence_curves(result.curves, n)
    levels = [(f"unrelated signals stay below {level:.2f} (95 %)", level, "dot")]
    signals = [
        box("", "perturbation → angle of the perturbed joint", "--signal-0"),
        box("", "perturbation → torque", "--signal-1"),
    ]
    return {
        "key": [*signals, *(box("", name, "--soft", dash, 2) for name, _, dash in levels)],
        "switches": _switches(result.curves),
        "joints": n,
        "averages": result.averages,
        "plots": plot_matrix(
            n,
            lambda i, k: coherence_plot(
                curves[i, k], i, k, joint_names=result.joint_names, levels=levels
            ),
        ),
    }


# --- trials ------------------------------------------------------------------------------------


def _joint(result: Result, joint: int) -> str:
    """Name of a joint (1-based), for which bags and summary may not agree."""
    names = result.joint_names
    return names[joint - 1] if 0 < joint <= len(names) else f"joint {joint}"


def _trial_title(result: Result, one: AssembledTrial) -> str:
    return f"Trial {one.trial}: {_joint(result, one.window.joint + 1)} perturbed"


def _locking(result: Result) -> Content | None:
    scored = [trial for trial in result.summary.trials if not np.isnan(trial.lock_ratio).all()]
    if not scored or result.summary.joints == 1:
        return None
    groups = [
        Group(title=f"{_joint(result, trial.k)} perturbed", rows=list(_locking_rows(result, trial)))
        for trial in scored
    ]
    table = Table(
        caption="Motion in each trial",
        columns=[
            "joint",
            "motion (rms)",
            "relative",
            "verdict",
            "element",
            "bias bound",
            "verdict",
        ],
        groups=groups,
        words=(3, 4, 6),
    )
    return {"table": table}


def _locking_rows(result: Result, trial: TrialSummary) -> Iterator[list[object]]:
    evidence = next((one for one in result.trials if one.window.joint == trial.k - 1), None)
    record = None if evidence is None else evidence.record
    for i, (ratio, bound) in enumerate(zip(trial.lock_ratio, trial.bias_bound, strict=True)):
        perturbed = i == trial.k - 1
        motion = math.nan if record is None else float(np.degrees(np.std(record.position[i])))
        yield [
            _joint(result, i + 1),
            number(motion, ".3g", "°"),
            "perturbed" if perturbed else percent(ratio, ".3f"),
            "" if perturbed else mark(ratio <= _LIMITS.lock_ratio),
            symbol("Z", i + 1, trial.k),
            percent(bound),
            mark(bound <= _LIMITS.bias_bound),
        ]


def _samples(result: Result) -> Content:
    if not result.trials:
        rows: list[list[object]] = [
            [f"trial of {_joint(result, trial.k)}", trial.ticks, trial.lost]
            for trial in result.summary.trials
        ]
        table = Table(
            caption="Samples", columns=["trial", "samples", "lost"], groups=[Group(rows=rows)]
        )
        return {"table": table, "bags": False, "excluded": None}
    table = Table(
        caption="Messages of each stream",
        columns=[
            *("stream", "expected", "received", "lost"),
            *("duplicated", "contradictory", "reordered", "late"),
        ],
        groups=[
            Group(title=_trial_title(result, one), rows=list(_streams(one)))
            for one in result.trials
        ],
    )
    return {"table": table, "bags": True, "excluded": _exclusions(result)}


def _streams(one: AssembledTrial) -> Iterator[list[object]]:
    for topic, count in one.ledger.streams.items():
        stamped = topic != topics.COMMANDS
        name = STREAMS.get(topic, topic)
        yield [
            Markup('{}<span class="aside"> {}</span>').format(name, code(topic)),
            count.expected,
            count.received,
            _noted(count.lost),
            *(
                _noted(found) if stamped else NONE
                for found in (count.duplicated, count.contradictory, count.reordered, count.late)
            ),
        ]


def _exclusions(result: Result) -> Table | None:
    """What no estimate uses, and why; nothing if all is used."""
    rows: list[list[object]] = []
    for one in result.trials:
        ledger = one.ledger
        if ledger.excluded or ledger.clipped:
            longest = max((part.samples for part in one.segments), default=0)
            rows.append(
                [
                    _trial_title(result, one),
                    ledger.clipped,
                    _noted(ledger.excluded),
                    percent(ledger.excluded_share),
                    ledger.stretches,
                    f"{longest * _PERIOD:.3f} s",
                    one.problem or "clipped commands",
                ]
            )
    if not rows:
        return None
    return Table(
        caption="Left out of all estimates",
        columns=["trial", "clipped", "samples", "share", "parts left", "longest", "why"],
        groups=[Group(rows=rows)],
        words=(6,),
    )


def _noted(count: int) -> object:
    return alarming(count) if count else 0


def _timing(summary: Summary) -> Content | None:
    """How regular samples were, and how quickly commands came; None for a run in lockstep."""
    timing = summary.timing
    if timing is None:
        return None
    ticks = max(timing.ticks, 1)
    period = (timing.period_p50, timing.period_p99, timing.period_max)
    latency = (timing.latency_p50, timing.latency_p99, timing.latency_max)
    spreads: list[list[object]] = [
        ["time between samples", *map(_milliseconds, period), "", ""],
        [
            "from a sample to its command",
            *map(_milliseconds, latency),
            f"99 % ≤ {_milliseconds(timing.max_latency)}",
            mark(timing.latency_p99 <= timing.max_latency),
        ],
    ]
    counts: list[list[object]] = [
        [what, count, percent(share, ".3f"), f"≤ {percent(limit)}", mark(share <= limit)]
        for what, count, limit in (
            ("samples sent late", timing.late, timing.max_late_share),
            ("commands not in time", timing.missed, timing.max_missed_share),
        )
        for share in (count / ticks,)
    ]
    return {
        "timing": timing,
        "late": _milliseconds(LATE_NS / 1e9),
        "jitter": Table(
            caption="Jitter",
            columns=["duration", "median", "99 %", "longest", "limit", "verdict"],
            groups=[Group(rows=spreads)],
            words=(5,),
        ),
        "counts": Table(
            caption="Late and missed",
            columns=["what", "count", "share", "limit", "verdict"],
            groups=[Group(rows=counts)],
            words=(4,),
        ),
    }


def _milliseconds(seconds: float) -> str:
    return number(1e3 * seconds, ".3f", "ms")


def _signals(result: Result) -> Content:
    shown = [one for one in result.trials if one.segments]
    together = result.summary.joints > SIDE_BY_SIDE
    trials: list[Content] = []
    views: list[View] = []
    for position, one in enumerate(shown, 1):
        title = _trial_title(result, one)
        plot = None
        if together:
            views += trace_views(one, f"{title}, ", _FEW_BUCKETS)
        else:
            description = f"Perturbation, angles, torques and commands of trial {one.trial}."
            plot = trace_plot(f"trace-{position}", description, trace_views(one))
        facts = _facts(result, one)
        trials.append({"title": title, "facts": facts, "problem": one.problem, "plot": plot})
    every = "Perturbation, angles, torques and commands of all trials."
    return {
        "key": [
            box("", name, joint_variable(joint)) for joint, name in enumerate(result.joint_names)
        ],
        "band": f"{BAND:g}",
        "trials": trials,
        "plot": trace_plot("traces-all", every, views) if views else None,
    }


def _facts(result: Result, one: AssembledTrial) -> str:
    window = one.window
    facts = [f"{(window.ticks + window.saved) * _PERIOD:g} s planned"]
    if window.saved:
        early = f"ended after {window.ticks * _PERIOD:g} s, its standard errors being small enough"
        facts.append(early)
    if window.seed is not None:
        facts.append(f"seed {window.seed}")
    if window.tare:
        facts.append("tare " + ", ".join(number(value, ".3f", "N·m") for value in window.tare))
    angles = np.degrees(one.segments[0].position.mean(axis=1))
    facts.append("mean posture " + ", ".join(number(a, ".2f", "°") for a in angles.tolist()))
    for trial in result.summary.trials:
        if trial.k - 1 == window.joint:
            facts += [f"{number(trial.rtf, '.3g')} × real time"] if trial.rtf > 0.0 else []
            facts += [f"bag {trial.bag}"] if trial.bag else []
    return "; ".join(facts) + "."


# --- settings ----------------------------------------------------------------------------------


def _settings(summary: Summary) -> Content:
    config, known = summary.config, summary.torque_reading
    return {
        "identity": identity(config, written(summary.seed)) if config else None,
        "reading": None if known is None else known.reading().sentence,
        "conditions": False,
        "tables": configuration(config),
    }


def identity(config: Mapping[str, Any], seed: object) -> list[tuple[str, object]]:
    """Versions, seed, and whatever else the configuration has beside its groups of values."""
    rows: list[tuple[str, object]] = [("seed", seed)]
    single = {name: value for name, value in config.items() if not isinstance(value, dict)}
    rows += [(name.replace("_", " "), written(value)) for name, value in single.items()]
    armimp = setting(config, "versions", "armimp")
    return rows if armimp is None else [("armimp", written(armimp)), *rows]


def configuration(config: Mapping[str, Any]) -> list[tuple[str, int, Table]]:
    """Name, size and table of every group of values, with where each value comes from."""
    return [
        (name, len(values), _values_table(config, name, values))
        for name, values in config.items()
        if isinstance(values, dict) and values
    ]


def _values_table(config: Mapping[str, Any], node: str, values: Mapping[str, Any]) -> Table:
    origins = {name: origin(config, node, name) for name in values}
    rows: list[list[object]] = [[code(name), written(value)] for name, value in values.items()]
    columns = ["name", "value"]
    if any(origins.values()):
        columns = ["parameter", "value", "where from"]
        rows = [[*row, marked(origins[n])] for row, n in zip(rows, values, strict=True)]
    return Table(
        caption="Values as they were recorded",
        columns=columns,
        groups=[Group(rows=rows)],
        words=(1, 2),
    )


def marked(where: str) -> object:
    """Set off where a value comes from, if it is assumed."""
    return Markup("<em>{}</em>").format(where) if ASSUMPTION in where else where


def assumptions_content(
    config: Mapping[str, Any], *, friction: str | None = None
) -> Content | None:
    """What the simulation assumes; None where nothing is known to be simulated.

    Parameters
    ----------
    config : mapping
        Configuration of a result, of any form.
    friction : str, optional
        Levels of friction in words, where there is more than one.
    """
    found = assumptions(config, friction=friction)
    return {"assumptions": found} if found else None
