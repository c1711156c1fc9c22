"""What is wrong with a result, as data: a code with values. Words are made here alone."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from enum import Enum
from typing import Final

from pydantic import Field, computed_field

from armimp_common.errors import ArmimpError
from armimp_estimation.json_model import JsonModel, Number


class Severity(str, Enum):
    """What a problem does to the verdicts that it concerns."""

    ERROR = "error"
    """They say not valid."""
    NOTE = "note"
    """Nothing: it was corrected, or is in the standard errors."""


class Concern(str, Enum):
    """Which verdict a problem concerns."""

    IMPEDANCE = "impedance"
    """Z(f) and its bands, and with them all that is fitted to it."""
    PARAMETERS = "parameters"
    """M, B and K and their intervals; Z(f) may be right."""


class ProblemCode(str, Enum):
    """Kinds of problems."""

    # of the samples of a trial
    SAMPLES_MISSING = "samples_missing"
    SAMPLES_MALFORMED = "samples_malformed"
    SAMPLES_NOT_FINITE = "samples_not_finite"
    SAMPLES_CONTRADICTORY = "samples_contradictory"
    SAMPLES_REPEATED = "samples_repeated"
    SAMPLES_REORDERED = "samples_reordered"
    SAMPLES_LOST = "samples_lost"
    STAMPS_DISAGREE = "stamps_disagree"
    COMMANDS_MISSING = "commands_missing"
    COMMANDS_FOREIGN = "commands_foreign"
    PERTURBATIONS_FOREIGN = "perturbations_foreign"
    NOTHING_RECORDED = "nothing_recorded"
    JOINT_UNKNOWN = "joint_unknown"
    NO_PERTURBATION = "no_perturbation"
    MUCH_EXCLUDED = "much_excluded"
    CLIPPED_UNKNOWN = "clipped_unknown"
    # of the run
    TRIAL_ABORTED = "trial_aborted"
    TRIAL_SPOILED = "trial_spoiled"
    MESSAGE_REFUSED = "message_refused"
    RECORDING_FAILED = "recording_failed"
    RECORDING_STOPPED = "recording_stopped"
    INTERRUPTED = "interrupted"
    STALLED = "stalled"
    NODE_FAILED = "node_failed"
    NODE_FAULT = "node_fault"
    PARAMETERS_DIFFER = "parameters_differ"
    SAMPLES_LATE = "samples_late"
    COMMANDS_LATE = "commands_late"
    LATENCY = "latency"
    # of what there is to estimate from
    NOT_ESTIMATED = "not_estimated"
    RECORD_TOO_SHORT = "record_too_short"
    TRIALS_INCOMPLETE = "trials_incomplete"
    JOINT_DOES_NOT_MOVE = "joint_does_not_move"
    # of signals and estimates
    RATE_UNCUSTOMARY = "rate_uncustomary"
    RATE_UNPLANNED = "rate_unplanned"
    RATE_DRIFTS = "rate_drifts"
    STAMPS_IRREGULAR = "stamps_irregular"
    STREAM_RATES_DIFFER = "stream_rates_differ"
    COMMANDS_PERMUTED = "commands_permuted"
    DELAY_CORRECTED = "delay_corrected"
    TIMING_REFUTED = "timing_refuted"
    LACK_OF_FIT = "lack_of_fit"
    MODEL_OFFERED = "model_offered"
    NO_MODEL = "no_model"
    CALIBRATION_ASSUMED = "calibration_assumed"
    IMPLAUSIBLE_INERTIA = "implausible_inertia"
    IMPLAUSIBLE_VALUE = "implausible_value"
    IMPLAUSIBLE_ANGLE = "implausible_angle"
    TORQUE_UNBALANCED = "torque_unbalanced"
    ROBOT_INERTIA_IMPOSSIBLE = "robot_inertia_impossible"
    CLIPPED = "clipped"
    STUCK = "stuck"
    UNRESOLVED = "unresolved"
    DEPENDS_ON_AMPLITUDE = "depends_on_amplitude"
    DEPENDS_ON_SPEED = "depends_on_speed"
    CHANGES_OVER_TIME = "changes_over_time"
    LOCK_RATIO = "lock_ratio"
    LOCK_BIAS = "lock_bias"
    NO_RESPONSE = "no_response"


_WHERE = "{count:d}, between {first:.3f} s and {last:.3f} s"

SENTENCES: Final[Mapping[ProblemCode, str]] = {
    ProblemCode.SAMPLES_MISSING: f"samples of {{stream}} are missing: {_WHERE}",
    ProblemCode.SAMPLES_MALFORMED: (
        "messages of {stream} are malformed: {count:d}, the first: {reason}"
    ),
    ProblemCode.SAMPLES_NOT_FINITE: f"samples of {{stream}} are not finite: {_WHERE}",
    ProblemCode.SAMPLES_CONTRADICTORY: f"samples of {{stream}} contradict themselves: {_WHERE}",
    ProblemCode.SAMPLES_REPEATED: "samples of {stream} came more than once: {count:d}",
    ProblemCode.SAMPLES_REORDERED: "samples of {stream} came out of order: {count:d}",
    ProblemCode.SAMPLES_LOST: "{reason}",
    ProblemCode.STAMPS_DISAGREE: (
        "stamps of the streams do not agree: {count:d}, the first {apart_ns:d} ns from its "
        "neighbour"
    ),
    ProblemCode.COMMANDS_MISSING: "there are {count:d} commands fewer than samples",
    ProblemCode.COMMANDS_FOREIGN: (
        "{count:d} commands are too many or out of turn: somebody else commanded"
    ),
    ProblemCode.PERTURBATIONS_FOREIGN: (
        "{count:d} perturbations are out of turn outside the trial, so that commands cannot be "
        "matched: somebody else published"
    ),
    ProblemCode.NOTHING_RECORDED: "no samples of it were recorded",
    ProblemCode.JOINT_UNKNOWN: "the perturbed joint {name} is none of {known}",
    ProblemCode.NO_PERTURBATION: "the perturbation is zero throughout",
    ProblemCode.MUCH_EXCLUDED: (
        "{percent:.3g} % of its samples are excluded (limit {limit:.3g} %)"
    ),
    ProblemCode.CLIPPED_UNKNOWN: "{count:d} commands were clipped, and it is not known when",
    ProblemCode.TRIAL_ABORTED: "aborted: {reason}",
    ProblemCode.TRIAL_SPOILED: "not valid: {reason}",
    ProblemCode.MESSAGE_REFUSED: "{stream}: {reason}",
    ProblemCode.RECORDING_FAILED: "{reason}",
    ProblemCode.RECORDING_STOPPED: "{reason}",
    ProblemCode.INTERRUPTED: "interrupted by the user",
    ProblemCode.STALLED: "nothing happened for {seconds:g} s",
    ProblemCode.NODE_FAILED: "{reason}",
    ProblemCode.NODE_FAULT: "{source}: {reason}",
    ProblemCode.PARAMETERS_DIFFER: "{reason}",
    ProblemCode.SAMPLES_LATE: (
        "real time: {count:d} of {ticks:d} samples were sent more than {late_ms:g} ms late, "
        "{percent:.3g} % (limit {limit:.3g} %)"
    ),
    ProblemCode.COMMANDS_LATE: (
        "real time: {count:d} of {ticks:d} commands did not come in time, {percent:.3g} % "
        "(limit {limit:.3g} %)"
    ),
    ProblemCode.LATENCY: (
        "real time: the 99 % quantile of the time from a sample to its command is {ms:.3g} ms "
        "(limit {limit:.3g} ms)"
    ),
    ProblemCode.NOT_ESTIMATED: "{reason}",
    ProblemCode.RECORD_TOO_SHORT: "{reason}",
    ProblemCode.TRIALS_INCOMPLETE: "{reason}",
    ProblemCode.JOINT_DOES_NOT_MOVE: "{reason}",
    ProblemCode.RATE_UNCUSTOMARY: (
        "stamps give a sampling rate of {rate:.7g} Hz, which is not a customary one: "
        "if it is right, declare it with --rate {rate:.7g}"
    ),
    ProblemCode.RATE_UNPLANNED: (
        "stamps give a sampling rate of {rate:.7g} Hz, but {planned:.7g} Hz were expected"
    ),
    ProblemCode.RATE_DRIFTS: (
        "the sampling rate drifts: stamps give {first:.7g} Hz in the first half, "
        "{second:.7g} Hz in the second"
    ),
    ProblemCode.STAMPS_IRREGULAR: (
        "stamps are irregular: they scatter by {scatter:.3g} periods (rms) and up to "
        "{largest:.3g} periods about a rate of {rate:.7g} Hz"
    ),
    ProblemCode.STREAM_RATES_DIFFER: (
        "stamps of {stream} give {rate:.7g} Hz, those of the others {other:.7g} Hz"
    ),
    ProblemCode.COMMANDS_PERMUTED: (
        "commands are in another order than the joints: {order}; they were put in order"
    ),
    ProblemCode.DELAY_CORRECTED: (
        "torques are late against angles by {delay_ms:.4g} ± {error_ms:.2g} ms; this was corrected"
    ),
    ProblemCode.TIMING_REFUTED: (
        "the declared instant of the torque readings ({declared}) is refuted by the records: "
        "torques are late by a further {delay_ms:.4g} ± {error_ms:.2g} ms, which was corrected"
    ),
    ProblemCode.LACK_OF_FIT: (
        "{estimator}: element {element} is not of the form M s² + B s + K: its lack of fit is "
        "{lack:.3g} times what noise explains (limit {limit:.3g})"
    ),
    ProblemCode.MODEL_OFFERED: (
        "{estimator}: the data support the model {model}, Z = {equation}, with a lack of fit of "
        "{lack:.3g}: {text}; its M, B and K stand beside the others"
    ),
    ProblemCode.NO_MODEL: ("{estimator}: noise doesn't explain what these models leave: {models}"),
    ProblemCode.CALIBRATION_ASSUMED: (
        "nobody declared how well the torque transducers are calibrated: standard errors assume "
        "{gain:.3g} % of gain and {cross_talk:.3g} % of cross-talk (--gain-uncertainty, "
        "--cross-talk-uncertainty)"
    ),
    ProblemCode.IMPLAUSIBLE_INERTIA: (
        "{estimator}: {matrix} is not that of a passive arm: its symmetric part has the eigenvalue "
        "{value:.3g} ± {error:.2g} {unit}; {suspect}"
    ),
    ProblemCode.IMPLAUSIBLE_VALUE: (
        "{estimator}: {matrix} of {name} is {value:.3g} {unit}, outside of what an arm may have "
        "({low:g} to {high:g}); check sign and unit of its torque and angle"
    ),
    ProblemCode.IMPLAUSIBLE_ANGLE: (
        "angles of {name} {what} {value:.3g}: they can't be radians; are they degrees?"
    ),
    ProblemCode.TORQUE_UNBALANCED: (
        "torque of {name} and its command disagree: the transducer shows {share:.3g} ± {error:.2g} "
        "times the stiffness that the command feels; check sign, unit, gain and order of both"
    ),
    ProblemCode.ROBOT_INERTIA_IMPOSSIBLE: (
        "commands less torques move a robot of the inertia {inertia}, which is impossible: "
        "check sign, unit, gain and order of commands, torques and angles of {name}"
    ),
    ProblemCode.CLIPPED: (
        "{stream} of {name} is clipped at {value:.4g} {unit} in {count:d} samples"
    ),
    ProblemCode.STUCK: (
        "{stream} of {name} is stuck: it keeps one value for {longest:.3g} s, "
        "{count:d} times for longer than {limit:.2g} s"
    ),
    ProblemCode.UNRESOLVED: (
        "{stream} of {name} moves by {counts:.2g} counts of its resolution only: "
        "what depends on it isn't resolved"
    ),
    ProblemCode.DEPENDS_ON_AMPLITUDE: (
        "the stiffness of {name} depends on the amplitude: it changes by {percent:.3g} ± "
        "{error:.2g} % from rest to the rms angle; the estimate is the best linear one there"
    ),
    ProblemCode.DEPENDS_ON_SPEED: (
        "the torque of {name} isn't in proportion to its speed, as of a spring that yields: it "
        "changes by {percent:.3g} ± {error:.2g} % of the stiffness from rest to the rms speed; the "
        "estimate is the best linear one there"
    ),
    ProblemCode.CHANGES_OVER_TIME: (
        "the stiffness of {name} changes by {percent:.3g} ± {error:.2g} % over the trial; "
        "the estimate is its mean"
    ),
    ProblemCode.LOCK_RATIO: (
        "{estimator}: {name} was not held still while {perturbed} was perturbed: within the band "
        "it moved by {percent:.3g} % of it (limit {limit:.3g} %)"
    ),
    ProblemCode.LOCK_BIAS: (
        "{estimator}: motion of {moving} while {perturbed} was perturbed explains {percent:.3g} % "
        "of the torque of {name} (limit {limit:.3g} %): element {element} may be biased as much"
    ),
    ProblemCode.NO_RESPONSE: (
        "{stream} of {name} does not follow the perturbation of {perturbed}: mean coherence "
        "{coherence:.3g} is not significant (level {level:.3g})"
    ),
}
"""One sentence for each code, with places for its values."""


class Problem(JsonModel):
    """One thing that is wrong, or was found and put right.

    Attributes
    ----------
    code : ProblemCode
        Kind of problem.
    concern : Concern
        Which verdict it concerns; what concerns the impedance concerns the parameters as well.
    severity : Severity
        Whether it makes that verdict say not valid.
    trial : int or None
        Number of the trial, 1-based, if it is of one.
    estimator : str
        The estimator, if only the estimate of one is concerned.
    values : mapping of str to float, int or str
        What the sentence of the code tells.
    """

    code: ProblemCode
    concern: Concern = Concern.IMPEDANCE
    severity: Severity = Severity.ERROR
    trial: int | None = None
    estimator: str = ""
    values: Mapping[str, int | Number | str] = Field(default_factory=dict)

    @computed_field  # type: ignore[prop-decorator]
    @property
    def sentence(self) -> str:
        """The problem in words, one line."""
        values = {"estimator": self.estimator, **self.values}
        where = "" if self.trial is None else f"trial {self.trial}: "
        return where + " ".join(SENTENCES[self.code].format(**values).split())

    def __str__(self) -> str:
        return self.sentence

    def spoils(self, concern: Concern, estimator: str = "") -> bool:
        """Whether it makes a verdict say not valid, for one estimator or for all."""
        if self.severity is not Severity.ERROR or self.estimator not in ("", estimator):
            return False
        return concern is Concern.PARAMETERS or self.concern is concern

    @classmethod
    def of(cls, error: ArmimpError, default: ProblemCode = ProblemCode.NOT_ESTIMATED) -> Problem:
        """The problem that an error tells of, by the code that it carries."""
        return problem(ProblemCode(error.code) if error.code else default, reason=str(error))


def problem(code: ProblemCode, **values: float | str) -> Problem:
    """Return a problem of a run, with the values of its sentence."""
    return Problem(code=code, values=values)


def spoiled(problems: Iterable[Problem], concern: Concern, estimator: str = "") -> bool:
    """Whether one of the problems makes a verdict say not valid."""
    return any(one.spoils(concern, estimator) for one in problems)
