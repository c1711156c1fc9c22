"""The trials: how still the held joints were, and time traces."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from armimp_common import contract
from armimp_estimation.report.formats import NONE, number, percent, symbol
from armimp_estimation.report.html import Group, Html, element, section, table
from armimp_estimation.report.look import joint_colour
from armimp_estimation.report.plots import frame
from armimp_estimation.report.result import Result, TrialEvidence
from armimp_estimation.report.traces import trace_plot
from armimp_estimation.report.verdict_part import mark
from armimp_estimation.results import TrialSummary
from armimp_estimation.verdict import Limits


def locking_section(result: Result) -> Html | None:
    """How still the held joints were; None if no trial could be scored."""
    scored = [trial for trial in result.summary.trials if not np.isnan(trial.lock_ratio).all()]
    if not scored or result.summary.joints == 1:
        return None
    groups = [
        Group(
            title=f"{joint_label(result, trial.k)} perturbed",
            rows=list(_locking_rows(result, trial)),
        )
        for trial in scored
    ]
    return section(
        "locking",
        "Locking",
        element(
            "p",
            "One joint at a time is perturbed, the others must stay still. The last columns bound "
            "the bias of an element of the matrix through motion of held joints.",
        ),
        table(
            "Motion in each trial",
            ["joint", "motion (rms)", "relative", "verdict", "element", "bias bound", "verdict"],
            groups,
            words=(3, 4, 6),
        ),
    )


def _locking_rows(result: Result, trial: TrialSummary) -> Iterator[list[object]]:
    limits = Limits()
    evidence = next((one for one in result.trials if one.joint == trial.k - 1), None)
    for i, (ratio, bound) in enumerate(zip(trial.lock_ratio, trial.bias_bound, strict=False)):
        perturbed = i == trial.k - 1
        yield [
            joint_label(result, i + 1),
            _motion(evidence, i),
            "perturbed" if perturbed else percent(ratio, ".3f"),
            "" if perturbed else mark(ratio <= limits.lock_ratio),
            symbol("Z", i + 1, trial.k),
            percent(bound),
            mark(bound <= limits.bias_bound),
        ]


def _motion(evidence: TrialEvidence | None, joint: int) -> str:
    if evidence is None or evidence.assembled.record is None:
        return NONE
    motion = np.std(evidence.assembled.record.position[joint])
    return number(float(np.degrees(motion)), ".3g", "°")


def traces_section(result: Result) -> Html:
    """Time traces of every trial."""
    shown = [one for one in result.trials if one.assembled.segments]
    if not shown:
        missing = "No samples are at hand, so there is nothing to show."
        return section("traces", "Signals over time", element("p", missing))
    key = (
        element("span", element("i", style=f"border-top:3px solid {joint_colour(joint)}"), name)
        for joint, name in enumerate(result.joint_names)
    )
    parts = []
    for position, one in enumerate(shown, 1):
        parts += [element("h3", trial_title(result, one)), element("p", _facts(result, one))]
        if one.assembled.problem:
            parts.append(element("p", f"Not usable: {one.assembled.problem}", class_="beyond"))
        parts.append(frame(trace_plot(one.assembled, f"trace-{position}")))
    return section(
        "traces",
        "Signals over time",
        element("p", "Joints: ", *key, class_="key"),
        element(
            "p",
            "Angles are about their mean. The whole trial is thinned out to the smallest and "
            "largest values of short intervals; its first and last seconds are shown in full. Drag "
            "to zoom, double-click to zoom out.",
        ),
        *parts,
    )


def trial_title(result: Result, one: TrialEvidence) -> str:
    """Heading of a trial."""
    return f"Trial {one.assembled.trial}: {joint_label(result, one.joint + 1)} perturbed"


def _facts(result: Result, one: TrialEvidence) -> str:
    window = one.assembled.window
    period = contract.PERIOD_NS / contract.NS_PER_S
    facts = [f"{(window.ticks + window.saved) * period:g} s planned"]
    if window.saved:
        early = f"ended after {window.ticks * period:g} s, its standard errors being small enough"
        facts.append(early)
    if window.seed is not None:
        facts.append(f"seed {window.seed}")
    if window.tare:
        facts.append("tare " + ", ".join(number(value, ".3f", "N·m") for value in window.tare))
    if one.assembled.segments:
        angles = np.degrees(one.assembled.segments[0].position.mean(axis=1))
        facts.append("mean posture " + ", ".join(number(a, ".2f", "°") for a in angles.tolist()))
    for trial in result.summary.trials:
        if trial.k - 1 == one.joint:
            facts += [f"{number(trial.rtf, '.3g')} × real time"] if trial.rtf > 0.0 else []
            facts += [f"bag {trial.bag}"] if trial.bag else []
    return "; ".join(facts) + "."


def joint_label(result: Result, joint: int) -> str:
    """Name of a joint (1-based), for which bags and summary may not agree."""
    names = result.joint_names
    return names[joint - 1] if 0 < joint <= len(names) else f"joint {joint}"
