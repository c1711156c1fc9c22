"""What a report tells of the trials: locking, samples, timing, signals."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from markupsafe import Markup

from armimp_common import topics
from armimp_common.realtime import LATE_NS
from armimp_estimation.alignment.assemble import Trial
from armimp_estimation.report.formats import (
    NONE,
    STREAMS,
    alarming,
    code,
    mark,
    number,
    percent,
    symbol,
)
from armimp_estimation.report.frequency_plots import SIDE_BY_SIDE
from armimp_estimation.report.look import joint_variable
from armimp_estimation.report.page import Content, Table, box
from armimp_estimation.report.traces import BAND, PERIOD, trace_plot, trace_views
from armimp_estimation.result import Result
from armimp_estimation.summary import Summary, TrialSummary
from armimp_estimation.verdict import Limits

_LIMITS = Limits()
_FEW_BUCKETS = 250
"""Parts of thinned signals where many trials share a plot, so that the file stays small."""


def _joint(result: Result, joint: int) -> str:
    """Name of a joint (1-based), for which bags and summary may not agree."""
    names = result.joint_names
    return names[joint - 1] if 0 < joint <= len(names) else f"joint {joint}"


def _title(result: Result, one: Trial) -> str:
    return f"Trial {one.trial}: {_joint(result, one.window.joint + 1)} perturbed"


def locking_content(result: Result) -> Content | None:
    """Motion of every joint in every trial, and the bias that it may cause."""
    scored = [trial for trial in result.summary.trials if not np.isnan(trial.lock_ratio).all()]
    if not scored or result.summary.joints == 1:
        return None
    columns = ["joint", "motion (rms)", "relative", "verdict", "element", "bias bound", "verdict"]
    groups = [
        (f"{_joint(result, trial.k)} perturbed", list(_locking_rows(result, trial)))
        for trial in scored
    ]
    return {
        "table": Table(
            caption="Motion in each trial", columns=columns, groups=groups, words=(3, 4, 6)
        )
    }


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


def samples_content(result: Result) -> Content:
    """How many messages of each stream came, and what no estimate uses."""
    if not result.trials:
        rows = [
            [f"trial of {_joint(result, trial.k)}", trial.ticks, trial.lost]
            for trial in result.summary.trials
        ]
        columns = ["trial", "samples", "lost"]
        table = Table(caption="Samples", columns=columns, groups=[(None, rows)])
        return {"table": table, "bags": False, "excluded": None}
    columns = ["stream", "expected", "received", "lost"]
    columns += ["duplicated", "contradictory", "reordered", "late"]
    table = Table(
        caption="Messages of each stream",
        columns=columns,
        groups=[(_title(result, one), list(_streams(one))) for one in result.trials],
    )
    return {"table": table, "bags": True, "excluded": _exclusions(result)}


def _streams(one: Trial) -> Iterator[list[object]]:
    for topic, count in one.statistics.streams.items():
        counts = (count.duplicated, count.contradictory, count.reordered, count.late)
        stamped = topic != topics.COMMANDS
        name = STREAMS.get(topic, topic)
        yield [
            Markup('{}<span class="aside"> {}</span>').format(name, code(topic)),
            count.expected,
            count.received,
            _noted(count.lost),
            *(_noted(found) if stamped else NONE for found in counts),
        ]


def _exclusions(result: Result) -> Table | None:
    """What no estimate uses, and why; nothing if all is used."""
    rows: list[list[object]] = [
        [
            _title(result, one),
            one.statistics.clipped,
            _noted(one.statistics.excluded),
            percent(one.statistics.excluded_share),
            one.statistics.stretches,
            f"{max((part.samples for part in one.segments), default=0) * PERIOD:.3f} s",
            "; ".join(map(str, one.problems)) or "clipped commands",
        ]
        for one in result.trials
        if one.statistics.excluded or one.statistics.clipped
    ]
    if not rows:
        return None
    return Table(
        caption="Left out of all estimates",
        columns=["trial", "clipped", "samples", "share", "parts left", "longest", "why"],
        groups=[(None, rows)],
        words=(6,),
    )


def _noted(count: int) -> object:
    return alarming(count) if count else 0


def timing_content(summary: Summary) -> Content | None:
    """How regular samples were, and how quickly commands came; None for a run in lockstep."""
    timing = summary.timing
    if timing is None:
        return None
    period = (timing.period_p50, timing.period_p99, timing.period_max)
    latency = (timing.latency_p50, timing.latency_p99, timing.latency_max)
    met = mark(timing.latency_p99 <= timing.max_latency)
    limit = f"99 % ≤ {_milliseconds(timing.max_latency)}"
    counts: list[list[object]] = []
    for what, count, most in (
        ("samples sent late", timing.late, timing.max_late_share),
        ("commands not in time", timing.missed, timing.max_missed_share),
    ):
        share = count / max(timing.ticks, 1)
        counts.append(
            [what, count, percent(share, ".3f"), f"≤ {percent(most)}", mark(share <= most)]
        )
    return {
        "timing": timing,
        "late": _milliseconds(LATE_NS / 1e9),
        "jitter": Table(
            caption="Jitter",
            columns=["duration", "median", "99 %", "longest", "limit", "verdict"],
            groups=[
                (
                    None,
                    [
                        ["time between samples", *map(_milliseconds, period), "", ""],
                        ["from a sample to its command", *map(_milliseconds, latency), limit, met],
                    ],
                )
            ],
            words=(5,),
        ),
        "counts": Table(
            caption="Late and missed",
            columns=["what", "count", "share", "limit", "verdict"],
            groups=[(None, counts)],
            words=(4,),
        ),
    }


def _milliseconds(seconds: float) -> str:
    return number(1e3 * seconds, ".3f", "ms")


def signals_content(result: Result) -> Content:
    """Time traces of all trials: of each for itself, or with many joints in one plot."""
    shown = [one for one in result.trials if one.segments]
    together = result.summary.joints > SIDE_BY_SIDE
    views = [
        view
        for one in shown
        if together
        for view in trace_views(one, f"{_title(result, one)}, ", _FEW_BUCKETS)
    ]
    signals = "Perturbation, angles, torques and commands of"
    trials = [
        {
            "title": _title(result, one),
            "facts": _facts(result, one),
            "problem": "; ".join(map(str, one.refusals())),
            "plot": None
            if together
            else trace_plot(f"trace-{position}", f"{signals} trial {one.trial}.", trace_views(one)),
        }
        for position, one in enumerate(shown, 1)
    ]
    return {
        "key": [
            box("", name, joint_variable(joint)) for joint, name in enumerate(result.joint_names)
        ],
        "band": f"{BAND:g}",
        "trials": trials,
        "plot": trace_plot("traces-all", f"{signals} all trials.", views) if views else None,
    }


def _facts(result: Result, one: Trial) -> str:
    window = one.window
    facts = [f"{(window.ticks + window.saved) * PERIOD:g} s planned"]
    if window.saved:
        early = f"ended after {window.ticks * PERIOD:g} s, its standard errors being small enough"
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
