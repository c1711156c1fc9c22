"""Torque of no linear arm or transducer: changing stiffness, hysteresis, in what the fit leaves.

With the fitted arm, ``e = τ_k - Σ_j Z_kj θ_j`` is what it doesn't explain of the torque of the
perturbed joint, in the band. If stiffness falls or grows with the angle, e follows the angle up to
half of its rms, and no further; if it is another one in either direction, ``|θ|``; if a spring of
short range yields, a play operator of the angle (the spring's stretch: Brokate & Sprekels,
*Hysteresis and Phase Transitions*, ch. 2); if friction is left in it, the sign of ``θ̇``; if
stiffness changes over the trial, ``θ t``, or at once, or is larger at its begin, ``θ exp(-t)``. If
the transducer is not linear, e follows the torque τ̂, up to the end of the perturbation: ``|τ̂|`` if
it shows more in one direction, ``τ̂³`` if its gain changes with the torque, the sign of τ̂ if small
torques don't show, ``τ̂ t`` if its gain changes over the trial, or at once, a play operator of it if
it has hysteresis. Terms and e are taken without
all that any linear filter makes of angle and perturbation, and the coefficient is found with what
of the term turns with the sign of the perturbation, or the same term of what that alone causes, as
the instrument (Söderström & Stoica, *Instrumental Variable Methods for System Identification*): so
a linear arm gives zero on average, whatever the person does beside, although that moves the arm,
too. What a person does is slow and hides what a stiffness that changes does there, so e is looked
at with what the angle exceeds its rms by, where it has least noise. What M, B and K are alike of
the regressor, times the coefficient, is what the term does to them; what the gain of a transducer
changes by is in doubt for all that it measures. What readings lack because torques jump with
commands is put right before: commands that overcome friction would make it look like a bent spring.
The trial is cut into parts, and the scatter of what each of them says is the error, with no
assumption about the spectrum of e; parts that weigh much pull the coefficient towards themselves,
which is made up for (MacKinnon & White, *Journal of Econometrics* 29, 1985: HC3). Few parts tell
that scatter badly, so what counts as significant follows Student's distribution. The ends of a
trial are left out: there the derivatives of a record that is cut off ring.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.special import ndtri, stdtr, stdtrit

from armimp_common.arrays import BoolArray, ComplexArray, FloatArray
from armimp_estimation.estimators.estimate import ImpedanceEstimate
from armimp_estimation.fit import MBKFit, hidden_square
from armimp_estimation.hold_correction import HoldCorrection, command_steps, without_skew
from armimp_estimation.mbk import MBK
from armimp_estimation.problems import Concern, Problem, ProblemCode, Severity, problem
from armimp_estimation.record import TrialRecord
from armimp_estimation.torque_timing import TorqueReading

BAND = ((0.2, 0.7), (11.0, 15.0))
"""Edges of the part of the spectrum that is looked at, Hz: a person's own torque is mostly below.

They are not sharp, so that the ends of the record soon die away.
"""
WIDE = (BAND[0], (30.0, 40.0))
"""Edges of the part of the fitted torque that bends a transducer: all that is perturbed, Hz."""
MOVING = ((0.0, 0.1), BAND[1])
"""Edges of the part of the motion that bends a spring, Hz: slow motion goes along its curve."""
SIGNIFICANT = 3.5
"""Standard errors that are significant if there are many parts: by chance, 1 in 2000 is larger."""
REST = 0.5
"""Angle up to which stiffness is that of an arm at rest, in rms angles."""
FAR = 1.0
"""Angle beyond which stiffness differs, in rms angles."""
ONSETS = 15.0
"""Length of a trial in times within which an arm that is startled calms down."""
PLAY = 0.12
"""Half of the play, in rms angles."""
SLACK = 0.05
"""Half of the play of a transducer, in rms torques."""
DEAD = 0.1
"""Torque beyond which a dead zone has taken all that it takes, in rms torques."""
_OWN_ZONE = 1.4
"""Half of a dead zone per what readings without it, and with little noise, show of it."""
_OWN_LAG = 2.0
"""Slack of a transducer per what its readings show of it: 1.3 to 2 of perturbed joints, of slack of
1 to 15 % of the rms torque, and up to 8 where torques are small."""
SLOW = 0.1
"""Speed at which friction has three quarters of its size, in rms speeds."""
_ENDS = 3.0
_WIDTH = 1.0
_SMOOTHING = 0.2
"""Over what weights are averaged, Hz: a person's rhythm is as narrow."""
_RATE = 200.0
_MOST_ENDS = 0.2
_PART = 1.5
"""Seconds of a part: motion and torque of a person hardly are alike any more after it."""
_FEWEST_PARTS = 2
"""Parts on either side of a change at once, at least."""
_SHORT = 0.75
"""And where a step is looked for."""
_FLIPS, _ALIKE, _RARE = 400, 4, 0.05
"""How often signs are flipped, of how many such parts together, and the chance that is compared."""
_BEYOND_CHANCE = 4.0
_NEGLIGIBLE = 0.003
_UNFELT = 0.001
_RUBBING = 0.03
"""Share of friction from which on it is the arm's: what the robot's leaves in torques is less."""
_GROUP = 8
_JUMPING = 15.0
"""Torque that friction of the robot may leave of an arm's, per period of commands whose jumps are
not known, N·m/s: a quarter of 2 N·m (assumption) at 30 rad/s."""
_LEFT = 0.01
_LEAST = 10.0
_TOLD = 0.1
"""Share of what the perturbation alone causes of a term below which that tells nothing: what
remains is chance, begin and end.

So it is where a periodic perturbation has all lines: between them is nothing, and at them any
motion is linear. A bent arm leaves a lack of fit there; gains are in doubt as of any transducer.
"""


class Kind(Enum):
    """What isn't linear, and so what its share is relative to."""

    STIFFNESS = "stiffness"
    """The arm, which changes: to the stiffness."""
    FORCE = "force"
    """The arm, with a torque beside it: to the largest of M, B and K that it looks like."""
    GAIN = "gain"
    """The transducer, of which the gain changes."""
    DRAG = "drag"
    """What is between transducer and arm, which takes torque off: as of a force."""
    LOST = "lost"
    """The transducer, which shows less than there is, never more: to the rms torque."""


@dataclass(frozen=True, kw_only=True)
class Term:
    """One way in which a joint, or its transducer, may not be linear."""

    bend: Callable[[FloatArray], FloatArray]
    """What follows from angle, the same and speed without what is slow, and torque, each in units
    of its rms; (4, N)."""
    code: ProblemCode
    kind: Kind = Kind.STIFFNESS
    in_time: bool = False
    """Whether it differs from period to period of a periodic perturbation."""
    at_once: int | None = None
    """Which of those signals it is a change of that may come at once, too."""
    lacks: Callable[[FloatArray, float], FloatArray] = lambda torque, _: 0.0 * torque
    """What a transducer that loses torque lacks, N·m, of what it shows, by the size of that."""
    size: float = 1.0
    """That size per what readings show of it, which lack it themselves."""
    slope: float = 1.0
    """Of that over its argument at one rms, less at rest, or between both directions; of what the
    angle exceeds its rms by, over a normal distribution of angles."""
    large: float = np.inf
    """Share of the stiffness, or of M, B or K, beyond which these are of this motion, or time,
    alone; change of the gain beyond which a transducer is none.

    Smaller ones are in the standard errors, and so is what friction of the robot leaves in the
    torques where their jumps with the commands are not known well.
    """
    most: float = np.inf
    """Share beyond which it is none of an arm: what a person does in time looks like it."""
    likely: float = 0.0
    sizes: tuple[float, ...] = (0.0,)
    """Assumptions: how likely it is there, and by what share if so."""
    lines_alone: bool = False
    """Whether that is so where the lines of a multisine tell it, as no other term does then."""
    robots: float = 0.0
    """Share in the largest of M, B and K up to which it is the robot's, and no more than that."""
    doubted: float = 0.0
    """Share of a change of the gain by which that may differ from that of the
    calibration, which is right for one of two directions, for small torques, at begin or end."""
    even: bool = False
    """Whether it doesn't turn with the sign of what the perturbation causes."""


TERMS: Mapping[str, Term] = {
    "amplitude": Term(
        bend=lambda signals: np.clip(signals[0], -REST, REST),
        code=ProblemCode.DEPENDS_ON_AMPLITUDE,
        slope=-1.0,
        large=0.03,
        likely=0.3,
        sizes=(0.03, 0.1, 0.3, 1.0),
        lines_alone=True,
    ),
    "curvature": Term(
        bend=lambda signals: signals[0] - np.clip(signals[0], -FAR, FAR),
        code=ProblemCode.DEPENDS_ON_AMPLITUDE,
        slope=0.32,
        large=0.1,
        likely=0.7,
        sizes=(0.1, 0.3, 1.0),
    ),
    "posture": Term(
        bend=lambda signals: np.abs(signals[0]),
        code=ProblemCode.DEPENDS_ON_DIRECTION,
        slope=2.0,
        large=0.1,
        even=True,
    ),
    "hysteresis": Term(
        bend=lambda signals: play(signals[1], PLAY),
        code=ProblemCode.HYSTERESIS,
        kind=Kind.FORCE,
        large=0.05,
        likely=0.1,
        sizes=(0.01, 0.03, 0.1),
    ),
    "slack": Term(
        bend=lambda signals: -play(signals[3], SLACK),
        code=ProblemCode.HYSTERESIS,
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
    "onset": Term(
        bend=lambda signals: signals[0] * np.exp(-np.linspace(0.0, ONSETS, signals.shape[1])),
        code=ProblemCode.CHANGES_OVER_TIME,
        in_time=True,
        large=0.3,
        likely=0.2,
        sizes=(0.1, 0.3, 1.0),
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
}
"""All of them, by name."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Deviation:
    """One way in which the perturbed joint is not linear."""

    name: str
    share: float
    error: float
    """Change of the stiffness from rest to the rms angle, or from begin to end, relative to it; of
    hysteresis and friction its share in the largest of M, B and K; of a transducer the change of
    its gain. And its standard error."""
    freedom: float
    """Degrees of freedom of that error."""
    shift: FloatArray
    """What it adds to M, B and K of the joint itself, SI units; shape (3,)."""
    gain: float = 0.0
    """What it adds to the gain of the transducer, relative to that."""
    held: float = 0.0
    """Torque of friction or of a spring that yields, N·m: it is there while the joint hardly moves,
    too."""
    at_lines: bool = False
    """Whether the lines of a multisine tell it."""
    looks: int = 1
    """At how many times it was looked for."""
    joints: int = 1
    """And of how many joints that chance may make it of."""
    slack: float = 0.0
    """Torque by which the transducer lags on either way, or that it shows as none, N·m."""

    @property
    def of_transducer(self) -> bool:
        """Whether it is the transducer that isn't linear, not the joint."""
        return TERMS[self.name].kind in {Kind.GAIN, Kind.DRAG, Kind.LOST}

    @property
    def significant(self) -> bool:
        """Whether chance hardly explains it."""
        return self._errors(self.looks * self.joints) > SIGNIFICANT

    def doubt(self, elsewhere: float = 0.0, *, declared: bool = False) -> float:
        """Standard error that it is, relative to what was found: less if it may be chance.

        Other joints of an arm tell how likely it is, `elsewhere`. Where it is `declared` how linear
        transducers are, what doesn't stand out of them is chance, but for their drift.
        """
        if self.significant:
            return 1.0
        if declared and self.of_transducer and not TERMS[self.name].in_time:
            return 0.0
        return float(np.sqrt(self._odds(elsewhere)[0])) / abs(self.share) if self.share else 0.0

    @property
    def evidence(self) -> float:
        """Logarithm of the ratio of likelihoods of what is and isn't linear."""
        return self._odds(0.0)[1]

    def _odds(self, elsewhere: float) -> tuple[float, float]:
        term = TERMS[self.name]
        if term.kind is Kind.GAIN and self.error == np.inf:
            return term.likely * float(np.mean(np.square(term.sizes))), 0.0
        untold = not term.likely or (term.lines_alone and not self.at_lines)
        if untold or not self.errors > 0.0 or abs(self.share) <= term.robots:
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
        """Standard errors of a normal distribution that are as unlikely."""
        return self._errors(self.looks)

    def _errors(self, looks: int) -> float:
        if not self.error > 0.0:
            return 0.0
        chance = looks * float(stdtr(self.freedom, -abs(self.share) / self.error))
        return float(-ndtri(min(max(chance, np.finfo(float).tiny), 0.5)))


class _Band:
    """Signals of a record within the band, at a rate that suffices for them, without its ends."""

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
        """Places of the lines of a periodic perturbation among its bins."""
        return np.flatnonzero(self._parts >= 0)

    def of(self, signal: FloatArray) -> ComplexArray:
        spectrum: ComplexArray = np.fft.rfft(signal - signal.mean(axis=-1, keepdims=True))
        return np.asarray(spectrum[..., self.bins] * self.passed / signal.shape[-1])

    def filters(self, signal: FloatArray) -> FloatArray:
        """A signal cut into bands, each as it is and turned by 90 degrees, (2 bands, N).

        Under a periodic perturbation each line is a band, and what lies between them, which is
        distortion and what a person does, is in none: what was made of a person's motion there
        would go with the person's torque. Nor does anything remain at the lines of what a fitted
        arm leaves there that is a little off, which no scatter between parts of the trial shows.
        """
        values = self.of(signal)
        parts = np.unique(self._parts[self._parts >= 0])
        cut = np.where(self._parts == parts[:, None], values, 0.0)
        return self.signal(np.concatenate((cut, 1j * cut)))

    def caused(self, signals: FloatArray) -> FloatArray:
        """What any linear filter makes of the perturbation in signals (..., N)."""
        return _onto(self.filters(self.pushes))(signals)

    def weights(self, *noise: FloatArray) -> FloatArray:
        """What makes a sum of signals white, by frequency.

        It changes gradually: what sharp edges pass is alike over the whole trial, whose parts
        would not be independent of each other.
        """
        width = _SMOOTHING / float(self.f[1] - self.f[0])
        power = np.sum([np.abs(self.of(n)) ** 2 for n in noise], axis=0)
        of_noise, of_white = (
            gaussian_filter1d(one, width, mode="constant") for one in (power, self.passed**4)
        )
        tiny = float(np.finfo(float).tiny)
        return np.asarray(np.sqrt(of_white / np.maximum(of_noise, tiny)))

    def means(self, values: FloatArray) -> FloatArray:
        """Mean in each band of 1 Hz of values at each frequency."""
        return np.bincount(self._which, weights=values) / np.bincount(self._which)

    def inner(self, signal: FloatArray) -> FloatArray:
        """The same without its ends, where the jump between end and begin of a record rings."""
        inside = np.zeros_like(signal)
        inside[self.kept] = signal[self.kept]
        return inside

    def signal(self, values: ComplexArray) -> FloatArray:
        """Whole signal at the lower rate, ends included."""
        spectrum = np.zeros((*values.shape[:-1], self.samples // 2 + 1), dtype=np.complex128)
        spectrum[..., self.bins] = values * self.samples
        signal: FloatArray = np.fft.irfft(spectrum, self.samples)
        return signal


def play(angle: FloatArray, half: float) -> FloatArray:
    """Stretch of a spring that yields beyond `half`, (N,), in units of that: the play operator."""
    # Each angle clips where the spring rested before. Two such clips are one, so that of all angles
    # up to each follows from joining runs of 1, 2, 4 ... of them.
    least, most = angle - half, angle + half
    run = 1
    while run < angle.size:
        lower, upper = least[run:], most[run:]
        joined = [np.minimum(np.maximum(one[:-run], lower), upper) for one in (least, most)]
        least[run:], most[run:] = joined
        run *= 2
    return np.asarray((angle - np.clip(0.0, least, most)) / half)


def _unexplained_torque(
    record: TrialRecord,
    arm: MBK,
    jump: HoldCorrection | None,
    reading: TorqueReading,
    late: float,
) -> tuple[FloatArray, FloatArray]:
    """Motion of the perturbed joint and what the arm leaves of its torque, both within the band.

    Angle, rad, and its first two derivatives, (3, N), and the torque, (N,), N·m; 200 samples per
    second at most.
    """
    k, n, band = record.perturbed_joint, record.joints, _Band(record)
    angle, torque = band.of(record.position), band.of(record.torque[k])
    coefficients = without_skew(band.f, record.rate, n, reading, jump, late)[k]
    torque = coefficients[k] * torque
    if jump is not None:
        steps = band.of(command_steps(record))
        torque = torque + np.sum(coefficients[n:] * steps, axis=0)
    motion = angle[k] * (2j * np.pi * band.f) ** np.arange(3)[:, None]
    left = torque - np.sum(arm.impedance(band.f)[k] * angle, axis=0)
    return band.signal(motion), band.signal(left)


def _onto(forces: FloatArray) -> Callable[[FloatArray], FloatArray]:
    """Project signals (..., N) onto what linear filters make of a perturbation, (2 bands, N)."""
    normal = np.linalg.pinv(forces @ forces.T, hermitian=True)
    return lambda signals: np.asarray((signals @ forces.T) @ normal @ forces)


def deviations(
    record: TrialRecord,
    arm: MBK,
    jump: HoldCorrection | None = None,
    reading: TorqueReading | None = None,
    late: float = 0.0,
) -> dict[str, Deviation]:
    """In which ways the perturbed joint is not linear, by name.

    Parameters
    ----------
    record : TrialRecord
        One trial.
    arm : MBK
        What was fitted.
    jump : HoldCorrection, optional
        How torques jump with the commands, if that is known.
    reading : TorqueReading, optional
        How torques were read.
    late : float
        How late they were found to be beyond that, s.

    Returns
    -------
    dict of str to Deviation
        Those of `TERMS`; empty for trials of less than 10 s.
    """
    if record.duration < _LEAST:
        return {}
    record = record.whole_periods
    band, k = _Band(record), record.perturbed_joint
    motion, rest = _unexplained_torque(record, arm, jump, reading or TorqueReading(), late)
    wide, moving = _Band(record, WIDE), _Band(record, MOVING)
    # All motion and torque are bent, but what the perturbation causes of them alone is independent
    # of what the person does: it is the instrument by which the rest is found. Slow motion of the
    # person would make it a weak one of terms that go by the direction of the motion.
    angle = moving.signal(moving.of(record.position[k]))
    quick = np.stack((2j * np.pi * wide.f * wide.of(record.position[k]), wide.of(record.torque[k])))
    speed, torque = wide.signal(quick)
    kept = band.kept
    caused = moving.caused(angle), band.caused(motion[0]), *wide.caused(np.stack((speed, torque)))
    load = band.inner(np.full(torque.size, record.torque[k].mean()))
    actual = np.stack([angle, motion[0], speed, band.inner(torque) + load])
    known = np.stack([*caused[:3], band.inner(caused[3])])
    sizes = np.std(actual[:, kept], axis=1)[:, None]
    own = np.array([arm.M[k, k], arm.B[k, k], arm.K[k, k]])
    if not ((sizes > 0.0).all() and own.all()):
        return {}
    signals, known = actual / sizes, known / sizes
    loaded = known + np.array([0.0, 0.0, 0.0, 1.0])[:, None] * load / sizes
    inner = band.inner(rest)
    white = band.weights(inner)
    # What a linear arm leaves that isn't quite as it was fitted is in proportion to the torque.
    nearly = band.weights(inner, _LEFT * band.inner(torque))
    left, moved, shown = (band.of(one) for one in (rest, record.position[k], record.torque[k]))
    linear = _Linear(record, band)
    weighed = [(one, linear.removed(band.signal(one * left)[kept])) for one in (nearly, white)]
    # With as many bands as there are lines, filters can follow what comes at once.
    smooth = linear if record.periods is None else _Linear(record, _Band(record, by_lines=False))
    steady = smooth.removed(band.signal(nearly * left)[kept])
    found = {}
    for name, one in TERMS.items():
        of_gain = one.kind is Kind.GAIN
        # What turns with the sign of the perturbation is as independent of the person as what that
        # alone causes, and tells more where the person moves or loads the joint.
        whole = one.bend(signals)
        turns = 0.5 * (whole - one.bend(signals - 2.0 * known))
        alone = one.bend(loaded if of_gain or one.even else known)
        turns = alone + turns if of_gain or one.even else turns
        bent = np.stack([band.of(signal) for signal in (turns, whole, alone)])
        weights, remains = weighed[1 if of_gain else 0]
        cause, term, alone = (band.signal(weights * part)[kept] for part in bent)
        instrument = linear.unlike(cause)
        told = _ratio(*_by_parts(instrument, linear.removed(term), remains))
        if np.linalg.norm(linear.unlike(alone)) <= _TOLD * np.linalg.norm(alone):
            told = told[0], np.inf, told[2]
        at_lines = False
        if record.periods is not None and not one.in_time:
            signal = shown if one.kind in {Kind.GAIN, Kind.LOST} else moved
            of_lines = _slope_at_lines(band.lines, signal, bent[2], bent[1], left, shown)
            at_lines = of_lines[1] < told[1]
            told = of_lines if at_lines else told
        # What M, B and K are alike of it: the derivatives 2, 1, 0.
        alike = np.linalg.lstsq(motion[2::-1, kept].T, band.signal(bent[1])[kept], rcond=None)[0]
        deviation = _deviation(name, told, alike, own, sizes[:, 0])
        found[name] = replace(deviation, at_lines=at_lines, joints=record.joints)
        if one.at_once is not None:
            changing = known[one.at_once], signals[one.at_once]
            seen = [band.signal(nearly * band.of(signal))[kept] for signal in changing]
            step, looks = _step(seen[0], seen[1], steady)
            sudden = replace(
                _deviation(name, step, alike, own, sizes[:, 0]), looks=looks, joints=record.joints
            )
            if abs(sudden.share) > _LEFT:
                found[name] = max(found[name], sudden, key=lambda one: one.errors)
    return found


def _deviation(
    name: str,
    told: tuple[float, float, float],
    alike: FloatArray,
    own: FloatArray,
    sizes: FloatArray,
) -> Deviation:
    """What a coefficient, its error and that's degrees of freedom mean.

    Parameters
    ----------
    name, told
        Of a term, N·m.
    alike, own : ndarray, shape (3,)
        M, B and K that are like a term of 1 N·m, and those of the joint.
    sizes : ndarray, shape (4,)
        Units of angle, the same without what is slow, speed and torque.
    """
    term, (slope, error, freedom) = TERMS[name], told
    shift, held, slack = slope * alike, 0.0, 0.0
    share = term.slope * slope / float(sizes[3])
    gain = term.doubted * share
    if term.kind is Kind.GAIN:
        shift = np.zeros(3)
    elif term.kind is Kind.LOST:
        slack = term.size * slope
        share = slack / float(sizes[3])
    elif term.kind in {Kind.FORCE, Kind.DRAG}:
        share = float(np.max(np.abs(shift / own)))
        # What hardly moves has hardly any drag.
        held = slope if term.kind is Kind.FORCE and share > term.robots else 0.0
    elif term.kind is Kind.STIFFNESS:
        # Where it falls that far, the stiffness of this motion is no measure of it.
        stiffness = float(max(abs(own[2]), abs(own[2] - shift[2])))
        share = term.slope * slope / (stiffness * float(sizes[0]))
    return Deviation(
        name=name,
        share=share,
        error=abs(share * error / slope) if slope else 0.0,
        freedom=freedom,
        shift=shift,
        gain=gain,
        held=held,
        slack=slack,
    )


def _lost(record: TrialRecord, joint: int, term: Term, size: float) -> FloatArray:
    """What the transducer of a joint lacks in one way, of that size, N·m, (N,).

    It is that of the torque as it was read, whatever the person adds to it.
    """
    wide = _Band(record, WIDE)
    torque = wide.signal(wide.of(record.torque[joint])) + record.torque[joint].mean()
    return term.lacks(torque, size)


def _lacking(found: Sequence[Mapping[str, Deviation]], linearity: float | None) -> dict[str, float]:
    """Standard errors of slack and dead zones, N·m, where they are felt.

    Transducers of one rig are alike, and small torques tell little of what is lost of them.
    """
    lost = [name for name, term in TERMS.items() if term.kind is Kind.LOST]
    sizes = {**dict.fromkeys(lost, 0.0), "slack": linearity or 0.0}
    for joint, one in enumerate(found):
        others = [other for k, other in enumerate(found) if k != joint and other]
        for name in sizes if one else ():
            told = sum(other[name].evidence for other in others)
            doubt = one[name].doubt(max(told, 0.0), declared=linearity is not None)
            if doubt * abs(one[name].share) > _UNFELT:
                sizes[name] = max(sizes[name], abs(doubt * one[name].slack))
    return {name: size for name, size in sizes.items() if size}


def _held(record: TrialRecord, joint: int, term: Term) -> FloatArray:
    """Friction or a spring that yields of a locked joint, (N,), as it moves nonetheless."""
    band = _Band(record)
    angle = band.of(record.position[joint])
    motion = band.signal(angle * (2j * np.pi * band.f) ** np.arange(2)[:, None])
    sizes = np.maximum(np.std(motion[:, band.kept], axis=1), np.finfo(float).tiny)
    angle, speed = motion / sizes[:, None]
    return term.bend(np.stack((angle, angle, speed, np.zeros_like(angle))))


def _response(record: TrialRecord, signal: FloatArray, f: FloatArray) -> ComplexArray:
    """How a signal, (N,) at either rate, answers the perturbation at some frequencies, (n_freq,).

    From the cross-spectrum in bands of 1 Hz.
    """
    wide = _Band(record, WIDE)
    pushes, answer = wide.of(wide.pushes), wide.of(signal)
    cross, power = np.conj(pushes) * answer, np.abs(pushes) ** 2
    middles, real, imaginary, powers = map(wide.means, (wide.f, cross.real, cross.imag, power))
    told = powers > np.finfo(float).eps * np.max(powers)
    answers = (real + 1j * imaginary)[told] / powers[told]
    return np.asarray(np.interp(f, middles[told], answers), dtype=np.complex128)


class _Linear:
    """What linear filters make of the motion, taken out by means of the perturbation alone.

    A person moves the joint, so that motion and the person's torque are alike: what is fitted to
    the motion itself would take a part of that torque with it, and put the rest of the motion,
    which friction of the robot bends, in its place. The perturbation is their instrument.

    Angle of the perturbed joint and perturbation are cut into parts of a band.
    """

    def __init__(self, record: TrialRecord, band: _Band) -> None:
        signals = record.position[record.perturbed_joint], band.pushes
        motion, forces = (band.filters(one)[:, band.kept] for one in signals)
        sizes = np.linalg.norm(motion, axis=1, keepdims=True)
        self._motion = motion / np.where(sizes > 0.0, sizes, 1.0)
        self._onto = _onto(forces)
        self._caused = self._onto(self._motion)
        # Motion that is not the perturbation's beyond chance can't be told from the person's.
        chance = _BEYOND_CHANCE * _RATE / motion.shape[1]
        self._inverse = np.linalg.pinv(self._caused @ self._caused.T, rcond=chance, hermitian=True)

    def removed(self, signal: FloatArray) -> FloatArray:
        """A signal (N,) without its part that is linear in the motion."""
        return np.asarray(signal - (self._inverse @ (self._caused @ signal)) @ self._motion)

    def unlike(self, signal: FloatArray) -> FloatArray:
        """What is orthogonal to perturbation and motion of a signal (N,) of the perturbation."""
        signal = signal - self._onto(signal)
        return np.asarray(signal - (self._inverse @ (self._motion @ signal)) @ self._caused)


def _by_parts(
    instrument: FloatArray, term: FloatArray, left: FloatArray, seconds: float = _PART
) -> tuple[FloatArray, FloatArray]:
    """Sums of products of the instrument with what is left, and with the term, by part."""
    count = max(round(left.size / (_RATE * seconds)), 3)
    parts = [np.array_split(one, count) for one in (instrument, term, left)]
    products = np.array([np.sum(p * q) for p, _, q in zip(*parts, strict=True)])
    squares = np.array([np.sum(p * q) for p, q, _ in zip(*parts, strict=True)])
    return products, squares


def _slope_at_lines(
    lines: NDArray[np.intp],
    signal: ComplexArray,
    instrument: ComplexArray,
    term: ComplexArray,
    left: ComplexArray,
    torque: ComplexArray,
) -> tuple[float, float, float]:
    """As :func:`_ratio`, from spectra (n_freq,) at the lines of a periodic perturbation.

    Where all harmonics are lines, what bends a signal falls on them, too, in another way on each.
    What any linear filter makes of the signal is smooth over frequency: of each `_GROUP` lines a
    multiple of the signal is taken out that changes steadily with the frequency. So is what the
    ends of the record leak, which has nothing to do with the signal: it is taken out likewise.
    """
    if lines.size < _GROUP:
        return 0.0, np.inf, 1.0
    products, squares = [], []
    for group in np.array_split(lines, lines.size // _GROUP):
        steps = np.linspace(-1.0, 1.0, group.size)
        multiples = np.stack((np.ones_like(steps), steps), axis=1)
        known = np.concatenate((signal[group, None] * multiples, multiples), axis=1)
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
    """Largest change of a coefficient from one part to the next, relative to its standard error.

    The error is that of a change there, from the scatter within both sides, as if it was the same
    everywhere (two-sample t test). It isn't where a person's torque comes and goes: how large the
    largest ratio may be by chance, what is left of all parts shows with its signs flipped, some
    parts together (wild bootstrap: Wu, *Annals of Statistics* 14, 1986), and errors follow.

    Returns
    -------
    told : tuple of float
        As :func:`_ratio` gives it.
    looks : int
        Between how many parts it was looked for.
    """
    products, squares = _by_parts(instrument, term, left, _SHORT)
    none = 0.0, np.inf, 1.0
    total = float(np.sum(squares))
    if not (squares > 0.0).all():
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

    Of products (..., parts) and squares, (parts,); each is (..., ends).
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
    """Ratio of sums over parts, its standard error by their scatter, and degrees of freedom."""
    total = float(np.sum(squares))
    if not total:
        return 0.0, np.inf, 1.0  # as of |τ| where a load keeps its sign
    slope = float(np.sum(products)) / total
    weights = np.clip(squares / total, 0.0, 0.9)
    error = float(np.linalg.norm((products - slope * squares) / (1.0 - weights))) / abs(total)
    return slope, error, max(1.0 / float(np.sum(weights**2)) - 1.0, 1.0)


def judge_linearity(
    records: Sequence[TrialRecord],
    estimate: ImpedanceEstimate,
    fit: MBKFit,
    jump: HoldCorrection | None,
    reading: TorqueReading,
    *,
    resolved: BoolArray,
    linearity: float | None,
) -> tuple[list[Problem], list[FloatArray], FloatArray]:
    """Find what isn't linear.

    Parameters
    ----------
    records : sequence of TrialRecord
        One trial for each joint, in order.
    estimate : ImpedanceEstimate
        What follows from them.
    fit : MBKFit
        M, B and K of that.
    jump : HoldCorrection or None
    reading : TorqueReading
        As :func:`deviations` takes them.
    resolved : ndarray of bool, shape (n,)
        Where the motion of locked joints isn't, its torque may look like what isn't linear.
    linearity : float or None
        That of the :class:`armimp_estimation.fit.Calibration`, N·m.

    Returns
    -------
    problems : list of Problem
    doubts : list of ndarray, shape (3, n, n)
        Changes of M, B and K that are in doubt, each independent of the others.
    gain : ndarray, shape (n,)
        Relative standard errors of the gains of the joints' transducers that come of it.
    """
    n = len(records)
    problems: list[Problem] = []
    doubts, gain = [np.zeros((3, n, n)) for _ in records], np.zeros(n)
    late = 0.0 if fit.delay is None else fit.delay.delay
    jumps_known = jump is not None or reading.without_jumps
    found = [deviations(record, fit.mbk, jump, reading, late) for record in records]

    def of_torque(joint: int, trial: int, torque: FloatArray) -> FloatArray:
        shift = np.zeros((3, n, n))
        if estimate.inverse is not None:
            answer = _response(records[trial].whole_periods, torque, estimate.f)
            shift[:, joint] = fit.of_row(joint, answer * estimate.inverse[trial])
        return shift

    for k, record in enumerate(records):
        said: set[tuple[ProblemCode, Severity]] = set()
        elsewhere = [one for joint, one in enumerate(found) if joint != k and one]
        for name, one in found[k].items():
            told = sum(other[name].evidence for other in elsewhere)
            # Joints of one arm are alike in whether their stiffness depends on the amplitude.
            # A transducer that isn't linear doesn't clear the others of it.
            doubt = one.doubt(
                told if name == "curvature" else max(told, 0.0), declared=linearity is not None
            )
            gain[k] = np.hypot(gain[k], doubt * one.gain)
            for m in range(n) if doubt * one.held else ():
                if m != k:
                    held = _held(records[m].whole_periods, k, TERMS[name])
                    doubts.append(of_torque(k, m, doubt * one.held * held))
            if one.significant and abs(one.share) < _NEGLIGIBLE:
                continue
            if not one.slack:
                doubts[k][:, k, k] = np.hypot(doubts[k][:, k, k], doubt * one.shift)
            arms = jumps_known or not 0.0 < abs(one.held) < _JUMPING / record.rate
            large = arms and resolved[k] and TERMS[name].large < abs(one.share) < TERMS[name].most
            code, severity = TERMS[name].code, Severity.ERROR if large else Severity.NOTE
            if not one.significant or (code, severity) in said:
                continue
            said.add((code, severity))
            concern = Concern.IMPEDANCE if one.of_transducer else Concern.PARAMETERS
            problems.append(
                problem(
                    code,
                    concern=concern,
                    severity=severity,
                    trial=record.trial,
                    name=record.joint_names[record.perturbed_joint],
                    percent=100.0 * one.share,
                    error=100.0 * one.error,
                )
            )
    for (name, size), k in product(_lacking(found, linearity).items(), range(n)):
        parts = [_lost(record.whole_periods, k, TERMS[name], size) for record in records]
        lost = np.asarray(sum(of_torque(k, m, part) for m, part in enumerate(parts)))
        if name == "slack" and fit.delay is not None:
            # In phase it is a delay, which was fitted as far as the data tell.
            lost[1] *= fit.delay.held
        doubts.append(lost)
    return problems, doubts, gain
