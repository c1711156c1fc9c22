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

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from armimp_common.arrays import TINY, ComplexArray, FloatArray
from armimp_common.errors import DataError
from armimp_estimation.estimators.estimate import noise_of
from armimp_estimation.estimators.local_polynomial import LocalResponse
from armimp_estimation.estimators.lpm import covariance_of, responses
from armimp_estimation.estimators.welch import invert, multiply
from armimp_estimation.fit import Calibration, MBKFit
from armimp_estimation.hold_correction import HoldCorrection, without_skew
from armimp_estimation.plausibility import least_eigenvalue, uneven
from armimp_estimation.record import APART, TrialRecord
from armimp_estimation.spectra import sums_within
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
ERRORS = 5.0  # standard errors beyond which a deviation is refused
_CLEARLY = 0.3  # rms stiffness in another order of commands relative to the given one, at most
_ANSWERS = 10.0
"""Ratio of the power of a command's response to its variance, median over the frequencies, that
chance doesn't reach."""
_FEWEST = 5  # frequencies for the seven coefficients of an element, at least
_LOOKS = 2
"""Fits to an element, each with weights by the lack of the one before."""
TAKEN = 0.15
"""Standard error of the torque that friction takes from a locked joint, relative to that torque, as
it isn't as linear as the terms fitted to it, and may be less so if speeds aren't Gaussian."""
_PUSHED = 0.3
"""Friction of a locked joint that is not like a damper's, relative to that, from which on the joint
is pushed now and then; of Gaussian speeds there is up to 0.15."""
_HIDDEN = 0.2
"""Share of friction in an element from which on all of that share may be inertia."""
_SLIGHT = 0.1
"""Share of an element that friction of locked joints takes, up to which it hardly bends that."""
NOTICED = 3.0
"""Standard errors from which on the scales of two encoders seem to differ."""


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
    sticking: FloatArray
    """Apparent inertia that friction of locked joints may have, kg·m², shape (n, n)."""
    order: tuple[int, ...]
    """Row of the commands that belongs to each joint."""
    unexplained: FloatArray
    """Torque that neither this robot nor noise explains, relative to that of the arm; (n,)."""
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
        hide inertia, the more so the less it is like a damper. Where it holds a joint between
        pushes, it follows the perturbation.
        """
        share = np.maximum(self.friction, self.unseen)
        hidden = self.friction > _HIDDEN * (1.0 - self.undamped)
        share *= np.where(hidden, 1.0, TAKEN)
        taken = share * np.maximum(np.abs(self.M), np.abs(self.M.T))
        own = np.diag(np.abs(np.diag(self.values[1]))) / (2.0 * np.pi * BAND[1])
        return np.asarray(taken + own + self.sticking)

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
        unlike = np.abs(ratio) > GAIN_TOLERANCE + ERRORS * its_error
        asymmetric = unlike | uneven(M, M_se, ASYMMETRY)
        return bool(value < -ERRORS * error or asymmetric.any())

    @cached_property
    def scales(self) -> tuple[FloatArray, FloatArray]:
        """Relative difference of M_ij and M_ji, and its standard error, (n, n).

        As the inertia is symmetric, it is that between the scales of encoders j and i. It is 0
        with an infinite error on the diagonal. Friction of locked joints is taken as viscous: as a
        spring it would look too much like an inertia. What it takes beyond a tenth of an element
        is an error.
        """
        M, error = self.damped
        taken = np.maximum(self.friction, self.unseen)
        size = np.maximum(np.minimum(np.abs(M), np.abs(M.T)), TINY)
        error = np.hypot(error, np.hypot(self._inertia_hidden, self.unsure))
        error = np.hypot(error, np.maximum(taken - _SLIGHT, 0.0) * np.maximum(np.abs(M), size))
        ratio, error = (M - M.T) / size, np.hypot(error, error.T) / size
        np.fill_diagonal(error, np.inf)
        return ratio, error

    @property
    def scales_in_doubt(self) -> FloatArray:
        """Relative standard errors, (n,), of scales of encoders that seem to differ."""
        ratio, error = self.scales
        seeming = np.where(np.abs(ratio) > NOTICED * error, ratio, 0.0)
        return np.asarray(np.linalg.norm(seeming, axis=0))

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

        Also None with too few frequencies; if no command responds to one of the perturbations, as
        of other trials; or if brakes hold joints.
        """
        channels = [
            np.concatenate([record.position, record.torque, record.command])
            for record in records
            if record.command is not None and not _braked(record)
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
        if columns[0].f.size < _FEWEST:
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
        if not (np.abs(given.K) > 2.0 * ERRORS * given.K_se).any():
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
        torque = multiply(multiply(mixed[:, n : 2 * n], self.stacked[n : 2 * n]), self.inverse)
        if delay is not None:
            systematics.append(delay.error * turn * rate * torque)
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
            torque,
        )
        M, B, _ = map(np.diag, fitted["values"])
        undamped, pace, times = self._not_of_a_damper
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
            sticking=np.where(undamped > _PUSHED, undamped, 0.0) * np.abs(B)[:, None] * times,
            order=order,
            unsure=unsure,
        )

    def _fit(
        self,
        impedance: ComplexArray,
        variance: FloatArray,
        driven: ComplexArray,
        torque: ComplexArray,
    ) -> dict[str, FloatArray]:
        """Fit a robot, friction of locked joints and a lag of the drives to an impedance.

        Returned are values, covariance, friction, damped and unexplained of a
        :class:`RobotBalance`; `driven` and `torque` are the contributions of the commands and of
        the transducers to the impedance, (n, n, n_freq).
        """
        n, f = len(self.records), self.columns[0].f
        s, correlation = 2j * np.pi * f, self.columns[0].bin_correlation()
        locked = self.stacked[:n] * np.einsum("jjf->jf", self.inverse)
        found, errors = np.zeros((3, n, n)), np.zeros((3, 3, n, n))
        friction, damped, unexplained = np.zeros((n, n)), np.zeros((2, n, n)), np.zeros(n)
        for i, j in np.ndindex(n, n):
            own = np.stack([s**2, s, np.ones_like(s)])
            held = np.stack([locked[i, j] * s, locked[i, j]])
            lag = np.stack([driven[i, j] * s, driven[i, j] * s**2])
            terms = np.concatenate([own, lag] if i == j else [own, held, lag])
            given = f, impedance[i, j], variance[i, j], correlation
            values, covariance = _least_squares(*given, terms)
            free, spread, taken = values, covariance, np.zeros_like(s)
            if i == j:
                rest = np.abs(impedance[i, i] - values @ terms) ** 2 - variance[i, i]
                left = np.sqrt(max(float(np.sum(rest)), 0.0))
                unexplained[i] = left / np.linalg.norm(torque[i, i])
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
        return {
            "values": found,
            "covariance": errors,
            "friction": friction,
            "damped": damped,
            "unexplained": unexplained,
        }

    @cached_property
    def _not_of_a_damper(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Torque of friction that may follow the perturbation, but not as that of a damper does.

        At a Gaussian speed v friction ``f sign(v)`` is the torque of a damper plus a residual that
        is uncorrelated with anything linear (Bussgang). The damper has the part
        ``(mean |v| / rms v)²`` of f², which is 2/π for Gaussian speeds. What is missing of that, as
        where a joint is pushed and then sticks away from its equilibrium, may act like a spring of
        either sign. Returned relative to the damper's torque, by joint and trial; with the rms
        speed over rms angle of each joint in its own trial, 1/s, and over the rms acceleration of
        the perturbed joint in each other trial, s, (n, n).
        """
        n = len(self.records)
        undamped, pace = np.zeros((n, n)), np.zeros(n)
        speeds, changes = np.zeros((2, n))
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
                speeds[k] = rms**2 / np.mean(np.abs(speed))
                changes[k] = self.records[k].rate * np.std(np.diff(speed))
        times = np.outer(speeds, 1.0 / np.maximum(changes, TINY)) * (1.0 - np.eye(n))
        return undamped, pace, times


def _braked(record: TrialRecord) -> bool:
    """Whether something other than the constant commands of locked joints holds them."""
    commands, k = record.command, record.perturbed_joint
    if commands is None or np.array_equal(commands[k], record.perturbation[k]):
        return False  # these are no commands, but perturbations
    return not np.ptp(np.delete(commands, k, axis=0), axis=1).all()


def _least_squares(
    f: FloatArray,
    Z: ComplexArray,
    variance: FloatArray,
    correlation: FloatArray,
    regressors: ComplexArray,
) -> tuple[FloatArray, FloatArray]:
    """Fit real coefficients, (p,), of regressors, (p, n_freq), to an element; and covariance."""
    whole = variance
    for _ in range(_LOOKS):
        weights = fit_weights(f, Z, whole, _FLOOR, reach=_REACH)
        scale = np.linalg.norm(np.sqrt(weights) * regressors, axis=1)
        scale[scale == 0.0] = 1.0
        design = regressors / scale[:, None]
        normal = np.linalg.pinv(((np.conj(design) * weights) @ design.T).real)
        functionals = normal @ (design * weights)
        values = (np.conj(functionals) @ Z).real
        lack = np.abs(Z - values @ design) ** 2 / max(1.0 - 0.5 * values.size / f.size, TINY)
        total, count = sums_within(f, lack / variance, _REACH)
        whole = variance * np.maximum(total / count, 1.0)
    spread = functionals * np.sqrt(whole)
    return values / scale, covariance_of_sums(spread, correlation) / np.outer(scale, scale)


def in_order(trial: TrialData, order: tuple[int, ...]) -> TrialData:
    """Return a trial with the rows of its commands in the order of the joints."""
    record = trial.record
    if record.command is None or order == tuple(range(record.joints)):
        return trial
    command = record.command[list(order)]
    return replace(trial, record=replace(record, command=command))
