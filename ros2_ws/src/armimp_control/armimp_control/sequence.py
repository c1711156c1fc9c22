"""The timetable of an experiment: (tare,) settle, perturb joint 1, rest, then joint 2, … n."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from armimp_common.errors import ConfigurationError
from armimp_common.status import Phase
from armimp_control.tare import TareConfig


@dataclass(frozen=True, kw_only=True)
class SequenceConfig:
    """Lengths of the phases, s.

    Parameters
    ----------
    duration : of the perturbation
    settle : before it, with the joints already in their roles
    rest : after it, until the motion has died down
    tare : TareConfig
        Before the joints settle in their roles, if a tare is taken at all.

    Raises
    ------
    ConfigurationError
        If a length is out of range.
    """

    duration: float = 50.0
    settle: float = 0.5
    rest: float = 0.5
    tare: TareConfig = field(default_factory=TareConfig)

    def __post_init__(self) -> None:
        if not 0.0 < self.duration < np.inf:
            raise ConfigurationError(f"trial: duration must be positive, got {self.duration} s")
        for name in ("settle", "rest"):
            # Recorders learn of a trial while it settles, and that it is over while it rests.
            if not 0.05 <= getattr(self, name) < np.inf:
                raise ConfigurationError(
                    f"trial: {name} must be at least 0.05 s, got {getattr(self, name)} s"
                )


@dataclass(frozen=True, kw_only=True)
class Segment:
    """A stretch of ticks in one phase of one trial.

    Attributes
    ----------
    phase : SETTLE, PERTURB or REST
    trial : 1-based
    joint : perturbed joint, 0-based
    first, ticks : first tick of the segment, and how many there are
    tare : whether all joints are held, for the tare
    """

    phase: Phase
    trial: int
    joint: int
    first: int
    ticks: int
    tare: bool = False

    @property
    def end(self) -> int:
        """First tick after the segment."""
        return self.first + self.ticks


def timetable(config: SequenceConfig, *, joints: int, period: float) -> tuple[Segment, ...]:
    """Timetable of an experiment with one trial for each joint, in order and without gaps.

    Parameters
    ----------
    config : SequenceConfig
    joints : number of joints n, and so of trials
    period : of control, s

    Raises
    ------
    ConfigurationError
        If a phase is shorter than half a period, so that it would have no tick.
    """
    segments: list[Segment] = []
    tare = config.tare.ticks(period)
    lengths = (
        (Phase.SETTLE, config.settle),
        (Phase.PERTURB, config.duration),
        (Phase.REST, config.rest),
    )
    first = 0
    for joint in range(joints):
        if tare:
            segments.append(
                Segment(
                    phase=Phase.SETTLE,
                    trial=joint + 1,
                    joint=joint,
                    first=first,
                    ticks=tare,
                    tare=True,
                )
            )
            first += tare
        for phase, seconds in lengths:
            ticks = round(seconds / period)
            if ticks < 1:
                raise ConfigurationError(
                    f"trial: {phase.value} of {seconds} s is shorter than a tick of {period} s"
                )
            segments.append(
                Segment(phase=phase, trial=joint + 1, joint=joint, first=first, ticks=ticks)
            )
            first += ticks
    return tuple(segments)
