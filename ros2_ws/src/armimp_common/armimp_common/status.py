"""What nodes report of themselves: records as key-values of ``diagnostic_msgs/DiagnosticStatus``.

One codec for all of them: each record is a frozen dataclass, each field one key, written so that it
reads back without loss. The message of the status has the same in words, for people alone.
"""

from __future__ import annotations

import math
import re
import types
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import MISSING, Field, dataclass, field, fields
from enum import Enum, IntEnum
from functools import cache
from typing import TYPE_CHECKING, Any, ClassVar, Final, TypeAlias, cast, get_args, get_type_hints

from armimp_common.errors import ConfigurationError, MalformedMessageError
from armimp_common.topics import CONTROLLER_NODE, ESTIMATOR_NODE, NS_PER_S, SIM_NODE

if TYPE_CHECKING:
    from builtin_interfaces.msg import Time
    from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
    from typing_extensions import Self

LIMITER_STATUS: Final = f"{CONTROLLER_NODE}: safety limiter"
"""``name`` of the controller's status on ``/diagnostics``."""

NOTICE_TICKS: Final = 200
"""Perturbed samples of a trial that follow those by which the estimator ends it.

Its decision is made and travels meanwhile, and everybody hears of the end before it comes.
"""

Value: TypeAlias = bool | int | float | str | Sequence[float]
"""What `format_value` turns into text."""

_INTEGER: Final = re.compile(r"-?[0-9]{1,40}")
_INTERVALS: Final = re.compile(r"([0-9]{1,19}-[0-9]{1,19}( [0-9]{1,19}-[0-9]{1,19}){0,99})?")
_MOST: Final = 2**53
"""Numbers of progress beyond which nobody is believed."""
_FROM_ONE: Final = {"from_one": True}
"""Marks a field that counts from 0, and from 1 on the wire, where a person may read it."""


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


def _integer(text: str) -> int:
    if not _INTEGER.fullmatch(text):
        raise ValueError
    return int(text)


_PARSERS: Final[dict[Any, tuple[Callable[[str], Any], str]]] = {
    str: (str, "text"),
    bool: ({"true": True, "false": False}.__getitem__, "true or false"),
    int: (_integer, "an integer"),
    float: (float, "a number"),
    tuple[float, ...]: (lambda text: tuple(map(float, text.split())), "numbers"),
}


@cache
def _types(record: Any) -> dict[str, Any]:
    return get_type_hints(record)


def _fields(record: Any) -> tuple[Field[Any], ...]:
    return fields(record)


def _parsed(kind: Any, text: str) -> Any:
    if isinstance(kind, types.UnionType):  # something or None
        return _parsed(get_args(kind)[0], text) if text else None
    parser = _PARSERS[kind][0] if kind in _PARSERS else kind  # an enumeration
    return parser(text)


class Record:
    """Base of frozen dataclasses that travel as key-values."""

    STATUS_NAME: ClassVar[str]
    """``name`` of the status that carries the record: ``node: what``."""

    def to_values(self) -> dict[str, str]:
        """Return the key-values of the record."""
        values = {one.name: getattr(self, one.name) for one in _fields(type(self))}
        values.update(
            {one.name: values[one.name] + 1 for one in _fields(type(self)) if one.metadata}
        )
        return {name: format_value(value) for name, value in values.items()}

    @classmethod
    def from_values(cls, values: Mapping[str, str]) -> Self:
        """Rebuild a record from its key-values; keys that are not known are ignored.

        Raises
        ------
        MalformedMessageError
            If a value is missing, cannot be parsed, or contradicts another.
        """
        what = cls.STATUS_NAME.partition(": ")[2]
        kinds = _types(record := cast(Any, cls))
        found: dict[str, Any] = {}
        for one in _fields(record):
            if one.name not in values:
                if one.default is MISSING:
                    raise MalformedMessageError(f"{what}: {one.name} is missing")
                continue
            text, kind = values[one.name], kinds[one.name]
            try:
                found[one.name] = _parsed(kind, text) - 1 if one.metadata else _parsed(kind, text)
            except (ValueError, KeyError):
                expected = _PARSERS.get(kind, (None, "known"))[1]
                raise MalformedMessageError(
                    f"{what}: {one.name} is not {expected}: {text!r:.80}"
                ) from None
        try:
            return cls(**found)
        except ConfigurationError as error:
            raise MalformedMessageError(f"{what}: {error}") from None


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
    """Samples did not reach the controller; those that were recorded may be used."""
    SAMPLES_STOPPED = "samples_stopped"
    STAMPS = "stamps"
    """Stamps went back, or jumped as the clock of the rig was set."""
    MALFORMED = "malformed"
    """A message that cannot be decoded, or has values that are not finite."""
    LIMIT = "limit"
    """The safety limiter stopped at one of its limits."""
    TARE = "tare"
    NODE_LOST = "node_lost"
    NOT_RECORDED = "not_recorded"
    STRANGER = "stranger"
    """Somebody else publishes what the estimator alone may say."""
    DECISION_MISSING = "decision_missing"
    """The estimator did not say whether the trial is over."""
    EMERGENCY_STOP = "emergency_stop"
    NODE_ENDED = "node_ended"
    """The controller itself was deactivated, shut down or ended."""
    OTHER = "other"


@dataclass(frozen=True, kw_only=True)
class TrialStatus(Record):
    """One published state of the trial sequence.

    Raises
    ------
    ConfigurationError
        If the numbers contradict one another.
    """

    STATUS_NAME: ClassVar[str] = f"{CONTROLLER_NODE}: trial"

    phase: Phase
    """What the controller is doing."""
    trial: int
    trials: int
    """Number of the present trial, from 1, and how many there are."""
    joint: int = field(metadata=_FROM_ONE)
    """Perturbed joint, from 0 (written from 1 on the wire)."""
    joint_name: str
    """Its name."""
    tick: int
    """Controller ticks since activation."""
    start_ns: int | None
    """Stamp of the first perturbed sample of this trial (ns); None until it is known."""
    ticks: int
    """Planned number of perturbed samples of this trial."""
    seed: int
    """Seed of the experiment."""
    valid: bool
    """False as soon as something spoiled the present trial."""
    cause: Cause = Cause.NONE
    reason: str = ""
    """Why it is not valid: as a code, and in words."""
    lost: int = 0
    """Samples that did not reach the controller between others of this trial."""
    clipped: int = 0
    """Joint commands that the safety limiter clipped so far during the perturbation of
    this trial."""
    clipped_intervals: str = ""
    """When: ``first-last first-last ...`` in ticks from the first perturbed sample, which is 0; at
    most 100 intervals, which hold all clipped ticks (and others, where there would be more)."""
    tare: tuple[float, ...] = ()
    tare_error: tuple[float, ...] = ()
    """What each torque transducer read at rest before this trial, and its standard error (N·m);
    empty as long as that is not known."""

    def __post_init__(self) -> None:
        if not 1 <= self.trial <= self.trials:
            raise ConfigurationError(f"trial {self.trial} is not within 1..{self.trials}")
        for name in ("joint", "tick", "ticks", "seed", "lost", "clipped"):
            if getattr(self, name) < 0:
                raise ConfigurationError(f"{name} is negative: {getattr(self, name)}")
        if self.phase is Phase.PERTURB and self.start_ns is None:
            raise ConfigurationError("start_ns is missing in phase perturb")
        if not _INTERVALS.fullmatch(self.clipped_intervals):
            raise ConfigurationError(
                f"clipped_intervals is not a list of intervals: {self.clipped_intervals!r:.80}"
            )

    @property
    def sentence(self) -> str:
        """The state in words, for the ``message`` of the DiagnosticStatus."""
        text = (
            f"trial {self.trial} of {self.trials}: {_DOING[self.phase]}"
            f" joint {self.joint + 1} ({self.joint_name})"
        )
        if not self.valid:
            text += f"; not valid: {self.reason or 'no reason given'}"
        return text


@dataclass(frozen=True, kw_only=True)
class StoppingDecision(Record):
    """Whether a trial has lasted long enough, by the stopping rule of the estimator.

    Raises
    ------
    ConfigurationError
        If a number is negative, or the next decision is due before this one.
    """

    STATUS_NAME: ClassVar[str] = f"{ESTIMATOR_NODE}: stopping"

    trial: int
    """Number of the trial, from 1."""
    samples: int
    """Perturbed samples that the decision is based on; 0 announces the first decision."""
    enough: bool
    """Whether all relative standard errors are below the bound."""
    due: int | None
    """Number of samples at which the next decision is made; None if there will be none."""
    bound: float
    """Largest relative standard error that is enough."""
    largest: float = math.nan
    """Largest one there is; NaN if it is not known."""
    element: str = ""
    """Where it is, such as ``K21``; empty if it is not known."""

    def __post_init__(self) -> None:
        if self.trial < 1 or self.samples < 0:
            raise ConfigurationError(f"trial {self.trial} cannot end after {self.samples} samples")
        if self.due is not None and self.due <= self.samples:
            raise ConfigurationError(f"due at {self.due} samples, after {self.samples}")

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


@dataclass(frozen=True, kw_only=True)
class TimingFigures(Record):
    """Timing of a rig in real time, from the first sample on.

    Raises
    ------
    ConfigurationError
        If a count is negative or larger than the number of samples.
    """

    STATUS_NAME: ClassVar[str] = f"{SIM_NODE}: timing"

    ticks: int
    """Samples sent."""
    late: int
    """Those sent more than :data:`armimp_common.realtime.LATE_NS` after their deadline."""
    missed: int
    """Periods for which the command did not come in time, so that the last one was held."""
    period_p50: float = math.nan
    period_p99: float = math.nan
    period_max: float = math.nan
    """Median, 99 % quantile and maximum of the time from one sample to the next, s."""
    latency_p50: float = math.nan
    latency_p99: float = math.nan
    latency_max: float = math.nan
    """The same of the time from a sample to the command that answers it, both at the rig, s."""

    def __post_init__(self) -> None:
        for name in ("ticks", "late", "missed"):
            if not 0 <= getattr(self, name) <= self.ticks:
                raise ConfigurationError(
                    f"{name} must lie between 0 and the number of samples, {self.ticks}, "
                    f"got {getattr(self, name)}"
                )

    @property
    def sentence(self) -> str:
        """What the record is."""
        return "timing since activation"


@dataclass(frozen=True, kw_only=True)
class Progress(Record):
    """Where an experiment stands, for display.

    Raises
    ------
    ConfigurationError
        If a number is impossible, or the columns differ in length.
    """

    STATUS_NAME: ClassVar[str] = f"{ESTIMATOR_NODE}: progress"

    trial: int
    trials: int
    """Number of the present trial, from 1, and how many there are."""
    joint: int
    """Perturbed joint k, from 1."""
    phase: Phase
    """What the controller is doing."""
    samples: int
    planned: int
    """Perturbed samples recorded so far, and those that there will be."""
    rate: float
    """Samples per second of wall time."""
    coherence_motion: float | None = None
    coherence_torque: float | None = None
    """Band means of γ²(τ_Δ, θ_k) and γ²(τ_Δ, τ_k) so far; None as long as there are none."""
    M: tuple[float, ...] = ()
    M_se: tuple[float, ...] = ()
    B: tuple[float, ...] = ()
    B_se: tuple[float, ...] = ()
    K: tuple[float, ...] = ()
    K_se: tuple[float, ...] = ()
    """Column k of the matrices so far (n,) and its standard errors, SI units; empty as long as
    there is none."""
    largest_error: float | None = None
    """Largest one of these standard errors, relative."""
    preliminary: bool = False
    """Whether motion of locked joints is in the values, as those had no trial yet."""

    def __post_init__(self) -> None:
        counts = (self.trial, self.trials, self.joint, self.samples, self.planned)
        # A trial may be above their count: trials of a session may be left out of its replay.
        if not (
            min(self.trial, self.trials) >= 1
            and 0 <= min(counts) <= max(counts) < _MOST
            and 0.0 <= self.rate < _MOST
        ):
            raise ConfigurationError(f"numbers that cannot be: {counts}, {self.rate:g} Hz")
        if len({len(part) for pair in self.column for part in pair}) > 1:
            raise ConfigurationError("M, B and K are not equally many numbers")

    @property
    def column(self) -> tuple[tuple[tuple[float, ...], tuple[float, ...]], ...]:
        """Values and standard errors of M, B and K in the column of the joint."""
        return (self.M, self.M_se), (self.B, self.B_se), (self.K, self.K_se)

    @property
    def sentence(self) -> str:
        """How far the trial is."""
        return f"trial {self.trial} of {self.trials}: {self.samples} of {self.planned}"


class Level(IntEnum):
    """Severity, with the numbers of ``diagnostic_msgs/msg/DiagnosticStatus``."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


def make_status(
    name: str, level: Level, message: str, values: Mapping[str, Value] | None = None
) -> DiagnosticStatus:
    """Return a ``DiagnosticStatus`` message.

    Parameters
    ----------
    name
        ``node: what``, as the convention of diagnostics has it.
    level, message
        Severity, and the state in words.
    values
        Key-values, kept in their order.
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
    """Return the message of a record; of trials ERROR if aborted, WARN if not valid, else OK."""
    level = Level.OK
    if isinstance(record, TrialStatus) and not record.valid:
        level = Level.ERROR if record.phase is Phase.ABORTED else Level.WARN
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


def to_ns(time: Time) -> int:
    """Return the stamp (ns) of a message."""
    return int(time.sec) * NS_PER_S + int(time.nanosec)
