"""Ways in which an arm, a transducer or an encoder may not be linear, as one list of terms.

Each term is a signal that no linear response to the motion contains. Beside it stands what the term
means: what its share is relative to, from which share on parameters are refused, how likely it is
before the data, and so how much of it counts while the data do not tell.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from enum import Enum
from typing import Literal, NamedTuple

import numpy as np

from armimp_common.arrays import FloatArray
from armimp_estimation.problems import ProblemCode
from armimp_estimation.residual_torque import RATE

_REST = 0.5
"""Angle up to which stiffness is that of an arm at rest, in rms angles."""
_FAR = 1.0
"""Angle beyond which stiffness differs, in rms angles."""
_ONSETS = 15.0
"""Length of a trial, in time constants with which a startled arm calms down."""
_PLAY = 0.12
"""Half of the play of the arm's spring, in rms angles."""
_SLACK = 0.05
"""Half of the play of a transducer, in rms torques."""
_DEAD = 0.1
"""Half width of a transducer's dead zone, beyond which its loss is constant, in rms torques."""
_SLOW = 0.1
"""Speed at which friction reaches three quarters of its size, in rms speeds."""
_LATER = 0.1
"""Unit of the time by which readings get later, s."""
_NORMAL = 0.8
"""Mean of the absolute value of a normal distribution, in standard deviations."""
_SATURATING = 0.59
"""Mean of ``d/dv v |v|/(1 + |v|)`` over a normal distribution of v with standard deviation 1."""


class Signals(NamedTuple):
    """Signals of which terms are made, each (N,), in units of their rms."""

    angle: FloatArray
    quick: FloatArray
    """The angle without slow motion."""
    speed: FloatArray
    torque: FloatArray


class Kind(Enum):
    """What isn't linear, and hence what the share of a deviation is relative to."""

    STIFFNESS = "stiffness"
    """The arm, whose stiffness changes; relative to the stiffness."""
    DAMPING = "damping"
    """The arm, whose damping changes; relative to the damping."""
    FORCE = "force"
    """The arm, which adds a torque; largest relative change of M, B and K that it looks like."""
    GAIN = "gain"
    """The transducer, whose gain changes; relative to the gain."""
    DRAG = "drag"
    """A transmission between transducer and arm, which loses torque; relative as for `FORCE`."""
    LOST = "lost"
    """The transducer, which shows too little torque, never too much; relative to the rms torque."""
    SCALE = "scale"
    """The encoder, whose scale changes, relative to which it is. The term is an angle."""
    CLOCK = "clock"
    """The clock of the transducer, which isn't that of the encoder, so that readings get later; in
    0.1 s over the trial, of which per cent are milliseconds."""

    @property
    def of_transducer(self) -> bool:
        """Whether it is the transducer that isn't linear."""
        return self in {Kind.GAIN, Kind.DRAG, Kind.LOST, Kind.CLOCK}

    @property
    def signal(self) -> int:
        """Index in `Signals` of the one whose coefficient changes."""
        return {Kind.STIFFNESS: 0, Kind.SCALE: 0, Kind.DAMPING: 2}.get(self, 3)


@dataclass(frozen=True, kw_only=True)
class Term:
    """One way in which a joint, or its sensors, may not be linear."""

    bend: Callable[[Signals], FloatArray]
    """Regressor, (N,)."""
    code: ProblemCode
    kind: Kind = Kind.STIFFNESS
    in_time: bool = False
    """Whether the term differs between the periods of a periodic perturbation."""
    at_once: bool = False
    """Whether the coefficient of the kind's signal may change abruptly, too."""
    lacks: Callable[[FloatArray, float], FloatArray] = lambda torque, _: 0.0 * torque
    """Error of the torque that a `Kind.LOST` transducer shows, relative to a half width that is
    given in units of the torque."""
    slope: float = 1.0
    """Change of the regressor's slope from rest to one rms, or between both directions; for the
    excess of the angle over its rms, the mean over a normal distribution of angles; for a torque
    that is lost, the half width per coefficient that is found from readings with that loss."""
    rest: float = 1.0
    """Ratio of the change of M, B and K from rest to the one that the regressor looks like. Fitted
    to ``θ |θ|``, the excess of a Gaussian angle has 1/1.75 of the stiffness of that spring; so has
    half of the rms, fitted to a cube that levels off at 1.25 times the rms."""
    large: float = 0.1
    """Share beyond which stiffness, or M, B and K, hold for this motion or time alone; change of
    the gain beyond which a transducer is unusable. Smaller shares are part of the standard errors,
    and so is what friction of the robot leaves in torques whose jumps with the commands are not
    known well."""
    most: float = np.inf
    """Share beyond which it is not attributed to the arm: voluntary torque may look like it."""
    likely: float = 0.0
    sizes: tuple[float, ...] = (0.01, 0.03, 0.1)
    """Assumptions: prior probability of the term, and its possible shares, all equally likely."""
    lines_alone: bool = False
    """Whether this prior counts only where the lines of a multisine determine the term, as no
    other term reveals it then."""
    robots: float = 0.0
    """Largest relative change of M, B and K up to which it is attributed to the robot alone."""
    doubted: float = 0.0
    """Share of a change of the gain by which the mean gain may differ from the calibrated one,
    which holds for one of two directions, for small torques, or at the start or end."""
    even: bool = False
    """Whether it does not change sign with the motion that the perturbation causes."""
    couples: bool = False
    """Whether it may be in the torque of a locked joint, too."""
    explained_by: str = ""
    """Term that explains this one where that term is found more clearly at the perturbed joint; it
    then lowers the odds of this one."""
    shared: Literal["no", "by joints", "by all"] = "no"
    """Whether either all joints of an arm have it or none, so that evidence against it at some
    joints lowers its odds at the others; and whether also in the coupling of two joints."""


def play(signal: FloatArray, half: float) -> FloatArray:
    """Play operator: stretch, (N,), in units of `half`, of a spring that yields beyond `half`.

    Brokate & Sprekels, *Hysteresis and Phase Transitions*, ch. 2.
    """
    # Each value clips the rest position of the spring. Two clips in succession are one clip, so
    # the clips by all values up to a sample follow from joining runs of 1, 2, 4 ... values.
    least, most = signal - half, signal + half
    run = 1
    while run < signal.size:
        lower, upper = least[run:], most[run:]
        joined = [np.minimum(np.maximum(one[:-run], lower), upper) for one in (least, most)]
        least[run:], most[run:] = joined
        run *= 2
    return np.asarray((signal - np.clip(0.0, least, most)) / half)


def _slack(torque: FloatArray, half: float) -> FloatArray:
    return -play(torque, half)


def _dead_zone(torque: FloatArray, half: float) -> FloatArray:
    return -np.clip(torque / half, -1.0, 1.0)


def _growing(signal: FloatArray) -> FloatArray:
    """A signal times a change over the trial by 1, 0 in the mean."""
    return np.asarray(signal * np.linspace(-0.5, 0.5, signal.size))


def _later(torque: FloatArray) -> FloatArray:
    """Change of a torque whose readings get later by `_LATER` over the trial, 0 in the mean."""
    return _growing(-_LATER * RATE * np.gradient(torque))


def _returning(signal: FloatArray) -> FloatArray:
    """A signal times a change until the middle of a trial and back, 0 in the mean."""
    return np.asarray(signal * (4.0 * np.linspace(-0.5, 0.5, signal.size) ** 2 - 1.0 / 3.0))


def _calming(signal: FloatArray) -> FloatArray:
    """A signal, as large as a startled arm still is unlike one at rest."""
    return np.asarray(signal * np.exp(-np.linspace(0.0, _ONSETS, signal.size)))


def _rubbing(speed: FloatArray) -> FloatArray:
    """Sign of the speed, gradual near zero."""
    return np.tanh(speed / _SLOW)


_STIFFNESS_OVER_TIME = Term(
    bend=lambda signals: _growing(signals.angle),
    code=ProblemCode.CHANGES_OVER_TIME,
    in_time=True,
    large=0.05,
    most=3.0,
    likely=0.2,
    sizes=(0.1, 0.3),
    explained_by="clock",
)
_DAMPING_OVER_TIME = Term(
    bend=lambda signals: _growing(signals.speed),
    code=ProblemCode.DAMPING_CHANGES,
    kind=Kind.DAMPING,
    in_time=True,
    large=0.3,
    likely=0.2,
    sizes=(0.1, 0.3),
    explained_by="clock",
)

TERMS: Mapping[str, Term] = {
    # Stiffness that changes with the amplitude, up to half of the rms angle. Slow voluntary torque
    # masks this, but not the excess of the angle over its rms, as its spectrum lies where the noise
    # is lowest.
    "amplitude": Term(
        bend=lambda signals: np.clip(signals.angle, -_REST, _REST),
        code=ProblemCode.DEPENDS_ON_AMPLITUDE,
        slope=-1.0,
        rest=1.75,
        large=0.03,
        likely=0.3,
        sizes=(0.03, 0.1, 0.3, 1.0),
        lines_alone=True,
        couples=True,
    ),
    "curvature": Term(
        bend=lambda signals: signals.angle - np.clip(signals.angle, -_FAR, _FAR),
        code=ProblemCode.DEPENDS_ON_AMPLITUDE,
        slope=0.32,
        rest=1.75,
        likely=0.5,
        sizes=(0.1, 0.3, 1.0),
        couples=True,
        shared="by joints",
    ),
    "posture": Term(
        bend=lambda signals: np.abs(signals.angle),
        code=ProblemCode.DEPENDS_ON_DIRECTION,
        slope=2.0,
        even=True,
    ),
    "stiffness by speed": Term(
        bend=lambda signals: signals.quick * np.abs(signals.speed),
        code=ProblemCode.DEPENDS_ON_SPEED,
        slope=_NORMAL,
        likely=0.03,
        sizes=(0.03, 0.1),
        couples=True,
    ),
    # Damping that changes less and less, as force-velocity curves of muscles flatten.
    "damping by speed": Term(
        bend=lambda signals: signals.speed * np.abs(signals.speed) / (1.0 + np.abs(signals.speed)),
        code=ProblemCode.DAMPING_CHANGES,
        kind=Kind.DAMPING,
        large=np.inf,
        slope=_SATURATING,
        likely=0.1,
        sizes=(0.1, 0.3),
        couples=True,
        shared="by all",
        explained_by="friction",
    ),
    "damping by angle": Term(
        bend=lambda signals: signals.speed * np.abs(signals.angle),
        code=ProblemCode.DAMPING_CHANGES,
        kind=Kind.DAMPING,
        slope=_NORMAL,
        likely=0.02,
        sizes=(0.1, 0.3),
        couples=True,
    ),
    # A short-range spring that yields.
    "hysteresis": Term(
        bend=lambda signals: play(signals.quick, _PLAY),
        code=ProblemCode.HYSTERESIS,
        kind=Kind.FORCE,
        large=0.05,
        likely=0.1,
        sizes=(0.01, 0.03, 0.1, 0.3, 1.0),
        couples=True,
    ),
    # Readings with slack show less of it themselves: its half width is 1.3 to 2 times the
    # coefficient at perturbed joints, for 1 to 15 % of the rms torque, and up to 8 times where
    # torques are small.
    "slack": Term(
        bend=lambda signals: _slack(signals.torque, _SLACK),
        code=ProblemCode.TORQUE_HYSTERESIS,
        kind=Kind.LOST,
        large=np.inf,
        lacks=_slack,
        slope=2.0,
        likely=0.4,
    ),
    # So do readings with a dead zone; at low noise the factor is 1.4.
    "dead zone": Term(
        bend=lambda signals: _dead_zone(signals.torque, _DEAD),
        code=ProblemCode.TORQUE_NOT_LINEAR,
        kind=Kind.LOST,
        lacks=_dead_zone,
        slope=1.4,
        likely=0.1,
    ),
    # Friction of the robot changes M, B or K by 3 % at most; what changes them more is the arm's.
    "friction": Term(
        bend=lambda signals: _rubbing(signals.speed),
        code=ProblemCode.FRICTION_LEFT,
        kind=Kind.FORCE,
        large=np.inf,
        robots=0.03,
        likely=0.1,
        sizes=(0.01, 0.03, 0.1, 0.3, 1.0),
    ),
    # Losses of a gear or Bowden cable, while it drives the arm.
    "efficiency": Term(
        bend=lambda signals: np.abs(signals.torque) * _rubbing(signals.speed),
        code=ProblemCode.FRICTION_LEFT,
        kind=Kind.DRAG,
        large=np.inf,
        slope=2.0,
        likely=0.1,
        doubted=0.5,
    ),
    "time": replace(_STIFFNESS_OVER_TIME, at_once=True, likely=0.5),
    "time and back": replace(_STIFFNESS_OVER_TIME, bend=lambda signals: _returning(signals.angle)),
    "damping over time": _DAMPING_OVER_TIME,
    "onset": Term(
        bend=lambda signals: _calming(signals.angle),
        code=ProblemCode.CHANGES_OVER_TIME,
        in_time=True,
        large=0.3,
        likely=0.2,
        sizes=(0.1, 0.3, 1.0),
        explained_by="clock",
    ),
    "damping at onset": replace(_DAMPING_OVER_TIME, bend=lambda signals: _calming(signals.speed)),
    "direction": Term(
        bend=lambda signals: np.abs(signals.torque),
        code=ProblemCode.TORQUE_NOT_LINEAR,
        kind=Kind.GAIN,
        slope=2.0,
        large=0.2,
        likely=0.05,
        sizes=(0.1,),
        doubted=0.5,
    ),
    # Without the mean load: with it, the square of a binary torque, its edges, would outweigh the
    # cube where readings bend about another torque.
    "gain": Term(
        bend=lambda signals: (signals.torque - np.mean(signals.torque)) ** 3,
        code=ProblemCode.TORQUE_NOT_LINEAR,
        kind=Kind.GAIN,
        slope=3.0,
        likely=0.15,
        doubted=1.0,
    ),
    "gain by speed": Term(
        bend=lambda signals: signals.torque * np.abs(signals.speed),
        code=ProblemCode.TORQUE_NOT_LINEAR,
        kind=Kind.GAIN,
        likely=0.03,
        sizes=(0.03, 0.1),
        doubted=_NORMAL,
    ),
    "drift": Term(
        bend=lambda signals: _growing(signals.torque),
        code=ProblemCode.GAIN_DRIFTS,
        kind=Kind.GAIN,
        in_time=True,
        at_once=True,
        likely=0.05,
        sizes=(0.1,),
        doubted=0.5,
        explained_by="clock",
    ),
    "drift and back": Term(
        bend=lambda signals: _returning(signals.torque),
        code=ProblemCode.GAIN_DRIFTS,
        kind=Kind.GAIN,
        in_time=True,
        likely=0.05,
        sizes=(0.03, 0.1),
        doubted=2.0 / 3.0,
    ),
    # The delay at its ends, half of that, changes Z at 15 Hz by a mean of (ωd)²/6.
    "clock": Term(
        bend=lambda signals: _later(signals.torque),
        code=ProblemCode.CLOCKS_DRIFT,
        kind=Kind.CLOCK,
        in_time=True,
        large=0.05,
        doubted=3.7,
    ),
    # The torque of the fitted arm at angles that the encoder does not show.
    "scale": Term(
        bend=lambda signals: signals.angle * np.abs(signals.angle),
        code=ProblemCode.ANGLE_NOT_LINEAR,
        kind=Kind.SCALE,
        slope=2.0,
        likely=0.03,
        sizes=(0.03, 0.1),
        doubted=_NORMAL,
    ),
    "scale by direction": Term(
        bend=lambda signals: np.abs(signals.angle),
        code=ProblemCode.ANGLE_NOT_LINEAR,
        kind=Kind.SCALE,
        slope=2.0,
        large=0.2,
        likely=0.03,
        sizes=(0.1,),
        doubted=0.5,
        even=True,
    ),
}
"""All terms, by name."""
