"""The report of a study: one page that holds everything, beside the tables and figures."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from armimp_bringup.study import LEVELS, Condition, StudyEntry
from armimp_bringup.study.figures import Curves, level_stroke, levels_chart, overlay_chart
from armimp_bringup.study.scores import (
    COHERENCE_SCORES,
    FIT_SCORES,
    MOST_JOINTS,
    SCORES,
    Score,
    StudyVerdict,
    Table,
    WorstValue,
)
from armimp_estimation.report.formats import mark, setting, symbol
from armimp_estimation.report.page import Content, Rows, Section, render_page
from armimp_estimation.report.plots import TRUE, Plot, Stroke, element_plots, estimator_tag
from armimp_estimation.report.run import advised, assumptions
from armimp_estimation.summary import ImpedanceCurve, OriginSummary

_COUNTS: Final = ("", "one", "two", "three", "four", "five", "six", "seven")
_MOST_PROBLEMS: Final = 10
_POINTS: Final = 100  # of a line


@dataclass(frozen=True, kw_only=True, eq=False)
class StudyReport:
    """The data of a report on a study."""

    entries: Sequence[StudyEntry]
    """Results with the same estimators and number of joints, at least one."""
    table: Table
    """Their numbers; shape (n_conditions, n_estimators, n, n)."""
    verdict: StudyVerdict
    """The verdict on them."""
    curves: Curves
    """Returns the curves of a condition."""
    files: Mapping[str, str]
    """Other files in the directory: names and what they hold."""
    origin: OriginSummary | None = None
    """Command line and date."""

    @property
    def _estimators(self) -> list[str]:
        return list(self.entries[0].estimators)

    @property
    def _seeds(self) -> list[int]:
        return sorted({entry.seed for entry in self.entries})

    def _of(self, estimator: str) -> Table:
        """Numbers of one estimator, shape (n_conditions, n, n)."""
        return self.table[:, self._estimators.index(estimator)]

    def page(self) -> str:
        """Return the report as an HTML document."""
        first = self.entries[0]
        friction = f"levels {_present(self.entries, 'friction')}"
        scores = self._by_level("scores", FIT_SCORES)
        coherence, levels = self._by_level("coherence", COHERENCE_SCORES), "study/levels.html"
        assumed = assumptions(first.config, friction=friction)
        settings: Content = {
            "config": first.config,
            "seed": ", ".join(map(str, self._seeds)),
            "reading": None,
            "conditions": True,
        }
        sections = [
            Section("verdict", "Verdict", self._verdict(), "study/verdict.html"),
            Section("conditions", "Conditions", self._conditions(), "study/conditions.html"),
            Section("impedance", "Impedance (Fig. 2)", self._impedance(), "study/impedance.html"),
            Section("scores", "VAF and R² (Fig. 3)", scores, levels),
            Section("coherence", "Coherence (Fig. 4)", coherence, levels),
            Section("settings", "Settings", settings),
            Section("assumptions", "Assumptions", assumed),
            Section("files", "Files", {"files": self.files}, "study/files.html"),
        ]
        return render_page(
            f"Study of {self.verdict.conditions} conditions: "
            f"{'targets met' if self.verdict.met else 'targets missed'}",
            "study/header.html",
            sections,
            packages={"study": "armimp_bringup.study"},
            joints=first.joints,
            count=_COUNTS[first.joints],
            facts=self._facts(),
            origin=self.origin,
        )

    def _facts(self) -> list[str]:
        first, seeds = self.entries[0], self._seeds
        many = f"seeds {seeds[0]} to {seeds[-1]}" if len(seeds) > 1 else f"seed {seeds[0]}"
        duration = setting(first.config, "imbic_controller", "sequence.duration")
        return [
            f"{len(self.entries)} conditions",
            *(f"{factor} {_present(self.entries, factor)}" for factor in LEVELS),
            many if len(seeds) < 3 else f"{len(seeds)} {many}",
            f"{first.joints} trials of {duration:g} s each",
        ]

    # --- verdict -------------------------------------------------------------------------------

    def _verdict(self) -> Content:
        verdict = self.verdict
        judged = [one for one in verdict.worst if one.met is not None]
        missed = [one for one in judged if not one.met]
        title = "All targets met" if judged else "Valid; there are no targets for this"
        if not verdict.met:
            parts = [f"{len(missed)} of {len(judged)} targets missed"] if missed else []
            if verdict.problems:
                invalid = f"{len(verdict.problems)} of {verdict.conditions} conditions not valid"
                parts.append(invalid)
            title = ", ".join(parts)
        return {
            "title": title,
            "met": verdict.met,
            "missed": [str(one) for one in missed],
            "unresolved": f"{100.0 * verdict.unresolved:.1f}" if verdict.unresolved else None,
            "problems": advised(verdict.problems[:_MOST_PROBLEMS]),
            "more": len(verdict.problems) - _MOST_PROBLEMS,
            "worst": [
                (name, [self._worst_row(one) for one in verdict.worst if one.estimator == name])
                for name in self._estimators
            ],
        }

    def _worst_row(self, one: WorstValue) -> list[object]:
        place = one.condition.short
        return [
            one.quantity,
            one.score.format(one.worst, one.limit),
            one.target,
            "not judged" if one.met is None else mark(one.met),
            symbol(one.element[0], one.element[1:]),
            f"{place}, seed {one.seed}" if len(self._seeds) > 1 else place,
        ]

    # --- conditions ----------------------------------------------------------------------------

    def _conditions(self) -> Content:
        """The worst value of each score in each combination of levels, over its seeds."""
        places: dict[str, list[int]] = {}
        for place, one in enumerate(self.entries):
            places.setdefault(one.condition.short, []).append(place)
        places = dict(sorted(places.items()))
        groups = []
        for name in self._estimators:
            rows: Rows = [[levels] for levels in places]
            for score in SCORES:
                limit = score.limit(self.entries[0].joints, name)
                for row, members in zip(rows, places.values(), strict=True):
                    worst, *_ = score.worst(self._of(name)[members], judged=limit is not None)
                    row.append(score.format(worst))
            groups.append((name, rows))
        names = [score.name for score in SCORES]
        return {"seeds": len(self._seeds), "scores": names, "worst": groups}

    # --- curves and levels ---------------------------------------------------------------------

    def _impedance(self) -> Content:
        """Magnitude, phase and error of every element in all conditions of the first seed."""
        first = self.entries[0]
        n = first.joints
        conditions = [one.condition for one in self.entries if one.seed == first.seed]
        if n > MOST_JOINTS:
            for factor in ("friction", "resolution"):
                levels = {getattr(one, factor) for one in conditions}
                ends = min(levels), max(levels)
                conditions = [one for one in conditions if getattr(one, factor) in ends]
        curves = {
            one: {name: _thinned(curve, _POINTS) for name, curve in self.curves(one).items()}
            for one in conditions
        }
        return {
            "seed": first.seed if len(self._seeds) > 1 else None,
            "points": _POINTS,
            "few": n > MOST_JOINTS,
            "choices": list(self._choices(conditions)),
            "switches": list(_switches(conditions)),
            "plots": element_plots(
                "overlay",
                n,
                lambda i, k: overlay_chart(curves, first.arm, i, k),
                470,
            ),
            "joints": n,
        }

    def _choices(
        self, conditions: Sequence[Condition]
    ) -> Iterator[tuple[str, str, list[tuple[str, str]]]]:
        """Yield name, legend and options of each selection that the page offers."""
        if len(self._estimators) > 1:
            options = [(estimator_tag(one), one) for one in self._estimators]
            yield "overlay-estimator", "Estimator", options
        perturbations = sorted({one.perturbation for one in conditions})
        if len(perturbations) > 1:
            options = [(f"perturbation:{level}", f"level {level}") for level in perturbations]
            yield "overlay-perturbation", "Perturbation", options

    def _by_level(self, identifier: str, scores: Sequence[Score]) -> Content:
        names = ", ".join(score.name for score in scores)
        title = f"By level: {names}"
        views = {name: levels_chart(self._of(name), scores) for name in self._estimators}
        plot = Plot(
            identifier=f"levels-{identifier}",
            caption=title,
            views=views,
            height=90 + 190 * len(scores),
        )
        return {"title": title, "plot": plot, "rows": self.entries[0].joints > MOST_JOINTS}


def _present(entries: Sequence[StudyEntry], factor: str) -> str:
    """Levels in words: ``0 to 3``, ``1 and 3``."""
    levels = sorted({getattr(entry, factor) for entry in entries})
    if len(levels) > 2 and levels == list(range(levels[0], levels[-1] + 1)):
        return f"{levels[0]} to {levels[-1]}"
    return " and ".join(map(str, levels))


def _thinned(curve: ImpedanceCurve, points: int) -> ImpedanceCurve:
    """Return a curve at about this many frequencies, evenly spaced on a logarithmic axis."""
    wanted = np.geomspace(curve.f[0], curve.f[-1], points)
    chosen = np.unique(np.abs(curve.f[:, np.newaxis] - wanted).argmin(axis=0))
    return replace(curve, f=curve.f[chosen], Z=curve.Z[:, :, chosen])


def _switches(conditions: Sequence[Condition]) -> Iterator[Stroke]:
    for factor in ("friction", "resolution"):
        for level in sorted({getattr(one, factor) for one in conditions}):
            yield replace(level_stroke(**{factor: level}), tags=[f"{factor}:{level}"])
    yield TRUE
