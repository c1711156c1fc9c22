"""The report of a study: one page that holds everything, beside the tables and figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from armimp_bringup.study.conditions import LEVELS
from armimp_bringup.study.entry import StudyEntry
from armimp_bringup.study.figures import Curves
from armimp_bringup.study.report_accuracy import accuracy_content
from armimp_bringup.study.report_levels import coherence_content, scores_content
from armimp_bringup.study.report_maps import conditions_content, locking_content
from armimp_bringup.study.report_overlay import impedance_content
from armimp_bringup.study.report_settings import levels_content, made_content
from armimp_bringup.study.report_verdict import verdict_content
from armimp_bringup.study.store import write_file
from armimp_bringup.study.verdict import StudyVerdict
from armimp_estimation.report.page import Section, render_page
from armimp_estimation.report.result import setting
from armimp_estimation.report.run import REPORT_FILE
from armimp_estimation.report.settings import assumptions_content
from armimp_estimation.results import OriginSummary


@dataclass(frozen=True, kw_only=True, eq=False)
class StudyReport:
    """What the report of a study is made of.

    Parameters
    ----------
    entries : sequence of StudyEntry
        Results with the same estimators and number of joints, at least one.
    verdict : StudyVerdict
        Of these.
    curves : callable
        Gives the curves of a condition.
    files : mapping of str to str
        What else is in the directory: names and what they hold.
    origin : OriginSummary or None
        Command line and date.
    """

    entries: Sequence[StudyEntry]
    verdict: StudyVerdict
    curves: Curves
    files: Mapping[str, str]
    origin: OriginSummary | None = None

    def page(self) -> str:
        """HTML document."""
        entries, verdict = self.entries, self.verdict
        config = entries[0].config
        friction = f"levels {_present(entries, 'friction')}"
        found: list[tuple[str, str, str, Any]] = [
            ("verdict", "Verdict", "study/verdict", verdict_content(entries, verdict)),
            ("conditions", "Conditions", "study/conditions", conditions_content(entries)),
            ("accuracy", "Elements", "study/accuracy", accuracy_content(entries)),
            (
                "impedance",
                "Impedance (Fig. 2)",
                "study/impedance",
                impedance_content(entries, self.curves),
            ),
            ("scores", "VAF and R² (Fig. 3)", "study/levels", scores_content(entries)),
            ("coherence", "Coherence (Fig. 4)", "study/levels", coherence_content(entries)),
            ("locking", "Locking", "study/locking", locking_content(entries)),
            ("levels", "Levels", "study/meaning", levels_content(entries)),
            ("settings", "Settings", "report/settings", made_content(entries)),
            (
                "assumptions",
                "Assumptions",
                "report/assumptions",
                assumptions_content(config, friction=friction),
            ),
            ("files", "Files", "study/files", {"files": self.files}),
        ]
        sections = [
            Section(identifier=name, title=title, template=f"{template}.html", content=content)
            for name, title, template, content in found
        ]
        state = "targets met" if verdict.met else "targets missed"
        return render_page(
            f"Study of {verdict.conditions} conditions: {state}",
            "study/header.html",
            sections,
            packages={"study": "armimp_bringup.study"},
            joints=entries[0].joints,
            count=_count(entries[0].joints),
            facts=self._facts(),
            origin=self.origin,
        )

    def write(self, directory: Path) -> Path:
        """Write ``report.html``, in place of one that is there.

        Raises
        ------
        StudyError, DataError
            If it can't be written, or curves not be read.
        """
        path = directory / REPORT_FILE
        write_file(path, self.page())
        return path

    def _facts(self) -> list[str]:
        entries = self.entries
        first = entries[0]
        seeds = sorted({entry.seed for entry in entries})
        many = f"seeds {seeds[0]} to {seeds[-1]}" if len(seeds) > 1 else f"seed {seeds[0]}"
        facts = [
            f"{len(entries)} conditions",
            *(f"{factor} {_present(entries, factor)}" for factor in LEVELS),
            many if len(seeds) < 3 else f"{len(seeds)} {many}",
            f"{first.joints} trials each",
        ]
        duration = setting(first.config, "imbic_controller", "sequence.duration")
        if isinstance(duration, (int, float)):
            facts[-1] += f" of {duration:g} s"
        law = setting(first.config, "imbic_controller", "law.kind")
        if law not in (None, "imbic"):
            facts.append(f"control law {law}")
        return facts


def _count(joints: int) -> str:
    words = {1: "one", 2: "two", 3: "three", 4: "four", 5: "five", 6: "six", 7: "seven"}
    return words.get(joints, str(joints))


def _present(entries: Sequence[StudyEntry], factor: str) -> str:
    """Levels in words: ``0 to 3``, ``1 and 3``."""
    levels = sorted({getattr(entry, factor) for entry in entries})
    if len(levels) > 2 and levels == list(range(levels[0], levels[-1] + 1)):
        return f"{levels[0]} to {levels[-1]}"
    return " and ".join(map(str, levels))
