"""What the balance of commands and torques tells of the transducers.

A robot has no stiffness between its joints but that of gravity, and its friction slows a joint
down. What else :mod:`armimp_estimation.robot_balance` finds belongs to the arm: a transducer shows
more or less than the torque on it, or a share of another joint's. Where nothing is significant, the
balance still tells how large such an error may be. Torques that balance too well were computed from
the commands.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from armimp_common.arrays import TINY, BoolArray, FloatArray
from armimp_common.topics import JOINT_STATES
from armimp_estimation.fit import Calibration, MBKFit
from armimp_estimation.hold_correction import answers_to_rounding
from armimp_estimation.problems import Problem, ProblemCode, Severity, problem
from armimp_estimation.record import TrialRecord
from armimp_estimation.robot_balance import ERRORS, GAIN_TOLERANCE, NOTICED, TAKEN, RobotBalance

_NEGATIVE = 4.0  # standard errors beyond which a negative viscosity or stiffness counts
_WEIGHTLESS = 0.02
"""Inertia of a joint of the robot relative to the arm's below which there is none, as the torque is
the command. The lightest robots have a sixth of the inertia of heavy arms."""
_HELD = 0.8
"""The same as `TAKEN` where friction that holds the joint would explain the residual."""
_UNCONFIRMED = 0.1
"""Assumption: relative error of a gain that nobody has declared and no command confirms."""
_UNCONFIRMED_CROSS_TALK = 0.03
"""Assumption: error of cross-talk in the same case."""
_SPRING = 2.0
"""Standard errors from which on a joint of the robot seems to have a spring."""
_RUBBING = 2.0
"""Largest ratio of the apparent stiffness of friction to its apparent viscosity, 1/s."""
_LOADED = 0.4
"""Assumption: relative standard error of a torque that seems to be that of a spring of the robot;
in one of six rigs it is that of a cable which loads the transducer."""
_WRONG = 0.3
"""Assumption: largest error of a declared gain that only a spring of the robot puts in doubt."""
_PULLED = 0.3
"""Assumption: negative stiffness by which gravity may pull a joint of the robot away from the
posture, relative to the arm's stiffness."""
_ALLOWED = 3.0
"""Standard errors by which shares may look wrong by the calibration of other ones, and inertias may
differ from what is known of the robot."""
_LIKELIER = 0.1
"""Share by which cross-talk must be more significant than a gain, which is off more often."""
_REFUTED = 3.0
"""Standard errors by which a gain has to differ from 1 to refute a declared calibration."""
_AT_ONCE, _WHOLE = 0.1, 1.2
"""Shares of a step of the command: by which a torque may jump beyond what inertias allow; and
beyond which the torque is in another unit, which the balance finds."""
_UNEXPLAINED = 0.05
"""Share of an arm's torque that a robot with no friction leaves unexplained at most, unless torques
or angles were filtered, or something yields between the arm and where they are measured."""
_ROUNDED = 1.0
"""Largest mean square of second differences of an angle, relative to its squared resolution, of
which most is rounding; rounding itself has half of that square."""


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
            robot.friction * np.maximum(TAKEN, robot.undamped),
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
    shares: FloatArray,
    errors: FloatArray,
    possible: FloatArray,
    springs: FloatArray,
    calibration: Calibration,
) -> FloatArray:
    """Standard errors of gains and, off the diagonal, of cross-talk that the balance leaves.

    A significant or `possible` share ρ is a standard error beside those assumed, whatever else may
    explain it. So is a share that the commands could not have shown, up to `_UNCONFIRMED` or, if a
    joint seems to have a spring, up to its stiffness relative to the arm's; or up to the largest ρ
    of all joints, as one cause, such as a wrong unit, may spoil all gains. A declared calibration
    counts until ρ differs from 0 by three standard errors, or the stiffness is negative, which only
    gravity could explain. Cross-talk counts only where it explains the residual better than a gain
    does.
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
    significant = np.maximum(significant, np.abs(possible))
    apparent, unexplained = np.abs(springs)
    apparent = np.maximum(apparent, np.diag(unconfirmed))
    largest = float(np.max(significant))
    if calibration.assumed:
        largest = max(largest, float(np.max(apparent)))
    else:
        apparent, unexplained = np.minimum((apparent, unexplained), _WRONG)
    most = np.where(own, np.maximum(apparent, largest), cross_talk)
    hidden = np.minimum(np.hypot(shares, errors), most)
    return np.asarray(np.maximum.reduce((significant, hidden, _LOADED * np.diag(unexplained))))


def _trials_in_doubt(
    shares: FloatArray, errors: FloatArray, springs: FloatArray, calibration: Calibration
) -> FloatArray:
    """Relative standard errors, (n,), of torques of each trial, as of an amplifier set anew.

    A gain that differs in one trial shows as the stiffness of the joint that is perturbed there,
    and as shares of the other joints, given with their standard errors. Of a declared calibration
    only negative stiffness is no spring of the robot.
    """
    if not calibration.assumed:
        springs = np.maximum(np.minimum(springs, 0.0), -_WRONG)
    n = len(shares)
    if n == 1:
        return np.zeros(1)
    others = np.where(np.eye(n, dtype=np.bool_), np.inf, np.hypot(shares, errors))
    return np.asarray(np.minimum(np.abs(springs), (n - 1) * np.min(others, axis=1)))


def _may_be_spring(shares: FloatArray) -> BoolArray:
    """Where a single joint's share may be a spring or gravity, as no other elements decide that."""
    return np.asarray((np.abs(shares) < 1.0) & (len(shares) == 1))


def _explained_better(shares: FloatArray, errors: FloatArray) -> BoolArray:
    """Where a share is the most significant of its row, (n, n); clearly so of another torque."""
    sure = np.abs(shares) / np.maximum(errors, TINY) * (1.0 + _LIKELIER * np.eye(len(shares)))
    return np.asarray(sure == np.max(sure, axis=1, keepdims=True))


def judge_balance(
    names: Sequence[str],
    balance: RobotBalance | None,
    arm: MBKFit,
    calibration: Calibration,
    known: tuple[FloatArray, float] | None = None,
) -> tuple[list[Problem], FloatArray, FloatArray]:
    """Find transducers and commands that don't balance.

    `arm` is fitted to the same trials. `balance` is None if no commands of them confirm gains.
    `known` is the inertia of the robot, kg·m², with the standard error of its elements relative to
    ``√(M_ii M_jj)``.

    Returns
    -------
    problems : list of Problem
    doubts : ndarray, shape (n, n)
        Relative standard errors of gains and cross-talk, see `_gains_in_doubt`; all 0 where a
        transducer is refused.
    trials : ndarray, shape (n,)
        Relative standard errors of all torques, or angles, of each trial in the same case.
    """
    if balance is None:
        doubt = max(_UNCONFIRMED, calibration.gain) if calibration.assumed else 0.0
        unconfirmed = [_unconfirmed(name, doubt) for name in names if doubt > 0.0]
        return unconfirmed, doubt * np.eye(len(names)), np.zeros(len(names))
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
    beyond = ~(np.abs(shares) <= allowed + ERRORS * errors)
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
    weightless = robots + ERRORS * np.diag(balance.M_se) < _WEIGHTLESS * arms
    if balance.impossible or weightless.any():
        code, inertia = ProblemCode.ROBOT_INERTIA_IMPOSSIBLE, _rows(balance.M)
        problems.append(problem(code, inertia=inertia, name=", ".join(wrong or names)))
    if known is not None:
        problems += _unlike(names, balance, *known)
    if wrong:
        return problems, np.zeros(own.shape), np.zeros(len(names))
    ratio, ratio_error = balance.scales
    for i, j in np.argwhere(np.triu(np.abs(ratio) > NOTICED * ratio_error)):
        percent, error = 100.0 * ratio[i, j], 100.0 * ratio_error[i, j]
        pair = {"name": names[i], "other": names[j], "percent": percent, "error": error}
        problems.append(problem(ProblemCode.SCALES_DIFFER, severity=Severity.NOTE, **pair))
    springs = _springs(balance, arm, calibration)
    doubts = _gains_in_doubt(shares, errors, possible, springs, calibration)
    own_shares, own_errors, own_doubts = map(np.diag, (shares, errors, doubts))
    for name, share, error, doubt in zip(names, own_shares, own_errors, own_doubts, strict=True):
        problems += _doubted(name, share, error, doubt, calibration)
    trials = _trials_in_doubt(own_shares, own_errors, springs[0], calibration)
    return problems, doubts, np.hypot(trials, balance.scales_in_doubt)


def _unlike(
    names: Sequence[str], balance: RobotBalance, known: FloatArray, uncertainty: float
) -> Iterator[Problem]:
    """Find joints that the commands move as if they had another inertia than the known one."""
    own = np.sqrt(np.abs(np.diag(known)))
    allowed = _ALLOWED * uncertainty * np.outer(own, own)
    allowed += ERRORS * np.hypot(balance.M_se, balance.unsure)
    # Negated so that NaN counts as beyond.
    beyond = ~(np.abs(balance.M - known) <= allowed)
    if beyond.any():
        code, found = ProblemCode.ROBOT_INERTIA_UNLIKE, _rows(balance.M)
        name = ", ".join(name for name, row in zip(names, beyond, strict=True) if row.any())
        yield problem(code, inertia=found, known=_rows(known), name=name)


def _rows(inertia: FloatArray) -> str:
    rows = "; ".join(" ".join(f"{x:.3g}" for x in row) for row in inertia)
    return f"[{rows}] kg·m²"


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
    if (answers - ERRORS * errors > _WHOLE).any():
        return
    inverse = np.linalg.pinv(arm.mbk.M + balance.M)
    shares = arm.mbk.M @ inverse
    of_arm, of_robot = (
        (np.eye(len(names)) - shares) ** 2 @ arm.errors[0] ** 2,
        shares**2 @ balance.M_se**2,
    )
    most_error = np.sqrt(np.diag((of_arm + of_robot) @ inverse**2))
    most = np.diag(shares)
    least = answers - ERRORS * np.hypot(errors, most_error[:, None])
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


def judge_unexplained(
    names: Sequence[str], balance: RobotBalance | None, arm: MBKFit
) -> Iterator[Problem]:
    """Find torques that don't balance although no gain is wrong, of an arm not of the form M, B, K.

    A filter of torques or angles, or what yields between encoder and arm, does both at once.
    """
    if balance is not None and not arm.of_form:
        for name, share in zip(names, balance.unexplained, strict=True):
            if share > _UNEXPLAINED:
                about: dict[str, Any] = {"name": name, "percent": 100.0 * float(share)}
                yield problem(ProblemCode.TORQUE_UNEXPLAINED, severity=Severity.NOTE, **about)


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
