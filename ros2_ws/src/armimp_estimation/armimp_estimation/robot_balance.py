"""Torque balance of the robot: commands less transducer torques must move a possible robot.

Between the robot's drives and the arm nothing but the robot itself takes torque, so

    H T_u - T_τ = (M_r s² + B_r s + K_r) R + F,    H = (1 - exp(-jωL))/jωL

with the responses T_u of the commands, T_τ of the transducers and R of the angles to the
perturbation, and the zero-order hold H of the commands. The robot's stiffness, due to springs and
gravity, and its inertia are symmetric, and the inertia has positive eigenvalues. Friction of a
joint depends on its own motion alone, ``F_ik = (β_ik s + κ_ik) R_ik``, but differs between the
trial that perturbs the joint and those in which it is locked and moves little. So off the diagonal
of ``(H T_u - T_τ) R⁻¹`` there are, beside M, B and K, the terms ``(β s + κ) W`` with the motion
``W_ij = R_ij (R⁻¹)_jj`` of locked joints. Viscosity that remains there, and stiffness in only one
of two mirrored elements, can't be the robot's: a transducer that shows g times the torque leaves
``(1 - g)/g`` times the estimated B̂ and K̂ in its row. So wrong signs, units, gains and orders show
without knowledge of arm or robot. Common errors of commands, torques and angles in the same
proportion don't, nor does a gain above 1 that friction of a locked joint (κ > 0) explains.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from armimp_common.arrays import TINY, BoolArray, ComplexArray, FloatArray
from armimp_common.errors import DataError
from armimp_common.topics import JOINT_STATES
from armimp_estimation.estimators.estimate import noise_of
from armimp_estimation.estimators.local_polynomial import LocalResponse
from armimp_estimation.estimators.lpm import covariance_of, responses
from armimp_estimation.estimators.welch import invert, multiply
from armimp_estimation.fit import Calibration, MBKFit
from armimp_estimation.hold_correction import HoldCorrection, answers_to_rounding, without_skew
from armimp_estimation.plausibility import least_eigenvalue, uneven
from armimp_estimation.problems import Problem, ProblemCode, Severity, problem
from armimp_estimation.record import APART, TrialRecord
from armimp_estimation.systematics import HiddenMotion, speed_of
from armimp_estimation.torque_timing import TorqueTiming
from armimp_estimation.trial import TrialData
from armimp_estimation.weights import covariance_of_sums, fit_weights

BAND = (0.25, 12.0)
"""Band in which inertia and stiffness of the robot show, Hz; below it friction dominates."""
GAIN_TOLERANCE = 0.02
"""Share by which the torque of a transducer may differ from that of the command, beside chance."""
ASYMMETRY = 0.25
"""Share of ``√(M_ii M_jj)`` by which M_ij and M_ji of the robot may differ, beside chance.

Friction that holds a locked joint may take up to a fifth of the element.
"""
_FLOOR = 0.03
"""Relative error that the weights of the fit allow for beside the variance."""
_REACH = 0.6
"""Half width of the smoothing of these weights, Hz."""
_ERRORS = 5.0  # standard errors beyond which a deviation is refused
_NEGATIVE = 4.0  # standard errors beyond which a negative viscosity or stiffness counts
_CLEARLY = 0.3  # rms stiffness in another order of commands relative to the given one, at most
_WEIGHTLESS = 0.02
"""Inertia of a joint of the robot relative to the arm's below which there is none, as the torque is
the command. The lightest robots have a sixth of the inertia of heavy arms."""
_ANSWERS = 10.0
"""Ratio of the power of a command's response to its variance, median over the frequencies, that
chance doesn't reach."""
_TAKEN = 0.15
_HELD = 0.8
"""Standard errors of the torque that friction takes from a locked joint, relative to that torque.

Friction isn't as linear as the terms fitted to it, and may be less so if speeds aren't Gaussian.
The second one applies where friction that holds the joint would explain the residual.
"""
_HIDDEN = 0.2
"""Share of friction in an element from which on all of that share may be inertia."""
_UNCONFIRMED = 0.1
"""Assumption: relative error of a gain that nobody has declared and no command confirms."""
_UNCONFIRMED_CROSS_TALK = 0.03
"""Assumption: error of cross-talk in the same case."""
_SLIGHT = 0.1
"""Share of an element that friction of locked joints takes, below which it hardly bends that."""
_NOTICED = 3.0
"""Standard errors from which on the scales of two encoders seem to differ."""
_SPRING = 2.0
"""Standard errors from which on a joint of the robot seems to have a spring."""
_RUBBING = 2.0
"""Largest ratio of the apparent stiffness of friction to its apparent viscosity, 1/s."""
_LOADED = 0.4
"""Assumption: relative standard error of a torque that seems to be that of a spring of the robot;
in one of six rigs it is that of a cable which loads the transducer."""
_WRONG = 0.3
"""Assumption: largest error of a gain that was declared."""
_PULLED = 0.3
"""Assumption: negative stiffness by which gravity may pull a joint of the robot away from the
posture, relative to the arm's stiffness."""
_ALLOWED = 3.0
"""Standard errors of the calibration of other shares by which a share may look wrong."""
_LIKELIER = 0.1
"""Share by which cross-talk must be more significant than a gain, which is off more often."""
_REFUTED = 3.0
"""Standard errors by which a gain has to differ from 1 to refute a declared calibration."""
_AT_ONCE, _WHOLE = 0.1, 1.2
"""Shares of a step of the command: by which a torque may jump beyond what inertias allow; and
beyond which the torque is in another unit, which the balance finds."""
_ROUNDED = 1.0
"""Largest mean square of second differences of an angle, relative to its squared resolution, of
which most is rounding; rounding itself has half of that square."""


@dataclass(frozen=True, kw_only=True, eq=False)
class RobotBalance:
    """Estimate of the robot that the commands less the transducer torques move."""

    values: FloatArray
    """Inertia, viscosity and stiffness of the robot, SI units; shape (3, n, n)."""
    covariance: FloatArray
    """Covariance of the three values of each element, with lack of fit; shape (3, 3, n, n)."""
    damped: FloatArray
    """Inertia as if friction of locked joints were viscous, and its standard error, which includes
    the difference from M; shape (2, n, n)."""
    friction: FloatArray
    """Share of what moves the robot that the friction of locked joints takes; shape (n, n)."""
    unseen: FloatArray
    """Share of the motion of locked joints that encoders may miss, so that friction may hold them;
    shape (n, n)."""
    undamped: FloatArray
    """Torque of friction of each joint in each trial that may follow the perturbation but not the
    speed, relative to that which follows the speed; shape (n, n)."""
    rubbing: FloatArray
    """Apparent stiffness that friction of the perturbed joint may have, N·m/rad, shape (n,)."""
    order: tuple[int, ...]
    """Row of the commands that belongs to each joint."""
    unsure: FloatArray
    """Standard errors of the inertia, kg·m², by calibration and postures of the trials, (n, n)."""

    @property
    def M(self) -> FloatArray:
        """Inertia of the robot, kg·m², shape (n, n)."""
        return np.asarray(self.values[0])

    @property
    def M_se(self) -> FloatArray:
        """Standard errors of M, kg·m², shape (n, n)."""
        return np.asarray(np.hypot(self.errors[0], self._inertia_hidden))

    @property
    def _inertia_hidden(self) -> FloatArray:
        """Standard errors of M, kg·m², by what friction may hide of it, shape (n, n).

        Friction of the perturbed joint that isn't like a damper may look like an inertia of B/ω at
        the upper end of the band. Where friction takes much of what moves a locked joint, it may
        hide inertia, the more so the less it is like a damper.
        """
        share = np.maximum(self.friction, self.unseen)
        hidden = self.friction > _HIDDEN * (1.0 - self.undamped)
        share *= np.where(hidden, 1.0, _TAKEN)
        taken = share * np.maximum(np.abs(self.M), np.abs(self.M.T))
        own = np.diag(np.abs(np.diag(self.values[1]))) / (2.0 * np.pi * BAND[1])
        return np.asarray(taken + own)

    @property
    def K(self) -> FloatArray:
        """Stiffness of the robot, N·m/rad, shape (n, n)."""
        return np.asarray(self.values[2])

    @property
    def K_se(self) -> FloatArray:
        """Standard errors of K, N·m/rad, shape (n, n)."""
        return np.asarray(self.errors[2])

    @property
    def impossible(self) -> bool:
        """Whether no robot has this inertia: it is asymmetric, or has a negative eigenvalue."""
        M, M_se = self.M, np.hypot(self.M_se, self.unsure)
        value, error = least_eigenvalue(M, M_se)
        ratio, its_error = self.scales
        unlike = np.abs(ratio) > GAIN_TOLERANCE + _ERRORS * its_error
        asymmetric = unlike | uneven(M, M_se, ASYMMETRY)
        return bool(value < -_ERRORS * error or asymmetric.any())

    @cached_property
    def scales(self) -> tuple[FloatArray, FloatArray]:
        """Relative difference of M_ij and M_ji, and its standard error, (n, n).

        As the inertia is symmetric, it is that between the scales of encoders j and i. It is 0
        with an infinite error where friction of locked joints takes a tenth of an element or more.
        Less friction is taken as viscous: as a spring it would look too much like an inertia.
        """
        M, error = self.damped
        taken = np.maximum(self.friction, self.unseen)
        slight = (np.maximum(taken, taken.T) < _SLIGHT) & ~np.eye(len(taken), dtype=np.bool_)
        size = np.maximum(np.minimum(np.abs(M), np.abs(M.T)), TINY)
        error = np.hypot(error, np.hypot(self._inertia_hidden, self.unsure))
        error = np.hypot(error, error.T)
        return (
            np.where(slight, (M - M.T) / size, 0.0),
            np.where(slight, error / size, np.inf),
        )

    def scales_in_doubt(self, arm: MBKFit) -> list[FloatArray]:
        """Changes of M, B and K, (3, n, n), one for each scale of two that seem to differ."""
        ratio, error = self.scales
        matrices, changes = arm.values, []
        for i, j in np.argwhere(np.abs(ratio) > _NOTICED * error):
            changes.append(np.zeros_like(matrices))
            changes[-1][:, :, j] = ratio[i, j] * matrices[:, :, j]
        return changes

    @property
    def errors(self) -> FloatArray:
        """Standard errors of the values, without what friction may hide of them; (3, n, n)."""
        return np.asarray(np.sqrt(np.einsum("aaij->aij", self.covariance)))


@dataclass(frozen=True, kw_only=True, eq=False)
class RobotResponses:
    """Responses to the perturbation from which the balance follows."""

    records: tuple[TrialRecord, ...]
    """One trial for each joint, in order."""
    columns: tuple[LocalResponse, ...]
    """Responses of angles, torques and commands, one element for each trial."""
    stacked: ComplexArray
    """The same as an array; shape (3n, n, n_freq)."""
    inverse: ComplexArray
    """``R⁻¹``; shape (n, n, n_freq)."""
    hidden: HiddenMotion
    """Motion of locked joints that encoders don't show."""

    @classmethod
    def of(cls, records: Sequence[TrialRecord]) -> RobotResponses | None:
        """Estimate the responses of trials; None without commands, or if R⁻¹ can't be found.

        Also None if no command responds to one of the perturbations: they are of other trials.
        """
        channels = [
            np.concatenate([record.position, record.torque, record.command])
            for record in records
            if record.command is not None
        ]
        if len(channels) < len(records):
            return None
        n = len(records)
        try:
            columns = responses(records, channels, BAND)
            stacked = np.stack([one.response for one in columns], axis=1)
            inverse = invert(stacked[:n], columns[0].f)
        except DataError:
            return None
        for one in columns:
            answers = np.abs(one.response) ** 2 / np.maximum(one.variance, TINY)
            if not (np.median(answers[2 * n :], axis=1) > _ANSWERS).any():
                return None
        return cls(
            records=tuple(records),
            columns=tuple(columns),
            stacked=stacked,
            inverse=inverse,
            hidden=HiddenMotion(records, stacked[:n], stacked[n : 2 * n], inverse, columns[0].f),
        )

    def order(self) -> tuple[int, ...]:
        """Row of the commands that belongs to each joint.

        In the right order the robot has hardly any stiffness but that of friction. The given order
        is kept unless it leaves stiffness beyond chance, and another one much less of it and a
        possible robot.
        """
        n = len(self.records)
        given = self.balance(tuple(range(n)))
        if not (np.abs(given.K) > 2.0 * _ERRORS * given.K_se).any():
            return given.order
        # What moves a joint depends on the command that belongs to that joint alone.
        stiffness, own = np.zeros((n, n)), np.arange(n)
        for shift in range(n):
            one = self.balance(tuple(np.roll(own, shift).tolist()))
            stiffness[own, list(one.order)] = np.sum(one.K**2, axis=1)
        # This import is slow, and few runs need it.
        from scipy.optimize import linear_sum_assignment

        _, best = linear_sum_assignment(np.nan_to_num(stiffness))
        if not np.sum(stiffness[own, best]) < _CLEARLY**2 * np.trace(stiffness):
            return given.order
        found = self.balance(tuple(best.tolist()))
        return given.order if found.impossible else found.order

    def balance(
        self,
        order: tuple[int, ...],
        jump: HoldCorrection | None = None,
        arm: MBKFit | None = None,
        calibration: Calibration | None = None,
        apart: float = 0.0,
    ) -> RobotBalance:
        """Estimate the robot that the commands move.

        Parameters
        ----------
        order : tuple of int
            Row of the commands that belongs to each joint.
        jump : HoldCorrection, optional
            How torques jump with the commands, if that is known.
        arm : MBKFit, optional
            Fit of the arm, with the delay of the torques that was found.
        calibration : Calibration, optional
            Errors of the sensors, if the arm is known.
        apart : float
            Distance between the postures of the trials, rad.
        """
        n, f, rate = len(self.records), self.columns[0].f, self.records[0].rate
        turn = 2j * np.pi * f / rate
        step = 1.0 - np.exp(-turn)
        delay = None if arm is None else arm.delay
        torques = without_skew(f, self.records[0], jump, 0.0 if arm is None else arm.late)
        # Coefficients of angles, torques and commands, (n, 3n), in the torque on the robot.
        mixed = np.zeros((n, 3 * n, f.size), dtype=np.complex128)
        mixed[:, n : 2 * n] = -torques[:, :n]
        for i in range(n):
            mixed[i, 2 * n + order[i]] = step / turn
        if jump is not None:
            mixed[:, 2 * n + np.array(order)] -= step * torques[:, n:]
        impedance = multiply(multiply(mixed, self.stacked), self.inverse)
        coefficients = mixed.copy()
        coefficients[:, :n] -= impedance
        ahead, leads, lost = self.hidden.effects(impedance)
        systematics = leads + lost
        if delay is not None:
            torque = multiply(mixed[:, n : 2 * n], self.stacked[n : 2 * n])
            systematics.append(delay.error * turn * rate * multiply(torque, self.inverse))
        if arm is not None and self.records[0].reading.timing is TorqueTiming.UNKNOWN:
            # Torques that don't jump with commands may be half a period late, or in time.
            steady = replace(arm.mbk, M=np.zeros((n, n))).impedance(f)
            systematics.append(0.5 * turn * steady)
        disturbance = covariance_of(self.columns, coefficients)
        noise = noise_of(disturbance, self.inverse)
        fitted = self._fit(
            impedance + ahead,
            noise + sum(np.abs(one) ** 2 for one in systematics),
            multiply(multiply(mixed[:, 2 * n :], self.stacked[2 * n :]), self.inverse),
        )
        M, B, _ = map(np.diag, fitted["values"])
        undamped, pace = self._not_of_a_damper
        unsure = np.zeros((n, n))
        if arm is not None and calibration is not None:
            # A gain or cross-talk adds a share of a row of the arm's inertia, the scale of an
            # encoder one of a column of the robot's. At other postures the robot is another one.
            squares = calibration.shares(n) ** 2 @ arm.mbk.M**2
            squares += (calibration.angle * fitted["values"][0]) ** 2
            if apart > APART:
                squares += apart**2 * np.abs(np.outer(M, M)) / 6.0
            unsure = np.sqrt(squares)
        return RobotBalance(
            **fitted,
            unseen=self.hidden.share,
            undamped=undamped,
            rubbing=np.abs(B) * np.diag(undamped) * pace,
            order=order,
            unsure=unsure,
        )

    def _fit(
        self, impedance: ComplexArray, variance: FloatArray, driven: ComplexArray
    ) -> dict[str, FloatArray]:
        """Fit a robot, friction of locked joints and a lag of the drives to an impedance.

        Returned are values, covariance, friction and damped of a :class:`RobotBalance`; `driven` is
        the contribution of the commands to the impedance, (n, n, n_freq).
        """
        n, f = len(self.records), self.columns[0].f
        s, correlation = 2j * np.pi * f, self.columns[0].bin_correlation()
        locked = self.stacked[:n] * np.einsum("jjf->jf", self.inverse)
        found, errors = np.zeros((3, n, n)), np.zeros((3, 3, n, n))
        friction, damped = np.zeros((n, n)), np.zeros((2, n, n))
        for i, j in np.ndindex(n, n):
            own = np.stack([s**2, s, np.ones_like(s)])
            held = np.stack([locked[i, j] * s, locked[i, j]])
            lag = np.stack([driven[i, j] * s, driven[i, j] * s**2])
            terms = np.concatenate([own, lag] if i == j else [own, held, lag])
            given = f, impedance[i, j], variance[i, j], correlation
            values, covariance = _least_squares(*given, terms)
            free, spread, taken = values, covariance, np.zeros_like(s)
            if i != j:
                taken = values[3:5] @ held
                free, spread = _least_squares(*given, np.delete(terms, 4, axis=0))
                if values[4] <= 0.0:
                    # Friction resists motion. A κ below 0 would push, so nothing holds the joint.
                    values, covariance, taken = free, spread, free[3] * held[0]
            damped[:, i, j] = free[0], np.hypot(np.sqrt(spread[0, 0]), free[0] - values[0])
            found[:, i, j], errors[:, :, i, j] = values[:3], covariance[:3, :3]
            whole = float(np.linalg.norm(impedance[i, j] / s))
            friction[i, j] = float(np.linalg.norm(taken / s)) / max(whole, TINY)
        return {"values": found, "covariance": errors, "friction": friction, "damped": damped}

    @cached_property
    def _not_of_a_damper(self) -> tuple[FloatArray, FloatArray]:
        """Torque of friction that may follow the perturbation, but not as that of a damper does.

        At a Gaussian speed v friction ``f sign(v)`` is the torque of a damper plus a residual that
        is uncorrelated with anything linear (Bussgang). The damper has the part
        ``(mean |v| / rms v)²`` of f², which is 2/π for Gaussian speeds. What is missing of that, as
        where a joint is pushed and then sticks away from its equilibrium, may act like a spring of
        either sign. Returned relative to the damper's torque, by joint and trial; with the rms
        speed over rms angle of each joint in its own trial, 1/s.
        """
        n = len(self.records)
        undamped, pace = np.zeros((n, n)), np.zeros(n)
        for joint, k in np.ndindex(undamped.shape):
            angle = self.records[k].position[joint]
            speed = speed_of(angle, self.records[k].rate, 2.0 * BAND[1])
            rms = float(np.std(speed))
            if rms == 0.0:
                continue
            excess = 2.0 / np.pi * (rms / np.mean(np.abs(speed))) ** 2 - 1.0
            undamped[joint, k] = np.sqrt(max(excess, 0.0))
            if joint == k:
                pace[k] = rms / np.std(angle)
        return undamped, pace


def _least_squares(
    f: FloatArray,
    Z: ComplexArray,
    variance: FloatArray,
    correlation: FloatArray,
    regressors: ComplexArray,
) -> tuple[FloatArray, FloatArray]:
    """Fit real coefficients, (p,), of regressors, (p, n_freq), to an element; and covariance."""
    weights = fit_weights(f, Z, variance, _FLOOR, reach=_REACH)
    scale = np.linalg.norm(np.sqrt(weights) * regressors, axis=1)
    scale[scale == 0.0] = 1.0
    design = regressors / scale[:, None]
    functionals = np.linalg.pinv(((np.conj(design) * weights) @ design.T).real) @ (design * weights)
    values = (np.conj(functionals) @ Z).real
    ratio = np.abs(Z - values @ design) ** 2 / variance
    lack = max(1.0, float(np.sum(ratio)) / max(f.size - 0.5 * values.size, 1.0))
    covariance = lack * covariance_of_sums(functionals * np.sqrt(variance), correlation)
    return values / scale, covariance / np.outer(scale, scale)


def imbalance(
    robot: RobotBalance, arm: MBKFit, calibration: Calibration
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Shares of the arm's torque that the balance contains, but no robot has, each (n, n).

    The share ρ of the joint's own torque, on the diagonal, is ``(1 - g)/g`` if its transducer shows
    g times that torque; those of other joints' torques are -c with the cross-talk c. Each is
    estimated as if it were the only one, by least squares from the off-diagonal B and K of the
    robot, since springs and friction of the joint itself are on the diagonal; for a single joint
    from its K. What K has in common with the mirrored element may come from gravity and is a
    standard error, unless the remaining information agrees with ρ rather than with 0. Own shares
    must show in K on the diagonal, too, but for what gravity and friction may add there; otherwise
    friction of the locked joint explains ρ, which is added to its own standard error. Returns the
    shares, their standard errors, and possible shares: those that are significant from all of K,
    but not from the remaining information, which agrees with them; else 0. Last is what other
    shares within the calibration look like.
    """
    K, known = robot.K, calibration.shares(len(robot.order))
    potential = np.where(K * K.T > 0.0, np.minimum(np.abs(K), np.abs(K.T)), 0.0)
    np.fill_diagonal(potential, 0.0)
    whole, whole_error, _ = _imbalance(robot, arm, known, np.diag(robot.rubbing))
    left, left_error, alike = _imbalance(robot, arm, known, np.diag(robot.rubbing) + potential)
    near = np.minimum(np.abs(left), _REFUTED * left_error)
    informative = (np.abs(left - whole) < near) & (left_error < np.abs(whole))
    sure = informative & (np.abs(left) > _REFUTED * left_error)
    possible = np.where(informative & ~sure & (np.abs(whole) > _REFUTED * whole_error), whole, 0.0)
    shares, errors = np.where(sure, whole, left), np.where(sure, whole_error, left_error)
    own, K_own = np.diag(K), np.diag(arm.mbk.K)
    spring = _PULLED * np.abs(K_own) + robot.rubbing + _REFUTED * np.diag(robot.K_se)
    refuted = (np.abs(own) < spring) & (np.abs(np.diag(shares) * K_own - own) > spring)
    errors = np.where(np.diag(refuted), np.hypot(errors, shares), errors)
    return shares, errors, possible, alike


def _imbalance(
    robot: RobotBalance, arm: MBKFit, known: FloatArray, other: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Shares and errors as of :func:`imbalance`, with further standard errors of K, (n, n).

    Last is what other shares, of the standard errors `known`, (n, n), look like.
    """
    n = len(robot.order)
    used, others = ([2], np.ones((1, 1))) if n == 1 else ([1, 2], 1.0 - np.eye(n))
    covariance = robot.covariance.copy()
    covariance[2, 2] += other**2
    covariance = np.moveaxis(covariance[np.ix_(used, used)], (0, 1), (2, 3))
    information = others[:, :, None, None] * np.linalg.pinv(covariance)
    residual = robot.values[used]
    arms, arms_se = arm.values[used], arm.errors[used]
    # Indices: joint i, row r of the arm whose torque its transducer may show, column j.
    part = np.einsum("arj,ijab,brj->irj", arms, information, arms)
    square = TINY + np.sum(part, axis=2)
    mixed = np.einsum("arj,ijab,bij->ir", arms, information, residual)
    left = np.einsum("aij,ijab,bij->i", residual, information, residual)
    taken, damped, held = (
        np.einsum("irj,ij->ir", part, share)
        for share in (
            robot.friction,
            robot.friction * np.maximum(_TAKEN, robot.undamped),
            robot.unseen,
        )
    )
    # Where the arm hardly couples the joints, the errors of the arm count.
    own = np.einsum("arj,ijab,brj->ir", arms_se, information, arms_se)
    shares = mixed / square
    # Shares of other torques, i.e. of rows l of the arm, may look like that of row r.
    alike = np.einsum("arj,ijab,blj->irl", arms, information, arms) / square[:, :, None]
    alike *= known[:, None] * (1.0 - np.eye(n))
    # One share has to explain all of the row.
    freedom = max(len(used) * max(n - 1, 1) - 1, 1)
    spread = np.maximum(1.0, (left[:, None] - mixed * mixed / square) / freedom)
    # Friction that holds a joint takes torque: to the transducer it is a gain above 1.
    holds = (mixed < 0.0) | ~np.eye(n, dtype=np.bool_)
    doubt = np.where(holds, _HELD * np.maximum(taken, held), damped) / square
    errors = np.sqrt(spread / square + doubt**2 + shares**2 * own / square)
    return shares, errors, np.linalg.norm(alike, axis=2)


def _gains_above_one(
    robot: RobotBalance, arm: MBKFit, shares: FloatArray, errors: FloatArray, allowed: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Shares of the arm's torque, (n,), that follow from negative diagonal elements of the robot.

    Friction makes the viscosity of a joint positive, so if it is negative, the transducer shows too
    much. So it does if the stiffness is negative beyond the apparent one of friction, unless
    gravity pulls the robot away. It is gravity if the off-diagonal elements determine the gain, and
    put it nearer to 1 than to the one that the stiffness suggests; where they don't, up to
    `_PULLED` may be gravity, and is in doubt. Friction may hide a part of each share. Shares and
    their standard errors are 0 where none is beyond chance and what is `allowed`, (n,). `shares`
    and `errors` are the diagonals of those of :func:`imbalance`.
    """
    own, own_error = (
        np.diagonal(one[1:], axis1=1, axis2=2) for one in (robot.values, robot.errors)
    )
    arms = np.stack((np.diag(arm.mbk.B), np.diag(arm.mbk.K)))
    least = allowed * arms + _NEGATIVE * own_error
    least[1] += robot.rubbing
    beyond = (arms > 0.0) & (own < -least)
    implied = np.divide(own, arms, out=np.zeros_like(own), where=beyond)
    implied_error = np.divide(own_error, arms, out=np.zeros_like(own), where=beyond)
    gravity = (shares > 0.5 * implied[1]) & (errors < np.abs(implied[1]))
    gravity |= (implied[1] > -_PULLED) & (shares > -_REFUTED * errors)
    by_stiffness = beyond[1] & ~gravity & (len(shares) > 1)
    share, error = (np.where(by_stiffness, one[1], one[0]) for one in (implied, implied_error))
    return np.maximum(share, -0.99), error


def _springs(robot: RobotBalance, arm: MBKFit, calibration: Calibration) -> FloatArray:
    """Stiffness of each joint of the robot beyond chance, relative to the arm's; shape (2, n).

    A robot has no stiffness but that of gravity and of friction that holds a joint, unless the
    transducer shows another torque than the drive feels. The first row is any such stiffness. The
    second is 0 unless friction of the viscosity found can't explain it, and includes the part of a
    negative stiffness that friction may hide.
    """
    own, error, K = np.diag(robot.K), np.diag(robot.K_se), np.abs(np.diag(arm.mbk.K))
    hidden = np.where(own < 0.0, robot.rubbing, 0.0)
    whole = np.stack((own, own - hidden)) / np.maximum(K, TINY)
    rubbing = _RUBBING * np.abs(np.diag(robot.values[1]))
    sure = _SPRING if calibration.assumed else _REFUTED
    beyond = np.abs(own) - np.stack((np.zeros_like(own), rubbing)) > sure * error
    return np.asarray(np.where(beyond, np.maximum(whole, -1.0), 0.0))


def _gains_in_doubt(
    shares: FloatArray, errors: FloatArray, springs: FloatArray, calibration: Calibration
) -> FloatArray:
    """Standard errors of gains and, off the diagonal, of cross-talk that the balance leaves.

    A significant share ρ is possible, whatever else may explain it, so it is a standard error
    beside those assumed. So is a share that the commands could not have shown, up to `_UNCONFIRMED`
    or, if the joint seems to have a spring, up to its stiffness relative to the arm's. A declared
    calibration counts until ρ differs from 0 by three standard errors, or the stiffness is
    negative, which only gravity could explain. Cross-talk counts only where it explains the
    residual better than a gain does.
    """
    size, own = np.abs(shares), np.eye(len(shares), dtype=np.bool_)
    significant = np.where(
        (size > _REFUTED * errors) & (own | _explained_better(shares, errors)), size, 0.0
    )
    # If nobody declared the gain, a share above one standard error is possible, too.
    unconfirmed = np.maximum(_UNCONFIRMED, np.where(size > errors, size, 0.0))
    cross_talk = _UNCONFIRMED_CROSS_TALK
    if not calibration.assumed:
        significant = np.where(_may_be_spring(shares) & (shares > 0.0), 0.0, significant)
        springs, unconfirmed, cross_talk = np.minimum(springs, 0.0), 0.0 * size, 0.0
    apparent, unexplained = np.abs(springs)
    most = np.where(own, np.maximum(apparent, unconfirmed), cross_talk)
    possible = np.minimum(np.hypot(shares, errors), most)
    possible = np.maximum(possible, _LOADED * np.diag(unexplained))
    return np.asarray(
        np.minimum(np.maximum(significant, possible), np.inf if calibration.assumed else _WRONG)
    )


def _may_be_spring(shares: FloatArray) -> BoolArray:
    """Where a single joint's share may be a spring or gravity, as no other elements decide that."""
    return np.asarray((np.abs(shares) < 1.0) & (len(shares) == 1))


def _explained_better(shares: FloatArray, errors: FloatArray) -> BoolArray:
    """Where a share is the most significant of its row, (n, n); clearly so of another torque."""
    sure = np.abs(shares) / np.maximum(errors, TINY) * (1.0 + _LIKELIER * np.eye(len(shares)))
    return np.asarray(sure == np.max(sure, axis=1, keepdims=True))


def judge_balance(
    names: Sequence[str], balance: RobotBalance | None, arm: MBKFit, calibration: Calibration
) -> tuple[list[Problem], FloatArray]:
    """Find transducers and commands that don't balance.

    `arm` is fitted to the same trials. `balance` is None if no commands of them confirm gains.

    Returns
    -------
    problems : list of Problem
    doubts : ndarray, shape (n, n)
        Relative standard errors of gains and cross-talk, see `_gains_in_doubt`; all 0 where a
        transducer is refused.
    """
    if balance is None:
        doubt = max(_UNCONFIRMED, calibration.gain) if calibration.assumed else 0.0
        unconfirmed = [_unconfirmed(name, doubt) for name in names if doubt > 0.0]
        return unconfirmed, doubt * np.eye(len(names))
    problems, wrong = [], []
    if balance.order != tuple(range(len(names))):
        order = ", ".join(names[row] for row in np.argsort(balance.order))
        problems.append(problem(ProblemCode.COMMANDS_PERMUTED, severity=Severity.NOTE, order=order))
    own = np.eye(len(names), dtype=np.bool_)
    shares, errors, possible, alike = imbalance(balance, arm, calibration)
    allowed = np.maximum(GAIN_TOLERANCE, _ALLOWED * alike)
    own_parts = map(np.diag, (shares, errors, allowed))
    less, less_error = _gains_above_one(balance, arm, *own_parts)
    # Negated so that NaN counts as beyond.
    beyond = ~(np.abs(shares) <= allowed + _ERRORS * errors)
    # Where a transducer shows too much of its own torque, its gain explains that, not cross-talk.
    crossed = beyond & ~own & _explained_better(shares, errors) & ~(less < 0.0)[:, None]
    explanations = [
        (crossed, shares, errors),
        (beyond & own & ~_may_be_spring(shares), shares, errors),
        (np.diag(less < 0.0), np.diag(less), np.diag(less_error)),
    ]
    for where, share, error in explanations:
        for i, row in np.argwhere(where):
            if i != row or names[i] not in wrong:
                wrong.append(names[i])
                problems.append(_wrong(names, i, row, share[i, row], error[i, row]))
    robots, arms = np.diag(balance.M), np.abs(np.diag(arm.mbk.M))
    weightless = robots + _ERRORS * np.diag(balance.M_se) < _WEIGHTLESS * arms
    if balance.impossible or weightless.any():
        rows = "; ".join(" ".join(f"{x:.3g}" for x in row) for row in balance.M)
        inertia, suspects = f"[{rows}] kg·m²", ", ".join(wrong or names)
        code = ProblemCode.ROBOT_INERTIA_IMPOSSIBLE
        problems.append(problem(code, inertia=inertia, name=suspects))
    if wrong:
        return problems, np.zeros(own.shape)
    ratio, ratio_error = balance.scales
    for i, j in np.argwhere(np.triu(np.abs(ratio) > _NOTICED * ratio_error)):
        percent, error = 100.0 * ratio[i, j], 100.0 * ratio_error[i, j]
        pair = {"name": names[i], "other": names[j], "percent": percent, "error": error}
        problems.append(problem(ProblemCode.SCALES_DIFFER, severity=Severity.NOTE, **pair))
    doubts = _gains_in_doubt(shares, errors, _springs(balance, arm, calibration), calibration)
    doubts = np.maximum(doubts, np.abs(possible))
    own_shares, own_errors, own_doubts = map(np.diag, (shares, errors, doubts))
    for name, share, error, doubt in zip(names, own_shares, own_errors, own_doubts, strict=True):
        problems += _doubted(name, share, error, doubt, calibration)
    return problems, doubts


def judge_answers(
    names: Sequence[str],
    records: Sequence[TrialRecord],
    balance: RobotBalance | None,
    arm: MBKFit,
) -> Iterator[Problem]:
    """Find torques that were computed from the commands and a model of the robot.

    Such torques balance, as the balance then finds the model of the robot. But the computation has
    to smooth accelerations, so that at first the torque shows all of a step of the command, while
    that on an arm shows no more than ``D = M_h (M_r + M_h)⁻¹`` of it. The trials are in the order
    of the joints.
    """
    if balance is None or not all(_rounds(record) for record in records):
        return
    answers, errors = answers_to_rounding(records)
    if (answers - _ERRORS * errors > _WHOLE).any():
        return
    inverse = np.linalg.pinv(arm.mbk.M + balance.M)
    shares = arm.mbk.M @ inverse
    of_arm, of_robot = (
        (np.eye(len(names)) - shares) ** 2 @ arm.errors[0] ** 2,
        shares**2 @ balance.M_se**2,
    )
    most_error = np.sqrt(np.diag((of_arm + of_robot) @ inverse**2))
    most = np.diag(shares)
    least = answers - _ERRORS * np.hypot(errors, most_error[:, None])
    beyond = least - most[:, None] - _AT_ONCE
    for i, when in enumerate(np.argmax(beyond, axis=1)):
        if beyond[i, when] > 0.0:
            yield problem(
                ProblemCode.TORQUE_FROM_COMMAND,
                name=names[i],
                percent=100.0 * float(answers[i, when]),
                error=100.0 * float(errors[i, when]),
                most=100.0 * float(most[i]),
            )


def _rounds(record: TrialRecord) -> bool:
    """Whether second differences of the angles are due to rounding rather than motion."""
    power = np.mean(np.diff(record.position, n=2) ** 2, axis=1)
    return bool((power <= _ROUNDED * record.resolution[JOINT_STATES] ** 2).all())


def _doubted(
    name: str, share: float, error: float, doubt: float, calibration: Calibration
) -> Iterator[Problem]:
    """Note what the standard errors contain of a transducer that is not refused."""
    if doubt > 1.0:
        yield problem(ProblemCode.COMMANDS_UNRELATED, severity=Severity.NOTE, name=name)
    elif doubt > 0.0 and (abs(share) > _REFUTED * error or not calibration.assumed):
        about = _gain_of(name, share, error) | {"doubt": 100.0 * float(doubt)}
        yield problem(ProblemCode.GAIN_DOUBTED, severity=Severity.NOTE, **about)
    elif calibration.assumed and doubt > calibration.gain:
        yield _unconfirmed(name, float(doubt))


def _unconfirmed(name: str, doubt: float) -> Problem:
    code = ProblemCode.GAIN_UNCONFIRMED
    return problem(code, severity=Severity.NOTE, name=name, doubt=100.0 * doubt)


def _wrong(names: Sequence[str], i: int, row: int, share: float, error: float) -> Problem:
    """Problem of transducer i with a share ρ of the torque of joint `row`, its own or another's."""
    if i == row:
        gain = _gain_of(names[i], share, error)
        if not gain["error"] < abs(gain["share"]):
            return problem(ProblemCode.COMMANDS_UNRELATED, name=names[i])
        return problem(ProblemCode.TORQUE_UNBALANCED, **gain)
    return problem(
        ProblemCode.TORQUES_CROSS,
        name=names[i],
        other=names[row],
        percent=-100.0 * share,
        error=100.0 * error,
    )


def _gain_of(name: str, share: float, error: float) -> dict[str, Any]:
    # From ρ = (1 - g)/g, which is linear in the stiffness, so that gains near 0 or below count.
    gain = 1.0 / (1.0 + share)
    return {"name": name, "share": float(gain), "error": float(error * gain**2)}


def in_order(trial: TrialData, order: tuple[int, ...]) -> TrialData:
    """Return a trial with the rows of its commands in the order of the joints."""
    record = trial.record
    if record.command is None or order == tuple(range(record.joints)):
        return trial
    command = record.command[list(order)]
    return replace(trial, record=replace(record, command=command))
