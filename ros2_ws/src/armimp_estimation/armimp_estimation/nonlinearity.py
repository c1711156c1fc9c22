"""Nonlinearity of arms and sensors, found in the residual torque of the fitted linear arm.

The residual torque of each joint in the band, ``e_i = τ_i - Σ_j Z_ij θ_j`` with the fitted
impedance Z, is regressed on one term at a time of those in `armimp_estimation.nonlinear_terms`,
which are functions of the perturbed joint's motion and of the torque:

1. *Terms* (`_Terms`). All linear responses to the angle and to the perturbation are projected out
   of each term and of e. The instrument (Söderström & Stoica, *Instrumental Variable Methods for
   System Identification*) is the part of the term that changes sign with the perturbation; for even
   terms and changes of a gain, the same term of the motion that the perturbation alone causes is
   added. So a linear arm gives zero on average, even while voluntary torque moves it.
2. *Coefficients* (`_Regression`). The standard error is the scatter between parts of the trial,
   with no assumption about the spectrum of e. Under a periodic perturbation, the scatter between
   its lines may give a smaller one. Stiffness or gain may also change abruptly.
3. *Deviations* (`_deviation`). The M, B and K that look most like a term, times its coefficient,
   are the change that it causes in them; a change of a transducer's gain, or an encoder's scale, is
   an uncertainty of all that it measures.
4. *Doubts and problems* (`judge_linearity`). What is significant counts whole, and is a problem if
   it is large; the rest counts by its odds. Noise in bursts adds to the standard errors, too.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri, stdtr, stdtrit

from armimp_common.arrays import EPS, TINY, BoolArray, ComplexArray, FloatArray
from armimp_estimation.estimators.estimate import ImpedanceEstimate
from armimp_estimation.fit import MBKFit
from armimp_estimation.hold_correction import HoldCorrection
from armimp_estimation.nonlinear_terms import TERMS, Kind, Signals, Term
from armimp_estimation.problems import Concern, Problem, Severity, problem
from armimp_estimation.record import TrialRecord
from armimp_estimation.residual_torque import (
    BAND,
    PART,
    RATE,
    Band,
    Residual,
    onto,
    parts_of,
)
from armimp_estimation.unfitted_terms import hidden_square

WIDE = (BAND[0], (30.0, 40.0))
"""Edges of the band of the torque that enters transducer terms, Hz: all perturbed frequencies."""
MOVING = ((0.0, 0.1), BAND[1])
"""Edges of the band of the angle that enters spring terms, Hz: slow motion bends a spring, too."""
SIGNIFICANT = 3.5
"""Significant number of standard errors if there are many parts: chance exceeds it in 1 of 2000."""
LOADED = ((-0.1, 0.0), (45.0, 60.0))
"""Edges of the band of the torque that enters transducer terms, Hz: slow torque, and the edges of
steps as far as the cube has no alias in `BAND`, else two values would not remain two."""
_RINGS = 100
"""Samples at either end in which the jump from end to begin of a record rings most."""
_FEWEST_PARTS = 2
"""Fewest parts on either side of an abrupt change."""
_SHORT = 0.75
"""Length of a part in the search for an abrupt change, s."""
_FLIPS, _ALIKE, _RARE = 400, 4, 0.05
"""Wild bootstrap: number of draws, successive parts with one sign, compared tail probability."""
_BEYOND_CHANCE = 4.0
_NEGLIGIBLE = 0.003  # share below which a significant deviation is not reported
_UNFELT = 0.001  # standard error of a loss of torque that is ignored, relative to the rms torque
_GROUP = 8  # lines in a group from which one coefficient is found
_JUMPING = 15.0
"""Friction of the robot that may be left in an arm's torque if jumps with the commands are unknown,
relative to the control period, N·m/s: a quarter of 2 N·m (assumption) at 30 rad/s."""
_LEFT = 0.01
"""Share of the torque that a linear arm may leave, and least share of an abrupt change."""
_BETWEEN = 0.05
"""Largest share of a linear residual that the linear filters leave between their frequencies."""
_BURSTS, _TIMES, _NEAR = 4.0, 60, 4
"""Noise in bursts: significant number of standard errors, number of times, those that are near."""
_INFORMATIVE = 0.1
"""Least share of a term of the perturbed motion alone that must remain once linear responses are
projected out. Less is due to chance and the ends, as under a periodic perturbation with all lines:
the motion has no power between them, and at them any motion looks linear; or as of the cube of a
binary torque. A nonlinear arm then leaves a lack of fit; gains are as uncertain as those of any
transducer."""
_MIXED = 0.7
"""The same for an arm that changes over time. Under a single sweep each frequency has its own time,
so that it looks like another arm that doesn't change; other perturbations leave 0.87 or more."""
_COUPLED = 0.1
"""Assumption: prior probability of terms of the coupling of two joints that count for a joint
itself only where lines determine them."""
_UNKNOWN = 1e-6
"""Coefficient of which nothing is known, N·m: so small that all changes are in proportion to it."""


@dataclass(frozen=True, kw_only=True)
class Coefficient:
    """Coefficient of a term in a residual torque, by default one of which nothing is known."""

    value: float = 0.0
    error: float = np.inf
    """Size, N·m, and its standard error."""
    freedom: float = 1.0
    """Degrees of freedom of that error."""
    at_lines: bool = False
    """Whether it is that from the lines of a multisine."""
    looks: int = 1
    """Number of instants at which an abrupt change was looked for."""

    def errors(self, joints: int = 1) -> float:
        """Number of standard errors of a normal distribution that is as unlikely as this one.

        Few parts give a poor estimate of the scatter, so it follows Student's distribution. Chance
        may exceed it at any of the `joints` that were tested.
        """
        if not (self.error > 0.0 and self.value):
            return 0.0
        chance = self.looks * joints * float(stdtr(self.freedom, -abs(self.value) / self.error))
        return float(-ndtri(min(max(chance, TINY), 0.5)))


@dataclass(frozen=True, kw_only=True, eq=False)
class Deviation:
    """One term as it was found in the torque of a joint."""

    term: Term
    coefficient: Coefficient
    share: float
    """Size of the term relative to what its `Kind` names. The size of a stiffness or gain is the
    change from rest to the rms, between directions, or over the trial."""
    shift: FloatArray
    """What it adds to M, B and K between the perturbed joint and this one, SI units; (3,)."""
    sensor: float = 0.0
    """Relative uncertainty of the transducer's gain, or the encoder's scale, that follows."""
    force: float = 0.0
    """Torque of friction or of a yielding spring, which acts on the locked joint, too, or half
    width of the hysteresis or dead zone of the transducer, N·m."""
    joints: int = 1
    """Number of joints that were tested, as chance may produce it at any of them."""

    @property
    def error(self) -> float:
        """Standard error of the share."""
        one = self.coefficient
        return abs(self.share * one.error / one.value) if one.value else 0.0

    @property
    def significant(self) -> bool:
        """Whether chance hardly explains it, given the numbers of looks and joints."""
        return self.coefficient.errors(self.joints) > SIGNIFICANT

    @property
    def negligible(self) -> bool:
        """Whether it is significant, but too small to count."""
        return self.significant and abs(self.share) < _NEGLIGIBLE

    @property
    def of_robot(self) -> bool:
        """Whether it is attributed to the robot alone."""
        return abs(self.share) <= self.term.robots

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
        if declared and self.term.kind.of_transducer and not self.term.in_time:
            return 0.0
        return float(np.sqrt(self._odds(elsewhere)[0])) / abs(self.share) if self.share else 0.0

    @property
    def evidence(self) -> float:
        """Logarithm of the likelihood ratio of its presence to its absence."""
        return self._odds(0.0)[1]

    def _odds(self, elsewhere: float) -> tuple[float, float]:
        """Posterior mean square of the share, and evidence, as of :func:`hidden_square`."""
        term = self.term
        if (term.kind is Kind.GAIN or term.in_time) and self.error == np.inf:
            return term.likely * float(np.mean(np.square(term.sizes))), 0.0
        unknown = not term.likely or (term.lines_alone and not self.coefficient.at_lines)
        errors = self.coefficient.errors()
        if unknown or not errors > 0.0 or self.of_robot:
            return 0.0, 0.0
        lost = term.kind is Kind.LOST
        return hidden_square(
            self.share if lost else abs(self.share),
            abs(self.share) / errors,
            term.likely,
            sizes=term.sizes,
            positive=lost,
            elsewhere=elsewhere,
        )


def deviations(residual: Residual) -> list[dict[str, Deviation]]:
    """Find each term of nonlinearity in the residual torque of each joint.

    Returns
    -------
    list of dict of str to Deviation
        By joint and by name in `TERMS`; at locked joints only terms that couple joints. Empty where
        a signal, or M, B or K, is zero.
    """
    k, band, arm = residual.record.perturbed_joint, residual.band, residual.arm
    terms, impedance = _Terms(residual), arm.impedance(band.f)
    # An element between joints may be small, so its size is its geometric mean with √(M_ii M_kk).
    elements = np.abs(np.stack((arm.M, arm.B, arm.K), axis=-1))
    own = np.sqrt(np.diagonal(elements).T)
    column = np.sqrt(elements[:, k] * own * own[k])
    found: list[dict[str, Deviation]] = []
    for joint, rest in enumerate(band.signal(residual.torques)):
        found.append({})
        if not ((terms.sizes > 0.0).all() and column[joint].all()):
            continue
        regression = _Regression(terms, joint, rest, impedance[joint, k])
        for name, term in TERMS.items():
            if joint != k and not term.couples:
                continue
            one = _deviation(name, regression.steady(name), column[joint], terms)
            if term.at_once and one.coefficient.error < np.inf:
                sudden = _deviation(name, regression.sudden(term), column[joint], terms)
                if abs(sudden.share) > _LEFT:
                    one = max(one, sudden, key=lambda each: each.coefficient.errors())
            if joint != k and term.lines_alone:
                one = replace(one, term=replace(term, lines_alone=False, likely=_COUPLED))
            found[joint][name] = one
    return found


class _Terms:
    """Motion of the perturbed joint in one trial, and the terms of nonlinearity that follow.

    A nonlinearity acts on all of motion and torque, but only the part that the perturbation causes
    is independent of the person: it gives the instrument. Slow voluntary motion would make that a
    weak instrument of terms that depend on the direction of the motion.
    """

    def __init__(self, residual: Residual) -> None:
        self.record, self.band = record, band = residual.record, residual.band
        k, kept = record.perturbed_joint, band.kept
        wide, moving = Band(record, WIDE), Band(record, MOVING)
        # Angle of the perturbed joint, rad, and its first two derivatives, (3, samples).
        self.moved = band.spectrum(record.position)[k]
        motion = band.signal(self.moved * (2j * np.pi * band.f) ** np.arange(3)[:, None])
        angle = moving.signal(moving.spectrum(record.position[k]))
        turning = 2j * np.pi * wide.f * wide.spectrum(record.position[k])
        speed, *self.torques = wide.signal(np.vstack((turning, wide.spectrum(record.torque))))
        # Line by line, the person's torque would seem to be caused by the perturbation, too.
        loaded = Band(record, LOADED, by_lines=False)
        torque, load = loaded.signal(loaded.spectrum(record.torque[k])), record.torque[k].mean()
        signals = (moving, angle), (band, motion[0]), (wide, speed), (loaded, torque)
        caused = np.stack([filters.caused(signal) for filters, signal in signals])
        actual = np.stack((angle, motion[0], speed, torque + load))
        self.sizes = np.std(actual[:, kept], axis=1)
        units = np.where(self.sizes > 0.0, self.sizes, 1.0)[:, None]
        self.actual, self.caused = actual / units, caused / units
        self._load = np.array([[0.0], [0.0], [0.0], [load]]) / units
        self.bent = {name: self._bend(one) for name, one in TERMS.items()}
        # The M, B and K that look most like a term: its regression on derivatives 2, 1, 0.
        # The estimate contains the ends, where an arm that is startled shows most of that.
        shapes = band.signal(np.stack([one[1] for one in self.bent.values()]))
        near = slice(_RINGS, -_RINGS)
        alike = np.linalg.lstsq(motion[2::-1, near].T, shapes[:, near].T, rcond=None)[0]
        self.alike = dict(zip(TERMS, alike.T, strict=True))
        self.linear = _Linear(record, band)
        # With one band for each line, the filters could follow an abrupt change.
        self.smooth = self.linear
        if record.periods is not None:
            self.smooth = _Linear(record, Band(record, by_lines=False))

    def _bend(self, term: Term) -> ComplexArray:
        """Spectra, (3, bins), of a term's instrument, of the term, and of it without the person.

        The part that changes sign with the perturbation is as independent of the person as the term
        of the perturbed motion alone, and larger where the person moves the joint.
        """
        whole = term.bend(Signals(*self.actual))
        turns = 0.5 * (whole - term.bend(Signals(*(self.actual - 2.0 * self.caused))))
        loaded = term.even or term.kind is Kind.GAIN
        alone = term.bend(Signals(*(self.caused + self._load if loaded else self.caused)))
        turns = alone + turns if loaded else turns
        return self.band.spectrum(np.stack((turns, whole, alone)))


class _Linear:
    """Linear responses to the motion, removed with the perturbation as their instrument.

    A person moves the joint, so motion and voluntary torque are correlated. Least squares on the
    motion itself would remove a part of that torque with it, and put the rest of the motion, which
    friction of the robot makes nonlinear, in its place.

    The angle of the perturbed joint and the perturbation are split as by :meth:`Band.filtered`.
    With the weights, (bins,), of the signals given, what varies within the bands of the filters is
    removed, too, as the fit takes it from the residual. Else it would remain of the gain of a
    torque with few values, which is nearly linear, and seem to show that it does not change.
    """

    def __init__(self, record: TrialRecord, band: Band, weights: FloatArray | None = None) -> None:
        angle, pushes = map(band.spectrum, (record.position[record.perturbed_joint], band.pushes))
        if weights is None:
            motion, forces = map(band.filtered, (angle, pushes))
        else:
            caused = band.spectrum(band.caused(band.signal(angle)))
            motion, forces = (
                np.concatenate((band.filtered(weights * one), band.varied(weights * other)))
                for one, other in ((angle, angle), (pushes, caused))
            )
        self._motion, forces = (
            one / np.maximum(np.linalg.norm(one, axis=1, keepdims=True), TINY)
            for one in (motion[:, band.kept], forces[:, band.kept])
        )
        self._onto = onto(forces)
        self._caused = self._onto(self._motion)
        # Motion that follows the perturbation no more than by chance may be the person's.
        chance = _BEYOND_CHANCE * RATE / self._motion.shape[1]
        self._inverse = np.linalg.pinv(self._caused @ self._caused.T, rcond=chance, hermitian=True)

    def removed(self, signal: FloatArray) -> FloatArray:
        """A signal (N,) without its part that is linear in the motion."""
        return np.asarray(signal - (self._inverse @ (self._caused @ signal)) @ self._motion)

    def unlike(self, signal: FloatArray) -> FloatArray:
        """Make a signal (N,) an instrument: nonlinear in the perturbation, orthogonal to motion."""
        signal = signal - self._onto(signal)
        return np.asarray(signal - (self._inverse @ (self._motion @ signal)) @ self._caused)


class _Regression:
    """Coefficients of the terms in the residual torque, (samples,), of one joint.

    Z, (bins,), is the impedance from the perturbed joint's angle to this joint's torque.
    """

    def __init__(self, terms: _Terms, joint: int, rest: FloatArray, Z: ComplexArray) -> None:
        record, band = terms.record, terms.band
        self._terms, self._left = terms, band.spectrum(rest)
        self._torque = band.spectrum(record.torque[joint])
        # Residuals have passed the band twice; inertia makes the upper edge of an angle matter.
        self._of_angle = Z * band.passed
        inner = band.inner(rest)
        # The residual of a linear arm whose fit is slightly wrong is in proportion to the torque.
        self._weights = band.weights(inner, _LEFT * band.inner(terms.torques[joint]))
        self._weights_of_gains = band.weights(inner)
        self._whole = band.signal(self._weights * self._left)[band.kept]
        self._remains = terms.linear.removed(self._whole)
        # A locked joint that moves shows another arm in a trial at another posture. Filters are
        # constant within each band, so some of that linear residual remains.
        between = _BETWEEN * float(np.linalg.norm(self._whole - self._remains))
        self._between = between if joint != record.perturbed_joint else 0.0

    @cached_property
    def _of_gains(self) -> tuple[_Linear, FloatArray]:
        """For gains, which only the perturbed joint has: linear responses, and what they leave."""
        band = self._terms.band
        linear = _Linear(self._terms.record, band, self._weights_of_gains)
        whole = band.signal(self._weights_of_gains * self._left)[band.kept]
        return linear, linear.removed(whole)

    def steady(self, name: str) -> Coefficient:
        """Find the coefficient of a term, from parts of the trial or from lines."""
        term, record = TERMS[name], self._terms.record
        bent = self._terms.bent[name]
        if term.kind is Kind.SCALE:
            bent = np.asarray(bent * self._of_angle)
        by_parts = self._by_parts(term, bent)
        if record.periods is None or term.in_time:
            return by_parts
        at_lines = self._at_lines(term, bent)
        return at_lines if at_lines.error < by_parts.error else by_parts

    def _by_parts(self, term: Term, bent: ComplexArray) -> Coefficient:
        """Find a coefficient from parts of the trial."""
        band, linear = self._terms.band, self._terms.linear
        weights, remains = self._weights, self._remains
        if term.kind is Kind.GAIN:
            weights, (linear, remains) = self._weights_of_gains, self._of_gains
        cause, shown, alone = band.signal(weights * bent)[:, band.kept]
        whole = linear.removed(shown)
        found = _ratio(*_products(linear.unlike(cause), whole, remains))
        error = found.error
        if self._between:
            error = float(np.hypot(error, self._between / np.linalg.norm(whole)))
        left, of, least = linear.unlike(alone), alone, _INFORMATIVE
        if term.in_time and term.kind is not Kind.GAIN:
            left, of, least = whole, shown, _MIXED
        if np.linalg.norm(left) <= least * np.linalg.norm(of):
            return Coefficient(value=_UNKNOWN)
        return replace(found, error=error)

    def _at_lines(self, term: Term, bent: ComplexArray) -> Coefficient:
        """Find a coefficient from the lines of a periodic perturbation.

        Where all harmonics are lines, distortion falls on them, too, but differs from line to line,
        while the output of a linear filter is smooth over frequency. So from each `_GROUP` lines a
        multiple of the filter's source is projected out that changes linearly with the frequency,
        and likewise the leakage of the record's ends, which is smooth in itself. The torque would
        be no source of itself, as it contains what the person adds.
        """
        band, (_, whole, alone) = self._terms.band, bent
        lines, source = band.lines, self._terms.moved
        if lines.size < _GROUP:
            return Coefficient()
        if term.kind in {Kind.GAIN, Kind.LOST}:
            source = band.spectrum(band.pushes)
        products, squares = [], []
        for group in np.array_split(lines, lines.size // _GROUP):
            steps = np.linspace(-1.0, 1.0, group.size)
            multiples = np.stack((np.ones_like(steps), steps), axis=1)
            known = np.concatenate((source[group, None] * multiples, multiples), axis=1)
            smooth = np.linalg.qr(known)[0]
            cause, shown, rest = (
                one[group] - smooth @ (np.conj(smooth.T) @ one[group])
                for one in (alone, whole, self._left)
            )
            nearly = np.abs(rest) ** 2 + np.abs(_LEFT * self._torque[group]) ** 2
            weight = group.size / max(float(np.sum(nearly)), TINY)
            products.append(weight * (np.conj(cause) * rest).real)
            squares.append(weight * (np.conj(cause) * shown).real)
        found = _ratio(np.concatenate(products), np.concatenate(squares))
        # What is projected out takes its share of the scatter, too.
        spare = 1.0 - known.shape[1] * len(products) / lines.size
        error, freedom = found.error / float(np.sqrt(spare)), max(spare * found.freedom, 1.0)
        return replace(found, error=error, freedom=freedom, at_lines=True)

    def sudden(self, term: Term) -> Coefficient:
        """Find the abrupt change of a stiffness or gain that is largest in standard errors.

        The error follows from the scatter within both sides, as if that were the same everywhere
        (two-sample t test), which fails where voluntary torque comes and goes. How large the
        largest ratio may be by chance is therefore found by flipping the signs of the residuals, a
        few parts at a time (wild bootstrap: Wu, *Annals of Statistics* 14, 1986), and the error
        enlarged to match.
        """
        terms, band, at = self._terms, self._terms.band, term.kind.signal
        instrument, signal = (
            band.signal(self._weights * band.spectrum(one))[band.kept]
            for one in (terms.caused[at], terms.actual[at])
        )
        left = terms.smooth.removed(self._whole)
        products, squares = _products(instrument, signal, left, _SHORT)
        telling = squares > 0.0
        products, squares = products[telling], squares[telling]
        total = float(np.sum(squares))
        freedom = total**2 / float(np.sum(squares**2)) - 2.0 if total else 0.0
        ends = np.arange(_FEWEST_PARTS, len(squares) - _FEWEST_PARTS + 1)
        if freedom < 1.0 or not ends.size:
            return Coefficient()
        change, error = _changes(products, squares, ends)
        best = int(np.argmax(np.abs(change) / error))
        rest = products - float(np.sum(products)) / total * squares
        flips = np.random.default_rng(0).choice((-1.0, 1.0), (_FLIPS, -(-len(rest) // _ALIKE)))
        flipped = np.repeat(flips, _ALIKE, axis=1)[:, : len(rest)] * rest
        by_chance, its_error = _changes(flipped, squares, ends)
        seen = np.quantile(np.max(np.abs(by_chance) / its_error, axis=1), 1.0 - _RARE)
        scale = max(1.0, float(seen / stdtrit(freedom, 1.0 - 0.5 * _RARE / ends.size)))
        return Coefficient(
            value=float(change[best]),
            error=float(error[best] * scale),
            freedom=freedom,
            looks=ends.size,
        )


def _products(
    instrument: FloatArray, term: FloatArray, left: FloatArray, seconds: float = PART
) -> tuple[FloatArray, FloatArray]:
    """Products of the instrument with the residual, and with the term, summed over each part."""
    parts = parts_of(np.stack((instrument * left, instrument * term)), seconds)
    products, squares = np.array([np.sum(part, axis=1) for part in parts]).T
    return products, squares


def _ratio(products: FloatArray, squares: FloatArray) -> Coefficient:
    """Coefficient from sums over parts, with the standard error that follows from their scatter.

    Influential parts pull it towards themselves, which is compensated (MacKinnon & White, *Journal
    of Econometrics* 29, 1985: HC3).
    """
    total = float(np.sum(squares))
    if not total:
        return Coefficient()  # as for |τ| under a load that keeps its sign
    slope = float(np.sum(products)) / total
    weights = np.clip(squares / total, 0.0, 0.9)
    error = float(np.linalg.norm((products - slope * squares) / (1.0 - weights))) / abs(total)
    freedom = max(1.0 / float(np.sum(weights**2)) - 1.0, 1.0)
    return Coefficient(value=slope, error=error, freedom=freedom)


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
    least = EPS * whole + TINY
    scatter = np.maximum(whole - explained, least) / (len(squares) - 2)
    slopes = sums / sizes
    return slopes[1] - slopes[0], np.sqrt(scatter * np.sum(1.0 / sizes, axis=0))


def _deviation(name: str, found: Coefficient, own: FloatArray, terms: _Terms) -> Deviation:
    """Interpret the coefficient of a term; `own`, (3,), is the size of M, B and K."""
    term = TERMS[name]
    shift = found.value * term.rest * terms.alike[name]
    change = share = term.slope * found.value / float(terms.sizes[term.kind.signal])
    force = 0.0
    if term.kind in {Kind.GAIN, Kind.SCALE, Kind.CLOCK}:
        shift = np.zeros(3)
    elif term.kind is Kind.LOST:
        force = term.slope * found.value
    elif term.kind in {Kind.FORCE, Kind.DRAG}:
        share = float(np.max(np.abs(shift / own)))
        # A locked joint hardly moves, so there drag is negligible.
        force = found.value if term.kind is Kind.FORCE and share > term.robots else 0.0
    else:
        # Where stiffness falls far, the change is relative to that at rest, not to this motion's.
        at = 2 if term.kind is Kind.STIFFNESS else 1
        share = change / float(max(abs(own[at]), abs(own[at] - shift[at])))
    return Deviation(
        term=term,
        coefficient=found,
        share=share,
        shift=shift,
        sensor=term.doubted * (change**2 if term.kind is Kind.CLOCK else change),
        force=force,
        joints=terms.record.joints,
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Linearity:
    """How far arm and transducers are linear, and what that adds to the standard errors."""

    problems: list[Problem]
    """What is significant."""
    doubts: list[FloatArray]
    """Uncertain changes of M, B and K, one standard error each, independent of each other; each of
    shape (3, n, n)."""
    noise: FloatArray
    """Variance of the impedance by torques that are lost or held, shape (n, n, n_freq)."""
    gain: FloatArray
    """Relative standard errors of the gains of the transducers, shape (n,)."""
    own: list[dict[str, Deviation]]
    """What was found at each perturbed joint, as of :func:`deviations`."""


def judge_linearity(
    records: Sequence[TrialRecord],
    estimate: ImpedanceEstimate,
    fit: MBKFit,
    jump: HoldCorrection | None,
    *,
    resolved: BoolArray,
    linearity: float | None,
) -> Linearity:
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
        As :meth:`Residual.of` takes it.
    resolved : ndarray of bool, shape (n,)
        Whether encoders resolve the motion of all locked joints in each trial. The torque of motion
        that they do not resolve may look nonlinear, so what is found then is a note, not an error.
    linearity : float or None
        That of the :class:`armimp_estimation.fit.Calibration`, N·m.
    """
    n = len(records)
    found, excess = [[dict[str, Deviation]()] * n] * n, np.zeros((3, n, n))
    for k, record in enumerate(records):
        residual = Residual.of(record, fit.mbk, jump, fit.late)
        if residual is not None:
            found[k], excess[:, :, k] = deviations(residual), _bursts(residual)
    weighed = list(_weighed(found, declared=linearity is not None))
    doubts = list(np.einsum("pij,jk->kpij", excess * fit.errors, np.eye(n)))
    gain, scale, noise = np.zeros(n), np.zeros(n), np.zeros(estimate.noise.shape)

    def of_torque(joint: int, trial: int, torque: FloatArray) -> FloatArray:
        """Change of M, B and K by a torque of one joint in one trial."""
        shift = np.zeros((3, n, n))
        if estimate.inverse is not None:
            answer = Band(records[trial].whole_periods, WIDE).response(torque, estimate.f)
            change = answer * estimate.inverse[trial]
            shift[:, joint] = fit.of_row(joint, change)
            noise[joint] += np.abs(change) ** 2
        return shift

    for k, i, one, doubt, _ in weighed:
        sensors = scale if one.term.kind is Kind.SCALE else gain
        sensors[k] = np.hypot(sensors[k], doubt * one.sensor)
        if i == k and one.term.kind is Kind.FORCE and doubt * one.force:
            for m in (*range(k), *range(k + 1, n)):
                held = _held(records[m].whole_periods, k, one.term)
                doubts.append(of_torque(k, m, doubt * one.force * held))
        if doubt and not one.negligible and one.term.kind is not Kind.LOST:
            doubts.append(np.zeros((3, n, n)))
            doubts[-1][:, i, k] = doubt * one.shift
    doubts += list(np.einsum("pij,jk->kpij", fit.values, np.diag(scale)[:, scale > 0.0]))
    own = [found[k][k] for k in range(n)]
    for (name, size), k in product(_lost_sizes(own, linearity).items(), range(n)):
        lost = np.zeros((3, n, n))
        for m, record in enumerate(records):
            lost += of_torque(k, m, _lost(record.whole_periods, k, TERMS[name], size))
        if name == "slack" and fit.delay is not None:
            # Its effect on B is that of a delay, which was fitted as far as the data determine it.
            lost[1] *= fit.delay.held
        doubts.append(lost)
    jumps_known = jump is not None or records[0].reading.without_jumps
    problems = list(_problems(records, weighed, resolved, jumps_known=jumps_known))
    return Linearity(problems=problems, doubts=doubts, noise=noise, gain=gain, own=own)


_Weighed: TypeAlias = tuple[int, int, Deviation, float, bool]
"""Perturbed joint and the joint of the torque, a deviation, its standard error relative to its
size, and whether another term explains it."""


def _weighed(
    found: Sequence[Sequence[Mapping[str, Deviation]]], *, declared: bool
) -> Iterator[_Weighed]:
    """Weigh each deviation by what it and the others of the same arm and rig tell."""
    own = [of_trial[k] for k, of_trial in enumerate(found)]
    for k, i in np.ndindex(len(found), len(found)):
        elsewhere = [one for joint, one in enumerate(own) if one and (joint != k or i != k)]
        for name, one in found[k][i].items():
            rival = own[k].get(one.term.explained_by)
            if rival is not None and not (
                rival.significant and rival.coefficient.errors() > one.coefficient.errors()
            ):
                rival = None
            evidence = sum(other[name].evidence for other in elsewhere)
            shared = one.term.shared
            lowers = shared == "by all" or (shared == "by joints" and i == k)
            doubt = one.doubt(
                evidence if lowers else max(evidence, 0.0), declared=declared, rival=rival
            )
            yield k, i, one, doubt, rival is not None


def _problems(
    records: Sequence[TrialRecord],
    weighed: Sequence[_Weighed],
    resolved: BoolArray,
    *,
    jumps_known: bool,
) -> Iterator[Problem]:
    """Yield what is significant, the first of each code and severity for each torque."""
    reported = set()
    for k, i, one, _, explained in weighed:
        if explained or not one.significant or one.negligible:
            continue
        term, record = one.term, records[k]
        of_sensor = term.kind.of_transducer or term.kind is Kind.SCALE
        torque = abs(one.coefficient.value)
        robots = not (of_sensor or jumps_known) and torque < _JUMPING / record.rate
        large = not robots and resolved[k] and term.large < abs(one.share) < term.most
        severity = Severity.ERROR if large else Severity.NOTE
        if (k, i, term.code, severity) in reported:
            continue
        reported.add((k, i, term.code, severity))
        yield problem(
            term.code,
            concern=Concern.IMPEDANCE if of_sensor else Concern.PARAMETERS,
            severity=severity,
            trial=record.trial,
            name=" and ".join(record.joint_names[j] for j in dict.fromkeys((i, k))),
            percent=100.0 * one.share,
            error=100.0 * one.error,
        )


def _bursts(residual: Residual) -> FloatArray:
    """Square root, (3, n), of the excess of the variance of M, B and K over that of steady noise.

    Noise that is larger while the perturbation moves the joint, as of a person who tenses then,
    counts more than its mean power tells (White, *Econometrica* 48, 1980). The excess is relative,
    and 0 unless it is beyond that of the same noise at other times.
    """
    record, band = residual.record, Band(residual.record, by_lines=False)
    angle = band.signal(band.spectrum(record.position[record.perturbed_joint]))
    caused = np.fft.rfft(band.caused(angle))[band.bins] / band.samples
    motion = caused * (2j * np.pi * band.f) ** np.arange(3)[::-1, None]
    excess = []
    for rest in residual.torques:
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


def _held(record: TrialRecord, joint: int, term: Term) -> FloatArray:
    """Term, (N,), of friction or a yielding spring at a locked joint, from its residual motion."""
    band = Band(record)
    angle = band.spectrum(record.position[joint])
    motion = band.signal(angle * (2j * np.pi * band.f) ** np.arange(2)[:, None])
    sizes = np.maximum(np.std(motion[:, band.kept], axis=1), TINY)
    angle, speed = motion / sizes[:, None]
    return term.bend(Signals(angle, angle, speed, np.zeros_like(angle)))


def _lost_sizes(
    found: Sequence[Mapping[str, Deviation]], linearity: float | None
) -> dict[str, float]:
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
                sizes[name] = max(sizes[name], abs(doubt * one[name].force))
    return {name: size for name, size in sizes.items() if size}


def _lost(record: TrialRecord, joint: int, term: Term, size: float) -> FloatArray:
    """Error, (N,), N·m, of a joint's torque by a slack or dead zone of the half width `size`, N·m.

    It follows from the torque as it was read, with whatever the person adds to it.
    """
    wide = Band(record, WIDE)
    torque = wide.signal(wide.spectrum(record.torque[joint])) + record.torque[joint].mean()
    return size * term.lacks(torque, size)
