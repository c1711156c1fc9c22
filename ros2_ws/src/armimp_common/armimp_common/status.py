"""Records in which nodes report: key-values of ``diagnostic_msgs/DiagnosticStatus``.

One codec serves all of them: each record is a frozen model and each field one key, written so that
it reads back without loss. The ``message`` of the status says the same in words, for people only.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from enum import Enum, IntEnum
from typing import TYPE_CHECKING, Annotated, ClassVar, Final, TypeAlias

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    PlainSerializer,
    ValidationError,
    model_validator,
)
from typing_extensions import Self

from armimp_common.errors import MalformedMessageError
from armimp_common.topics import CONTROLLER_NODE, ESTIMATOR_NODE, NS_PER_S, SIM_NODE

if TYPE_CHECKING:
    from builtin_interfaces.msg import Time
    from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus

LIMITER_STATUS: Final = f"{CONTROLLER_NODE}: safety limiter"
"""``name`` of the controller's status on ``/diagnostics``."""

NOTICE_TICKS: Final = 200
"""Perturbed samples between those that a decision to end a trial is based on and the end.

Meanwhile the decision is made and transmitted, so that every node learns of the end beforehand.
"""

Value: TypeAlias = bool | int | float | str | Sequence[float]
"""Types that `format_value` turns into text."""

_INTERVALS: Final = r"^([0-9]{1,19}-[0-9]{1,19}( [0-9]{1,19}-[0-9]{1,19}){0,99})?$"
_MOST: Final = 2**53
"""Bound of the numbers in :class:`Progress`; larger ones are refused as implausible."""


def format_value(value: Value | None) -> str:
    """Return a value as text that reads back without loss: ``true``, ``3``, ``0.1``, ``0.1 2.0``.

    Numbers of a sequence are separated by one space; None is empty.
    """
    if value is None:
        return ""
    if isinstance(value, str):
        return str(value.value) if isinstance(value, Enum) else value
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int):
        return str(int(value))
    if isinstance(value, float):
        return repr(float(value))
    return " ".join(repr(float(item)) for item in value)


_NONE_IF_EMPTY: Final = BeforeValidator(lambda value: None if value == "" else value)
_Count: TypeAlias = Annotated[int, Field(ge=0)]
_Number: TypeAlias = Annotated[int, Field(ge=1)]
_Believed: TypeAlias = Annotated[_Count, Field(lt=_MOST)]
_Joint: TypeAlias = Annotated[
    int,
    Field(ge=0),
    # On the wire, where a person may read it, it counts from 1.
    BeforeValidator(lambda value: int(value) - 1 if isinstance(value, str) else value),
    PlainSerializer(lambda joint: joint + 1),
]
_Duration: TypeAlias = Annotated[float, BeforeValidator(lambda s: math.nan if s is None else s)]
"""NaN where nothing was measured; JSON has null for it."""
_Numbers: TypeAlias = Annotated[
    tuple[float, ...],
    BeforeValidator(lambda value: value.split() if isinstance(value, str) else value),
]
_MaybeCount: TypeAlias = Annotated[int | None, _NONE_IF_EMPTY]
_MaybeNumber: TypeAlias = Annotated[float | None, _NONE_IF_EMPTY]


class Record(BaseModel):
    """Base of records that are sent as key-values."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    STATUS_NAME: ClassVar[str]
    """``name`` of the status that carries the record: ``node: what``."""

    def to_values(self) -> dict[str, str]:
        """Return the key-values of the record."""
        return {name: format_value(value) for name, value in self.model_dump().items()}

    @classmethod
    def from_values(cls, values: Mapping[str, str]) -> Self:
        """Rebuild a record from its key-values; unknown keys are ignored.

        Raises
        ------
        MalformedMessageError
            If a value is missing, cannot be parsed, or contradicts another.
        """
        known = {name: values[name] for name in cls.model_fields if name in values}
        try:
            return cls.model_validate(known)
        except ValidationError as error:
            what, first = cls.STATUS_NAME.partition(": ")[2], error.errors()[0]
            name = ".".join(map(str, first["loc"]))
            if first["type"] == "missing":
                raise MalformedMessageError(f"{what}: {name} is missing") from None
            reason = f"{first['msg'].removeprefix('Value error, ')}: {first['input']!r:.80}"
            raise MalformedMessageError(f"{what}: {name or 'values'}: {reason}") from None


class Phase(str, Enum):
    """What the controller is doing within the sequence of trials."""

    SETTLE = "settle"
    PERTURB = "perturb"
    REST = "rest"
    DONE = "done"
    ABORTED = "aborted"


_DOING: Final = {
    Phase.SETTLE: "settling before the perturbation of",
    Phase.PERTURB: "perturbing",
    Phase.REST: "resting after the perturbation of",
    Phase.DONE: "finished with",
    Phase.ABORTED: "aborted at",
}


class Cause(str, Enum):
    """Why a trial is not valid."""

    NONE = ""
    SAMPLES_LOST = "samples_lost"
    """Samples did not reach the controller; the recorded ones can still be used."""
    SAMPLES_STOPPED = "samples_stopped"
    STAMPS = "stamps"
    """Stamps went back, or jumped as the clock of the rig was set."""
    MALFORMED = "malformed"
    """A message could not be decoded, or had values that are not finite."""
    LIMIT = "limit"
    """The safety limiter stopped at one of its limits."""
    TARE = "tare"
    NODE_LOST = "node_lost"
    NOT_RECORDED = "not_recorded"
    STRANGER = "stranger"
    """Another node published what only the estimator may publish."""
    DECISION_MISSING = "decision_missing"
    """The estimator did not say whether the trial is over."""
    EMERGENCY_STOP = "emergency_stop"
    NODE_ENDED = "node_ended"
    """The controller itself was deactivated, shut down or ended."""


class TrialStatus(Record):
    """One published state of the trial sequence."""

    STATUS_NAME: ClassVar[str] = f"{CONTROLLER_NODE}: trial"

    phase: Phase
    """What the controller is doing."""
    trial: _Number
    """Number of the present trial, from 1."""
    trials: _Number
    """Number of trials."""
    joint: _Joint
    """Perturbed joint in the order of the controller's ``joints``: from 1 in messages, from 0 in
    Python."""
    joint_name: str
    """Name of the perturbed joint."""
    tick: _Count
    """Samples answered since the experiment began."""
    start_ns: _MaybeCount
    """Stamp of the first perturbed sample of this trial (ns); empty until it is known."""
    ticks: _Count
    """Perturbed samples of this trial: as planned, or fewer once it is known to end early."""
    seed: _MaybeCount
    """Seed of the perturbation; empty if it is unknown."""
    valid: bool
    """False as soon as something has made the present trial invalid."""
    cause: Cause = Cause.NONE
    """Why the trial is not valid, as a code; empty if it is valid."""
    reason: str = ""
    """Why the trial is not valid, in words."""
    lost: _Count = 0
    """Samples missing between those of this trial that reached the controller."""
    clipped: _Count = 0
    """Joint commands that the safety limiter clipped so far during the perturbation of
    this trial."""
    clipped_intervals: str = Field(default="", pattern=_INTERVALS)
    """Clipped ticks, ``first-last first-last ...``, from the first perturbed sample, which is 0; at
    most 100 intervals, which hold all clipped ticks (and others, if there would be more)."""
    tare: _Numbers = ()
    """What the torque transducer of each joint read at rest before this trial (N·m); empty until
    that is known, and without a tare."""
    tare_error: _Numbers = ()
    """Standard errors of ``tare`` (N·m); empty where that is."""

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        if self.trial > self.trials:
            raise ValueError(f"trial {self.trial} is not within 1..{self.trials}")
        if self.phase is Phase.PERTURB and self.start_ns is None:
            raise ValueError("start_ns is missing in phase perturb")
        return self

    @property
    def level(self) -> Level:
        """ERROR for an aborted trial, WARN for another one that is not valid."""
        if self.phase is Phase.ABORTED:
            return Level.ERROR
        return Level.OK if self.valid else Level.WARN

    @property
    def sentence(self) -> str:
        """The status in words, for the ``message`` of the DiagnosticStatus."""
        text = (
            f"trial {self.trial} of {self.trials}: {_DOING[self.phase]}"
            f" joint {self.joint + 1} ({self.joint_name})"
        )
        if not self.valid:
            text += f"; not valid: {self.reason or 'no reason given'}"
        return text


class StoppingDecision(Record):
    """Whether a trial has lasted long enough, by the stopping rule of the estimator."""

    STATUS_NAME: ClassVar[str] = f"{ESTIMATOR_NODE}: stopping"

    trial: _Number
    """Number of the trial, from 1."""
    samples: _Count
    """Perturbed samples that were judged, counted from the start of the trial; 0 announces the
    first decision."""
    enough: bool
    """Whether all relative standard errors of the column are below the bound."""
    due: _MaybeCount
    """Number of samples at which the next decision is made; empty if there will be none."""
    bound: float
    """Relative standard error below which the trial may end, ``target_error``."""
    largest: float = math.nan
    """Largest standard error (one, not 95 %) of M, B and K of the column, relative to the absolute
    value of its parameter; NaN if it is not known."""
    element: str = ""
    """Element with that error, such as ``K21``; empty if it is not known."""

    @model_validator(mode="after")
    def _is_due_later(self) -> Self:
        if self.due is not None and self.due <= self.samples:
            raise ValueError(f"due at {self.due} samples, after {self.samples}")
        return self

    @property
    def sentence(self) -> str:
        """The decision in words."""
        bound = f"{100.0 * self.bound:g} %"
        if not self.samples:
            return f"trial {self.trial}: ends once standard errors are below {bound}"
        found = "not known"
        if not math.isnan(self.largest):
            found = f"{100.0 * self.largest:.3g} % ({self.element})"
        verb = "is" if self.enough else "is not"
        return f"trial {self.trial}: largest standard error {found} {verb} below {bound}"


class TimingFigures(Record):
    """Timing of a rig in real time, from the first sample on."""

    STATUS_NAME: ClassVar[str] = f"{SIM_NODE}: timing"

    ticks: _Count
    """Samples sent, in and between all trials."""
    late: _Count
    """Samples sent more than 0.25 ms after their deadline."""
    missed: _Count
    """Periods whose command did not come in time, so that the last one was held."""
    period_p50: _Duration = math.nan
    """Median time from one sample to the next (s); quantiles are of up to 4096 drawn at random."""
    period_p99: _Duration = math.nan
    """99 % quantile of the time from one sample to the next (s)."""
    period_max: _Duration = math.nan
    """Longest time from one sample to the next (s)."""
    latency_p50: _Duration = math.nan
    """Median time from a sample to the command that answers it, both at the rig (s)."""
    latency_p99: _Duration = math.nan
    """99 % quantile of the time from a sample to its command (s)."""
    latency_max: _Duration = math.nan
    """Longest time from a sample to its command (s)."""

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        if max(self.late, self.missed) > self.ticks:
            raise ValueError(f"late {self.late} or missed {self.missed} of {self.ticks} samples")
        return self

    @property
    def sentence(self) -> str:
        """What the record is."""
        return "timing since activation"


class Progress(Record):
    """Progress of an experiment, for display."""

    STATUS_NAME: ClassVar[str] = f"{ESTIMATOR_NODE}: progress"

    trial: _Believed = Field(ge=1)
    """Number of the present trial, from 1."""
    trials: _Believed = Field(ge=1)
    """Number of trials; it may be below ``trial`` if a replay leaves trials out."""
    joint: _Believed
    """Perturbed joint k, from 1."""
    phase: Phase
    """What the controller is doing."""
    samples: _Believed
    """Complete perturbed samples recorded so far."""
    planned: _Believed
    """Perturbed samples planned for the trial."""
    rate: float = Field(ge=0.0, lt=_MOST)
    """Samples per second of wall time."""
    coherence_motion: _MaybeNumber = None
    """Band mean of γ²(τ_Δ, θ_k) so far, from two segments on."""
    coherence_torque: _MaybeNumber = None
    """Band mean of γ²(τ_Δ, τ_k) so far, likewise."""
    M: _Numbers = ()
    """Column k of the inertia as ``lpm_full`` estimates it from this trial so far and earlier ones
    (kg·m²); renewed at most once a second, empty while samples are too few or if one is missing."""
    M_se: _Numbers = ()
    """Standard errors of M."""
    B: _Numbers = ()
    """Column k of the viscosity, likewise (N·m·s/rad)."""
    B_se: _Numbers = ()
    """Standard errors of B."""
    K: _Numbers = ()
    """Column k of the stiffness, likewise (N·m/rad)."""
    K_se: _Numbers = ()
    """Standard errors of K."""
    largest_error: _MaybeNumber = None
    """Largest of these standard errors relative to the absolute value of its parameter."""
    preliminary: bool = False
    """Whether another joint has had no trial yet: the values then are biased by the motion of the
    locked joints, which the standard errors do not include."""

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        if len({len(part) for pair in self.column for part in pair}) > 1:
            raise ValueError("M, B and K are not equally many numbers")
        return self

    @property
    def column(self) -> tuple[tuple[tuple[float, ...], tuple[float, ...]], ...]:
        """Values and standard errors of M, B and K in the column of the joint."""
        return (self.M, self.M_se), (self.B, self.B_se), (self.K, self.K_se)

    @property
    def sentence(self) -> str:
        """How far the trial is, in words."""
        return f"trial {self.trial} of {self.trials}: {self.samples} of {self.planned}"


class Level(IntEnum):
    """Severity, with numbers of ``diagnostic_msgs/msg/DiagnosticStatus``."""

    OK = 0
    WARN = 1
    ERROR = 2


def make_status(
    name: str, level: Level, message: str, values: Mapping[str, Value] | None = None
) -> DiagnosticStatus:
    """Return a ``DiagnosticStatus`` message.

    Parameters
    ----------
    name : ``node: what``, as the convention of diagnostics has it
    level, message : severity, and the state in words
    values : key-values, kept in their order
    """
    # Imported here so that what needs no ROS in this module can be used without it.
    from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

    return DiagnosticStatus(
        level=bytes([level]),
        name=name,
        message=message,
        values=[KeyValue(key=key, value=format_value(v)) for key, v in (values or {}).items()],
    )


def status_message(
    record: TrialStatus | StoppingDecision | TimingFigures | Progress,
) -> DiagnosticStatus:
    """Return a record as a ``DiagnosticStatus`` message."""
    level = record.level if isinstance(record, TrialStatus) else Level.OK
    return make_status(record.STATUS_NAME, level, record.sentence, record.to_values())


def make_array(stamp_ns: int, statuses: Iterable[DiagnosticStatus]) -> DiagnosticArray:
    """Return a ``DiagnosticArray`` message with stamp `stamp_ns` (ns)."""
    from diagnostic_msgs.msg import DiagnosticArray

    array = DiagnosticArray(status=list(statuses))
    array.header.stamp = to_time(stamp_ns)
    return array


def values_of(status: DiagnosticStatus) -> dict[str, str]:
    """Return the key-values of a ``DiagnosticStatus`` message."""
    return {item.key: item.value for item in status.values}


def to_time(stamp_ns: int) -> Time:
    """Return the message for a stamp (ns); fails if its seconds do not fit 32 bits."""
    from builtin_interfaces.msg import Time

    sec, nanosec = divmod(stamp_ns, NS_PER_S)
    return Time(sec=sec, nanosec=nanosec)
