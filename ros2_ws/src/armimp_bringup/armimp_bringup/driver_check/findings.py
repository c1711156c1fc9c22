"""What a check of a driver found, as codes with values, and the words for them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
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


class Rule(Enum):
    """What is asked of a driver: the name of the check, what was found, and the limit, in words."""

    TYPE = "type", "{types} from {nodes}", "one {role} of {kind}"
    QUALITY = "quality of service", "{quality}", "{wanted}"
    SERVICE = "", "{state}", "there"
    LIFECYCLE = (
        "lifecycle",
        "was {state}",
        "lifecycle services, for armimp run --processes external",
    )
    NO_FAULT = "no fault at rest", "{fault}", "no status ERROR on {topic}"
    MESSAGES = "messages", "{count}, and {malformed} that cannot be decoded", "≥ {least}, and none"
    JOINT_NAMES = "joint names", "{names}", "{expected}, each once"
    FIELD = "field", "{lengths} values in {field}", "{expected} in {field}"
    FINITE = "finite", "{bad} of {count} are not", "no NaN, no infinity"
    RANGE = "range", "{largest:.4g} {unit}", "|value| ≤ {bound:.4g} {unit}"
    JUMPS = "jumps", "{jump:.3g} rad", "≤ {bound:g} rad from one sample to the next"
    RESOLUTION = "resolution", "{step:.4g} {unit}", "≤ {bound:.4g} {unit}, the study's coarsest"
    INCREASE = "stamps increase", "{still} repeat, {back} go back", "none repeats, goes back"
    STEPS = (
        "stamps 1 ms apart",
        "{off} of {count} are not; longest {longest:.4g} ms",
        "all, within half of that",
    )
    CLOCK = "clock", "{mean:.6f} ms", "1 ms ± {tolerance:g} %"
    RATE = "rate", "{rate:.1f} Hz", "{nominal:g} Hz ± {tolerance:g} %"
    ANSWERS = "rate", "{count} for {commands} commands", "one for each command, and the first"
    JITTER = (
        "jitter",
        "{late:.3g} %; worst {worst:.3g} ms",
        "≤ {share:g} % arrive more than {bound:g} ms late",
    )
    PAIRS = "pairs", "{alone} readings without a partner", "both streams have the same stamps"
    LATENCY = (
        "sample to command",
        "99 %: {latency:.3g} ms",
        "99 % ≤ {bound:g} ms, as arm_sim: timing reports it",
    )
    MOTION = "motion", "{moved:.3g} rad", "≤ {most:g} rad from where each joint was"
    NO_STOP = (
        "no stop",
        "{fault}; {repeated} repeated, commands up to {gap:.3g} ms apart",
        "no fault while commands come as they should",
    )
    WAYS = "joint and sign", "{ways}", "each joint turns the way of its torque"
    SENSOR_SIGN = "sign", "{changes}", "the reading of torque goes the way of the joint"
    DELAY = "delay", "{periods} periods", "≤ {bound} periods from command to effect"
    GONE = "", "after about {delay:.0f} ms", "torque gone within {bound:g} ms (± {blur:g} ms)"
    LATCHED = (
        "latched",
        "{share:.0f} % of the usual motion",
        "no torque before the reset, whatever is commanded",
    )
    ANSWER = "answer", "{answer}, {seconds:.3f} s", "success within {bound:g} s"
    TOLD = "told", "after {told:.3f} s", "status ERROR on {topic} within {bound:g} s"
    RESET = "reset", "{answer}", "granted under zero torque"

    @property
    def label(self) -> str:
        """What people read, after what it is asked of; may be empty."""
        return self.value[0]


class Reason(Enum):
    """Why a check could not be made, or did not pass, beyond its figures."""

    NOT_ASKED = "not without --move"
    NOT_TRIED = "not tried"
    NO_LIFECYCLE = "none: nobody can lead this node through its life"
    NOT_REPORTED = "the driver does not report it"
    NO_ENDPOINT = "no {role}"
    NOT_WHOLE = "no whole message"
    DEGREES = "{largest:.4g} rad (degrees?)"
    MILLIMETRES = "{largest:.4g} N·m (N·mm?)"
    STILL_ANGLES = "readings do not change: move the arm, or --move"
    STILL_TORQUES = "readings do not change"
    FEW_LEVELS = "too few readings that differ"
    NO_CLOCK = "in lockstep there is no clock"
    STANDS_STILL = "in lockstep time stands still without commands"
    MISSING_STREAM = "a stream is missing"
    HELD_UP = "{shown}; held up: this process for {stall:.3g} ms, the driver for {waited:.3g} ms"
    UNSOUND = "{topic} is not sound enough to command torque"
    NOT_FINITE = "{topic} is not finite: no torque is commanded"
    FAULT_AT_REST = "there was a fault before: {fault}"
    TOO_FAR = "{joint} went {moved:.3g} rad from where it was: torque taken away"
    UNREADABLE = "an angle cannot be read: {error}: torque taken away"
    STOPPED = "the driver stopped: {fault}"
    NO_RESET = "the driver stopped, and no reset was granted: {fault}"
    INTERRUPTIONS = "commands were held up {attempts} times, by up to {gap:.3g} ms"
    MIXED = "torque acts on another joint"
    NO_EFFECT = "no effect: try a larger --torque"
    NO_MOTION = "{joints} did not move: try a larger --torque"
    DEAF = "readings of torque do not answer: try a larger --torque"
    NO_TORQUE = "no torque was there: --move"
    STAYS = "{stays:.0f} % of the torque seems to stay"
    NO_ANSWER = "no answer"
    NEVER = "none"


@dataclass(frozen=True, kw_only=True)
class Finding:
    """Outcome of one check."""

    rule: Rule
    verdict: Verdict
    of: str = ""  # which topic, service or move
    values: Mapping[str, object] = field(default_factory=dict)  # found, and asked for
    reason: Reason | None = None  # why it ended so, if that is not plain from the values

    @property
    def check(self) -> str:
        """Name of the check, as ``joint_states: rate``."""
        return ": ".join(part for part in (self.of, self.rule.label) if part)

    @property
    def figure(self) -> str:
        """What was found, or why nothing could be."""
        words = self.rule.value[1] if self.reason is None else self.reason.value
        return words.format(**self.values)

    @property
    def limit(self) -> str:
        """What is asked for."""
        return self.rule.value[2].format(**self.values)

    def to_json(self) -> dict[str, object]:
        """Return the finding as plain values."""
        return {
            "check": self.check,
            "verdict": self.verdict.value,
            "reason": None if self.reason is None else self.reason.name.lower(),
            "figure": self.figure,
            "limit": self.limit,
            "values": dict(self.values),
        }


def judged(
    rule: Rule, good: bool, of: str = "", *, why: Reason | None = None, **values: object
) -> Finding:
    """Return a finding that passes if ``good``; ``why`` is the reason if it does not."""
    verdict = Verdict.PASS if good else Verdict.FAIL
    return Finding(rule=rule, of=of, verdict=verdict, values=values, reason=None if good else why)


def not_checked(rule: Rule, reason: Reason, of: str = "", **values: object) -> Finding:
    """Return a finding for what does not apply or was not asked for."""
    return Finding(rule=rule, of=of, verdict=Verdict.NOT_CHECKED, values=values, reason=reason)


def inconclusive(rule: Rule, reason: Reason, of: str = "", **values: object) -> Finding:
    """Return a finding for what was tried, but could not be decided."""
    return Finding(rule=rule, of=of, verdict=Verdict.INCONCLUSIVE, values=values, reason=reason)


def with_verdict(findings: Iterable[Finding], verdict: Verdict) -> list[str]:
    """Return the names of the checks with this verdict, in their order."""
    return [finding.check for finding in findings if finding.verdict is verdict]


def report(findings: Sequence[Finding]) -> dict[str, object]:
    """Return what ``--json`` prints of the findings."""
    count = {verdict: len(with_verdict(findings, verdict)) for verdict in Verdict}
    return {
        "schema": 1,
        "passed": not count[Verdict.FAIL] and not count[Verdict.INCONCLUSIVE],
        "pass": count[Verdict.PASS],
        "fail": count[Verdict.FAIL],
        "inconclusive": count[Verdict.INCONCLUSIVE],
        "not_checked": count[Verdict.NOT_CHECKED],
        "findings": [finding.to_json() for finding in findings],
    }
