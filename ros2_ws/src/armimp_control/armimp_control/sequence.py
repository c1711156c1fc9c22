"""The timetable of an experiment: (tare,) settle, perturb joint 1, rest, then joint 2, … n."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pydantic import Field, model_validator

from armimp_common.arrays import FloatArray
from armimp_common.schema import Schema
from armimp_common.status import Phase
from armimp_common.topics import PERIOD

_PARTS = 4
"""Parts into which the readings of a tare are cut; their scatter gives its standard error."""


@dataclass(frozen=True, kw_only=True)
class Tare:
    """Offsets of the torque transducers, with the torque of a person's muscles at rest."""

    offset: tuple[float, ...]
    """Offset of each joint, N·m."""
    error: tuple[float, ...]
    """Standard error of each, N·m."""


class TareParameters(Schema):
    """Tare of the torque transducers before each trial.

    All joints are held in the posture θ_0, where the arm has no elastic torque. What the
    transducers read there is their offset, and the mean torque of the person's muscles, which is
    no answer to the perturbation either. The law subtracts both from the reading of the perturbed
    joint; otherwise an offset c would hold that joint at a distance c/(K_rd + K_h) from θ_0. A
    drift is not followed within a trial.
    """

    duration: float = Field(default=0.0, ge=0.0, le=60.0)
    """Length of the readings for the tare before each trial, at least 0.4 (s); 0 for no tare."""
    wait: float = Field(default=0.5, ge=0.0, le=60.0)
    """Time before the readings for the tare, until the arm rests (s)."""
    limit: float = Field(default=5.0, gt=0.0)
    """Largest tare of a joint that is accepted (N·m)."""
    noise: float = Field(default=0.05, gt=0.0)
    """Largest standard error of a tare that is accepted (N·m)."""

    @model_validator(mode="after")
    def _long_enough(self) -> TareParameters:
        # Each part has to be far longer than the periods of dither and mains, to average them out.
        if 0.0 < self.duration < 0.4:
            raise ValueError(f"duration must be 0 or at least 0.4 s, got {self.duration} s")
        return self

    @property
    def ticks(self) -> int:
        """Ticks of waiting and reading together, 0 without a tare."""
        return round((self.wait + self.duration) / PERIOD) if self.duration else 0

    def of(self, torque: FloatArray) -> Tare:
        """Compute the tare from the torques (n, ticks), N·m, read since all joints have been held.

        The readings after the wait are cut into four parts of equal length. Each is averaged with a
        Hann window, which suppresses the dither of held joints and mains hum. The tare is the mean
        of these four means; its standard error comes from their scatter, so it also shows slow
        unrest and drift.
        """
        torque = torque[:, round(self.wait / PERIOD) :]
        length = torque.shape[1] // _PARTS
        parts = torque[:, torque.shape[1] - _PARTS * length :].reshape(len(torque), _PARTS, length)
        window = 0.5 - 0.5 * np.cos(2.0 * np.pi * (np.arange(length) + 0.5) / length)
        means = np.sum(parts * window, axis=2) / np.sum(window)
        error = np.std(means, axis=1, ddof=1) / np.sqrt(_PARTS)
        return Tare(offset=tuple(means.mean(axis=1).tolist()), error=tuple(error.tolist()))

    def refusal(self, tare: Tare, names: Sequence[str]) -> str:
        """Return why no trial may begin with this tare; empty if it may."""
        for name, offset, error in zip(names, tare.offset, tare.error, strict=True):
            # Written so that NaN fails.
            if not abs(offset) <= self.limit:
                return (
                    f"tare: the torque of {name} reads {offset:.3g} N·m at rest, "
                    f"tare.limit is {self.limit:g} N·m"
                )
            if not error <= self.noise:
                return (
                    f"tare: the torque of {name} does not rest: {offset:.3g} ± {error:.2g} N·m, "
                    f"tare.noise is {self.noise:g} N·m"
                )
        return ""


class SequenceParameters(Schema):
    """Lengths of the phases of every trial."""

    duration: float = Field(default=50.0, ge=PERIOD)
    """Length of the perturbation of each trial (s)."""
    # Recorders learn of a trial while it settles, and that it is over while it rests.
    settle: float = Field(default=0.5, ge=0.05)
    """Time before each perturbation, with joints already in their roles (s)."""
    rest: float = Field(default=0.5, ge=0.05)
    """Time after each perturbation, for motion to die down (s)."""
    may_end_early: bool = False
    """Whether the estimator may end a trial before its planned end."""


@dataclass(frozen=True, kw_only=True)
class Segment:
    """A stretch of ticks in one phase of one trial."""

    phase: Phase
    """SETTLE, PERTURB or REST."""
    joint: int
    """Perturbed joint, 0-based."""
    first: int
    ticks: int
    """First tick of the segment, and how many there are."""
    tare: bool = False
    """Whether all joints are held, for the tare."""

    @property
    def trial(self) -> int:
        """Number of the trial: each joint has one."""
        return self.joint + 1

    @property
    def end(self) -> int:
        """First tick after the segment."""
        return self.first + self.ticks


def timetable(
    sequence: SequenceParameters, *, joints: int, tare: TareParameters
) -> tuple[Segment, ...]:
    """Return the timetable of an experiment: one trial for each joint, in order, without gaps.

    Parameters
    ----------
    sequence : SequenceParameters
    joints : number of joints n, and so of trials
    tare : TareParameters
    """
    lengths = [
        (Phase.SETTLE, tare.ticks, True),
        (Phase.SETTLE, round(sequence.settle / PERIOD), False),
        (Phase.PERTURB, round(sequence.duration / PERIOD), False),
        (Phase.REST, round(sequence.rest / PERIOD), False),
    ]
    segments: list[Segment] = []
    first = 0
    for joint, (phase, ticks, held) in itertools.product(range(joints), lengths):
        if ticks:
            segments.append(Segment(phase=phase, joint=joint, first=first, ticks=ticks, tare=held))
            first += ticks
    return tuple(segments)
