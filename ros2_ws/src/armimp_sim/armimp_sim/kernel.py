"""The compiled plant: equations of motion and RK4, for many trials side by side.

All numbers of a batch live in one flat array of rows; each row holds one quantity of all lanes
(trials). The number of joints n and of lanes are compile-time constants, carried by the lengths of
two tuples, so the compiler knows every distance inside the array: it unrolls the loops over joints
and turns the loops over lanes into SIMD instructions. One lane is the ordinary single trial; the
arithmetic is the same operation by operation, so a lane gives the same bits in any batch.

Rows (n rows each unless said otherwise), in the order of :func:`rows`:
state θ, v, z; input τ, d; parameters; work space.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from armimp_common.compiled import compiled, compiled_entry
from armimp_sim.elementary import exp_minus, sine_cosine

Tag = tuple[float, ...]

# Vectors, in units of n rows: state, inputs, parameters, outputs, work space.
THETA, VELOCITY, BRISTLE = 0, 1, 2
COMMAND, VOLUNTARY = 3, 4
POSTURE = 5
COULOMB, STRIBECK, INVERSE_STRIBECK_VELOCITY = 6, 7, 8  # Fc, Fs − Fc, 1/vs
SIGMA_0, SIGMA_1, SIGMA_2 = 9, 10, 11
TORQUE = 12  # torque on the arm at the last sample
_LAST_THETA, _LAST_VELOCITY, _MEAN_THETA = 13, 14, 15  # for the mean torque of an interval
_START = 16  # state at the start of the RK4 step: 3 vectors
_SUM = 19  # weighted sum of the slopes: 3 vectors
_SLOPE_V, _SLOPE_Z = 22, 23
_COSINE, _SINE, _OMEGA_SQUARED = 24, 25, 26
_CENTRIPETAL, _RHS = 27, 28
VECTORS = 29
# n×n matrices follow the vectors.
INERTIA, DAMPING, STIFFNESS, CHAIN, _MASS = 0, 1, 2, 3, 4
MATRICES = 5


def rows(n: int) -> int:
    """Number of rows of a batch with n joints."""
    return VECTORS * n + MATRICES * n * n


@compiled
def _matrix_row(which: int, i: int, j: int, n: int) -> int:
    return VECTORS * n + which * n * n + i * n + j


@compiled
def _kinematics(w: NDArray[np.float64], joints: Tag, lanes: Tag) -> None:
    """Sines and cosines of the absolute link angles, and squared absolute rates."""
    n, m = len(joints), len(lanes)
    for lane in range(m):
        # The dynamics depend on angle differences only: the first link may stand at zero.
        angle = 0.0
        rate = w[(VELOCITY * n) * m + lane]
        w[(_COSINE * n) * m + lane] = 1.0
        w[(_SINE * n) * m + lane] = 0.0
        w[(_OMEGA_SQUARED * n) * m + lane] = rate * rate
        for a in range(1, n):
            angle += w[(THETA * n + a) * m + lane]
            rate += w[(VELOCITY * n + a) * m + lane]
            s, c = sine_cosine(angle)
            w[(_COSINE * n + a) * m + lane] = c
            w[(_SINE * n + a) * m + lane] = s
            w[(_OMEGA_SQUARED * n + a) * m + lane] = rate * rate


@compiled
def _friction(w: NDArray[np.float64], joints: Tag, lanes: Tag) -> None:
    """LuGre: slope of the bristle deflection, and −F into the right-hand side."""
    n, m = len(joints), len(lanes)
    for i in range(n):
        for lane in range(m):
            v = w[(VELOCITY * n + i) * m + lane]
            z = w[(BRISTLE * n + i) * m + lane]
            x = v * w[(INVERSE_STRIBECK_VELOCITY * n + i) * m + lane]
            g = w[(COULOMB * n + i) * m + lane] + w[(STRIBECK * n + i) * m + lane] * exp_minus(
                x * x
            )
            sigma_0 = w[(SIGMA_0 * n + i) * m + lane]
            dz = v - sigma_0 * abs(v) * z / g
            w[(_SLOPE_Z * n + i) * m + lane] = dz
            w[(_RHS * n + i) * m + lane] = -(
                sigma_0 * z
                + w[(SIGMA_1 * n + i) * m + lane] * dz
                + w[(SIGMA_2 * n + i) * m + lane] * v
            )


@compiled
def _arm(w: NDArray[np.float64], joints: Tag, lanes: Tag) -> None:
    """Take B_h θ̇ + K_h (θ − θ_0) + d from the right-hand side."""
    n, m = len(joints), len(lanes)
    for i in range(n):
        for lane in range(m):
            total = w[(VOLUNTARY * n + i) * m + lane]
            for j in range(n):
                total += w[_matrix_row(DAMPING, i, j, n) * m + lane] * w[
                    (VELOCITY * n + j) * m + lane
                ] + w[_matrix_row(STIFFNESS, i, j, n) * m + lane] * (
                    w[(THETA * n + j) * m + lane] - w[(POSTURE * n + j) * m + lane]
                )
            w[(_RHS * n + i) * m + lane] -= total


@compiled
def _links(w: NDArray[np.float64], joints: Tag, lanes: Tag) -> None:
    """Inertia and centripetal torque of the chain in absolute link angles φ.

    There the kinetic energy is ½ Σ_ab A_ab cos(φ_a − φ_b) φ̇_a φ̇_b with constant A. Since
    φ_a = Σ_{i≤a} θ_i, joint quantities are sums over the links from the joint outwards.
    """
    n, m = len(joints), len(lanes)
    for i in range(n):
        for lane in range(m):
            w[(_CENTRIPETAL * n + i) * m + lane] = 0.0
        for b in range(n):
            for lane in range(m):
                coefficient = w[_matrix_row(CHAIN, i, b, n) * m + lane]
                c_i, s_i = w[(_COSINE * n + i) * m + lane], w[(_SINE * n + i) * m + lane]
                c_b, s_b = w[(_COSINE * n + b) * m + lane], w[(_SINE * n + b) * m + lane]
                w[_matrix_row(_MASS, i, b, n) * m + lane] = coefficient * (c_i * c_b + s_i * s_b)
                w[(_CENTRIPETAL * n + i) * m + lane] += (
                    coefficient * (s_i * c_b - c_i * s_b) * w[(_OMEGA_SQUARED * n + b) * m + lane]
                )


@compiled
def _drive(w: NDArray[np.float64], joints: Tag, lanes: Tag) -> None:
    """Add τ − C θ̇ to the right-hand side."""
    n, m = len(joints), len(lanes)
    for i in range(n - 2, -1, -1):
        for lane in range(m):
            w[(_CENTRIPETAL * n + i) * m + lane] += w[(_CENTRIPETAL * n + i + 1) * m + lane]
    for i in range(n):
        for lane in range(m):
            w[(_RHS * n + i) * m + lane] += (
                w[(COMMAND * n + i) * m + lane] - w[(_CENTRIPETAL * n + i) * m + lane]
            )


@compiled
def _masses(w: NDArray[np.float64], joints: Tag, lanes: Tag) -> None:
    """M_r(θ) + M_h from the inertia of the links: sums over columns, then over rows."""
    n, m = len(joints), len(lanes)
    for i in range(n):
        for b in range(n - 2, -1, -1):
            for lane in range(m):
                w[_matrix_row(_MASS, i, b, n) * m + lane] += w[
                    _matrix_row(_MASS, i, b + 1, n) * m + lane
                ]
    for i in range(n - 2, -1, -1):
        for b in range(n):
            for lane in range(m):
                w[_matrix_row(_MASS, i, b, n) * m + lane] += w[
                    _matrix_row(_MASS, i + 1, b, n) * m + lane
                ]
    for i in range(n):
        for b in range(n):
            for lane in range(m):
                w[_matrix_row(_MASS, i, b, n) * m + lane] += w[
                    _matrix_row(INERTIA, i, b, n) * m + lane
                ]


@compiled
def _solve(w: NDArray[np.float64], joints: Tag, lanes: Tag) -> None:
    """θ̈ = (M_r + M_h)⁻¹ rhs by elimination.

    No pivoting: configuration checks that the symmetric part is positive definite, for which
    elimination in the given order is stable.
    """
    n, m = len(joints), len(lanes)
    for p in range(n):
        for i in range(p + 1, n):
            for lane in range(m):
                factor = (
                    w[_matrix_row(_MASS, i, p, n) * m + lane]
                    / w[_matrix_row(_MASS, p, p, n) * m + lane]
                )
                for j in range(p + 1, n):
                    w[_matrix_row(_MASS, i, j, n) * m + lane] -= (
                        factor * w[_matrix_row(_MASS, p, j, n) * m + lane]
                    )
                w[(_RHS * n + i) * m + lane] -= factor * w[(_RHS * n + p) * m + lane]
    for i in range(n - 1, -1, -1):
        for lane in range(m):
            total = w[(_RHS * n + i) * m + lane]
            for j in range(i + 1, n):
                total -= (
                    w[_matrix_row(_MASS, i, j, n) * m + lane] * w[(_SLOPE_V * n + j) * m + lane]
                )
            w[(_SLOPE_V * n + i) * m + lane] = total / w[_matrix_row(_MASS, i, i, n) * m + lane]


@compiled
def _slopes(w: NDArray[np.float64], joints: Tag, lanes: Tag) -> None:
    """Time derivatives of v and z at the present state (that of θ is v itself)."""
    _kinematics(w, joints, lanes)
    _friction(w, joints, lanes)
    _arm(w, joints, lanes)
    _links(w, joints, lanes)
    _drive(w, joints, lanes)
    _masses(w, joints, lanes)
    _solve(w, joints, lanes)


@compiled
def _stage(
    w: NDArray[np.float64], joints: Tag, lanes: Tag, weight: float, first: bool, ahead: float
) -> None:
    """Evaluate the slopes, add them by ``weight``, and set the state for the next stage."""
    n, m = len(joints), len(lanes)
    _slopes(w, joints, lanes)
    for i in range(n):
        for lane in range(m):
            v = w[(VELOCITY * n + i) * m + lane]
            a = w[(_SLOPE_V * n + i) * m + lane]
            dz = w[(_SLOPE_Z * n + i) * m + lane]
            if first:
                w[(_SUM * n + i) * m + lane] = v
                w[((_SUM + 1) * n + i) * m + lane] = a
                w[((_SUM + 2) * n + i) * m + lane] = dz
            else:
                w[(_SUM * n + i) * m + lane] += weight * v
                w[((_SUM + 1) * n + i) * m + lane] += weight * a
                w[((_SUM + 2) * n + i) * m + lane] += weight * dz
            w[(THETA * n + i) * m + lane] = w[(_START * n + i) * m + lane] + ahead * v
            w[(VELOCITY * n + i) * m + lane] = w[((_START + 1) * n + i) * m + lane] + ahead * a
            w[(BRISTLE * n + i) * m + lane] = w[((_START + 2) * n + i) * m + lane] + ahead * dz


@compiled
def _rk4_step(w: NDArray[np.float64], joints: Tag, lanes: Tag, h: float) -> None:
    """One classical Runge–Kutta step of length h with constant command."""
    n, m = len(joints), len(lanes)
    for row in range(3 * n):
        for lane in range(m):
            w[(_START * n + row) * m + lane] = w[row * m + lane]
    _stage(w, joints, lanes, 1.0, True, 0.5 * h)
    _stage(w, joints, lanes, 2.0, False, 0.5 * h)
    _stage(w, joints, lanes, 2.0, False, h)
    _stage(w, joints, lanes, 1.0, False, 0.0)
    for row in range(3 * n):
        for lane in range(m):
            w[row * m + lane] = (
                w[(_START * n + row) * m + lane] + (h / 6.0) * w[(_SUM * n + row) * m + lane]
            )


@compiled
def _remember(w: NDArray[np.float64], joints: Tag, lanes: Tag) -> None:
    n, m = len(joints), len(lanes)
    for i in range(n):
        for lane in range(m):
            w[(_LAST_THETA * n + i) * m + lane] = w[(THETA * n + i) * m + lane]
            w[(_LAST_VELOCITY * n + i) * m + lane] = w[(VELOCITY * n + i) * m + lane]
            w[(_MEAN_THETA * n + i) * m + lane] = 0.0


@compiled
def _add_to_mean(w: NDArray[np.float64], joints: Tag, lanes: Tag, weight: float) -> None:
    n, m = len(joints), len(lanes)
    for i in range(n):
        for lane in range(m):
            w[(_MEAN_THETA * n + i) * m + lane] += weight * (
                w[(_START * n + i) * m + lane] + w[(THETA * n + i) * m + lane]
            )


@compiled
def _torque(
    w: NDArray[np.float64], joints: Tag, lanes: Tag, theta: int, velocity: int, slope: int
) -> None:
    """TORQUE = M_h a + B_h v + K_h (θ − θ_0) + d with the three vectors taken from given rows."""
    n, m = len(joints), len(lanes)
    for i in range(n):
        for lane in range(m):
            total = w[(VOLUNTARY * n + i) * m + lane]
            for j in range(n):
                total += (
                    w[_matrix_row(INERTIA, i, j, n) * m + lane] * w[(slope * n + j) * m + lane]
                    + w[_matrix_row(DAMPING, i, j, n) * m + lane] * w[(velocity * n + j) * m + lane]
                    + w[_matrix_row(STIFFNESS, i, j, n) * m + lane]
                    * (w[(theta * n + j) * m + lane] - w[(POSTURE * n + j) * m + lane])
                )
            w[(TORQUE * n + i) * m + lane] = total


@compiled_entry
def sample_now(w: NDArray[np.float64], joints: Tag, lanes: Tag) -> None:
    """Torque on the arm at this instant, N·m, under the command still in force, into TORQUE."""
    _slopes(w, joints, lanes)
    _torque(w, joints, lanes, THETA, VELOCITY, _SLOPE_V)


@compiled_entry
def advance(
    w: NDArray[np.float64], joints: Tag, lanes: Tag, steps: int, h: float, interval_mean: bool
) -> None:
    """Advance all lanes by ``steps`` RK4 steps of ``h`` seconds, then sample the torque.

    Parameters
    ----------
    w : (rows(n) · lanes,)
        The batch; its COMMAND and VOLUNTARY rows are held constant (zero-order hold).
    joints, lanes : tuples of n and of the number of lanes zeros
        Carry the two numbers as compile-time constants.
    steps : int
        Number of steps.
    h : s
        Length of one.
    interval_mean : bool
        Whether TORQUE is the mean over the interval rather than its value at the end.
    """
    n, m = len(joints), len(lanes)
    _remember(w, joints, lanes)
    for _ in range(steps):
        _rk4_step(w, joints, lanes, h)
        _add_to_mean(w, joints, lanes, 0.5 / steps)
    if not interval_mean:
        sample_now(w, joints, lanes)
        return
    period = steps * h
    for i in range(n):
        for lane in range(m):
            w[(_SLOPE_V * n + i) * m + lane] = (
                w[(VELOCITY * n + i) * m + lane] - w[(_LAST_VELOCITY * n + i) * m + lane]
            ) / period
            # The mean velocity takes the place of the last one, which is no longer needed.
            w[(_LAST_VELOCITY * n + i) * m + lane] = (
                w[(THETA * n + i) * m + lane] - w[(_LAST_THETA * n + i) * m + lane]
            ) / period
    _torque(w, joints, lanes, _MEAN_THETA, _LAST_VELOCITY, _SLOPE_V)


@compiled_entry
def stiffness_ratio(w: NDArray[np.float64], joints: Tag, lanes: Tag, h: float) -> float:
    """Largest h·σ0|v|/g(v) of all joints and lanes, for the step-stability check.

    Parameters
    ----------
    w : (rows(n) · lanes,)
        The batch.
    joints, lanes : tuples of n and of the number of lanes zeros
        Carry the two numbers as compile-time constants.
    h : s

    Returns
    -------
    float
        Not finite if the velocity of any joint in any lane is not.
    """
    n, m = len(joints), len(lanes)
    worst = 0.0
    for i in range(n):
        for lane in range(m):
            v = w[(VELOCITY * n + i) * m + lane]
            x = v * w[(INVERSE_STRIBECK_VELOCITY * n + i) * m + lane]
            g = w[(COULOMB * n + i) * m + lane] + w[(STRIBECK * n + i) * m + lane] * exp_minus(
                x * x
            )
            ratio = h * w[(SIGMA_0 * n + i) * m + lane] * abs(v) / g
            if np.isnan(ratio):
                return np.nan
            worst = max(worst, ratio)
    return worst
