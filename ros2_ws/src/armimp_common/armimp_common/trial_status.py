"""The state of the trial sequence, as the controller publishes it on ``imbic_controller/trial``."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Final

from armimp_common.errors import ConfigurationError, MalformedMessageError

STATUS_NAME: Final = "imbic_controller: trial"
"""``name`` of the DiagnosticStatus that carries a trial status."""

_INTEGER: Final = re.compile(r"-?[0-9]{1,40}")
_INTERVALS: Final = re.compile(r"([0-9]{1,19}-[0-9]{1,19}( [0-9]{1,19}-[0-9]{1,19}){0,99})?")
_BOOLEANS: Final = {"true": True, "false": False}


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


@dataclass(frozen=True, kw_only=True)
class TrialStatus:
    """One published state of the trial sequence.

    Parameters
    ----------
    phase
        What the controller is doing.
    trial, trials
        Number of the present trial, from 1, and how many there are.
    joint
        Perturbed joint, from 0 (written from 1 on the wire, where a person may read it).
    joint_name
        Its name.
    tick
        Controller ticks since activation.
    start_ns
        Stamp of the first perturbed sample of this trial (ns); None until it is known.
    ticks
        Planned number of perturbed samples of this trial.
    seed
        Seed of the experiment.
    valid
        False as soon as something spoiled the present trial.
    reason
        Why it is not valid.
    clipped
        Joint commands that the safety gate clipped so far during the perturbation of this trial.
    clipped_intervals
        When: ``first-last first-last ...`` in ticks from the first perturbed sample, which is 0; at
        most 100 intervals, which hold all clipped ticks (and others, where there would be more).
    tare, tare_error
        What each torque transducer read at rest before this trial, and its standard error (N·m);
        empty as long as that is not known.

    Raises
    ------
    ConfigurationError
        If the numbers contradict one another.
    """

    phase: Phase
    trial: int
    trials: int
    joint: int
    joint_name: str
    tick: int
    start_ns: int | None
    ticks: int
    seed: int
    valid: bool
    reason: str = ""
    clipped: int = 0
    clipped_intervals: str = ""
    tare: tuple[float, ...] = ()
    tare_error: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if not 1 <= self.trial <= self.trials:
            raise ConfigurationError(f"trial {self.trial} is not within 1..{self.trials}")
        for name in ("joint", "tick", "ticks", "seed", "clipped"):
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

    def to_values(self) -> dict[str, str]:
        """Return the key-values of the DiagnosticStatus; ``joint`` counts from 1 in them."""
        return {
            "phase": self.phase.value,
            "trial": str(self.trial),
            "trials": str(self.trials),
            "joint": str(self.joint + 1),
            "joint_name": self.joint_name,
            "tick": str(self.tick),
            "start_ns": "" if self.start_ns is None else str(self.start_ns),
            "ticks": str(self.ticks),
            "seed": str(self.seed),
            "valid": "true" if self.valid else "false",
            "reason": self.reason,
            "clipped": str(self.clipped),
            "clipped_intervals": self.clipped_intervals,
            "tare": " ".join(map(repr, self.tare)),
            "tare_error": " ".join(map(repr, self.tare_error)),
        }

    @classmethod
    def from_values(cls, values: Mapping[str, str]) -> "TrialStatus":
        """Rebuild a status from its key-values; keys that are not known are ignored.

        Raises
        ------
        MalformedMessageError
            If a value is missing, cannot be parsed, or contradicts another.
        """
        phase = _get(values, "phase")
        if phase not in [member.value for member in Phase]:
            raise MalformedMessageError(f"trial status: phase is not known: {phase!r}")
        valid = _get(values, "valid")
        if valid not in _BOOLEANS:
            raise MalformedMessageError(f"trial status: valid is not true or false: {valid!r}")
        try:
            return cls(
                phase=Phase(phase),
                trial=_integer(values, "trial"),
                trials=_integer(values, "trials"),
                joint=_integer(values, "joint") - 1,
                joint_name=_get(values, "joint_name"),
                tick=_integer(values, "tick"),
                start_ns=_integer(values, "start_ns") if _get(values, "start_ns") else None,
                ticks=_integer(values, "ticks"),
                seed=_integer(values, "seed"),
                valid=_BOOLEANS[valid],
                reason=_get(values, "reason"),
                # Bags that are older than these do not have them.
                clipped=_integer({"clipped": "0", **values}, "clipped"),
                clipped_intervals=values.get("clipped_intervals", ""),
                tare=_numbers(values, "tare"),
                tare_error=_numbers(values, "tare_error"),
            )
        except ConfigurationError as error:
            raise MalformedMessageError(f"trial status: {error}") from None


def _get(values: Mapping[str, str], key: str) -> str:
    try:
        return values[key]
    except KeyError:
        raise MalformedMessageError(f"trial status: {key} is missing") from None


def _numbers(values: Mapping[str, str], key: str) -> tuple[float, ...]:
    """Numbers between spaces; none where the key is missing, as in older bags."""
    text = values.get(key, "")
    try:
        return tuple(map(float, text.split()))
    except ValueError:
        raise MalformedMessageError(f"trial status: {key} is not numbers: {text!r:.80}") from None


def _integer(values: Mapping[str, str], key: str) -> int:
    text = _get(values, key)
    if not _INTEGER.fullmatch(text):
        raise MalformedMessageError(f"trial status: {key} is not an integer: {text!r}")
    return int(text)
