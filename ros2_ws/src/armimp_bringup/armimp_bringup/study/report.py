"""The report of a study: one page that holds everything, beside the tables and figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from armimp_bringup.study.conditions import LEVELS
from armimp_bringup.study.entry import StudyEntry
from armimp_bringup.study.figures import Curves
from armimp_bringup.study.report_accuracy import accuracy_section
from armimp_bringup.study.report_levels import coherence_section, scores_section
from armimp_bringup.study.report_maps import conditions_section, locking_section
from armimp_bringup.study.report_overlay import impedance_section
from armimp_bringup.study.report_settings import files_section, levels_section, made_section
from armimp_bringup.study.report_verdict import verdict_section
from armimp_bringup.study.store import write_file
from armimp_bringup.study.verdict import StudyVerdict
from armimp_estimation.report.html import Html, element, join
from armimp_estimation.report.page import Chapter, page
from armimp_estimation.report.report import REPORT_FILE
from armimp_estimation.report.result import setting
from armimp_estimation.report.settings_part import assumptions_section


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
    """

    entries: Sequence[StudyEntry]
    verdict: StudyVerdict
    curves: Curves
    files: Mapping[str, str]

    def page(self) -> str:
        """HTML document."""
        entries, verdict = self.entries, self.verdict
        config = entries[0].config
        chapters: list[Chapter] = [
            ("verdict", "Verdict", verdict_section(entries, verdict)),
            ("conditions", "Conditions", conditions_section(entries)),
            ("accuracy", "Elements", accuracy_section(entries)),
            ("impedance", "Impedance (Fig. 2)", impedance_section(entries, self.curves)),
            ("scores", "VAF and R² (Fig. 3)", scores_section(entries)),
            ("coherence", "Coherence (Fig. 4)", coherence_section(entries)),
            ("locking", "Locking", locking_section(entries)),
            ("levels", "Levels", levels_section(entries)),
            ("settings", "Settings", made_section(entries)),
            (
                "assumptions",
                "Assumptions",
                assumptions_section(config, friction=f"levels {_present(entries, 'friction')}"),
            ),
            ("files", "Files", files_section(self.files)),
        ]
        state = "targets met" if verdict.met else "targets missed"
        return page(f"Study of {verdict.conditions} conditions: {state}", self._header(), chapters)

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

    def _header(self) -> Html:
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
        return join(
            [
                element("p", "armimp · report of a study", class_="kicker"),
                element("h1", f"Study: impedance of a {_count(first.joints)}-joint arm"),
                element("p", " · ".join(facts)),
                element(
                    "p",
                    "The simulation study of Kang and Zhang, “Robust Identification of Multi-Joint "
                    "Human Arm Impedance Based on Dynamics Decomposition: A Modeling Study”",
                    "."
                    if first.joints == 2
                    else ", carried over to another number of joints, for which the paper has no "
                    "values.",
                ),
            ]
        )


def _count(joints: int) -> str:
    words = {1: "one", 2: "two", 3: "three", 4: "four", 5: "five", 6: "six", 7: "seven"}
    return words.get(joints, str(joints))


def _present(entries: Sequence[StudyEntry], factor: str) -> str:
    """Levels in words: ``0 to 3``, ``1 and 3``."""
    levels = sorted({getattr(entry, factor) for entry in entries})
    if len(levels) > 2 and levels == list(range(levels[0], levels[-1] + 1)):
        return f"{levels[0]} to {levels[-1]}"
    return " and ".join(map(str, levels))
