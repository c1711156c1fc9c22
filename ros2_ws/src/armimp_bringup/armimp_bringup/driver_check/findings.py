"""What a check of a driver found, line by line."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from enum import Enum


class Verdict(Enum):
    """How one check ended.

    A check is not made where it does not apply, or was not asked for. It is inconclusive where it
    was asked for and could not be finished, or where the machine may be to blame.
    """

    PASS = "pass"
    FAIL = "fail"
    INCONCLUSIVE = "inconclusive"
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
    """Return a finding for what does not apply or was not asked for."""
    return Finding(check=check, verdict=Verdict.NOT_CHECKED, figure=reason, limit=limit)


def inconclusive(check: str, reason: str, limit: str) -> Finding:
    """Return a finding for what was looked at in vain."""
    return Finding(check=check, verdict=Verdict.INCONCLUSIVE, figure=reason, limit=limit)


def failures(findings: Iterable[Finding]) -> list[str]:
    """Names of the checks that failed, in their order."""
    return _named(findings, Verdict.FAIL)


def open_questions(findings: Iterable[Finding]) -> list[str]:
    """Names of the checks that are inconclusive, in their order."""
    return _named(findings, Verdict.INCONCLUSIVE)


def _named(findings: Iterable[Finding], verdict: Verdict) -> list[str]:
    return [finding.check for finding in findings if finding.verdict is verdict]


def report(findings: Sequence[Finding]) -> dict[str, object]:
    """Return what ``--json`` prints of the findings."""
    count = {verdict: len(_named(findings, verdict)) for verdict in Verdict}
    return {
        "schema": 1,
        "passed": not count[Verdict.FAIL] and not count[Verdict.INCONCLUSIVE],
        "pass": count[Verdict.PASS],
        "fail": count[Verdict.FAIL],
        "inconclusive": count[Verdict.INCONCLUSIVE],
        "not_checked": count[Verdict.NOT_CHECKED],
        "findings": [finding.to_json() for finding in findings],
    }
