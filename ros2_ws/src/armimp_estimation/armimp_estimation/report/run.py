"""The report of one result: its sections, and what their templates are filled with."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
from markupsafe import Markup

from armimp_estimation.atomic_write import write_text
from armimp_estimation.problems import Kind, ProblemCode, kind_of
from armimp_estimation.report.curves import reference_of
from armimp_estimation.report.formats import (
    NAMES,
    NONE,
    UNITS,
    difference,
    mark,
    number,
    percent,
    setting,
    symbol,
    uncertain,
)
from armimp_estimation.report.frequency_plots import (
    BANDS,
    TRUTH,
    bode_plot,
    coherence_plot,
    estimator_tag,
    plot_matrix,
)
from armimp_estimation.report.look import looks
from armimp_estimation.report.page import Content, Section, Table, box, render_page
from armimp_estimation.report.settings import assumptions_content, configuration, identity
from armimp_estimation.report.trials import (
    locking_content,
    samples_content,
    signals_content,
    timing_content,
)
from armimp_estimation.result import Result
from armimp_estimation.summary import Summary
from armimp_estimation.verdict import Limits

REPORT_FILE = "report.html"
_LIMITS = Limits()


def report_page(result: Result) -> str:
    """HTML document of a result, valid or not."""
    summary = result.summary
    found: list[tuple[str, str, Content | None]] = [
        ("verdict", "Verdict", _verdict(result)),
        ("parameters", "M, B, K", _parameters(summary)),
        ("scores", "Scores", _scores(summary)),
        ("impedance", "Impedance", _impedance(result)),
        ("coherence", "Coherence", _coherence(result)),
        ("locking", "Locking", locking_content(result)),
        ("samples", "Samples", samples_content(result)),
        ("timing", "Timing", timing_content(summary)),
        ("signals", "Signals", signals_content(result)),
        ("settings", "Settings", _settings(summary)),
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
        introduction=_introduction(result),
        origin=summary.origin,
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
        """Row of the worst of some values, each with where it was found; NaN is the worst."""
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


# --- estimates ---------------------------------------------------------------------------------


def _parameters(summary: Summary) -> Content | None:
    if not summary.estimators:
        return None
    found, truth = looks(summary.estimators), summary.truth
    columns: list[object] = ["element"]
    spans: list[tuple[object, int]] = [("", 1)]
    if truth is not None:
        columns.append("true value")
        spans.append(("Simulation", 1))
    for look in found.values():
        columns += ["estimate ± s.e.", "95 % interval"]
        columns.append("relative s.e." if truth is None else "error")
        spans.append((look.name, 3))
    groups = [
        (
            Markup("{} {} ({})").format(NAMES[letter], symbol(letter), UNITS[letter]),
            [
                _parameter_row(summary, letter, i, k)
                for i, k in np.ndindex(summary.joints, summary.joints)
            ],
        )
        for letter in ("M", "B", "K")
    ]
    return {
        "table": Table(caption="Estimates", columns=columns, groups=groups, spans=spans),
        "remarks": [look for look in found.values() if look.remark],
    }


def _parameter_row(summary: Summary, letter: str, i: int, k: int) -> list[object]:
    cells: list[object] = [symbol(letter, i + 1, k + 1)]
    true = None if summary.truth is None else float(getattr(summary.truth, letter)[i][k])
    if true is not None:
        cells.append(number(true, ".5g"))
    for one in summary.estimators.values():
        value = float(getattr(one, letter)[i][k])
        error = float(getattr(one, f"{letter}_se")[i][k])
        ends = getattr(one, f"{letter}_ci")[i][k]
        cells += [uncertain(value, error), " to ".join(number(end, "#.4g") for end in ends)]
        relative = percent(abs(error / value)) if value else NONE
        cells.append(relative if true is None else difference(value, true))
    return cells


def _scores(summary: Summary) -> Content | None:
    if not summary.estimators:
        return None
    derived, torque = (Markup("<var>γ</var>² {}").format(kind) for kind in ("derived", "torque"))
    columns: list[object] = ["element"]
    spans: list[tuple[object, int]] = [("", 1)]
    scores = []
    for name, one in summary.estimators.items():
        found = [
            ("VAF %", one.vaf, ".2f"),
            ("R²", one.r2, ".4f"),
            ("lack of fit", one.lack_of_fit, ".2f"),
            (derived, one.coherence_derived, ".4f"),
        ]
        known = [(title, values, spec) for title, values, spec in found if values is not None]
        scores += known
        spans.append((name, len(known)))
    # No matter of the estimator, so once is enough.
    scores.append((torque, next(iter(summary.estimators.values())).coherence_torque, ".4f"))
    spans.append(("Signals", 1))
    columns += [title for title, _, _ in scores]
    rows = [
        [symbol("Z", i + 1, k + 1), *(number(values[i][k], spec) for _, values, spec in scores)]
        for i, k in np.ndindex(summary.joints, summary.joints)
    ]
    caption = "Scores of the elements"
    return {
        "table": Table(caption=caption, columns=columns, groups=[(None, rows)], spans=spans),
        "known": summary.truth is not None,
    }


# --- curves ------------------------------------------------------------------------------------


def _switches(names: Iterable[str]) -> list[Content]:
    return [
        box(estimator_tag(look.name), look.name, look.variable, look.dash)
        for look in looks(names).values()
    ]


def _impedance(result: Result) -> Content | None:
    curves, n = result.curves, result.summary.joints
    if not curves:
        return None
    truth = None if result.summary.truth is None else result.summary.truth.mbk()
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


def _settings(summary: Summary) -> Content:
    known = summary.torque_reading
    return {
        "identity": identity(summary.config, summary.seed) if summary.config else None,
        "reading": None if known is None else known.sentence,
        "conditions": False,
        "tables": configuration(summary.config),
    }
