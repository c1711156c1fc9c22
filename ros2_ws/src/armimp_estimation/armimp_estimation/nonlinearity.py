"""Nonlinearity of arms and sensors, found in the residual torque of the fitted linear arm.

The residual torque of each joint in the band, ``e_i = τ_i - Σ_j Z_ij θ_j`` with the fitted
impedance Z, is regressed on one term of the perturbed joint's motion at a time. Terms of the arm
are the angle clipped at half of its rms (a stiffness that changes with the amplitude), ``|θ|`` (one
that depends on the direction), ``θ |θ̇|`` and ``θ̇ |θ|`` (stiffness that changes with the speed, and
damping with the angle), ``θ̇ |θ̇|/(1 + |θ̇|)`` (damping that changes with the speed, less and less,
as force-velocity curves of muscles flatten), a play operator of the angle (a short-range spring
that yields: Brokate & Sprekels, *Hysteresis and Phase Transitions*, ch. 2), the sign of ``θ̇``
(friction), ``θ t``, ``θ t²`` or an abrupt change (a stiffness that changes over the trial) and ``θ
exp(-t)`` and ``θ̇ exp(-t)`` (stiffness and damping larger at the start). Terms of the transducer
depend on the torque τ̂ over all perturbed frequencies: ``|τ̂|`` (its gain depends on the
direction), ``|τ̂|`` times the sign of ``θ̇`` (losses of a transmission), ``τ̂³`` and ``τ̂ |θ̇|``
(its gain changes with torque or speed), the sign of τ̂ (it does not show small torques), ``τ̂ t``,
``τ̂ t²`` or an abrupt change (its gain drifts) and a play operator (hysteresis). Terms of the
encoder are ``Z θ |θ|`` (its scale changes with the angle) and ``Z |θ|`` (with the direction): the
torque of the fitted arm at angles that are not shown.

All linear responses to the angle and to the perturbation are projected out of the terms and of e.
The instrument (Söderström & Stoica, *Instrumental Variable Methods for System Identification*) is
the part of the term that changes sign with the perturbation; for even terms and changes of a gain,
the same term of the motion that the perturbation alone causes is added. So a linear arm gives zero
on average, even while voluntary torque moves it. Voluntary torque is slow and masks a changing
stiffness at low frequencies, so e is also regressed on the excess of the angle over its rms, whose
spectrum lies where the noise is lowest. The M, B and K that look most like a term, times its
coefficient, are the change that it causes in them; a change of a transducer's gain is an
uncertainty of all that it measures. Readings that miss jumps of the torque with the commands are
corrected first: where commands overcome friction, the error would look like a nonlinear spring.

The standard error is the scatter between parts of the trial, with no assumption about the spectrum
of e. Influential parts pull the coefficient towards themselves, which is compensated (MacKinnon &
White, *Journal of Econometrics* 29, 1985: HC3). Few parts give a poor estimate of the scatter, so
significance follows Student's distribution. The ends of a trial are left out: there the derivatives
of a truncated record ring.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from functools import cached_property, partial
from itertools import permutations, product
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.special import ndtri, stdtr, stdtrit

from armimp_common.arrays import BoolArray, ComplexArray, FloatArray
from armimp_estimation.estimators.estimate import ImpedanceEstimate
from armimp_estimation.estimators.lpm import LpmFull
from armimp_estimation.fit import MBKFit, hidden_square
from armimp_estimation.hold_correction import HoldCorrection, command_steps, without_skew
from armimp_estimation.mbk import MBK
from armimp_estimation.problems import Concern, Problem, ProblemCode, Severity, problem
from armimp_estimation.record import TrialRecord

BAND = ((0.2, 0.7), (11.0, 15.0))
"""Edges of the analysed band, Hz: voluntary torque is mostly below it. They are gradual, so that
ringing at the ends of a record soon decays."""
WIDE = (BAND[0], (30.0, 40.0))
"""Edges of the band of the torque that enters transducer terms, Hz: all perturbed frequencies."""
MOVING = ((0.0, 0.1), BAND[1])
"""Edges of the band of the angle that enters spring terms, Hz: slow motion bends a spring, too."""
SIGNIFICANT = 3.5
"""Significant number of standard errors if there are many parts: chance exceeds it in 1 of 2000."""
REST = 0.5
"""Angle up to which stiffness is that of an arm at rest, in rms angles."""
FAR = 1.0
"""Angle beyond which stiffness differs, in rms angles."""
ONSETS = 15.0
"""Length of a trial, in time constants with which a startled arm calms down."""
PLAY = 0.12
"""Half of the play of the arm's spring, in rms angles."""
SLACK = 0.05
"""Half of the play of a transducer, in rms torques."""
DEAD = 0.1
"""Half width of a transducer's dead zone, beyond which its loss is constant, in rms torques."""
_OWN_ZONE = 1.4
"""Half width of a dead zone per coefficient found from readings with that zone, at low noise."""
_OWN_LAG = 2.0
"""Half of a transducer's play per coefficient found from its own readings: 1.3 to 2 at perturbed
joints for 1 to 15 % of the rms torque, up to 8 where torques are small."""
SLOW = 0.1
"""Speed at which friction reaches three quarters of its size, in rms speeds."""
_NORMAL = 0.8
"""Mean of the absolute value of a normal distribution, in standard deviations."""
_SATURATING = 0.59
"""Mean of ``d/dv v |v|/(1 + |v|)`` over a normal distribution of v with standard deviation 1."""
_ENDS = 3.0
"""Seconds that are left out at either end, up to the share `_MOST_ENDS` of the record."""
_RINGS = 100
"""Samples at either end in which the jump from end to begin of a record rings most."""
_WIDTH = 1.0
"""Width of the bands of the linear filters, Hz."""
_SMOOTHING = 0.2
"""Standard deviation of the Gaussian that smooths weights, Hz: a voluntary rhythm is as narrow."""
_RATE = 200.0  # largest sampling rate of the analysed signals, Hz
_MOST_ENDS = 0.2
_PART = 1.5
"""Length of a part, s: after it, voluntary motion and torque are hardly correlated."""
_FEWEST_PARTS = 2
"""Fewest parts on either side of an abrupt change."""
_SHORT = 0.75
"""Length of a part in the search for an abrupt change, s."""
_FLIPS, _ALIKE, _RARE = 400, 4, 0.05
"""Wild bootstrap: number of draws, successive parts with one sign, compared tail probability."""
_BEYOND_CHANCE = 4.0
_NEGLIGIBLE = 0.003  # share below which a significant deviation is not reported
_UNFELT = 0.001  # standard error of a loss of torque that is ignored, relative to the rms torque
_RUBBING = 0.03
"""Relative change of M, B or K above which friction must be the arm's: the robot's causes less."""
_GROUP = 8  # lines in a group of `_slope_at_lines`
_JUMPING = 15.0
"""Friction of the robot that may be left in an arm's torque if jumps with the commands are unknown,
relative to the control period, N·m/s: a quarter of 2 N·m (assumption) at 30 rad/s."""
_LEFT = 0.01
"""Share of the torque that a linear arm may leave, and least share of an abrupt change."""
_BETWEEN = 0.05
"""Largest share of a linear residual that the linear filters leave between their frequencies."""
_TURNING = 25.0
"""Frequency up to which motion counts with which the inertia changes, Hz."""
_TURNS = 5.0
"""Standard errors from which on an inertia changes with the angles beyond chance."""
_BURSTS, _TIMES, _NEAR = 4.0, 60, 4
"""Noise in bursts: significant number of standard errors, number of times, those that are near."""
_LEAST = 10.0  # duration of the shortest trial that is tested, s
_INFORMATIVE = 0.1
"""Least share of a term of the perturbed motion alone that must remain once linear responses are
projected out. Less is due to chance and the ends, as under a periodic perturbation with all lines:
the motion has no power between them, and at them any motion looks linear. A nonlinear arm then
leaves a lack of fit; gains are as uncertain as those of any transducer."""


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


@dataclass(frozen=True, kw_only=True)
class Term:
    """One way in which a joint, or its transducer, may not be linear."""

    bend: Callable[[FloatArray], FloatArray]
    """Regressor, (N,), from four signals in units of their rms, (4, N): angle, angle and speed
    without slow motion, and torque."""
    code: ProblemCode
    kind: Kind = Kind.STIFFNESS
    in_time: bool = False
    """Whether the term differs between the periods of a periodic perturbation."""
    at_once: int | None = None
    """Index of the signal whose coefficient may change abruptly, too."""
    lacks: Callable[[FloatArray, float], FloatArray] = lambda torque, _: 0.0 * torque
    """Error, N·m, of the torque that a `Kind.LOST` transducer shows, for a half width in N·m."""
    size: float = 1.0
    """That half width per coefficient found from readings, which contain the error themselves."""
    slope: float = 1.0
    """Change of the regressor's slope from rest to one rms, or between both directions; for the
    excess of the angle over its rms, the mean over a normal distribution of angles."""
    rest: float = 1.0
    """Ratio of the change of M, B and K from rest to the one that the regressor looks like. Fitted
    to ``θ |θ|``, the excess of a Gaussian angle has 1/1.75 of the stiffness of that spring."""
    large: float = np.inf
    """Share beyond which stiffness, or M, B and K, hold for this motion or time alone; change of
    the gain beyond which a transducer is unusable. Smaller shares are part of the standard errors,
    and so is what friction of the robot leaves in torques whose jumps with the commands are not
    known well."""
    most: float = np.inf
    """Share beyond which it is not attributed to the arm: voluntary torque may look like it."""
    likely: float = 0.0
    sizes: tuple[float, ...] = (0.0,)
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


TERMS: Mapping[str, Term] = {
    "amplitude": Term(
        bend=lambda signals: np.clip(signals[0], -REST, REST),
        code=ProblemCode.DEPENDS_ON_AMPLITUDE,
        slope=-1.0,
        large=0.03,
        likely=0.3,
        sizes=(0.03, 0.1, 0.3, 1.0),
        lines_alone=True,
        couples=True,
    ),
    "curvature": Term(
        bend=lambda signals: signals[0] - np.clip(signals[0], -FAR, FAR),
        code=ProblemCode.DEPENDS_ON_AMPLITUDE,
        slope=0.32,
        rest=1.75,
        large=0.1,
        likely=0.5,
        sizes=(0.1, 0.3, 1.0),
        couples=True,
        shared="by joints",
    ),
    "posture": Term(
        bend=lambda signals: np.abs(signals[0]),
        code=ProblemCode.DEPENDS_ON_DIRECTION,
        slope=2.0,
        large=0.1,
        even=True,
    ),
    "stiffness by speed": Term(
        bend=lambda signals: signals[1] * np.abs(signals[2]),
        code=ProblemCode.DEPENDS_ON_SPEED,
        slope=_NORMAL,
        large=0.1,
        likely=0.03,
        sizes=(0.03, 0.1),
        couples=True,
    ),
    "damping by speed": Term(
        bend=lambda signals: signals[2] * np.abs(signals[2]) / (1.0 + np.abs(signals[2])),
        code=ProblemCode.DAMPING_CHANGES,
        kind=Kind.DAMPING,
        slope=_SATURATING,
        likely=0.1,
        sizes=(0.1, 0.3),
        couples=True,
        shared="by all",
        explained_by="friction",
    ),
    "damping by angle": Term(
        bend=lambda signals: signals[2] * np.abs(signals[0]),
        code=ProblemCode.DAMPING_CHANGES,
        kind=Kind.DAMPING,
        slope=_NORMAL,
        large=0.1,
        likely=0.02,
        sizes=(0.1, 0.3),
        couples=True,
    ),
    "hysteresis": Term(
        bend=lambda signals: play(signals[1], PLAY),
        code=ProblemCode.HYSTERESIS,
        kind=Kind.FORCE,
        large=0.05,
        likely=0.1,
        sizes=(0.01, 0.03, 0.1),
        couples=True,
    ),
    "slack": Term(
        bend=lambda signals: -play(signals[3], SLACK),
        code=ProblemCode.TORQUE_HYSTERESIS,
        kind=Kind.LOST,
        lacks=lambda torque, slack: -slack * play(torque, slack),
        size=_OWN_LAG,
        likely=0.4,
        sizes=(0.01, 0.03, 0.1),
    ),
    "dead zone": Term(
        bend=lambda signals: -np.clip(signals[3] / DEAD, -1.0, 1.0),
        code=ProblemCode.TORQUE_NOT_LINEAR,
        kind=Kind.LOST,
        lacks=lambda torque, zone: -np.clip(torque, -zone, zone),
        size=_OWN_ZONE,
        large=0.1,
        likely=0.1,
        sizes=(0.01, 0.03, 0.1),
    ),
    "friction": Term(
        bend=lambda signals: np.tanh(signals[2] / SLOW),
        code=ProblemCode.FRICTION_LEFT,
        kind=Kind.FORCE,
        robots=_RUBBING,
        likely=0.1,
        sizes=(0.01, 0.03, 0.1),
    ),
    "efficiency": Term(
        bend=lambda signals: np.abs(signals[3]) * np.tanh(signals[2] / SLOW),
        code=ProblemCode.FRICTION_LEFT,
        kind=Kind.DRAG,
        slope=2.0,
        likely=0.1,
        sizes=(0.01, 0.03, 0.1),
        doubted=0.5,
    ),
    "time": Term(
        bend=lambda signals: signals[0] * np.linspace(-0.5, 0.5, signals.shape[1]),
        code=ProblemCode.CHANGES_OVER_TIME,
        in_time=True,
        at_once=0,
        large=0.05,
        most=3.0,
    ),
    "time and back": Term(
        bend=lambda signals: returning(signals[0]),
        code=ProblemCode.CHANGES_OVER_TIME,
        in_time=True,
        large=0.05,
        most=3.0,
    ),
    "onset": Term(
        bend=lambda signals: calming(signals[0]),
        code=ProblemCode.CHANGES_OVER_TIME,
        in_time=True,
        large=0.3,
        likely=0.2,
        sizes=(0.1, 0.3, 1.0),
    ),
    "damping at onset": Term(
        bend=lambda signals: calming(signals[2]),
        code=ProblemCode.DAMPING_CHANGES,
        kind=Kind.DAMPING,
        in_time=True,
        large=0.3,
        likely=0.2,
        sizes=(0.1, 0.3),
    ),
    "direction": Term(
        bend=lambda signals: np.abs(signals[3]),
        code=ProblemCode.TORQUE_NOT_LINEAR,
        kind=Kind.GAIN,
        slope=2.0,
        large=0.2,
        likely=0.05,
        sizes=(0.1,),
        doubted=0.5,
    ),
    "gain": Term(
        bend=lambda signals: signals[3] ** 3,
        code=ProblemCode.TORQUE_NOT_LINEAR,
        kind=Kind.GAIN,
        slope=3.0,
        large=0.1,
        likely=0.15,
        sizes=(0.01, 0.03, 0.1),
        doubted=1.0,
    ),
    "gain by speed": Term(
        bend=lambda signals: signals[3] * np.abs(signals[2]),
        code=ProblemCode.TORQUE_NOT_LINEAR,
        kind=Kind.GAIN,
        large=0.1,
        likely=0.03,
        sizes=(0.03, 0.1),
        doubted=_NORMAL,
    ),
    "drift": Term(
        bend=lambda signals: signals[3] * np.linspace(-0.5, 0.5, signals.shape[1]),
        code=ProblemCode.GAIN_DRIFTS,
        kind=Kind.GAIN,
        in_time=True,
        at_once=3,
        large=0.1,
        likely=0.05,
        sizes=(0.1,),
        doubted=0.5,
    ),
    "drift and back": Term(
        bend=lambda signals: returning(signals[3]),
        code=ProblemCode.GAIN_DRIFTS,
        kind=Kind.GAIN,
        in_time=True,
        large=0.1,
        likely=0.03,
        sizes=(0.1,),
        doubted=2.0 / 3.0,
    ),
    "scale": Term(
        bend=lambda signals: signals[0] * np.abs(signals[0]),
        code=ProblemCode.ANGLE_NOT_LINEAR,
        kind=Kind.SCALE,
        slope=2.0,
        large=0.1,
        likely=0.03,
        sizes=(0.03, 0.1),
        doubted=_NORMAL,
    ),
    "scale by direction": Term(
        bend=lambda signals: np.abs(signals[0]),
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


@dataclass(frozen=True, kw_only=True, eq=False)
class Deviation:
    """One term as it was found in the torque of a joint."""

    name: str
    share: float
    error: float
    """Size of the term relative to what its `Kind` names, and its standard error. The size of a
    stiffness or gain is the change from rest to the rms, between directions, or over the trial."""
    freedom: float
    """Degrees of freedom of that error."""
    shift: FloatArray
    """What it adds to M, B and K between the perturbed joint and this one, SI units; (3,)."""
    sensor: float = 0.0
    """Relative uncertainty of the transducer's gain, or the encoder's scale, that follows."""
    held: float = 0.0
    """Torque of friction or of a yielding spring, N·m, which acts on the locked joint, too."""
    at_lines: bool = False
    """Whether the coefficient is that from the lines of a multisine."""
    looks: int = 1
    """Number of instants at which an abrupt change was looked for."""
    joints: int = 1
    """Number of joints that were tested, as chance may produce it at any of them."""
    slack: float = 0.0
    """Half width of the hysteresis or dead zone of the transducer, N·m."""

    @property
    def of_transducer(self) -> bool:
        """Whether it is the transducer that isn't linear."""
        return TERMS[self.name].kind in {Kind.GAIN, Kind.DRAG, Kind.LOST}

    @property
    def of_robot(self) -> bool:
        """Whether it is attributed to the robot alone."""
        return abs(self.share) <= TERMS[self.name].robots

    @property
    def significant(self) -> bool:
        """Whether chance hardly explains it, given the numbers of looks and joints."""
        return self._errors(self.looks * self.joints) > SIGNIFICANT

    def doubt(
        self, elsewhere: float = 0.0, *, declared: bool = False, rival: Deviation | None = None
    ) -> float:
        """Standard error that follows from it, relative to its size: below 1 if it may be chance.

        `elsewhere` is the evidence that the other joints give; that of a `rival`, which explains
        the same, is against it. If the linearity of transducers was `declared`, what is not
        significant of them is taken as chance, except a drift.
        """
        if rival is not None:
            elsewhere -= np.inf if rival.of_robot else rival.evidence
        elif self.significant:
            return 1.0
        if declared and self.of_transducer and not TERMS[self.name].in_time:
            return 0.0
        return float(np.sqrt(self._odds(elsewhere)[0])) / abs(self.share) if self.share else 0.0

    @property
    def evidence(self) -> float:
        """Logarithm of the likelihood ratio of its presence to its absence."""
        return self._odds(0.0)[1]

    def _odds(self, elsewhere: float) -> tuple[float, float]:
        """Posterior mean square of the share, and evidence, as of :func:`hidden_square`."""
        term = TERMS[self.name]
        if term.kind is Kind.GAIN and self.error == np.inf:
            return term.likely * float(np.mean(np.square(term.sizes))), 0.0
        untold = not term.likely or (term.lines_alone and not self.at_lines)
        if untold or not self.errors > 0.0 or self.of_robot:
            return 0.0, 0.0
        error = abs(self.share) / self.errors
        lost = term.kind is Kind.LOST
        return hidden_square(
            self.share if lost else abs(self.share),
            error,
            term.likely,
            sizes=term.sizes,
            positive=lost,
            elsewhere=elsewhere,
        )

    @property
    def errors(self) -> float:
        """Number of standard errors of a normal distribution that is as unlikely as this one."""
        return self._errors(self.looks)

    def _errors(self, looks: int) -> float:
        if not self.error > 0.0:
            return 0.0
        chance = looks * float(stdtr(self.freedom, -abs(self.share) / self.error))
        return float(-ndtri(min(max(chance, np.finfo(float).tiny), 0.5)))


class _Band:
    """Signals of a record within a band, at a rate that suffices for it; `kept` omits the ends."""

    def __init__(
        self,
        record: TrialRecord,
        edges: tuple[tuple[float, float], tuple[float, float]] = BAND,
        *,
        by_lines: bool = True,
    ) -> None:
        f = np.fft.rfftfreq(record.samples, 1.0 / record.rate)
        (foot, top), (shoulder, end) = edges
        rise = np.clip((f - foot) / (top - foot), 0.0, 1.0)
        fall = np.clip((end - f) / (end - shoulder), 0.0, 1.0)
        passed = np.sin(0.5 * np.pi * rise) ** 2 * np.sin(0.5 * np.pi * fall) ** 2
        inside = np.flatnonzero(passed)
        self.pushes = record.perturbation[record.perturbed_joint]
        self.samples = round(record.duration * min(record.rate, _RATE))
        self.bins = slice(int(inside[0]), int(inside[-1]) + 1)
        self.f = np.asarray(f[self.bins], dtype=np.float64)
        self.passed = passed[self.bins]
        ends = int(self.samples * min(_ENDS / record.duration, _MOST_ENDS))
        self.kept = slice(ends, self.samples - ends)
        self._which: NDArray[np.int64] = np.floor((self.f - self.f[0]) / _WIDTH).astype(np.int64)
        self._parts = self._which
        if by_lines and record.periods is not None:
            bins = np.arange(self.bins.start, self.bins.stop)
            lines = record.periods.lines * record.periods.count
            self._parts = np.where(np.isin(bins, lines), np.searchsorted(lines, bins), -1)

    @property
    def lines(self) -> NDArray[np.intp]:
        """Indices of the lines of a periodic perturbation among the bins of the band."""
        return np.flatnonzero(self._parts >= 0)

    def of(self, signal: FloatArray) -> ComplexArray:
        spectrum: ComplexArray = np.fft.rfft(signal - signal.mean(axis=-1, keepdims=True))
        return np.asarray(spectrum[..., self.bins] * self.passed / signal.shape[-1])

    def filters(self, signal: FloatArray) -> FloatArray:
        """Split a signal into bands, each as it is and shifted by 90 degrees, (2 bands, N).

        Under a periodic perturbation each line is a band. What lies between the lines, distortion
        and voluntary motion, belongs to none: a filter of voluntary motion would follow voluntary
        torque. Nothing of the residual can remain at the lines, either: a slightly wrong fit leaves
        errors there that do not show in the scatter between parts of the trial.
        """
        values = self.of(signal)
        parts = np.unique(self._parts[self._parts >= 0])
        cut = np.where(self._parts == parts[:, None], values, 0.0)
        return self.signal(np.concatenate((cut, 1j * cut)))

    @cached_property
    def forces(self) -> FloatArray:
        """The perturbation by bands as `filters` splits it, (2 bands, N)."""
        return self.filters(self.pushes)

    def caused(self, signals: FloatArray) -> FloatArray:
        """Project signals (..., N) onto everything that linear filters make of the perturbation."""
        return _onto(self.forces)(signals)

    def weights(self, *noise: FloatArray) -> FloatArray:
        """Weights by frequency that make a sum of independent signals white.

        They change gradually: signals that pass sharp edges are correlated over the whole trial,
        so that its parts would not be independent of each other.
        """
        width = _SMOOTHING / float(self.f[1] - self.f[0])
        power = np.sum([np.abs(self.of(n)) ** 2 for n in noise], axis=0)
        of_noise, of_white = (
            gaussian_filter1d(one, width, mode="constant") for one in (power, self.passed**4)
        )
        tiny = float(np.finfo(float).tiny)
        return np.asarray(np.sqrt(of_white / np.maximum(of_noise, tiny)))

    def means(self, values: FloatArray) -> FloatArray:
        """Mean within each band of 1 Hz of values that are given at each frequency."""
        return np.bincount(self._which, weights=values) / np.bincount(self._which)

    def inner(self, signal: FloatArray) -> FloatArray:
        """Set the ends to zero, where the jump between end and start of a record rings."""
        inside = np.zeros_like(signal)
        inside[self.kept] = signal[self.kept]
        return inside

    def signal(self, values: ComplexArray) -> FloatArray:
        """Return the signal of a spectrum at the lower rate, ends included."""
        spectrum = np.zeros((*values.shape[:-1], self.samples // 2 + 1), dtype=np.complex128)
        spectrum[..., self.bins] = values * self.samples
        signal: FloatArray = np.fft.irfft(spectrum, self.samples)
        return signal


def play(angle: FloatArray, half: float) -> FloatArray:
    """Play operator: stretch, (N,), in units of `half`, of a spring that yields beyond `half`."""
    # Each angle clips the rest position of the spring. Two clips in succession are one clip, so
    # the clips by all angles up to a sample follow from joining runs of 1, 2, 4 ... angles.
    least, most = angle - half, angle + half
    run = 1
    while run < angle.size:
        lower, upper = least[run:], most[run:]
        joined = [np.minimum(np.maximum(one[:-run], lower), upper) for one in (least, most)]
        least[run:], most[run:] = joined
        run *= 2
    return np.asarray((angle - np.clip(0.0, least, most)) / half)


def calming(signal: FloatArray) -> FloatArray:
    """A signal, (N,), as large as a startled arm still is unlike one at rest."""
    return np.asarray(signal * np.exp(-np.linspace(0.0, ONSETS, signal.size)))


def returning(signal: FloatArray) -> FloatArray:
    """A signal, (N,), times a change until the middle of a trial and back, 0 in the mean."""
    return np.asarray(signal * (4.0 * np.linspace(-0.5, 0.5, signal.size) ** 2 - 1.0 / 3.0))


def _onto(forces: FloatArray) -> Callable[[FloatArray], FloatArray]:
    """Return the projection of signals (..., N) onto the rows of `forces`, (2 bands, N)."""
    normal = np.linalg.pinv(forces @ forces.T, hermitian=True)
    return lambda signals: np.asarray((signals @ forces.T) @ normal @ forces)


def _left(
    record: TrialRecord, band: _Band, arm: MBK, jump: HoldCorrection | None, late: float = 0.0
) -> ComplexArray:
    """Spectra, (n, n_freq), of the torques that an arm leaves; see :func:`deviations`."""
    n = record.joints
    coefficients = without_skew(band.f, record, jump, late)
    torques = np.einsum("iif,if->if", coefficients[:, :n], band.of(record.torque))
    if jump is not None:
        steps = band.of(command_steps(record))
        torques = torques + np.einsum("ijf,jf->if", coefficients[:, n:], steps)
    impedance, angles = arm.impedance(band.f), band.of(record.position)
    return np.asarray(torques - np.einsum("ijf,jf->if", impedance, angles))


def _turning(record: TrialRecord) -> ComplexArray:
    """Spectra, (terms, n, bins), of torques of an inertia that changes with the angles, to 50 Hz.

    They are those of the kinetic energies ``θ_j θ̇_i²`` and ``θ_i θ̇_i θ̇_j``, as Lagrange's
    equations give them, and 0 where the perturbed joint has no part in that. Where it has one, and
    two other joints, these move little.
    """
    k = record.perturbed_joint
    size = round(4.0 * _TURNING * record.duration)
    s = 2j * np.pi * np.arange(size // 2 + 1) / record.duration
    moved = np.fft.rfft(record.position - record.position.mean(axis=1, keepdims=True))
    moved = moved[:, : s.size] * (np.abs(s) <= 2.0 * np.pi * _TURNING) * (size / record.samples)
    angle, speed = (np.fft.irfft(one, size) for one in (moved, s * moved))
    terms = []
    for i, j in permutations(range(record.joints), 2):
        for first, second, at in ((i, i, j), (i, j, i)):
            terms.append(np.zeros_like(moved))
            if k in (i, j):
                for one, other in ((first, second), (second, first)):
                    terms[-1][one] += s * np.fft.rfft(angle[at] * speed[other])
                terms[-1][at] -= np.fft.rfft(speed[first] * speed[second])
    return np.asarray(np.stack(terms) * (record.samples / size))


def at_posture(records: Sequence[TrialRecord], lpm: LpmFull) -> list[TrialRecord]:
    """Return trials with the torques of an arm whose inertia stays that at the posture.

    The inertia ``M_ij + Σ_l G_ijl θ_l`` of any jointed arm causes Coriolis torques and the like.
    They are even in the motion, so no part of M, B and K, but distort the lines of a multisine, and
    look like a stiffness that depends on the direction where locked joints move. G is found by
    regression of what a reference arm of `lpm` leaves, of all trials, and removed if it is beyond
    chance. G_iii is 0: the own inertia of a joint doesn't depend on its angle.
    """
    if records[0].joints == 1 or min(record.duration for record in records) < _LEAST:
        return list(records)
    arm, jump = lpm.reference(records)
    parts = []
    for record in (one.whole_periods for one in records):
        band = _Band(record)
        left = _left(record, band, arm, jump)
        terms = _turning(record)[..., band.bins] * band.passed / record.samples
        for rest, term in zip(left, np.moveaxis(terms, 1, 0), strict=True):
            weights = band.weights(band.inner(band.signal(rest)))
            whole = band.signal(weights * np.vstack((term, rest)))[:, band.kept]
            parts += np.array_split(whole, max(round(whole.shape[1] / (_RATE * _PART)), 3), axis=1)
    inverse = np.linalg.pinv(sum(part[:-1] @ part[:-1].T for part in parts), hermitian=True)
    found = inverse @ sum(part[:-1] @ part[-1] for part in parts)
    scores = [part[:-1] @ (part[-1] - found @ part[:-1]) for part in parts]
    errors = np.linalg.norm(scores @ inverse, axis=0)
    if not (np.abs(found) > _TURNS * errors).any():
        return list(records)
    return [
        replace(
            one,
            torque=one.torque - np.fft.irfft(found @ np.moveaxis(_turning(one), 0, 1), one.samples),
        )
        for one in records
    ]


def _bursts(record: TrialRecord, arm: MBK, jump: HoldCorrection | None) -> FloatArray:
    """Square root, (3, n), of the excess of the variance of M, B and K over that of steady noise.

    Noise that is larger while the perturbation moves the joint, as of a person who tenses then,
    counts more than its mean power tells (White, *Econometrica* 48, 1980). The excess is relative,
    and 0 unless it is beyond that of the same noise at other times.
    """
    if record.duration < _LEAST:
        return np.zeros((3, record.joints))
    record = record.whole_periods
    band = _Band(record, by_lines=False)
    angle = band.signal(band.of(record.position[record.perturbed_joint]))
    caused = np.fft.rfft(band.caused(angle))[band.bins] / band.samples
    motion = caused * (2j * np.pi * band.f) ** np.arange(3)[::-1, None]
    excess = []
    for rest in _left(record, band, arm, jump):
        weights = band.weights(band.inner(band.signal(rest)))
        *moved, noise = band.signal(weights * np.vstack((motion, rest)))[:, band.kept]
        pull = np.linalg.pinv(np.transpose(moved)) ** 2
        pull /= np.mean(pull, axis=1, keepdims=True)
        power = noise**2 / np.mean(noise**2)
        times = np.linspace(0, power.size, _TIMES, endpoint=False, dtype=np.intp)
        ratios = pull @ np.stack([np.roll(power, time) for time in times], axis=1) / power.size
        beyond = ratios[:, 0] - 1.0
        chance = _BURSTS * np.std(ratios[:, _NEAR:-_NEAR], axis=1)
        excess.append(np.sqrt(np.where(beyond > chance, beyond, 0.0)))
    return np.stack(excess, axis=1)


def deviations(
    record: TrialRecord, arm: MBK, jump: HoldCorrection | None = None, late: float = 0.0
) -> list[dict[str, Deviation]]:
    """Estimate each term of nonlinearity in the torques of a trial.

    Parameters
    ----------
    record : TrialRecord
        One trial.
    arm : MBK
        Fitted arm.
    jump : HoldCorrection, optional
        How torques jump with the commands, if that is known.
    late : float
        Fitted delay of the torques beyond the known one, s.

    Returns
    -------
    list of dict of str to Deviation
        Deviations in the torque of each joint, by name in `TERMS`; at locked joints only terms that
        couple joints. Empty for trials of less than 10 s, or if a signal, or M, B or K, is zero.
    """
    if record.duration < _LEAST:
        return [{} for _ in record.joint_names]
    record = record.whole_periods
    n, k, band = record.joints, record.perturbed_joint, _Band(record)
    angles, impedance = band.of(record.position), arm.impedance(band.f)
    residuals = band.signal(_left(record, band, arm, jump, late))
    # Angle of the perturbed joint, rad, and its first two derivatives, (3, N).
    motion = band.signal(angles[k] * (2j * np.pi * band.f) ** np.arange(3)[:, None])
    moved = _Motion(record, band, motion)
    # An element between joints may be small, so its size is its geometric mean with √(M_ii M_kk).
    elements = np.abs(np.stack((arm.M, arm.B, arm.K), axis=-1))
    own = np.sqrt(np.diagonal(elements).T)
    column = np.sqrt(elements[:, k] * own * own[k])
    return [
        moved.deviations(joint, residuals[joint], column[joint], impedance[joint, k])
        for joint in range(n)
    ]


class _Motion:
    """Motion of the perturbed joint in one trial, and the terms of nonlinearity that follow.

    A nonlinearity acts on all of motion and torque, but only the part that the perturbation causes
    is independent of the person: it gives the instrument. Slow voluntary motion would make that a
    weak instrument of terms that depend on the direction of the motion.
    """

    def __init__(self, record: TrialRecord, band: _Band, motion: FloatArray) -> None:
        self._record, self._band = record, band
        k, kept = record.perturbed_joint, band.kept
        wide, moving = _Band(record, WIDE), _Band(record, MOVING)
        position = record.position[k]
        angle = moving.signal(moving.of(position))
        quick = np.vstack((2j * np.pi * wide.f * wide.of(position), wide.of(record.torque)))
        speed, *self._torques = wide.signal(quick)
        torque = band.inner(self._torques[k])
        load = band.inner(np.full(torque.size, record.torque[k].mean()))
        # Line by line, the person's torque would seem to be caused by the perturbation, too.
        pushed = _Band(record, WIDE, by_lines=False).caused(self._torques[k])
        actual = np.stack((angle, motion[0], speed, torque + load))
        known = (
            moving.caused(angle),
            band.caused(motion[0]),
            wide.caused(speed),
            band.inner(pushed),
        )
        self._sizes = np.std(actual[:, kept], axis=1)
        units = np.where(self._sizes > 0.0, self._sizes, 1.0)[:, None]
        self._signals, self._known = actual / units, np.stack(known) / units
        self._load = np.array([0.0, 0.0, 0.0, 1.0])[:, None] * load / units
        self._bent = {name: self._bend(one) for name, one in TERMS.items()}
        # The M, B and K that look most like a term: its regression on derivatives 2, 1, 0.
        # The estimate contains the ends, where an arm that is startled shows most of that.
        shapes = band.signal(np.stack([one[1] for one in self._bent.values()]))
        near = slice(_RINGS, -_RINGS)
        alike = np.linalg.lstsq(motion[2::-1, near].T, shapes[:, near].T, rcond=None)[0]
        self._alike = dict(zip(TERMS, alike.T, strict=True))
        self._linear = _Linear(record, band)
        # With one band for each line, the filters could follow an abrupt change.
        self._smooth = self._linear
        if record.periods is not None:
            self._smooth = _Linear(record, _Band(record, by_lines=False))

    def _bend(self, term: Term) -> ComplexArray:
        """Spectra, (3, n_freq), of a term's instrument, of the term, and of it without the person.

        The part that changes sign with the perturbation is as independent of the person as the term
        of the perturbed motion alone, and larger where the person moves the joint.
        """
        whole = term.bend(self._signals)
        turns = 0.5 * (whole - term.bend(self._signals - 2.0 * self._known))
        loaded = term.even or term.kind is Kind.GAIN
        alone = term.bend(self._known + self._load if loaded else self._known)
        turns = alone + turns if loaded else turns
        return self._band.of(np.stack((turns, whole, alone)))

    def deviations(
        self, joint: int, rest: FloatArray, size: FloatArray, Z: ComplexArray
    ) -> dict[str, Deviation]:
        """Estimate the terms in the residual torque, (N,), of a joint.

        `size`, (3,), is that of M, B and K between it and the perturbed one; `Z` their impedance.
        """
        record, band, linear = self._record, self._band, self._linear
        k, kept = record.perturbed_joint, band.kept
        if not ((self._sizes > 0.0).all() and size.all()):
            return {}
        inner, torque = band.inner(rest), band.inner(self._torques[joint])
        left, moved, shown = map(band.of, (rest, record.position[k], record.torque[joint]))
        pushes = band.of(band.pushes)

        def weighed(*noise: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
            weights = band.weights(*noise)
            whole = band.signal(weights * left)[kept]
            return weights, whole, linear.removed(whole)

        # The residual of a linear arm whose fit is slightly wrong is in proportion to the torque.
        usual = nearly, whole, remains = weighed(inner, _LEFT * torque)
        of_gains, steady = weighed(inner), self._smooth.removed(whole)
        # A locked joint that moves shows another arm in a trial at another posture. Filters are
        # constant within each band, so some of that linear residual remains.
        between = 0.0 if joint == k else _BETWEEN * float(np.linalg.norm(whole - remains))
        found = {}
        # Residuals have passed the band twice; inertia makes the upper edge of an angle matter.
        of_angle = Z * band.passed
        for name, one in TERMS.items():
            if joint != k and not one.couples:
                continue
            weights, _, remains = of_gains if one.kind is Kind.GAIN else usual
            bent = self._bent[name]
            if one.kind is Kind.SCALE:
                bent = np.asarray(bent * of_angle)
            cause, term, alone = band.signal(weights * bent)[:, kept]
            instrument = linear.unlike(cause)
            term = linear.removed(term)
            slope, error, freedom = _ratio(*_by_parts(instrument, term, remains))
            if between:
                error = float(np.hypot(error, between / np.linalg.norm(term)))
            if np.linalg.norm(linear.unlike(alone)) <= _INFORMATIVE * np.linalg.norm(alone):
                error = np.inf
            estimate = slope, error, freedom
            at_lines = False
            if record.periods is not None and not one.in_time:
                source = pushes if one.kind in {Kind.GAIN, Kind.LOST} else moved
                of_lines = _slope_at_lines(band.lines, source, bent[2], bent[1], left, shown)
                at_lines = of_lines[1] < estimate[1]
                estimate = of_lines if at_lines else estimate
            alike, sizes = self._alike[name], self._sizes
            known_of = partial(_deviation, name, alike=alike, own=size, sizes=sizes)
            found[name] = replace(known_of(estimate), at_lines=at_lines, joints=record.joints)
            if one.at_once is not None:
                changing = self._known[one.at_once], self._signals[one.at_once]
                seen = [band.signal(nearly * band.of(signal))[kept] for signal in changing]
                step, looks = _step(seen[0], seen[1], steady)
                sudden = replace(known_of(step), looks=looks, joints=record.joints)
                if abs(sudden.share) > _LEFT:
                    found[name] = max(found[name], sudden, key=lambda one: one.errors)
        return found


def _deviation(
    name: str,
    estimate: tuple[float, float, float],
    alike: FloatArray,
    own: FloatArray,
    sizes: FloatArray,
) -> Deviation:
    """Interpret the coefficient of a term, N·m, with its standard error and degrees of freedom.

    `alike` and `own`, (3,), are the M, B and K that look like a term of 1 N·m, and those of the
    joint; `sizes`, (4,), are the units of the term's signals.
    """
    term, (slope, error, freedom) = TERMS[name], estimate
    shift, held, slack = slope * term.rest * alike, 0.0, 0.0
    share = term.slope * slope / float(sizes[0 if term.kind is Kind.SCALE else 3])
    sensor = term.doubted * share
    if term.kind in {Kind.GAIN, Kind.SCALE}:
        shift = np.zeros(3)
    elif term.kind is Kind.LOST:
        slack = term.size * slope
        share = slack / float(sizes[3])
    elif term.kind in {Kind.FORCE, Kind.DRAG}:
        share = float(np.max(np.abs(shift / own)))
        # A locked joint hardly moves, so there drag is negligible.
        held = slope if term.kind is Kind.FORCE and share > term.robots else 0.0
    elif term.kind is Kind.STIFFNESS:
        # Where stiffness falls far, the change is relative to that at rest, not to this motion's.
        stiffness = float(max(abs(own[2]), abs(own[2] - shift[2])))
        share = term.slope * slope / (stiffness * float(sizes[0]))
    elif term.kind is Kind.DAMPING:
        damping = float(max(abs(own[1]), abs(own[1] - shift[1])))
        share = term.slope * slope / (damping * float(sizes[2]))
    return Deviation(
        name=name,
        share=share,
        error=abs(share * error / slope) if slope else 0.0,
        freedom=freedom,
        shift=shift,
        sensor=sensor,
        held=held,
        slack=slack,
    )


def _lost(record: TrialRecord, joint: int, term: Term, size: float) -> FloatArray:
    """Error, (N,), N·m, of a joint's torque by a slack or dead zone of the half width `size`, N·m.

    It follows from the torque as it was read, with whatever the person adds to it.
    """
    wide = _Band(record, WIDE)
    torque = wide.signal(wide.of(record.torque[joint])) + record.torque[joint].mean()
    return term.lacks(torque, size)


def _lacking(found: Sequence[Mapping[str, Deviation]], linearity: float | None) -> dict[str, float]:
    """Standard errors of half widths of slack and dead zones, N·m, that matter, by term.

    Each is the largest of all joints: transducers of one rig are alike, and small torques reveal
    little of what is lost of them.
    """
    lost = [name for name, term in TERMS.items() if term.kind is Kind.LOST]
    sizes = {**dict.fromkeys(lost, 0.0), "slack": linearity or 0.0}
    for joint, one in enumerate(found):
        others = [other for k, other in enumerate(found) if k != joint and other]
        for name in sizes if one else ():
            evidence = sum(other[name].evidence for other in others)
            doubt = one[name].doubt(max(evidence, 0.0), declared=linearity is not None)
            if doubt * abs(one[name].share) > _UNFELT:
                sizes[name] = max(sizes[name], abs(doubt * one[name].slack))
    return {name: size for name, size in sizes.items() if size}


def _held(record: TrialRecord, joint: int, term: Term) -> FloatArray:
    """Term, (N,), of friction or a yielding spring at a locked joint, from its residual motion."""
    band = _Band(record)
    angle = band.of(record.position[joint])
    motion = band.signal(angle * (2j * np.pi * band.f) ** np.arange(2)[:, None])
    sizes = np.maximum(np.std(motion[:, band.kept], axis=1), np.finfo(float).tiny)
    angle, speed = motion / sizes[:, None]
    return term.bend(np.stack((angle, angle, speed, np.zeros_like(angle))))


def _response(record: TrialRecord, signal: FloatArray, f: FloatArray) -> ComplexArray:
    """Frequency response, (n_freq,), from the perturbation to a signal, (N,) at either rate.

    It is estimated from the cross-spectrum in bands of 1 Hz and interpolated to `f`, Hz.
    """
    wide = _Band(record, WIDE)
    pushes, answer = wide.of(wide.pushes), wide.of(signal)
    cross, power = np.conj(pushes) * answer, np.abs(pushes) ** 2
    middles, real, imaginary, powers = map(wide.means, (wide.f, cross.real, cross.imag, power))
    driven = powers > np.finfo(float).eps * np.max(powers)
    answers = (real + 1j * imaginary)[driven] / powers[driven]
    return np.asarray(np.interp(f, middles[driven], answers), dtype=np.complex128)


class _Linear:
    """Linear responses to the motion, removed with the perturbation as their instrument.

    A person moves the joint, so motion and voluntary torque are correlated. Least squares on the
    motion itself would remove a part of that torque with it, and put the rest of the motion, which
    friction of the robot makes nonlinear, in its place.

    The angle of the perturbed joint and the perturbation are split as by :meth:`_Band.filters`.
    """

    def __init__(self, record: TrialRecord, band: _Band) -> None:
        motion = band.filters(record.position[record.perturbed_joint])[:, band.kept]
        sizes = np.linalg.norm(motion, axis=1, keepdims=True)
        self._motion = motion / np.where(sizes > 0.0, sizes, 1.0)
        self._onto = _onto(band.forces[:, band.kept])
        self._caused = self._onto(self._motion)
        # Motion that follows the perturbation no more than by chance may be the person's.
        chance = _BEYOND_CHANCE * _RATE / motion.shape[1]
        self._inverse = np.linalg.pinv(self._caused @ self._caused.T, rcond=chance, hermitian=True)

    def removed(self, signal: FloatArray) -> FloatArray:
        """A signal (N,) without its part that is linear in the motion."""
        return np.asarray(signal - (self._inverse @ (self._caused @ signal)) @ self._motion)

    def unlike(self, signal: FloatArray) -> FloatArray:
        """Make a signal (N,) an instrument: nonlinear in the perturbation, orthogonal to motion."""
        signal = signal - self._onto(signal)
        return np.asarray(signal - (self._inverse @ (self._motion @ signal)) @ self._caused)


def _by_parts(
    instrument: FloatArray, term: FloatArray, left: FloatArray, seconds: float = _PART
) -> tuple[FloatArray, FloatArray]:
    """Products of the instrument with the residual, and with the term, summed over each part."""
    count = max(round(left.size / (_RATE * seconds)), 3)
    parts = [np.array_split(one, count) for one in (instrument, term, left)]
    products = np.array([np.sum(p * q) for p, _, q in zip(*parts, strict=True)])
    squares = np.array([np.sum(p * q) for p, q, _ in zip(*parts, strict=True)])
    return products, squares


def _slope_at_lines(
    lines: NDArray[np.intp],
    source: ComplexArray,
    instrument: ComplexArray,
    term: ComplexArray,
    left: ComplexArray,
    torque: ComplexArray,
) -> tuple[float, float, float]:
    """As :func:`_ratio`, from spectra (n_freq,) at the lines of a periodic perturbation.

    Where all harmonics are lines, distortion falls on them, too, but differs from line to line,
    while the output of a linear filter of a `source` is smooth over frequency. So from each
    `_GROUP` lines a multiple of it is projected out that changes linearly with the frequency, and
    likewise the leakage of the record's ends, which is smooth in itself. The torque would be no
    source of itself, as it contains what the person adds.
    """
    if lines.size < _GROUP:
        return 0.0, np.inf, 1.0
    products, squares = [], []
    for group in np.array_split(lines, lines.size // _GROUP):
        steps = np.linspace(-1.0, 1.0, group.size)
        multiples = np.stack((np.ones_like(steps), steps), axis=1)
        known = np.concatenate((source[group, None] * multiples, multiples), axis=1)
        smooth = np.linalg.qr(known)[0]
        cause, bent, rest = (
            one[group] - smooth @ (np.conj(smooth.T) @ one[group])
            for one in (instrument, term, left)
        )
        nearly = np.abs(rest) ** 2 + np.abs(_LEFT * torque[group]) ** 2
        weight = group.size / max(float(np.sum(nearly)), np.finfo(float).tiny)
        products.append(weight * (np.conj(cause) * rest).real)
        squares.append(weight * (np.conj(cause) * bent).real)
    return _ratio(np.concatenate(products), np.concatenate(squares))


def _step(
    instrument: FloatArray, term: FloatArray, left: FloatArray
) -> tuple[tuple[float, float, float], int]:
    """Find the abrupt change of a coefficient that is largest relative to its standard error.

    The error follows from the scatter within both sides, as if that were the same everywhere
    (two-sample t test), which fails where voluntary torque comes and goes. How large the largest
    ratio may be by chance is therefore found by flipping the signs of the residuals, a few parts at
    a time (wild bootstrap: Wu, *Annals of Statistics* 14, 1986), and the error enlarged to match.
    Returned as :func:`_ratio` does, with the number of instants at which a change was looked for.
    """
    products, squares = _by_parts(instrument, term, left, _SHORT)
    none = 0.0, np.inf, 1.0
    telling = squares > 0.0
    products, squares = products[telling], squares[telling]
    total = float(np.sum(squares))
    if not total:
        return none, 1
    freedom = total**2 / float(np.sum(squares**2)) - 2.0
    ends = np.arange(_FEWEST_PARTS, len(squares) - _FEWEST_PARTS + 1)
    if freedom < 1.0 or not ends.size:
        return none, 1
    change, error = _changes(products, squares, ends)
    best = int(np.argmax(np.abs(change) / error))
    rest = products - float(np.sum(products)) / total * squares
    flips = np.random.default_rng(0).choice((-1.0, 1.0), (_FLIPS, -(-len(rest) // _ALIKE)))
    flipped = np.repeat(flips, _ALIKE, axis=1)[:, : len(rest)] * rest
    by_chance, its_error = _changes(flipped, squares, ends)
    seen = np.quantile(np.max(np.abs(by_chance) / its_error, axis=1), 1.0 - _RARE)
    scale = max(1.0, float(seen / stdtrit(freedom, 1.0 - 0.5 * _RARE / ends.size)))
    return (float(change[best]), float(error[best] * scale), freedom), ends.size


def _changes(
    products: FloatArray, squares: FloatArray, ends: NDArray[np.intp]
) -> tuple[FloatArray, FloatArray]:
    """Change of the slope from the parts before each end to those after it, and its error.

    From products (..., parts) and squares (parts,); either result is (..., ends).
    """
    first, before = np.cumsum(products, axis=-1), np.cumsum(squares)
    sums = np.stack((first[..., ends - 1], first[..., -1:] - first[..., ends - 1]))
    sizes = np.stack((before[ends - 1], before[-1] - before[ends - 1]))
    sizes = np.expand_dims(sizes, tuple(range(1, products.ndim)))
    explained = np.sum(sums**2 / sizes, axis=0)
    whole = np.sum(products**2 / squares, axis=-1, keepdims=True)
    least = np.finfo(np.float64).eps * whole + np.finfo(np.float64).tiny
    scatter = np.maximum(whole - explained, least) / (len(squares) - 2)
    slopes = sums / sizes
    return slopes[1] - slopes[0], np.sqrt(scatter * np.sum(1.0 / sizes, axis=0))


def _ratio(products: FloatArray, squares: FloatArray) -> tuple[float, float, float]:
    """Ratio of sums over parts, its standard error from their scatter, and degrees of freedom."""
    total = float(np.sum(squares))
    if not total:
        return 0.0, np.inf, 1.0  # as for |τ| under a load that keeps its sign
    slope = float(np.sum(products)) / total
    weights = np.clip(squares / total, 0.0, 0.9)
    error = float(np.linalg.norm((products - slope * squares) / (1.0 - weights))) / abs(total)
    return slope, error, max(1.0 / float(np.sum(weights**2)) - 1.0, 1.0)


def judge_linearity(
    records: Sequence[TrialRecord],
    estimate: ImpedanceEstimate,
    fit: MBKFit,
    jump: HoldCorrection | None,
    *,
    resolved: BoolArray,
    linearity: float | None,
) -> tuple[list[Problem], list[FloatArray], FloatArray]:
    """Judge how far arm and transducers are linear, and what that adds to the standard errors.

    Parameters
    ----------
    records : sequence of TrialRecord
        One trial for each joint, in order.
    estimate : ImpedanceEstimate
        Estimate from these trials.
    fit : MBKFit
        Its M, B and K.
    jump : HoldCorrection or None
        As :func:`deviations` takes it.
    resolved : ndarray of bool, shape (n,)
        Whether encoders resolve the motion of all locked joints in each trial. The torque of motion
        that they do not resolve may look nonlinear, so what is found then is a note, not an error.
    linearity : float or None
        That of the :class:`armimp_estimation.fit.Calibration`, N·m.

    Returns
    -------
    problems : list of Problem
    doubts : list of ndarray, shape (3, n, n)
        Uncertain changes of M, B and K, one standard error each, independent of each other.
    gain : ndarray, shape (n,)
        Relative standard errors of the gains of the transducers.
    """
    n = len(records)
    problems: list[Problem] = []
    doubts, gain, scale = list[FloatArray](), np.zeros(n), np.zeros(n)
    late = 0.0 if fit.delay is None else fit.delay.delay
    jumps_known = jump is not None or records[0].reading.without_jumps
    found = [deviations(record, fit.mbk, jump, late) for record in records]
    own = [found[k][k] for k in range(n)]
    excess = np.stack([_bursts(record, fit.mbk, jump) for record in records], axis=-1)
    doubts += list(np.einsum("pij,jk->kpij", excess * fit.errors, np.eye(n)))

    def of_torque(joint: int, trial: int, torque: FloatArray) -> FloatArray:
        shift = np.zeros((3, n, n))
        if estimate.inverse is not None:
            answer = _response(records[trial].whole_periods, torque, estimate.f)
            shift[:, joint] = fit.of_row(joint, answer * estimate.inverse[trial])
        return shift

    for k, i in np.ndindex(n, n):
        record = records[k]
        reported: set[tuple[ProblemCode, Severity]] = set()
        elsewhere = [one for joint, one in enumerate(own) if one and (joint != k or i != k)]
        for name, one in found[k][i].items():
            term, rival = TERMS[name], own[k].get(TERMS[name].explained_by)
            if rival is not None and not (rival.significant and rival.errors > one.errors):
                rival = None
            evidence = sum(other[name].evidence for other in elsewhere)
            lowers = term.shared == "by all" or (term.shared == "by joints" and i == k)
            evidence = evidence if lowers else max(evidence, 0.0)
            doubt = one.doubt(evidence, declared=linearity is not None, rival=rival)
            sensors = scale if term.kind is Kind.SCALE else gain
            sensors[k] = np.hypot(sensors[k], doubt * one.sensor)
            for m in range(n) if i == k and doubt * one.held else ():
                if m != k:
                    held = _held(records[m].whole_periods, k, term)
                    doubts.append(of_torque(k, m, doubt * one.held * held))
            if one.significant and abs(one.share) < _NEGLIGIBLE:
                continue
            if not one.slack and doubt:
                doubts.append(np.zeros((3, n, n)))
                doubts[-1][:, i, k] = doubt * one.shift
            arms = jumps_known or not 0.0 < abs(one.held) < _JUMPING / record.rate
            large = arms and resolved[k] and term.large < abs(one.share) < term.most
            code, severity = term.code, Severity.ERROR if large else Severity.NOTE
            if rival is not None or not one.significant or (code, severity) in reported:
                continue
            reported.add((code, severity))
            of_sensor = one.of_transducer or term.kind is Kind.SCALE
            concern = Concern.IMPEDANCE if of_sensor else Concern.PARAMETERS
            problems.append(
                problem(
                    code,
                    concern=concern,
                    severity=severity,
                    trial=record.trial,
                    name=" and ".join(record.joint_names[j] for j in dict.fromkeys((i, k))),
                    percent=100.0 * one.share,
                    error=100.0 * one.error,
                )
            )
    doubts += list(np.einsum("pij,jk->kpij", fit.values, np.diag(scale)[:, scale > 0.0]))
    for (name, size), k in product(_lacking(own, linearity).items(), range(n)):
        parts = [_lost(record.whole_periods, k, TERMS[name], size) for record in records]
        lost = np.asarray(sum(of_torque(k, m, part) for m, part in enumerate(parts)))
        if name == "slack" and fit.delay is not None:
            # Its effect on B is that of a delay, which was fitted as far as the data determine it.
            lost[1] *= fit.delay.held
        doubts.append(lost)
    return problems, doubts, gain
