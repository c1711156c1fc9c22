"""Building of diagnostic messages from plain values."""

from collections.abc import Iterable, Mapping, Sequence
from enum import IntEnum
from typing import TYPE_CHECKING, TypeAlias

from armimp_common.contract import CONTROLLER_NODE
from armimp_common.jitter import TIMING_NAME, TimingFigures
from armimp_common.stopping_rule import JUDGEMENT_NAME, StoppingDecision
from armimp_common.trial_status import STATUS_NAME, Phase, TrialStatus

if TYPE_CHECKING:
    from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus

GATE_STATUS = f"{CONTROLLER_NODE}: gate"
"""``name`` of the controller's status on ``/diagnostics``."""

Value: TypeAlias = bool | int | float | str | Sequence[float]
"""What `format_value` turns into text."""


class Level(IntEnum):
    """Severity, with the numbers of ``diagnostic_msgs/msg/DiagnosticStatus``."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


def worst(levels: Iterable[Level]) -> Level:
    """Return the most severe level, OK if there is none."""
    return max(levels, default=Level.OK)


def format_value(value: Value) -> str:
    """Return a value as text that reads back without loss: ``true``, ``3``, ``0.1``, ``0.1 2.0``.

    Numbers of a sequence are separated by one space.
    """
    if isinstance(value, str):
        return value
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int):
        return str(int(value))
    if isinstance(value, float):
        return repr(float(value))
    return " ".join(repr(float(item)) for item in value)


def make_status(
    name: str,
    level: Level,
    message: str,
    values: Mapping[str, Value] | None = None,
    *,
    hardware_id: str = "",
) -> "DiagnosticStatus":
    """Return a ``DiagnosticStatus`` message.

    Parameters
    ----------
    name
        ``node: what``, as the convention of diagnostics has it.
    level, message
        Severity, and the state in words.
    values
        Key-values, kept in their order.
    hardware_id
        The device, if any.
    """
    # Imported here so that what needs no ROS in this module can be used without it.
    from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

    return DiagnosticStatus(
        level=bytes([level]),
        name=name,
        message=message,
        hardware_id=hardware_id,
        values=[KeyValue(key=key, value=format_value(v)) for key, v in (values or {}).items()],
    )


def make_array(stamp_ns: int, statuses: Iterable["DiagnosticStatus"]) -> "DiagnosticArray":
    """Return a ``DiagnosticArray`` message with stamp `stamp_ns` (ns)."""
    from diagnostic_msgs.msg import DiagnosticArray

    from armimp_common.stamps import to_time

    array = DiagnosticArray(status=list(statuses))
    array.header.stamp = to_time(stamp_ns)
    return array


def values_of(status: "DiagnosticStatus") -> dict[str, str]:
    """Return the key-values of a ``DiagnosticStatus`` message."""
    return {item.key: item.value for item in status.values}


def judgement_message(judgement: StoppingDecision) -> "DiagnosticStatus":
    """Return the message that carries a judgement."""
    return make_status(JUDGEMENT_NAME, Level.OK, judgement.sentence, judgement.to_values())


def timing_status(figures: TimingFigures) -> "DiagnosticStatus":
    """Return the message in which a rig tells its timing in real time."""
    return make_status(TIMING_NAME, Level.OK, "timing since activation", figures.to_values())


def trial_status_message(trial: TrialStatus) -> "DiagnosticStatus":
    """Return the message that carries a trial status: ERROR if aborted, WARN if not valid."""
    level = Level.OK if trial.valid else Level.WARN
    if trial.phase is Phase.ABORTED:
        level = Level.ERROR
    return make_status(STATUS_NAME, level, trial.sentence, trial.to_values())
