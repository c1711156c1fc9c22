"""What an impedance may contain beside M, B and K, and how much that may change M, B and K.

A term that data show counts by its square beyond chance. One that noise may hide counts by its
posterior mean square: each has a prior probability, and is then of some usual size (assumptions).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from itertools import product

import numpy as np
from scipy.special import expit, log_ndtr, ndtr, softmax

from armimp_common.arrays import TINY, BoolArray, ComplexArray, FloatArray
from armimp_estimation.weighted_fit import WeightedFit
from armimp_estimation.weights import root_of

_NOTICED = 2.0
_ROUNDING = 1e-9
_MOST_CUFFS = 8
"""Most joints for which cuffs and reflexes are looked for: the time goes with the third power."""
_LIKELY, _SOFT = 0.3, 0.2
"""Assumption: prior probabilities that an element has reflexes, or a spring that relaxes, of one of
the alternatives rather than none; and that a joint has a soft cuff."""
_RARE = 0.01
"""Probability at which a reflex or a relaxing spring is too rare to change a 95 % interval."""
_REFLEX = 0.5
"""Assumption: velocity gain that a reflex of an element may have, relative to its B."""
_ARCS = ((0.04, 30.0), (0.03, 50.0), (0.06, 50.0))
"""Assumption: delays of reflexes, s, and corners of their muscles, rad/s: as in Kearney, Stein &
Parameswaran (1997), and a quicker and a later one."""
_STRETCH = 0.3
"""Assumption: stretch gain that a reflex of an element may have, relative to its K."""
_RELAXED, _RELAXATIONS = 0.4, (0.05, 0.3)
"""Assumption: stiffness of a relaxing spring beside K, relative to K, and its time constants, s."""
_MODE = 0.1
_MODES, _DAMPED, _PARTS = (1.8, 2.5, 3.5, 5.0, 7.0, 10.0), (0.2, 0.5, 1.0), (0.02, 0.06, 0.2)
"""Assumption: prior probability that an arm has a second mode, as of a hand that nobody strapped or
of soft tissue; its natural frequency, Hz, damping ratio and share of the inertia."""
_CUFF = 1e-5
"""Assumption: compliance that a cuff between robot and arm may have, rad/(N·m)."""
_COUPLED, _CORNERS = 0.5, (0.3, 1.0)
"""Assumption: prior probability that a torque or angle without slow motion passed a high-pass, and
corners of that, Hz."""
_CREEPING, _CREEPS = 0.2, (0.05, 0.3, 1.0)
_CREEP = (0.02, 0.06, 0.2, -0.02, -0.06)
"""Assumption: prior probability that a transducer of undeclared linearity creeps, time constants of
that, s, and shares of the torque."""
_TENSE, _TENSION = 0.5, 0.35
"""Assumption: prior probability that a person tenses or relaxes between trials, and share by which
stiffness and viscosity of each trial then differ from the mean."""


def squared_changes(
    fit: WeightedFit, *, may_creep: bool = False
) -> tuple[FloatArray, list[ComplexArray]]:
    """Squared standard errors of M, B and K, (3, n, m), by all that they don't describe.

    Transducers of unknown linearity `may_creep`: they show more of a torque the longer it lasts.
    Second are the systematic errors of Z, (n, m, n_freq), that channels add; the rest is the arm's.
    """
    n, columns = fit.shape
    squares, of_channels = _by_curvature(fit) + _by_frequency(fit), list[ComplexArray]()
    hidden = np.maximum(_by_reflexes(fit), _by_second_mode(fit))
    if n == columns and n <= _MOST_CUFFS:
        squares = squares + _by_sensors_and_cuffs(fit)
        by_channels, of_channels = _by_channels(fit, may_creep=may_creep)
        hidden = hidden + by_channels
    squares = squares + hidden
    # A change within rounding errors is none.
    least = _ROUNDING * np.abs(fit.values)
    return np.where(squares > least**2, squares, 0.0), of_channels


def high_pass(fit: WeightedFit, Z: ComplexArray) -> tuple[float, float]:
    """Corner of a high-pass common to the torques of an arm Z, and its standard error, Hz.

    Nothing is known of it where M, B and K don't fit without that high-pass, either: then it is the
    arm that relaxes, say.
    """
    value, error, _ = fit.common_coefficient(1j * Z / fit.omega)
    before = fit.corrected(
        fit.estimate.Z * (1.0 - 1j * value / fit.omega), fit.estimate.systematics
    )
    if not before.roughly_fits(before.values):
        return 0.0, math.inf
    return value / (2.0 * np.pi), error / (2.0 * np.pi)


def errors_by_tension(fit: WeightedFit) -> list[ComplexArray]:
    """Standard errors by a person who is tenser in some trials, as joints held softly show.

    A delay that was fitted before looks like a part of it, so one is fitted anew beside it.

    Returns
    -------
    list of ndarray, shape (n, m, n_freq)
    """
    count = len(fit.estimate.tensions)
    if not count or fit.values[0].size > _MOST_CUFFS**2:
        return []
    late = fit.estimate.delay_unknown * 1j * fit.omega * fit.impedance(fit.values)
    terms = np.stack((*(_TENSION * one for one in fit.estimate.tensions), late))
    (mean, covariance, both), (_, _, one) = (
        _posterior(fit, chosen) for chosen in (terms, terms[count:])
    )
    present = expit(math.log(_TENSE / (1.0 - _TENSE)) + both - one)
    square = present * (np.outer(mean, mean) + covariance)[:count, :count]
    return list(np.tensordot(root_of(square).T, terms[:count], axes=1))


def _posterior(fit: WeightedFit, terms: ComplexArray) -> tuple[FloatArray, FloatArray, float]:
    """Coefficients 0 ± 1 of common terms, (p,), their covariance, and the log of the evidence."""
    mean, covariance = fit.common_coefficients(terms, np.zeros(len(terms)))
    likely = mean @ np.linalg.solve(covariance, mean) + np.linalg.slogdet(covariance)[1]
    return mean, covariance, 0.5 * float(likely)


def _by_curvature(fit: WeightedFit) -> FloatArray:
    """Squared changes by ``c s³`` and ``c s⁴`` of each element."""
    relative, squares = fit.omega / fit.omega[-1], np.zeros_like(fit.values)
    for term in (-1j * relative**3, relative**4 + 0j):
        terms: ComplexArray = np.broadcast_to(term, fit.estimate.Z.shape)
        squares += _noticed(*np.moveaxis(fit.coefficients(terms), -1, 0)) * fit.shifts(terms) ** 2
    return squares


def _by_frequency(fit: WeightedFit) -> FloatArray:
    """Squared differences of B and K from those of the lowest third of the band alone.

    They show at low frequencies, so anything else at the upper end of the band shows in that
    difference (Hausman, *Econometrica* 46, 1978).
    """
    squares = _noticed(*fit.below())
    squares[0] = 0.0
    return squares


def _by_sensors_and_cuffs(fit: WeightedFit) -> FloatArray:
    """Squared changes by terms with one coefficient in all elements, also where noise hides them.

    A cuff of the compliance c between robot and arm at joint l takes ``c Z_il Z_lj`` off, and a
    first-order high-pass with the corner c, which torques passed and angles did not, about
    ``c Z_ij/s``. Resonances of transducers and encoders far above the band change Z by a share in
    proportion to s².
    """
    Z, squares = fit.impedance(fit.values), np.zeros_like(fit.values)
    for joint in range(len(Z)):
        terms = -Z[:, joint, None] * Z[None, joint]
        value, error, _ = fit.common_coefficient(terms)
        soft, _ = hidden_square(value, error, _SOFT, sizes=(_CUFF,), positive=True)
        # A compliance is not negative; a corner is if angles passed the high-pass.
        square = np.maximum(_noticed(max(value, 0.0), error), soft)
        squares += square * fit.shifts(terms) ** 2
    for terms in (-1j * Z / fit.omega, (fit.omega / fit.omega[-1]) ** 2 * Z):
        value, error, _ = fit.common_coefficient(terms)
        squares += _noticed(value, error) * fit.shifts(terms) ** 2
    return squares


def hidden_terms(fit: WeightedFit, values: FloatArray) -> list[list[ComplexArray]]:
    """What reflexes, and springs that relax, add to M, B and K: the alternatives of either kind.

    A reflex, by speed and by stretch, has two terms, (2, n, m, n_freq); a spring has one.
    """
    if values[0].size > _MOST_CUFFS**2:
        return []
    s, (_, B, K) = 1j * fit.omega, values[..., None]
    gains = np.stack((_REFLEX * B * s, _STRETCH * K + 0.0 * s))
    kinds = [[gains * np.exp(-s * delay) / (1.0 + s / muscle) ** 2 for delay, muscle in _ARCS]]
    if fit.estimate.unbiased:  # the leakage of biased estimators also hides a relaxing spring
        kinds.append([(_RELAXED * K * s * T / (1.0 + s * T))[None] for T in _RELAXATIONS])
    return kinds


def _by_reflexes(fit: WeightedFit) -> FloatArray:
    """Squared change by the kind of `hidden_terms` that may change M, B and K most."""
    change = np.zeros_like(fit.values)
    for kind in hidden_terms(fit, fit.values):
        found = [_not_negative(fit, terms) for terms in kind]
        squares, evidence = (np.stack(one) for one in zip(*found, strict=True))
        present = _present(fit, evidence, _LIKELY / (1.0 - _LIKELY))
        counts = 1.0 - _RARE / np.maximum(np.sum(present, axis=0), _RARE)
        change = np.maximum(change, counts * np.einsum("tij,tpij->pij", present, squares))
    return change


def _present(fit: WeightedFit, evidence: FloatArray, odds: float) -> FloatArray:
    """Posterior probabilities of alternative terms in each element, (t, n, m).

    They follow from the prior odds of each term, and from its evidence, (t, n, m), in the element.
    A term across joints also acts on its own joint, which shows whether the term is present. So do
    the own terms of other joints, as one person has it in all of them or in none.
    """
    own = np.stack([evidence[:, row, column] for row, column in fit.own], axis=1)
    others = np.maximum(np.sum(own, axis=1, keepdims=True) - own, 0.0)
    seen = evidence + (math.log(odds) + others + own)[:, None]
    for place, (row, column) in enumerate(fit.own):
        seen[:, row, column] -= own[:, place]
    absent = np.zeros_like(seen[:1])
    return np.asarray(softmax(np.concatenate((seen, absent)), axis=0)[:-1])


def _not_negative(fit: WeightedFit, terms: ComplexArray) -> tuple[FloatArray, FloatArray]:
    """Squared changes by terms with coefficients 0 ± 1 that aren't negative, and their evidence.

    The changes of M, B and K, (3, n, m), are those if the terms are present. The evidence, (n, m),
    is the logarithm of the likelihood ratio of their presence to their absence. Two terms may
    nearly cancel beside M, B and K, so coefficients are judged together. The probability that they
    are both positive is interpolated between those of independent, equal and opposite ones.
    """
    shifts = np.stack([fit.shifts(one) for one in terms])
    squares, evidence = np.zeros_like(fit.values), np.zeros(fit.shape)
    elements = zip(np.ndindex(fit.shape), fit.own_coefficients(terms), strict=True)
    for (row, column), (mean, covariance, ratio) in elements:
        errors = np.sqrt(np.diag(covariance))
        single = ndtr(mean / errors)
        alike = covariance[0, -1] / (errors[0] * errors[-1])
        share = 2.0 / math.pi * math.asin(min(max(alike, -1.0), 1.0))
        positive = np.prod(single) * (1.0 - abs(share)) + np.min(single) * max(share, 0.0)
        evidence[row, column] = ratio + math.log(max(2.0**mean.size * positive, TINY))
        most, change = np.maximum(mean, 0.0), shifts[:, :, row, column]
        square = np.outer(most, most) + covariance
        squares[:, row, column] = np.einsum("pa,pq,qa->a", change, square, change)
    return squares, evidence


def _by_second_mode(fit: WeightedFit) -> FloatArray:
    """Squared change by a mass that a spring couples to the arm.

    With the share c of the inertia, it adds ``-c M s⁴/(s² + 2ζws + w²)`` to the arm that is
    rigid up to it: beyond w the mass stays behind. All elements together tell which w and ζ it
    may have; what the data leave open counts by the prior.
    """
    if not fit.estimate.unbiased or fit.values[0].size > _MOST_CUFFS**2:
        return np.zeros_like(fit.values)
    s, M = 1j * fit.omega, fit.values[0][..., None]
    shapes = [
        -M * s**4 / (s**2 + 2.0 * damped * w * s + w**2)
        for w, damped in product(2.0 * np.pi * np.array(_MODES), _DAMPED)
    ]
    judged = partial(hidden_square, likely=0.5, sizes=_PARTS, positive=True)
    every = [[[judged(*one) for one in row] for row in fit.coefficients(shape)] for shape in shapes]
    squares, evidence = np.moveaxis(np.array(every), -1, 0)
    squares *= 1.0 + np.exp(np.minimum(-evidence, 700.0))  # if there is such a mode
    # A mass that moves two joints has no more of the coupling than the geometric mean of its own.
    inertia = squares * fit.values[0] ** 2
    row, column = np.transpose(fit.own)
    own = inertia[:, row, column]
    most = np.full_like(squares, np.inf)
    most[:, row] = np.sqrt(own[:, :, None] * own[:, None])
    squares *= np.minimum(most / np.maximum(inertia, TINY), 1.0)
    moved = squares * np.stack([fit.shifts(shape) for shape in shapes], axis=1) ** 2
    present = _present(fit, evidence, _MODE / (1.0 - _MODE) / len(shapes))
    return np.asarray(np.einsum("tij,ptij->pij", present, moved))


def _by_channels(fit: WeightedFit, *, may_creep: bool) -> tuple[FloatArray, list[ComplexArray]]:
    """Squared change by a high-pass or creep of single channels, of whichever changes most.

    A first-order high-pass with the corner w takes ``w/(s + w) Z_ij`` off the row of a torque,
    and adds ``w/s Z_ij`` to the column of an angle. A channel that shows slow signals passed
    none. A transducer that creeps adds ``c/(1 + sT) Z_ij`` to its row if its gain was found
    quickly, and takes ``c sT/(1 + sT) Z_ij`` off if it was found with weights. Channels of one rig
    are alike, so each is evidence of whether the others have such an error. Second is the largest
    change of Z, (n, m, n_freq), by each channel; of an arm that is not M, B and K, which may look
    like that, not beyond the prior one.
    """
    Z, s = fit.impedance(fit.values), np.asarray(1j * fit.omega, dtype=np.complex128)
    own = np.eye(len(Z), dtype=np.bool_)[:, :, None, None]
    kinds: list[tuple[float, Sequence[float], int, BoolArray, ComplexArray]] = [
        (_COUPLED, (1.0,), axis, possible, -w / (s + w) if axis == 0 else w / s)
        for w in 2.0 * np.pi * np.array(_CORNERS)
        for axis, possible in enumerate(fit.estimate.without_slow)
    ]
    if may_creep:
        every = np.ones(len(Z), dtype=np.bool_)
        for time in _CREEPS:
            later = 1.0 / (1.0 + s * time)
            kinds += [(_CREEPING, _CREEP, 0, every, one) for one in (later, later - 1.0)]
    fits = fit.roughly_fits(fit.values)
    change, largest = np.zeros_like(fit.values), dict[tuple[int, int], ComplexArray]()
    for likely, sizes, axis, possible, effect in kinds:
        channels = np.where(np.moveaxis(own, 1, 1 + axis), effect * Z, 0.0)[possible]
        judged = partial(hidden_square, likely=likely, sizes=sizes, positive=True)
        found = [fit.common_coefficient(terms)[:2] for terms in channels]
        evidence = [judged(*one)[1] for one in found]
        places = np.flatnonzero(possible).tolist()
        for place, terms, one, of_one in zip(places, channels, found, evidence, strict=True):
            square, _ = judged(*one, elsewhere=max(sum(evidence) - of_one, 0.0))
            change = np.maximum(change, fit.shifts(math.sqrt(square) * terms) ** 2)
            if not fits:
                square = min(square, likely * float(np.mean(np.square(sizes))))
            error = math.sqrt(square) * terms
            if np.linalg.norm(error) > np.linalg.norm(largest.get((axis, place), 0.0)):
                largest[axis, place] = error
    return change, list(largest.values())


def _noticed(value: FloatArray | float, error: FloatArray | float) -> FloatArray:
    """Squared coefficient of a term, less the square that chance alone may give it.

    With a mere threshold, all of it would count whenever chance exceeds the threshold.
    """
    return np.maximum(np.square(value) - (_NOTICED * np.asarray(error)) ** 2, 0.0)


def hidden_square(
    value: float,
    error: float,
    likely: float,
    *,
    sizes: Sequence[float] = (1.0,),
    positive: bool = False,
    elsewhere: float = 0.0,
) -> tuple[float, float]:
    """Posterior mean square of an effect that may be absent (spike-and-slab prior).

    Before the data, the effect is present with the probability p, and is then 0 ± s. If the data
    estimate it as g with the standard error e, in units of s, the odds are multiplied by the
    likelihood ratio ``√v exp(m²/2v)``, with ``v = e²/(1 + e²)`` and ``m = g v/e²``, and the mean
    square of an effect that is present is ``m² + v``. If it cannot be negative, the ratio is
    ``2 Φ(m/√v)`` times that.

    Parameters
    ----------
    value, error : float
        Estimate g s and its standard error e s.
    likely : float
        Prior probability p.
    sizes : sequence of float
        Sizes s, all equally likely.
    positive : bool
        Whether the effect cannot be negative.
    elsewhere : float
        Logarithm of that ratio for other data, which show only whether the effect is present.

    Returns
    -------
    square : float
        Posterior mean square of the effect, which is 0 if it is absent.
    evidence : float
        Logarithm of the likelihood ratio of these data, over all sizes.
    """
    if not 0.0 < error < math.inf:
        return 0.0, 0.0
    size = np.asarray(sizes, dtype=np.float64)
    left = (error / size) ** 2 / (1.0 + (error / size) ** 2)
    mean = value / size * left / (error / size) ** 2
    ratios = 0.5 * np.log(left) + 0.5 * mean**2 / left - math.log(len(size))
    if positive:
        ratios += math.log(2.0) + log_ndtr(mean / np.sqrt(left))
        mean = np.maximum(mean, 0.0)
    odds = math.log(likely / (1.0 - likely)) + elsewhere + ratios
    present = softmax(np.append(odds, 0.0))[:-1]
    square = float(np.sum(present * (mean**2 + left) * size**2))
    return square, float(np.logaddexp.reduce(ratios))
