"""What a check of a driver found, line by line."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from enum import Enum


class Verdict(Enum):
    """How one check ended."""

    PASS = "pass"
    FAIL = "fail"
    NOT_CHECKED = "not checked"


@dataclass(frozen=True, kw_only=True)
class Finding:
    """Outcome of one check.

    Attributes
    ----------
    check : name of the check, as ``joint_states: rate``
    verdict : Verdict
    figure : what was found, or why nothing could be
    limit : what is asked for
    """

    check: str
    verdict: Verdict
    figure: str
    limit: str

    def to_json(self) -> dict[str, str]:
        """The finding as plain values."""
        return {**asdict(self), "verdict": self.verdict.value}


def judged(check: str, good: bool, figure: str, limit: str) -> Finding:
    """Return a finding that passes if ``good``."""
    verdict = Verdict.PASS if good else Verdict.FAIL
    return Finding(check=check, verdict=verdict, figure=figure, limit=limit)


def not_checked(check: str, reason: str, limit: str) -> Finding:
    """Return a finding for what could not be looked at."""
    return Finding(check=check, verdict=Verdict.NOT_CHECKED, figure=reason, limit=limit)


def failures(findings: Iterable[Finding]) -> list[str]:
    """Names of the checks that failed, in their order."""
    return [finding.check for finding in findings if finding.verdict is Verdict.FAIL]


def report(findings: Sequence[Finding]) -> dict[str, object]:
    """Return what ``--json`` prints."""
    count = {verdict: sum(f.verdict is verdict for f in findings) for verdict in Verdict}
    return {
        "schema": 1,
        "passed": not count[Verdict.FAIL],
        "pass": count[Verdict.PASS],
        "fail": count[Verdict.FAIL],
        "not_checked": count[Verdict.NOT_CHECKED],
        "findings": [finding.to_json() for finding in findings],
    }
