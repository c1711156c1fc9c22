"""Problems of a result as data: a code with values. Sentences are in ``problems.yaml``."""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum
from functools import cache
from importlib.resources import files

from pydantic import Field, computed_field

from armimp_common.errors import ArmimpError
from armimp_common.schema import TextLoader, load_yaml
from armimp_estimation.json_model import JsonModel, Number


class Severity(str, Enum):
    """Effect of a problem on the verdicts that it concerns."""

    ERROR = "error"
    """They are "not valid"."""
    NOTE = "note"
    """None: the problem was corrected, or the standard errors include it."""


class Concern(str, Enum):
    """Verdict that a problem concerns."""

    IMPEDANCE = "impedance"
    """Z(f) and its confidence bands, and so all that is fitted to it."""
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
    STAMPS_APART = "stamps_apart"
    COMMANDS_MISSING = "commands_missing"
    COMMANDS_FOREIGN = "commands_foreign"
    PERTURBATIONS_FOREIGN = "perturbations_foreign"
    NOTHING_RECORDED = "nothing_recorded"
    JOINT_UNKNOWN = "joint_unknown"
    NO_PERTURBATION = "no_perturbation"
    FURTHER_JOINT_MOVED = "further_joint_moved"
    MUCH_EXCLUDED = "much_excluded"
    CUT_SHORT = "cut_short"
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
    # of the data for an estimate
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
    SENSORS_PERMUTED = "sensors_permuted"
    TRIALS_MIXED = "trials_mixed"
    DELAY_CORRECTED = "delay_corrected"
    SEEMS_LATE = "seems_late"
    TIMING_REFUTED = "timing_refuted"
    LACK_OF_FIT = "lack_of_fit"
    RESPONSE_UNEVEN = "response_uneven"
    HIGH_PASSED = "high_passed"
    MODEL_OFFERED = "model_offered"
    MODEL_DECLARED = "model_declared"
    NO_MODEL = "no_model"
    CALIBRATION_ASSUMED = "calibration_assumed"
    IMPLAUSIBLE_INERTIA = "implausible_inertia"
    UNEVEN_INERTIA = "uneven_inertia"
    POSTURES_DIFFER = "postures_differ"
    IMPLAUSIBLE_VALUE = "implausible_value"
    ANGLE_JUMPS = "angle_jumps"
    ANGLE_TOO_LARGE = "angle_too_large"
    MOTION_TOO_LARGE = "motion_too_large"
    TORQUE_UNBALANCED = "torque_unbalanced"
    TORQUES_CROSS = "torques_cross"
    COMMANDS_UNRELATED = "commands_unrelated"
    TORQUE_UNEXPLAINED = "torque_unexplained"
    GAIN_DOUBTED = "gain_doubted"
    GAIN_UNCONFIRMED = "gain_unconfirmed"
    SCALES_DIFFER = "scales_differ"
    ROBOT_INERTIA_IMPOSSIBLE = "robot_inertia_impossible"
    ROBOT_INERTIA_UNLIKE = "robot_inertia_unlike"
    CLIPPED = "clipped"
    STUCK = "stuck"
    DROPPED = "dropped"
    MENDED = "mended"
    DEAD_ZONE = "dead_zone"
    INTERPOLATED = "interpolated"
    ALIASED = "aliased"
    TIME_JUMPS = "time_jumps"
    JOINED = "joined"
    TORQUE_IS_COMMAND = "torque_is_command"
    TORQUE_FROM_COMMAND = "torque_from_command"
    UNRESOLVED = "unresolved"
    ANGLE_CONSTANT = "angle_constant"
    DEPENDS_ON_AMPLITUDE = "depends_on_amplitude"
    DEPENDS_ON_DIRECTION = "depends_on_direction"
    HYSTERESIS = "hysteresis"
    TORQUE_HYSTERESIS = "torque_hysteresis"
    TORQUE_NOT_LINEAR = "torque_not_linear"
    ANGLE_NOT_LINEAR = "angle_not_linear"
    CLOCKS_DRIFT = "clocks_drift"
    GAIN_DRIFTS = "gain_drifts"
    DEPENDS_ON_SPEED = "depends_on_speed"
    DAMPING_CHANGES = "damping_changes"
    FRICTION_LEFT = "friction_left"
    CHANGES_OVER_TIME = "changes_over_time"
    BAND_NARROWED = "band_narrowed"
    LOCK_RATIO = "lock_ratio"
    LOCK_BIAS = "lock_bias"
    NO_RESPONSE = "no_response"
    ARM_FLOATS = "arm_floats"


class Kind(JsonModel):
    """A kind of problem: several codes to which the same advice applies."""

    title: str
    """The kind in plain words."""
    advice: str
    """What the problem means and what to do about it."""
    sentences: Mapping[ProblemCode, str]
    """A sentence for each code, as a format string for its values."""


@cache
def kinds() -> Mapping[ProblemCode, Kind]:
    """Kind of each code, from ``problems.yaml``."""
    text = files(__package__).joinpath("problems.yaml").read_text(encoding="utf-8")
    found = [Kind.model_validate(one) for one in load_yaml(text, TextLoader)]
    return {code: kind for kind in found for code in kind.sentences}


class Problem(JsonModel):
    """A problem of a result, or one that was found and corrected."""

    code: ProblemCode
    """Kind of problem."""
    concern: Concern = Concern.IMPEDANCE
    """Which verdict it concerns; what concerns the impedance concerns the parameters as well."""
    severity: Severity = Severity.ERROR
    """Whether it makes that verdict "not valid"."""
    trial: int | None = None
    """Number of the trial, 1-based, if it concerns one."""
    estimator: str = ""
    """Name of the estimator, if only its estimate is concerned."""
    values: Mapping[str, int | Number | str] = Field(default_factory=dict)
    """Values that the sentence contains."""

    @computed_field  # type: ignore[prop-decorator]
    @property
    def sentence(self) -> str:
        """The problem in words, one line."""
        values = {"estimator": self.estimator, **self.values}
        where = "" if self.trial is None else f"trial {self.trial}: "
        sentence = kinds()[self.code].sentences[self.code].format(**values)
        return where + " ".join(sentence.split())

    def __str__(self) -> str:
        return self.sentence

    @classmethod
    def of(cls, error: ArmimpError, default: ProblemCode = ProblemCode.NOT_ESTIMATED) -> Problem:
        """The problem that an error reports, with the code of the error or else the default."""
        return problem(ProblemCode(error.code) if error.code else default, reason=str(error))


def problem(
    code: ProblemCode,
    *,
    concern: Concern = Concern.IMPEDANCE,
    severity: Severity = Severity.ERROR,
    trial: int | None = None,
    estimator: str = "",
    **values: float | str,
) -> Problem:
    """Return a problem; `values` are those of its sentence, the rest as for :class:`Problem`."""
    of = {"concern": concern, "severity": severity, "trial": trial, "estimator": estimator}
    return Problem.model_validate({"code": code, "values": values, **of})
