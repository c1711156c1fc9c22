"""The compiled plant: equations of motion and RK4, for many trials side by side.

Each trial has a lane, and lanes are grouped in blocks of equal width. The numbers of a batch fill
an array (blocks, quantities, width), with a place in each quantity for each lane of a block. A
block goes through a whole control period on its own, so its numbers stay in the processor's
registers and first-level cache. The width and the number of joints n are compile-time constants,
carried by the lengths of two tuples; arithmetic is on all lanes of a block at once
(:mod:`armimp_sim.simd`). A block of width 1 is the ordinary single trial; its arithmetic is the
same operation by operation, so a lane gives the same bits in any batch.

Places in a block (n times the width each unless said otherwise), in the order of :func:`rows`:
state θ, v, z; input τ, d; parameters; work space.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from armimp_common.arrays import FloatArray
from armimp_common.compiled import compiled, compiled_entry
from armimp_sim.model.friction import bristle_force, lugre
from armimp_sim.simd import Tag, fill, load, sine_cosine, store

WIDTH = 8
"""Lanes of a block if there are several: the widest registers hold as many. Twice as many are only
a tenth faster, and leave more lanes unused; the unused ones of the last block are at rest."""

# Vectors, in units of n rows: state, inputs, parameters, outputs, work space.
THETA, VELOCITY, BRISTLE = 0, 1, 2
COMMAND, VOLUNTARY = 3, 4
POSTURE = 5
COULOMB, STRIBECK, INVERSE_STRIBECK_VELOCITY = 6, 7, 8  # Fc, Fs − Fc, 1/vs
SIGMA_0, SIGMA_1, SIGMA_2 = 9, 10, 11
TORQUE = 12  # torque on the arm at the last sample
_START = 13  # state at the start of the RK4 step: 3 vectors
_SUM = 16  # weighted sum of the slopes: 3 vectors
_SLOPE_V, _SLOPE_Z = 19, 20
_COSINE, _SINE, _OMEGA_SQUARED = 21, 22, 23
_CENTRIPETAL, _RHS = 24, 25
VECTORS = 26
# n×n matrices follow the vectors.
INERTIA, DAMPING, STIFFNESS, CHAIN, _MASS = 0, 1, 2, 3, 4
MATRICES = 5


class Batch(NamedTuple):
    """A batch of plants, in the form that compiled code takes."""

    w: FloatArray
    """(blocks, rows(n), width) all numbers of the plants."""
    joints: Tag
    width: Tag
    """Tuples of zeros, n of them and as many as a block is wide."""
    substeps: int
    step: float
    """Number and length (s) of the RK4 steps of a period."""
    interval_mean: bool
    """Whether torque is read as the mean over the period."""
    resolutions: FloatArray
    """(lanes, 2) of encoders, rad, and torque transducers, N·m."""
    position: FloatArray
    torque: FloatArray
    """(lanes, n) readings, rad and N·m."""


def rows(n: int) -> int:
    """Return the number of quantities of a lane with n joints."""
    return VECTORS * n + MATRICES * n * n


@compiled
def _get(w: FloatArray, row: int, width: Tag) -> float:
    return load(w, row * len(width), (width,))


@compiled
def _put(w: FloatArray, row: int, width: Tag, value: float) -> None:
    store(w, row * len(width), value)


@compiled
def _vector(w: FloatArray, which: int, joints: Tag, width: Tag) -> float:
    """Return one quantity of all joints: where they don't act on each other, they go together."""
    return load(w, which * len(joints) * len(width), (joints, width))


@compiled
def _put_vector(w: FloatArray, which: int, joints: Tag, width: Tag, values: float) -> None:
    store(w, which * len(joints) * len(width), values)


@compiled
def _matrix_row(which: int, i: int, j: int, n: int) -> int:
    return VECTORS * n + which * n * n + i * n + j


@compiled
def _kinematics(w: FloatArray, joints: Tag, width: Tag) -> None:
    """Compute sines and cosines of the absolute link angles, and squared absolute rates."""
    n = len(joints)
    # The dynamics depend on differences of angles only, so the first link is put at zero.
    angle = fill(0.0, width)
    rate = _get(w, VELOCITY * n, width)
    _put(w, _COSINE * n, width, fill(1.0, width))
    _put(w, _SINE * n, width, angle)
    _put(w, _OMEGA_SQUARED * n, width, rate * rate)
    for a in range(1, n):
        angle += _get(w, THETA * n + a, width)
        rate += _get(w, VELOCITY * n + a, width)
        s, c = sine_cosine(angle)
        _put(w, _COSINE * n + a, width, c)
        _put(w, _SINE * n + a, width, s)
        _put(w, _OMEGA_SQUARED * n + a, width, rate * rate)


@compiled
def _bristle_force(w: FloatArray, v: float, joints: Tag, width: Tag) -> float:
    """Return LuGre's g(v) of all joints."""
    return bristle_force(
        v,
        _vector(w, COULOMB, joints, width),
        _vector(w, STRIBECK, joints, width),
        _vector(w, INVERSE_STRIBECK_VELOCITY, joints, width),
    )


@compiled
def _friction(w: FloatArray, joints: Tag, width: Tag) -> None:
    """Compute the slopes of the bristles' deflections, and subtract F from the right-hand side."""
    v = _vector(w, VELOCITY, joints, width)
    dz, force = lugre(
        v,
        _vector(w, BRISTLE, joints, width),
        _bristle_force(w, v, joints, width),
        _vector(w, SIGMA_0, joints, width),
        _vector(w, SIGMA_1, joints, width),
        _vector(w, SIGMA_2, joints, width),
    )
    _put_vector(w, _SLOPE_Z, joints, width, dz)
    _put_vector(w, _RHS, joints, width, _vector(w, _RHS, joints, width) - force)


@compiled
def _arm(w: FloatArray, joints: Tag, width: Tag) -> None:
    """Subtract B_h θ̇ + K_h (θ − θ_0) + d from the right-hand side."""
    n = len(joints)
    for i in range(n):
        total = _get(w, VOLUNTARY * n + i, width)
        for j in range(n):
            angle = _get(w, THETA * n + j, width) - _get(w, POSTURE * n + j, width)
            total += (
                _get(w, _matrix_row(DAMPING, i, j, n), width) * _get(w, VELOCITY * n + j, width)
                + _get(w, _matrix_row(STIFFNESS, i, j, n), width) * angle
            )
        _put(w, _RHS * n + i, width, -total)


@compiled
def _links(w: FloatArray, joints: Tag, width: Tag) -> None:
    """Compute inertia and centripetal torque of the chain in absolute link angles φ.

    There the kinetic energy is ½ Σ_ab A_ab cos(φ_a − φ_b) φ̇_a φ̇_b with constant A. Since
    φ_a = Σ_{i≤a} θ_i, joint quantities are sums over the links from the joint outwards.
    """
    n = len(joints)
    for a in range(n):
        _put(w, _matrix_row(_MASS, a, a, n), width, _get(w, _matrix_row(CHAIN, a, a, n), width))
        _put(w, _CENTRIPETAL * n + a, width, fill(0.0, width))
    for a in range(n):
        c_a, s_a = _get(w, _COSINE * n + a, width), _get(w, _SINE * n + a, width)
        for b in range(a + 1, n):
            c_b, s_b = _get(w, _COSINE * n + b, width), _get(w, _SINE * n + b, width)
            coefficient = _get(w, _matrix_row(CHAIN, a, b, n), width)
            cosine = coefficient * (c_a * c_b + s_a * s_b)
            _put(w, _matrix_row(_MASS, a, b, n), width, cosine)
            _put(w, _matrix_row(_MASS, b, a, n), width, cosine)
            sine = coefficient * (s_a * c_b - c_a * s_b)
            _accumulate(
                w, _CENTRIPETAL * n + a, sine * _get(w, _OMEGA_SQUARED * n + b, width), width
            )
            _accumulate(
                w, _CENTRIPETAL * n + b, -sine * _get(w, _OMEGA_SQUARED * n + a, width), width
            )


@compiled
def _drive(w: FloatArray, joints: Tag, width: Tag) -> None:
    """Add τ − C θ̇ to the right-hand side."""
    n = len(joints)
    outwards = fill(0.0, width)
    for i in range(n - 1, -1, -1):
        outwards = _get(w, _CENTRIPETAL * n + i, width) + outwards
        torque = _get(w, COMMAND * n + i, width) - outwards
        _put(w, _RHS * n + i, width, _get(w, _RHS * n + i, width) + torque)


@compiled
def _masses(w: FloatArray, joints: Tag, width: Tag) -> None:
    """Compute M_r(θ) + M_h from the inertia of the links: sum over columns, then over rows."""
    n = len(joints)
    first, arm = _matrix_row(_MASS, 0, 0, n), _matrix_row(INERTIA, 0, 0, n)
    for i in range(n):
        for b in range(n - 2, -1, -1):
            row = first + i * n + b
            _accumulate(w, row, _get(w, row + 1, width), width)
    for element in range(n * (n - 1) - 1, -1, -1):
        _accumulate(w, first + element, _get(w, first + element + n, width), width)
    for element in range(n * n):
        _accumulate(w, first + element, _get(w, arm + element, width), width)


@compiled
def _accumulate(w: FloatArray, row: int, value: float, width: Tag) -> None:
    """Add a value to a quantity."""
    _put(w, row, width, _get(w, row, width) + value)


@compiled
def _solve(w: FloatArray, joints: Tag, width: Tag) -> None:
    """Solve θ̈ = (M_r + M_h)⁻¹ rhs by elimination.

    Without pivoting: configuration checks that the symmetric part is positive definite, for which
    elimination in the given order is stable.
    """
    n = len(joints)
    for p in range(n):
        pivot = _matrix_row(_MASS, p, p, n)
        inverse = 1.0 / _get(w, pivot, width)  # what needs the right-hand side only multiplies
        _put(w, pivot, width, inverse)
        for i in range(p + 1, n):
            factor = _get(w, _matrix_row(_MASS, i, p, n), width) * inverse
            for j in range(p + 1, n):
                row, above = _matrix_row(_MASS, i, j, n), _matrix_row(_MASS, p, j, n)
                value = _get(w, row, width) - factor * _get(w, above, width)
                _put(w, row, width, value)
            value = _get(w, _RHS * n + i, width) - factor * _get(w, _RHS * n + p, width)
            _put(w, _RHS * n + i, width, value)
    for i in range(n - 1, -1, -1):
        total = _get(w, _RHS * n + i, width)
        for j in range(i + 1, n):
            total -= _get(w, _matrix_row(_MASS, i, j, n), width) * _get(w, _SLOPE_V * n + j, width)
        _put(w, _SLOPE_V * n + i, width, total * _get(w, _matrix_row(_MASS, i, i, n), width))


@compiled
def _slopes(w: FloatArray, joints: Tag, width: Tag) -> None:
    """Compute the time derivatives of v and z at the present state (that of θ is v itself)."""
    _kinematics(w, joints, width)
    _arm(w, joints, width)
    _links(w, joints, width)
    _drive(w, joints, width)
    _masses(w, joints, width)
    _friction(w, joints, width)  # last: it takes longest, and only _solve waits for it
    _solve(w, joints, width)


@compiled
def rk4_step(w: FloatArray, joints: Tag, width: Tag, h: float) -> None:
    """Take one classical Runge–Kutta step of length h with constant command."""
    n = len(joints)
    for row in range(3 * n):
        _put(w, _START * n + row, width, _get(w, row, width))
        _put(w, _SUM * n + row, width, fill(0.0, width))
    for stage in range(4):
        # Weight of these slopes in the sum, and how far they lead to the next stage.
        weight = 2.0 if 1 <= stage <= 2 else 1.0
        ahead = 0.5 * h if stage < 2 else h
        _slopes(w, joints, width)
        for row in range(3 * n):
            if row < n:
                slope = _get(w, VELOCITY * n + row, width)
            else:
                slope = _get(w, _SLOPE_V * n + row - n, width)
            total = _get(w, _SUM * n + row, width) + weight * slope
            _put(w, _SUM * n + row, width, total)
            next_value = _get(w, _START * n + row, width) + ahead * slope
            _put(w, row, width, next_value)
    for row in range(3 * n):
        total = (h / 6.0) * _get(w, _SUM * n + row, width)
        _put(w, row, width, _get(w, _START * n + row, width) + total)


@compiled
def sample_block(w: FloatArray, joints: Tag, width: Tag) -> None:
    """Set TORQUE = M_h θ̈ + B_h θ̇ + K_h (θ − θ_0) + d in a block, as :func:`sample_now`."""
    n = len(joints)
    _slopes(w, joints, width)
    for i in range(n):
        total = _get(w, VOLUNTARY * n + i, width)
        for j in range(n):
            angle = _get(w, THETA * n + j, width) - _get(w, POSTURE * n + j, width)
            total += (
                _get(w, _matrix_row(INERTIA, i, j, n), width) * _get(w, _SLOPE_V * n + j, width)
                + _get(w, _matrix_row(DAMPING, i, j, n), width) * _get(w, VELOCITY * n + j, width)
                + _get(w, _matrix_row(STIFFNESS, i, j, n), width) * angle
            )
        _put(w, TORQUE * n + i, width, total)


@compiled_entry
def sample_now(batch: Batch) -> None:
    """Put the torque on the arm at this instant, N·m, under the present command, into TORQUE."""
    for block in batch.w:
        sample_block(block, batch.joints, batch.width)


@compiled_entry
def advance(batch: Batch) -> None:
    """Advance all lanes by a period, with COMMAND and VOLUNTARY held, then sample the torque."""
    for block in batch.w:
        for _ in range(batch.substeps):
            rk4_step(block, batch.joints, batch.width, batch.step)
        sample_block(block, batch.joints, batch.width)


@compiled_entry
def stiffness_ratio(batch: Batch) -> float:
    """Return the largest h·σ0|v|/g(v) of all joints and lanes, for the check of the step.

    It is not finite if the velocity of any joint in any lane is not.
    """
    joints, width = batch.joints, batch.width
    ratios = np.empty(len(joints) * len(width))
    worst = 0.0
    for block in batch.w:
        v = _vector(block, VELOCITY, joints, width)
        level = _bristle_force(block, v, joints, width)
        store(ratios, 0, batch.step * _vector(block, SIGMA_0, joints, width) * abs(v) / level)
        for ratio in ratios:
            if np.isnan(ratio):
                return np.nan
            worst = max(worst, ratio)
    return worst
