"""Balance of the robot: what the commands move, less what the transducers show of the arm.

Between the robot's drives and the arm nothing but the robot itself takes torque, so

    H T_u - T_τ = (M_r s² + B_r s + K_r) R,    H = (1 - exp(-jωL))/jωL

with the responses T_u of the commands, T_τ of the transducers and R of the angles to the
perturbation, and the hold H of the commands. A robot in the plane has no stiffness beyond that of
its friction, and its inertia is symmetric with positive eigenvalues. If the transducer of a joint
shows g times the torque, then ``K_r = (1 - g)/g · K̂`` in its row, with the stiffness K̂ of the
estimate. So wrong signs, units, gains and orders show without knowing arm or robot. What is wrong
with commands, torques and angles in the same proportion doesn't.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from armimp_common.errors import DataError
from armimp_estimation.estimators.estimate import ImpedanceEstimate
from armimp_estimation.estimators.local_polynomial import LocalResponse, local_response
from armimp_estimation.estimators.lpm import LpmConfig, unresolved
from armimp_estimation.estimators.welch import invert, multiply
from armimp_estimation.fit import CommonDelay, FitConfig, MBKFit, fit_impedance
from armimp_estimation.hold_correction import HoldCorrection
from armimp_estimation.plausibility import least_eigenvalue
from armimp_estimation.problems import Problem, ProblemCode, Severity
from armimp_estimation.record import TrialRecord
from armimp_estimation.torque_timing import TorqueReading
from armimp_estimation.trial import TrialData

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

BAND = (0.25, 12.0)
"""Where inertia and stiffness are seen, Hz: below, friction is most of it."""
GAIN_TOLERANCE = 0.03
"""Share by which the torque of a transducer may differ from that of the command, beside chance.

A spring at the robot is no fault, nor is friction, which looks like one.
"""
ASYMMETRY = 0.03
"""Share by which elements of the robot's inertia off the diagonal may differ from each other."""
_ERRORS = 5.0
_NEGATIVE = 4.0
_MOST_ORDERS = 4
_CLEARLY = 0.3
_NOT_ALL = 0.03


@dataclass(frozen=True, kw_only=True, eq=False)
class RobotBalance:
    """What commands less torques move.

    Attributes
    ----------
    fit : MBKFit
        Inertia, viscosity and stiffness of the robot, with standard errors.
    order : tuple of int
        Row of the commands that belongs to each joint.
    """

    fit: MBKFit
    order: tuple[int, ...]

    @property
    def permuted(self) -> bool:
        """Whether commands are in another order than the joints."""
        return self.order != tuple(range(len(self.order)))


@dataclass(frozen=True, kw_only=True, eq=False)
class RobotResponses:
    """Responses to the perturbation from which the balance follows.

    Attributes
    ----------
    records : tuple of TrialRecord
        One trial for each joint, in order.
    columns : tuple of LocalResponse
        Of angles, torques and commands, by trial.
    inverse : ndarray, shape (n, n, n_freq)
        ``R⁻¹``.
    """

    records: tuple[TrialRecord, ...]
    columns: tuple[LocalResponse, ...]
    inverse: ComplexArray

    @classmethod
    def of(cls, records: Sequence[TrialRecord]) -> RobotResponses | None:
        """Those of trials; None if there are no commands, or something does not respond."""
        if any(record.command is None for record in records):
            return None
        try:
            columns = _responses(records)
            angles = np.stack([one.response[: len(records)] for one in columns], axis=1)
            inverse = invert(angles, columns[0].f)
        except DataError:
            return None
        return cls(records=tuple(records), columns=tuple(columns), inverse=inverse)

    def order(self) -> tuple[int, ...]:
        """Row of the commands that belongs to each joint.

        The right order leaves a robot with hardly any stiffness; friction leaves some of it.
        """
        n = len(self.records)
        orders = list(itertools.permutations(range(n))) if n <= _MOST_ORDERS else [tuple(range(n))]
        stiffness = [float(np.linalg.norm(self.balance(one).fit.mbk.K)) for one in orders]
        best = int(np.argmin(stiffness))
        return orders[best] if stiffness[best] < _CLEARLY * stiffness[0] else orders[0]

    def balance(
        self,
        order: tuple[int, ...],
        jump: HoldCorrection | None = None,
        reading: TorqueReading | None = None,
        delay: CommonDelay | None = None,
    ) -> RobotBalance:
        """Estimate what the commands move.

        Parameters
        ----------
        order : tuple of int
            Row of the commands that belongs to each joint.
        jump : HoldCorrection, optional
            How torques jump with the commands, if that is known.
        reading : TorqueReading, optional
            How torques were read.
        delay : CommonDelay, optional
            What was found of their delay.
        """
        n, f, rate = len(self.records), self.columns[0].f, self.records[0].rate
        turn = 2j * np.pi * f / rate
        step = 1.0 - np.exp(-turn)
        late = 0.0 if delay is None else delay.delay
        # What torque and commands, (n, 3n), move the robot.
        mixed = np.zeros((n, 3 * n, f.size), dtype=np.complex128)
        read = reading.at_rate(rate) if reading is not None else TorqueReading()
        known = np.exp(turn * rate * late) / read.response(f)
        for i in range(n):
            mixed[i, n + i] = -known
            mixed[i, 2 * n + order[i]] = step / turn
        if jump is not None:
            mixed[:, 2 * n :] -= known * step * jump.missing(f, rate, read)
        stacked = np.stack([one.response for one in self.columns], axis=1)
        moving = multiply(mixed, stacked)
        impedance = multiply(moving, self.inverse)
        coefficients = mixed.copy()
        coefficients[:, :n] -= impedance
        systematics = unresolved(self.records, impedance, self.inverse)
        if delay is not None:
            torque = multiply(mixed[:, n : 2 * n], stacked[n : 2 * n])
            systematics.append(delay.error * turn * rate * multiply(torque, self.inverse))
        variance = np.asarray(sum(np.abs(one) ** 2 for one in systematics) + np.zeros(moving.shape))
        for k, response in enumerate(self.columns):
            for i in range(n):
                noise = response.combined_variance(coefficients[i])
                variance[i] += noise * np.abs(self.inverse[k]) ** 2
        estimate = ImpedanceEstimate(
            name="robot",
            f=f,
            Z=impedance,
            variance=variance,
            systematics=tuple(systematics),
            bin_correlation=self.columns[0].bin_correlation(),
            averages=self.columns[0].freedom + 1.0,
            T=moving,
            R=stacked[:n],
        )
        return RobotBalance(fit=fit_impedance(estimate, FitConfig())[1], order=order)


def transducer_gains(robot: MBKFit, arm: MBKFit) -> tuple[FloatArray, FloatArray]:
    """Gain g of each transducer against the commands, and its standard error.

    With ``ρ = Σ_j K_r,ij K̂_ij / Σ_j K̂_ij²`` over the other joints j it is ``1/(1 + ρ)``. A spring
    or friction in the joint i itself is in ``K_r,ii`` alone, so that is left out where it can be.
    """
    K = arm.mbk.K if len(arm.mbk.K) == 1 else arm.mbk.K * (1.0 - np.eye(len(arm.mbk.K)))
    size = np.maximum(np.sum(K**2, axis=1), np.finfo(np.float64).tiny)
    share = np.sum(robot.mbk.K * K, axis=1) / size
    error = np.hypot(
        np.sqrt(np.sum((robot.K_se * K) ** 2, axis=1)) / size,
        # Where the arm hardly couples the joints its own errors count.
        share * np.sqrt(np.sum((arm.K_se * K) ** 2, axis=1)) / size,
    )
    return 1.0 / (1.0 + share), error / (1.0 + share) ** 2


def negative_gains(robot: MBKFit, arm: MBKFit) -> FloatArray:
    """Gains of transducers that a negative stiffness of the robot takes at least; 1: none.

    Springs and friction make that of a joint positive, so a transducer has to show too much.
    """
    own, own_error = np.diag(robot.mbk.K), np.diag(robot.K_se)
    K = np.diag(arm.mbk.K)
    beyond = (K > 0.0) & (own < -GAIN_TOLERANCE * K - _NEGATIVE * own_error)
    share = np.maximum(np.divide(own, K, out=np.zeros_like(own), where=beyond), -0.99)
    return np.where(beyond, 1.0 / (1.0 + share), 1.0)


def judge_balance(names: Sequence[str], balance: RobotBalance, arm: MBKFit) -> list[Problem]:
    """Find what doesn't balance.

    Parameters
    ----------
    names : sequence of str
        Joint names.
    balance : RobotBalance
        What the commands move.
    arm : MBKFit
        What was estimated of the arm from the same trials.
    """
    problems = []
    gains, errors = transducer_gains(balance.fit, arm)
    if balance.permuted:
        order = ", ".join(names[row] for row in np.argsort(balance.order))
        problems.append(
            Problem(
                code=ProblemCode.COMMANDS_PERMUTED,
                severity=Severity.NOTE,
                values={"order": order},
            )
        )
    wrong = []
    # Where locked joints are held by something else than commands, nothing has to balance.
    shares, doubts = 1.0 / gains - 1.0, errors / gains**2
    if (np.abs(shares + 1.0) <= _NOT_ALL + 2.0 * doubts).any():
        return problems
    for name, gain, error in zip(names, gains, errors, strict=True):
        # In terms of the stiffness, so that a gain near 0 or below counts as well.
        if not abs(1.0 / gain - 1.0) <= GAIN_TOLERANCE + _ERRORS * error / gain**2:
            wrong.append(name)
            problems.append(
                Problem(
                    code=ProblemCode.TORQUE_UNBALANCED,
                    values={"name": name, "share": float(gain), "error": float(error)},
                )
            )
    fit = balance.fit
    for name, least in zip(names, negative_gains(fit, arm), strict=True):
        if least > 1.0 and name not in wrong:
            wrong.append(name)
            values: dict[str, float | int | str] = {
                "name": name,
                "share": float(least),
                "error": 0.0,
            }
            problems.append(Problem(code=ProblemCode.TORQUE_UNBALANCED, values=values))
    value, error = least_eigenvalue(fit.mbk.M, fit.M_se)
    M = fit.mbk.M
    size = np.sqrt(np.abs(np.outer(np.diag(M), np.diag(M))))
    uneven = np.abs(M - M.T) > ASYMMETRY * size + _ERRORS * np.hypot(fit.M_se, fit.M_se.T)
    if value < -_ERRORS * error or uneven.any():
        inertia = "[" + "; ".join(" ".join(f"{x:.3g}" for x in row) for row in M) + "] kg·m²"
        problems.append(
            Problem(
                code=ProblemCode.ROBOT_INERTIA_IMPOSSIBLE,
                values={"inertia": inertia, "name": ", ".join(wrong or names)},
            )
        )
    return problems


def in_order(trial: TrialData, order: tuple[int, ...]) -> TrialData:
    """Return a trial with its commands in the order of the joints."""
    record = trial.record
    if record.command is None:
        return trial
    command = record.command[list(order)]
    return replace(trial, record=replace(record, command=command))


def _responses(records: Sequence[TrialRecord]) -> list[LocalResponse]:
    shortest = min(records, key=lambda record: record.samples)
    f = None
    found = []
    for record in (shortest, *(one for one in records if one is not shortest)):
        command = record.position[:0] if record.command is None else record.command
        response = local_response(
            record.perturbation[record.perturbed_joint],
            np.concatenate([record.position, record.torque, command]),
            record.rate,
            BAND,
            LpmConfig().local_for(record.duration),
            f,
        )
        f = response.f
        found.append((record.perturbed_joint, response))
    return [response for _, response in sorted(found, key=lambda pair: pair[0])]
